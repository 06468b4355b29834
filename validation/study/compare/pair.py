"""Comparison of two gaits, mainly at the switches of support.

Both sides are walked or loaded. At the switches they are compared by jumps of the plan, jumps of joint
accelerations on finer grids, measured ground force, ZMP error, torque rates, feedback. Metrics of the whole
run are compared, too.

Only a convergence study gives the numerical uncertainty of a measured value. Without one no value of a walk
is called better, however large the difference.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ampm.body.motion import WholeBodyMotion
from ampm.body.orbit import solve_motion
from ampm.body.robot import Robot
from ampm.brief import Brief
from ampm.exceptions import InputError
from ampm.planner.support import StepPlan, plan_steps
from ampm.run_file import load_run
from validation.judge.uncertainty import Uncertainty, load_uncertainty, matching
from validation.progress import Progress
from validation.run.validate import validate
from validation.store.folders import check_run_folder, check_target
from validation.store.identity import parameter_values
from validation.store.json import json_ready
from validation.store.saved import RUN_FILE, SUMMARY_FILE, SavedRun, load_saved_run
from validation.study.compare.metrics import GRIDS, Quantity, metric_values, quantities, switch_values
from validation.trial.plan import Request, check_formula, complete, load_request, make_body

REPORT, NUMBERS, PICTURE = "report.html", "comparison.json", "switches.svg"
EVEN = 1.25
"""Ratio of two values within which neither side is called better."""


@dataclass(frozen=True)
class Joints:
    """Joint accelerations of the periodic motion at a switch, on finer and finer grids.

    Attributes:
        grid: largest step of each grid, descending, shape (n,) [s].
        jump: largest change of a joint's acceleration over the grid interval that ends at a switch, shape
            (n,) [rad/s^2].
        limit: value extrapolated from the two finest grids [rad/s^2]: zero for a continuous acceleration.
        joint: the joint with the largest limit.
    """

    grid: tuple[float, ...]
    jump: tuple[float, ...]
    limit: float
    joint: str


@dataclass(frozen=True)
class Side(Brief):
    """One of the two gaits, walked.

    Attributes:
        label: name in tables.
        saved: its run.
        plan: in closed form.
        joints: of its motion.
        outcome: name of the outcome.
    """

    label: str
    saved: SavedRun
    plan: StepPlan
    joints: Joints
    outcome: str

    @property
    def weight(self) -> float:
        """Of the body [N]."""
        return self.saved.record.mass * self.saved.record.gravity

    def values(self) -> dict[str, float]:
        """Every quantity, as shown."""
        residuals, height = self.plan.residuals(), self.plan.com_height
        jump = residuals.acceleration * self.plan.gravity
        return {
            "plan_acceleration": jump,
            "plan_force": 100.0 * jump / self.plan.gravity,
            "plan_zmp": 1e3 * residuals.zmp * height,
            "plan_moment": residuals.moment * self.plan.weight * height,
            "joint_limit": self.joints.limit,
            **{f"joint_{1e3 * h:g}ms": j for h, j in zip(self.joints.grid, self.joints.jump, strict=True)},
            **switch_values(self.plan, self.saved.signals, self.saved.record),
            **metric_values(self.saved.summary, self.weight),
        }

    def as_dict(self) -> dict[str, Any]:
        """Facts about the gait: lengths in m, speeds in m/s, durations in s."""
        gait, constants = self.saved.parameters.gait, self.plan.constants
        return {
            "name": self.label,
            "outcome": self.outcome,
            "steps_completed": self.saved.record.outcome.steps_completed,
            "model": gait.model,
            "step_length": gait.step_length,
            "switching_velocity": gait.switching_velocity,
            "mean_velocity": constants.mean_velocity,
            "single_support_duration": constants.single_support_duration,
            "double_support_duration": constants.double_support_duration,
            "joint_acceleration_jump": self.joints,
        }


class Row(NamedTuple):
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

        Empty where undecided: a value is missing, its numerical uncertainty is not known, or the
        difference is within that of both.
        """
        u = self.u_a + self.u_b
        if not all(map(math.isfinite, (self.a, self.b, u))):
            return ""
        if u > 0.0 and abs(self.a - self.b) <= u:
            return ""
        ratio = max(self.b, self.of.least) / max(self.a, self.of.least)
        return "a" if ratio > EVEN else "b" if ratio < 1.0 / EVEN else "even"


