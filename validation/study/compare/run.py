"""Two gaits side by side: what continuity at the switches buys, and where it buys nothing.

Both sides are walked (or loaded) and asked the same questions about the instants at which support changes:
what does the plan demand there, what do the joints of the whole-body motion have to do as its grid is
refined, what does the measured ground force do, how far is the ZMP off, how fast do torques change, how much
feedback is needed. Metrics of the whole run stand beside them, so that a gain at the switches is seen against
the rest.

How far a measured value is from that of a vanishing time step only a convergence study says: without one no
value of a walk is called better, however large the difference.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ampm.body.motion import WholeBodyMotion
from ampm.body.orbit import solve_motion
from ampm.body.robot import Robot
from ampm.exceptions import InputError
from ampm.planner.periodic import plan_gait
from ampm.planner.support import StepPlan, plan_steps
from ampm.run_file import load_run
from validation.judge.uncertainty import Uncertainty, load_uncertainty, matching
from validation.progress import Progress
from validation.run.validate import Options, validate
from validation.show.text import format_number
from validation.store.folders import check_run_folder, check_target
from validation.store.json import json_ready
from validation.store.saved import RUN_FILE, SavedRun, load_saved_run
from validation.study.compare.metrics import (
    GRIDS,
    Quantity,
    metric_values,
    quantities,
    si_unit,
    switch_figures,
)
from validation.trial.plan import Request, load_request, make_body, motion_cache

EVEN = 1.25
"""Ratio of two values within which neither side is called better."""
REPORT, NUMBERS, PICTURE = "report.html", "comparison.json", "switches.svg"


@dataclass(frozen=True)
class Joints:
    """What the joints of the periodic motion do at a switch, on finer and finer grids.

    Attributes:
        grid: largest step of each grid, descending, shape (n,) [s].
        jump: largest change of a joint's acceleration over the grid interval that ends at a switch, shape
            (n,) [rad/s^2].
        limit: what the two finest grids say is left without a grid [rad/s^2]: a jump that stays is the
            motion's, one that vanishes was the grid's.
        joint: the joint with the largest limit.
    """

    grid: tuple[float, ...]
    jump: tuple[float, ...]
    limit: float
    joint: str


@dataclass(frozen=True)
class Side:
    """One of the two gaits, walked.

    Attributes:
        label: how tables call it.
        saved: its run.
        plan: in closed form.
        joints: of its motion.
        completed: whether it walked to the end.
        outcome: name of the outcome.
    """

    label: str
    saved: SavedRun
    plan: StepPlan
    joints: Joints
    completed: bool
    outcome: str


@dataclass(frozen=True)
class Row:
    """One quantity of both sides.

    Attributes:
        of: the quantity.
        a: value of the first side as shown, NaN if it has none.
        b: of the second side.
        u_a: numerical uncertainty of ``a``: 0 where nothing is walked, infinite without bound, NaN unknown.
        u_b: of ``b``.
    """

    of: Quantity
    a: float
    b: float
    u_a: float = math.nan
    u_b: float = math.nan

    @property
    def ratio(self) -> float | None:
        """Second over first value; None if one is missing, or noise."""
        known = math.isfinite(self.a) and math.isfinite(self.b)
        return self.b / self.a if known and min(self.a, self.b) >= self.of.least else None

    @property
    def better(self) -> str:
        """``a``, ``b``, or ``even`` where they differ by less than :data:`EVEN`.

        Empty where nothing can be said: a value is missing, its numerical uncertainty is not known, or the
        difference is within that of both.
        """
        u = self.u_a + self.u_b
        if not (math.isfinite(self.a) and math.isfinite(self.b) and math.isfinite(u)):
            return ""
        if u > 0.0 and abs(self.a - self.b) <= u:
            return ""
        ratio = max(self.b, self.of.least) / max(self.a, self.of.least)
        return "a" if ratio > EVEN else "b" if ratio < 1.0 / EVEN else "even"


@dataclass(frozen=True)
class Pair:
    """Both sides and all that they are compared by.

    Attributes:
        a: first side.
        b: second side.
        rows: quantities, group by group.
        studies: convergence study of either side; None without.
    """

    a: Side
    b: Side
    rows: tuple[Row, ...]
    studies: tuple[Uncertainty, Uncertainty] | None = None

    @property
    def groups(self) -> Mapping[str, list[Row]]:
        """Rows by their heading."""
        found: dict[str, list[Row]] = {}
        for row in self.rows:
            found.setdefault(row.of.group, []).append(row)
        return found

    @property
    def parameters(self) -> dict[str, tuple[Any, Any]]:
        """Key to the values of both sides, of every parameter in which they differ."""
        one, two = (side.saved.parameters.model_dump() for side in (self.a, self.b))
        return {
            f"{section}.{key}": (value, two[section][key])
            for section, entries in one.items()
            for key, value in entries.items()
            if value != two[section][key]
        }

    def won(self, better: str) -> dict[str, list[str]]:
        """Group to the labels of its rows in which one side is better, neither is, or nothing is said."""
        found = {
            group: [row.of.label for row in rows if row.better == better]
            for group, rows in self.groups.items()
        }
        return {group: labels for group, labels in found.items() if labels}

    def unbounded(self, count: int = 5) -> list[Row]:
        """Rows of the largest ratios among those of which nothing is said."""
        open_rows = [row for row in self.rows if row.better == "" and row.ratio]
        return sorted(open_rows, key=lambda row: -abs(math.log(row.ratio or 1.0)))[:count]

    def as_dict(self) -> dict[str, Any]:
        """Everything, as plain data."""
        sides = {
            key: {
                "name": side.label,
                "outcome": side.outcome,
                "steps_completed": side.saved.record.outcome.steps_completed,
                "model": side.saved.parameters.gait.model,
                "step_length": side.saved.parameters.gait.step_length,
                "switching_velocity": side.saved.parameters.gait.switching_velocity,
                "mean_velocity": side.plan.constants.mean_velocity,
                "single_support_duration": side.plan.constants.single_support_duration,
                "double_support_duration": side.plan.constants.double_support_duration,
                "joint_acceleration_jump": {
                    "grid": side.joints.grid,
                    "jump": side.joints.jump,
                    "limit": side.joints.limit,
                    "joint": side.joints.joint,
                },
            }
            for key, side in (("a", self.a), ("b", self.b))
        }
        values = {
            row.of.name: {
                "group": row.of.group,
                "label": row.of.label,
                "unit": row.of.unit,
                "a": row.a,
                "b": row.b,
                "ratio": row.ratio,
                "uncertainty": {"a": row.u_a, "b": row.u_b},
                "better": row.better,
            }
            for row in self.rows
        }
        studies = None if self.studies is None else [study.as_dict() for study in self.studies]
        rest = {"parameters": self.parameters, "uncertainty": studies, "figures": values}
        return dict(json_ready({**sides, **rest}))


def compare_pair(
    a: str,
    b: str,
    settings: Sequence[str] = (),
    *,
    uncertainty: Sequence[Path] = (),
    out: Path | None = None,
    force: bool = False,
    stages: Progress | None = None,
) -> Pair:
    """Walk or load two gaits and compare them.

    Args:
        a: preset, TOML file, or folder of a run.
        b: likewise.
        settings: ``key=value`` texts for the gaits that are to be walked.
        uncertainty: ``convergence.json`` of both gaits; without, no value of a walk is called better.
        out: folder that keeps the runs that are walked, and that
            :func:`validation.study.compare.report.write_pair` will fill; None keeps nothing.
        force: replace an earlier comparison in ``out``.
        stages: where to report progress.

    Raises:
        InputError, MathematicalRefusal, BodilyRefusal: a gait or folder cannot be used.
    """
    stages = stages or Progress()
    sources = [_source(text, settings) for text in (a, b)]
    if settings and all(isinstance(source, Path) for source in sources):
        raise InputError(
            "both sides are runs that are already walked: --set has nothing to change; leave it out."
        )
    labels = _labels(sources)
    for label, source in zip(labels, sources, strict=True):
        if isinstance(source, Request):  # refuse bad mathematics before anything walks
            plan_gait(source.run.gait, source.run.body.mass)
        elif not (source / "summary.json").is_file():
            raise InputError(
                f"{label} is no folder of a finished run; give a preset, a TOML file or a run's folder."
            )
    studies = _studies(sources, labels, uncertainty)
    folders = _folders(out, labels, sources, force=force)
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="ampm-compare-") if out is None else nullcontext(out) as place:
        sides = []
        for label, source, folder in zip(labels, sources, folders, strict=True):
            if isinstance(source, Request):
                target = folder or Path(place) / label
                options = Options(force=force, recording=out is not None)
                summary = validate(source, target, options, progress=stages)
                if summary["outcome"] == "interrupted":  # the other one is not wanted either
                    raise KeyboardInterrupt
                source = target
            sides.append(_side(label, source, stages))
        return pair_of(*sides, studies=studies)


def _source(text: str, settings: Sequence[str]) -> Request | Path:
    """A gait to walk, or the folder of a run."""
    if Path(text).is_dir():
        return Path(text)
    return load_request(text, settings)


def _studies(
    sources: Sequence[Request | Path], labels: Sequence[str], files: Sequence[Path]
) -> tuple[Uncertainty, Uncertainty] | None:
    """The convergence study of either side, before anything walks.

    Raises:
        InputError: a file is none, or none is of one of the gaits.
    """
    if not files:
        return None
    known = [load_uncertainty(file) for file in files]
    a, b = (
        matching(known, s if isinstance(s, Request) else Request(label, load_run(s / RUN_FILE, ())))
        for label, s in zip(labels, sources, strict=True)
    )
    return a, b


def _labels(sources: Sequence[Request | Path]) -> list[str]:
    """Names for tables; two of one name are told apart by a number."""
    names = [s.name if isinstance(s, Request) else s.resolve().name for s in sources]
    if names[0] == names[1]:
        if all(isinstance(source, Request) for source in sources):
            raise InputError(
                f"both gaits are named {names[0]!r}; give two different ones, or folders of runs."
            )
        names = [f"{name}-{number}" for number, name in enumerate(names, start=1)]
    return names


def _folders(
    out: Path | None, labels: Sequence[str], sources: Sequence[Request | Path], *, force: bool
) -> list[Path | None]:
    """Where each run that is to be made goes; refuses what must not be written.

    Raises:
        InputError: ``out`` is a file, holds something else, or holds a comparison and ``force`` is off.
    """
    if out is None:
        return [None, None]
    check_target(out, None, force=force, what="comparison", marks=(NUMBERS, PICTURE))
    folders = [
        out / name if isinstance(s, Request) else None for name, s in zip(labels, sources, strict=True)
    ]
    for folder in folders:
        if folder is not None:
            check_run_folder(folder, force=force)
    return folders


def _side(label: str, folder: Path, stages: Progress) -> Side:
    """Load a run and solve its motion on all grids."""
    saved = load_saved_run(folder)
    if not len(saved.signals):
        raise InputError(f"{label} ended before its first instant; there is nothing to compare.")
    run = saved.parameters
    with stages.stage(f"{label}: motion on {len(GRIDS)} grids") as stage:
        body = make_body(run)
        sole = body.model.description.sole
        plan = plan_steps(run.gait, run.body.mass, run.foot, sole)
        motions = []
        for step in GRIDS:
            finer = run.replace({"solver.ik_time_step": step})
            motions.append(solve_motion(plan, finer, body.robot, progress=stage.note, cache=motion_cache()))
        joints = joint_jumps(motions, body.robot, GRIDS)
    outcome = saved.record.outcome
    return Side(label, saved, plan, joints, outcome.completed, str(outcome.name))


def joint_jumps(motions: Sequence[WholeBodyMotion], robot: Robot, grids: Sequence[float]) -> Joints:
    """Change of joint accelerations over the grid interval that ends at a switch, and what is left of it.

    Args:
        motions: of one gait, on finer and finer grids.
        robot: the body.
        grids: the largest step of each, only reported [s].
    """
    steps, changes = [], []
    for motion in motions:
        a, time = motion.acceleration[:, 6:], motion.time
        switch = int(np.searchsorted(time, motion.double_support_start - 1e-9))
        # The step begins with a switch too: the interval before it is the step's last one, mirrored.
        changes.append(np.stack([a[switch] - a[switch - 1], a[0] - robot.mirror_joints(a[-2])]))
        steps.append(np.array([time[switch] - time[switch - 1], time[-1] - time[-2]])[:, None])
    # A continuous acceleration changes in proportion to the step; what is left at none is a jump.
    h, finer = steps[-2:]
    limit = np.abs((changes[-1] * h - changes[-2] * finer) / (h - finer))
    joint = int(limit.max(axis=0).argmax())
    return Joints(
        grid=tuple(grids),
        jump=tuple(float(np.abs(change).max()) for change in changes),
        limit=float(limit.max()),
        joint=robot.joint_names[joint],
    )


def pair_of(a: Side, b: Side, *, studies: tuple[Uncertainty, Uncertainty] | None = None) -> Pair:
    """All quantities of two walked sides, with the numerical uncertainty that the studies found."""
    values_a, values_b = _values(a), _values(b)
    study_a, study_b = studies or (None, None)
    rows = tuple(
        Row(
            item,
            values_a[item.name],
            values_b[item.name],
            _uncertainty(item, a, study_a),
            _uncertainty(item, b, study_b),
        )
        for item in quantities(a.plan.mass * a.plan.gravity)
    )
    return Pair(a, b, rows, studies)


def _uncertainty(item: Quantity, side: Side, study: Uncertainty | None) -> float:
    """Of one quantity, as shown."""
    if not item.walked:
        return 0.0
    if study is None:
        return math.nan
    record = side.saved.record
    return study.bounds.get(item.studied_name, math.nan) / si_unit(item.unit, record.mass * record.gravity)[0]


def _values(side: Side) -> dict[str, float]:
    """Every quantity of one side, as shown."""
    plan, record = side.plan, side.saved.record
    residuals = plan.residuals()
    jump, height = residuals.acceleration * plan.gravity, plan.centroidal.com_height
    return {
        "plan_acceleration": jump,
        "plan_force": 100.0 * jump / plan.gravity,
        "plan_zmp": 1e3 * residuals.zmp * height,
        "plan_moment": residuals.moment * plan.centroidal.weight * height,
        "joint_limit": side.joints.limit,
        **{f"joint_{1e3 * h:g}ms": j for h, j in zip(side.joints.grid, side.joints.jump, strict=True)},
        **switch_figures(plan, side.saved.signals, record),
        **metric_values(side.saved.summary, record.mass * record.gravity),
    }


def facts(pair: Pair) -> list[tuple[str, str, str]]:
    """What both gaits are: name of the fact, first side, second side."""

    def both(label: str, tell: Any) -> tuple[str, str, str]:
        return label, tell(pair.a), tell(pair.b)

    return [
        both("outcome", lambda s: f"{s.outcome}, {s.saved.record.outcome.steps_completed} steps"),
        both("model", lambda s: s.saved.parameters.gait.model),
        both("step length", lambda s: f"{s.saved.parameters.gait.step_length:g} m"),
        both("speed at a switch", lambda s: f"{s.saved.parameters.gait.switching_velocity:g} m/s"),
        both("mean speed", lambda s: f"{s.plan.constants.mean_velocity:.3f} m/s"),
        both("single support", lambda s: f"{s.plan.constants.single_support_duration:.3f} s"),
        both("double support", lambda s: f"{s.plan.constants.double_support_duration:.3f} s"),
        both("joint that jumps most", lambda s: s.joints.joint.replace("_", " ")),
    ]


def verdicts(pair: Pair) -> list[tuple[str, str]]:
    """Values of :attr:`Row.better`, and the words for them."""
    return [
        ("a", f"{pair.a.label} is better in"),
        ("even", "no difference in"),
        ("b", f"{pair.b.label} is better in"),
        ("", "nothing is said of"),
    ]


def known(pair: Pair) -> str:
    """What a difference is held against, in a sentence or two."""
    if pair.studies is None:
        return (
            "No convergence study was given (--uncertainty FILE, one per gait): of the walks no value is "
            "called better, only of plan and motion, which are not simulated."
        )
    told = []
    for side, study in zip((pair.a, pair.b), pair.studies, strict=True):
        inside = " + ".join(study.studies) or "no numerical study"
        lacking = f", not studied: {', '.join(study.not_studied)}" if study.not_studied else ""
        told.append(f"of {side.label} ({inside}{lacking})")
    return (
        f"A difference within the sum of both numerical uncertainties, {' and '.join(told)}, is no result, "
        "nor is one of a value whose uncertainty is not known."
    )


def shown(value: float) -> str:
    """A value for a table: rounding errors are 0."""
    return "0" if abs(value) < 1e-9 else format_number(value, 3)


def ratio(row: Row) -> str:
    """Second over first value, for a table."""
    if row.ratio is None:
        return ""
    return "> 1000" if row.ratio > 1000.0 else "< 0.001" if row.ratio < 1e-3 else format_number(row.ratio, 3)
