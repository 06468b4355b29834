"""Two gaits side by side: what continuity at the switches buys, and where it buys nothing.

Both sides are walked or loaded. At the instants at which support changes they are compared by jumps of the
plan, jumps of joint accelerations on finer grids, measured ground force, ZMP error, torque rates, feedback.
Metrics of the whole run stand beside these.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path

import numpy as np

from ampm.body.motion import WholeBodyMotion
from ampm.body.orbit import solve_motion
from ampm.body.robot import Robot
from ampm.exceptions import InputError
from ampm.planner.periodic import plan_gait
from ampm.planner.support import plan_steps
from ampm.run_file import load_run
from validation.judge.uncertainty import Uncertainty, load_uncertainty, matching
from validation.progress import Progress
from validation.run.validate import Options, validate
from validation.store.folders import check_run_folder, check_target
from validation.store.saved import RUN_FILE, load_saved_run
from validation.study.compare.metrics import (
    GRIDS,
    Quantity,
    metric_values,
    quantities,
    si_unit,
    switch_quantities,
)
from validation.study.compare.pair import Joints, Pair, Row, Side
from validation.trial.plan import Request, load_request, make_body, motion_cache

REPORT, NUMBERS, PICTURE = "report.html", "comparison.json", "switches.svg"


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
    sources = [Path(text) if Path(text).is_dir() else load_request(text, settings) for text in (a, b)]
    walked = [isinstance(source, Path) for source in sources]
    if settings and all(walked):
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
    if out is not None:
        check_target(out, None, force=force, what="comparison", marks=(NUMBERS, PICTURE))
        for label, is_walked in zip(labels, walked, strict=True):
            if not is_walked:
                check_run_folder(out / label, force=force)
        out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="ampm-compare-") if out is None else nullcontext(out) as place:
        sides = []
        for label, source in zip(labels, sources, strict=True):
            if isinstance(source, Request):
                options, folder = Options(force=force, recording=out is not None), Path(place) / label
                if validate(source, folder, options, progress=stages)["outcome"] == "interrupted":
                    raise KeyboardInterrupt  # the other one is not wanted either
                source = folder
            sides.append(_side(label, source, stages))
        return pair_of(*sides, studies=studies)


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
    """Names for tables; two of one name are distinguished by a number."""
    names = [s.name if isinstance(s, Request) else s.resolve().name for s in sources]
    if names[0] != names[1]:
        return names
    if all(isinstance(source, Request) for source in sources):
        raise InputError(f"both gaits are named {names[0]!r}; give two different ones, or folders of runs.")
    return [f"{name}-{number}" for number, name in enumerate(names, start=1)]


def _side(label: str, folder: Path, stages: Progress) -> Side:
    """Load a run and solve its motion on all grids."""
    saved = load_saved_run(folder)
    if not len(saved.signals):
        raise InputError(f"{label} ended before its first instant; there is nothing to compare.")
    run = saved.parameters
    with stages.stage(f"{label}: motion on {len(GRIDS)} grids") as stage:
        body = make_body(run)
        plan = plan_steps(run.gait, run.body.mass, run.foot, body.model.description.sole)
        motions = [
            solve_motion(
                plan,
                run.replace({"solver.ik_time_step": step}),
                body.robot,
                progress=stage.note,
                cache=motion_cache(),
            )
            for step in GRIDS
        ]
    joints = joint_jumps(motions, body.robot, GRIDS)
    return Side(label, saved, plan, joints, str(saved.record.outcome.name))


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
    values = [_values(side) for side in (a, b)]

    def uncertainties(item: Quantity) -> list[float]:
        """Of both sides, as shown: what is not walked has none, and without a study it is not known."""
        if not item.walked:
            return [0.0, 0.0]
        if studies is None:
            return [math.nan, math.nan]
        records = (a.saved.record, b.saved.record)
        return [
            study.bounds.get(item.studied_name, math.nan)
            / si_unit(item.unit, record.mass * record.gravity)[0]
            for study, record in zip(studies, records, strict=True)
        ]

    rows = (
        Row(item, *(found[item.name] for found in values), *uncertainties(item))
        for item in quantities(a.plan.mass * a.plan.gravity)
    )
    return Pair(a, b, tuple(rows), studies)


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
        **switch_quantities(plan, side.saved.signals, record),
        **metric_values(side.saved.summary, record.mass * record.gravity),
    }