@dataclass(frozen=True)
class Pair(Brief):
    """Both sides and all their compared quantities.

    Attributes:
        a: first side.
        b: second side.
        rows: quantities, group by group.
        studies: convergence study of either side; empty without.
    """

    a: Side
    b: Side
    rows: tuple[Row, ...]
    studies: tuple[Uncertainty, ...] = ()

    @property
    def parameters(self) -> dict[str, tuple[Any, Any]]:
        """Key to the values of both sides, of every parameter in which they differ."""
        one, two = (parameter_values(side.saved.parameters) for side in (self.a, self.b))
        return {key: (value, two[key]) for key, value in one.items() if value != two[key]}

    def as_dict(self) -> dict[str, Any]:
        """Everything, as plain data."""
        entries = {
            row.of.name: {
                **{key: getattr(row.of, key) for key in ("group", "label", "unit")},
                **{key: getattr(row, key) for key in ("a", "b", "ratio", "better")},
                "uncertainty": {"a": row.u_a, "b": row.u_b},
            }
            for row in self.rows
        }
        table = {
            "a": self.a.as_dict(),
            "b": self.b.as_dict(),
            "parameters": self.parameters,
            "uncertainty": [study.as_dict() for study in self.studies] or None,
            "quantities": entries,
        }
        return dict(json_ready(table))


def compare_pair(
    a: str | None,
    b: str | None,
    settings: Sequence[str] = (),
    *,
    as_is: bool = False,
    controllers: Sequence[str] = (),
    uncertainty: Sequence[Path] = (),
    out: Path | None = None,
    force: bool = False,
    stages: Progress | None = None,
) -> Pair:
    """Walk or load two gaits and compare them.

    Args:
        a: preset, TOML file, folder of a run, or None for `normal` or the own gait of another body.
        b: likewise.
        settings: ``key=value`` texts for the gaits that are to be walked.
        as_is: find nothing that they leave open.
        controllers: name of one for both walks, or of one for each.
        uncertainty: ``convergence.json`` of both gaits; without, no value of a walk is called better.
        out: folder that keeps the runs that are walked, and that
            :func:`validation.study.compare.report.write_pair` will fill; None keeps nothing.
        force: replace an earlier comparison in ``out``.
        stages: where to report progress.

    Raises:
        InputError, MathematicalRefusal, BodilyRefusal: a gait or folder cannot be used.
    """
    stages = stages or Progress()
    sources = _sources([a, b], settings, controllers, as_is=as_is)
    for label, source in sources.items():
        if isinstance(source, Request):  # refuse gaits without a plan before the first walk
            check_formula(source)
        elif not (source / SUMMARY_FILE).is_file():
            raise InputError(
                f"{label} is no folder of a finished run; give a preset, a TOML file or a run's folder."
            )
    if uncertainty:  # studies are of all values
        sources = {
            label: complete(source, stages) if isinstance(source, Request) else source
            for label, source in sources.items()
        }
    studies = _studies(sources, uncertainty)
    if out is not None:
        check_target(out, None, force=force, what="comparison", marks=(NUMBERS, PICTURE))
        for label, source in sources.items():
            if isinstance(source, Request):
                check_run_folder(out / label, force=force)
        out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="ampm-compare-") if out is None else nullcontext(out) as place:
        sides = []
        for label, source in sources.items():
            if isinstance(source, Request):
                folder, kept = Path(place) / label, out is not None
                summary = validate(source, folder, force=force, recording=kept, progress=stages)
                if summary["outcome"] == "interrupted":
                    raise KeyboardInterrupt  # the other one is not needed either
                source = folder
            sides.append(load_side(label, source, stages))
        return pair_of(*sides, studies=studies)


def _sources(
    texts: Sequence[str | None], settings: Sequence[str], controllers: Sequence[str], *, as_is: bool
) -> Mapping[str, Request | Path]:
    """Gaits or folders, by their name in tables."""
    if len(controllers) > len(texts):
        raise InputError(
            f"{len(controllers)} controllers were given, two gaits are compared; give one for both, or two."
        )
    own = [[f'controller.name="{name}"'] for name in controllers] or [[]]
    sources = [
        Path(text) if text and Path(text).is_dir() else load_request(text, [*settings, *more], as_is=as_is)
        for text, more in zip(texts, own * len(texts), strict=False)
    ]
    walks = [source for source in sources if isinstance(source, Request)]
    if (settings or controllers) and not walks:
        raise InputError(
            "both sides are runs that are already walked: --set and --controller have nothing to change; "
            "leave them out."
        )
    names = [s.name if isinstance(s, Request) else s.resolve().name for s in sources]
    if names[0] == names[1] and len({*controllers}) == len(walks) == 2:
        names = [f"{name}-{controller}" for name, controller in zip(names, controllers, strict=True)]
    if names[0] == names[1]:
        if len(walks) == len(sources):
            raise InputError(
                f"both gaits are named {names[0]!r}; give two different ones, or folders of runs."
            )
        names = [f"{name}-{number}" for number, name in enumerate(names, start=1)]
    return dict(zip(names, sources, strict=True))


def _studies(sources: Mapping[str, Request | Path], files: Sequence[Path]) -> tuple[Uncertainty, ...]:
    """The convergence study of either side, before anything walks.

    Raises:
        InputError: a file is none, or none is of one of the gaits.
    """
    known = [load_uncertainty(file) for file in files]
    requests = (
        source if isinstance(source, Request) else Request(label, load_run(source / RUN_FILE, ()))
        for label, source in sources.items()
    )
    return tuple(matching(known, request) for request in requests) if known else ()


def load_side(label: str, folder: Path, stages: Progress) -> Side:
    """Load a run and solve its motion on all grids."""
    saved = load_saved_run(folder)
    if not len(saved.signals):
        raise InputError(f"{label} ended before its first instant; there is nothing to compare.")
    run = saved.parameters
    with stages.stage(f"{label}: motion on {len(GRIDS)} grids") as stage:
        body = make_body(run)
        plan = plan_steps(run.gait, run.body.mass, run.foot, body.model.description.sole)
        finer = [run.replace({"solver.ik_time_step": step}) for step in GRIDS]
        motions = [solve_motion(plan, run, body.robot, progress=stage.note) for run in finer]
    return Side(label, saved, plan, joint_jumps(motions, body.robot), str(saved.record.outcome.name))


def joint_jumps(motions: Sequence[WholeBodyMotion], robot: Robot) -> Joints:
    """Change of joint accelerations over the grid interval that ends at a switch, and its extrapolation.

    Args:
        motions: of one gait, on the grids of :data:`GRIDS`.
        robot: the body.
    """
    steps, changes = [], []
    for motion in motions:
        a, time = motion.acceleration[:, 6:], motion.time
        switch = int(np.searchsorted(time, motion.double_support_start - 1e-9))
        # The step begins with a switch too: the interval before it is the step's last one, mirrored.
        changes.append(np.stack([a[switch] - a[switch - 1], a[0] - robot.mirror_joints(a[-2])]))
        steps.append(np.array([time[switch] - time[switch - 1], time[-1] - time[-2]])[:, None])
    # A continuous acceleration changes in proportion to the step; the limit at step zero is the jump.
    h, finer = steps[-2:]
    limit = np.abs((changes[-1] * h - changes[-2] * finer) / (h - finer))
    jumps = tuple(float(np.abs(change).max()) for change in changes)
    joint = robot.joint_names[int(limit.max(axis=0).argmax())]
    return Joints(GRIDS, jumps, float(limit.max()), joint)


def pair_of(a: Side, b: Side, *, studies: tuple[Uncertainty, ...] = ()) -> Pair:
    """All quantities of two walked sides, with their numerical uncertainty from the studies."""
    values = [side.values() for side in (a, b)]

    def uncertainties(item: Quantity) -> list[float]:
        """Of both sides, as shown: zero if not walked, NaN without a study."""
        if not (item.walked and studies):
            return [math.nan if item.walked else 0.0] * 2
        found = (study.bounds.get(item.studied_name, math.nan) for study in studies)
        return [u / item.si_unit(side.weight)[0] for u, side in zip(found, (a, b), strict=True)]

    rows = (
        Row(item, *(found[item.name] for found in values), *uncertainties(item))
        for item in quantities(a.plan.mass * a.plan.gravity)
    )
    return Pair(a, b, tuple(rows), studies)
