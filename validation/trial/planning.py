"""From a user's words to a plan and its motion, and back to words: what ``ampm plan`` and ``ampm motion`` do.

Every trial starts here too, so that a gait is planned in one way only.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import platformdirs

from ampm.exceptions import InputError
from ampm.parameters import PRESETS, RunParameters, load_run
from ampm.planner.gait import PlanConstants, plan_gait
from validation.cli.console import Silent, figure, print_line, print_table
from validation.store.folders import output_file
from validation.store.tables import check_suffix, plan_table, sample_times, write_columns

if TYPE_CHECKING:
    from ampm.body.motion import WholeBodyMotion
    from ampm.body.robot import Robot
    from ampm.planner.gait import GaitPlan
    from models.human import BodyModel

MOTION_METADATA = "ampm_motion"
"""Schema metadata of a motion's Parquet file: JSON, gait to what the orbit says of itself."""

_UNITS = {
    "l_s": "m",
    "l_d": "m",
    "inverse_a_s": "1",
    "a_d": "1",
    "c_d": "1",
    "single_support_duration": "s",
    "double_support_duration": "s",
    "s": "m",
    "beta": "m",
    "lateral_switching_velocity": "m/s",
    "mean_velocity": "m/s",
    "angular_momentum_y_offset": "N m s",
}
MOTION_UNITS = {
    "step_duration": "s",
    "step_length": "m",
    "angular_momentum_y_offset": "N m s",
    "residual": "rad, m, rad/s, m/s",
    "mean_trunk_pitch": "rad",
    "constraint_position": "m, rad",
    "constraint_velocity": "m/s, rad/s",
    "constraint_acceleration": "m/s², rad/s²",
    "knee_minimum": "rad",
    "knee_minimum_time": "s",
    "joint_limit_margin": "rad",
    "joint_limit_time": "s",
    "acceleration_jump": "rad/s²",
}
"""Units of what a motion says of itself; what is not listed is a name or a plain number."""


@dataclass(frozen=True)
class Request:
    """One gait that a user asks for.

    Attributes:
        name: preset, or stem of the file.
        run: everything that describes the run.
    """

    name: str
    run: RunParameters


@dataclass(frozen=True)
class Body:
    """A body as both sides need it: the simulator's model, and the robot of planner and controller."""

    model: BodyModel
    robot: Robot


@dataclass(frozen=True)
class Planned:
    """A plan, and with a body its motion.

    Attributes:
        request: what was asked for.
        plan: with the body's constant of L_y, if there is a body.
        body: None for pure mathematics.
        motion: None for pure mathematics.
    """

    request: Request
    plan: GaitPlan
    body: Body | None = None
    motion: WholeBodyMotion | None = None

    @property
    def name(self) -> str:
        """The gait's name."""
        return self.request.name

    @cached_property
    def zmp_margin(self) -> float | None:
        """Least distance of the planned ZMP from the edge of the support polygon [m]."""
        return None if self.plan.feet is None else self.plan.least_zmp_margin()[0]


def request(gait: str, settings: Sequence[str]) -> Request:
    """Resolve one gait and its settings.

    Raises:
        InputError: unknown gait or key, or a bad value.
    """
    run = load_run(gait, settings)
    path = Path(gait)
    # A run folder's own run.toml is named after the folder.
    name = path.resolve().parent.name if path.name == "run.toml" else path.stem
    if gait in PRESETS:  # a dot in a preset's name begins no suffix
        name = gait
    return Request(name, run)


def requests(gaits: Sequence[str], settings: Sequence[str]) -> list[Request]:
    """Resolve several gaits; refuse those that are mathematically impossible before any of them walks.

    Raises:
        InputError: as :func:`request`, or two gaits of one name.
        MathematicalRefusal: a gait has no plan.
    """
    resolved = [request(gait, settings) for gait in gaits]
    names = [item.name for item in resolved]
    for name in names:
        if names.count(name) > 1:
            raise InputError(
                f"{names.count(name)} gaits are named {name!r}; give every gait once, by its own name."
            )
    for item in resolved:
        plan_gait(item.run.gait, mass=item.run.body.mass)
    return resolved


def make_body(run: RunParameters) -> Body:
    """Build the body of a run."""
    from ampm.body.robot import Robot
    from models.human import build
    from validation.trial.bridge import pinocchio_model

    model = build(run.body, run.contact, run.simulation)
    return Body(model, Robot(pinocchio_model(model.compile()), model.description))


def plan(asked: Request, *, with_body: bool, stages: Silent) -> Planned:
    """Plan a gait; with a body, solve its periodic motion, which fixes the constant of L_y.

    Args:
        asked: the gait.
        with_body: False for pure mathematics.
        stages: where to report progress.

    Raises:
        InputError, MathematicalRefusal, BodilyRefusal: the request cannot be met.
    """
    run = asked.run
    if not with_body:
        return Planned(asked, plan_gait(run.gait, mass=run.body.mass))
    plan_gait(run.gait, mass=run.body.mass)  # refuse bad mathematics before a body is built
    from ampm.body.feasibility import check_body
    from ampm.body.orbit import solve_motion

    with stages.stage(f"{asked.name}: body"):
        body = make_body(run)
    feet_plan = plan_gait(run.gait, mass=run.body.mass, foot=run.foot, sole=body.model.description.sole)
    check_body(feet_plan, body.model.description)
    with stages.stage(f"{asked.name}: whole-body motion") as stage:
        motion = solve_motion(feet_plan, run, body.robot, progress=stage.note, cache=motion_cache())
    offset = motion.report.angular_momentum_y_offset
    return Planned(asked, feet_plan.with_angular_momentum_offset(offset), body, motion)


def motion_cache() -> Path | None:
    """Folder of solved motions, in the user's cache; None if it cannot be written."""
    folder = platformdirs.user_cache_path("ampm") / "motions"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    return folder


def describe(planned: Planned) -> dict[str, Any]:
    """A plan as a JSON object: parameters, derived constants, residuals, and with a body its margins."""
    constants = planned.plan.constants
    residuals = planned.plan.residuals()
    answer: dict[str, Any] = {
        "gait": planned.name,
        "parameters": planned.request.run.model_dump(),
        **{field.name: getattr(constants, field.name) for field in fields(constants)},
        "step_duration": constants.step_duration,
        "duration": planned.plan.duration,
        "residuals": {field.name: getattr(residuals, field.name) for field in fields(residuals)},
        "zmp_margin": planned.zmp_margin,
        "motion": planned.motion.report.as_dict() if planned.motion is not None else None,
    }
    return answer


def print_plan(planned: Planned) -> None:
    """Print a plan for a reader."""
    described = describe(planned)
    rows = [
        (name, figure(described[name], 6), "" if unit == "1" else unit, _MEANINGS[name])
        for name, unit in _UNITS.items()
    ]
    print_table(
        f"plan of {planned.name}",
        (("constant", "left"), ("value", "right"), ("unit", "left"), ("meaning", "left")),
        rows,
    )
    print_line(f"largest jump at a switch, relative: {figure(planned.plan.residuals().largest, 2)}")
    if planned.zmp_margin is not None:
        print_line(
            f"least distance of the ZMP from the edge of the support: {1000 * planned.zmp_margin:.1f} mm"
        )
    if planned.motion is not None:
        print_line(f"least flexion of a knee: {planned.motion.report.knee_minimum:.3f} rad")


def describe_motion(planned: Planned) -> dict[str, Any]:
    """What a motion says of itself, as a JSON object."""
    if planned.motion is None:
        raise InputError("a plan without a body has no motion; plan it with one.")
    return {
        "gait": planned.name,
        "step_duration": planned.motion.step_duration,
        "step_length": planned.motion.step_length,
        **planned.motion.report.as_dict(),
    }


def print_motion(planned: Planned) -> None:
    """Print what a motion says of itself."""
    rows = []
    for name, value in describe_motion(planned).items():
        if name == "gait":
            continue
        if name == "multipliers":
            text = ", ".join(f"{re:.4g}{im:+.2g}i" if im else f"{re:.4g}" for re, im in value[:4])
        else:
            text = figure(value, 5) if isinstance(value, float) else str(value)
        rows.append((name, text, MOTION_UNITS.get(name, "")))
    columns = (("quantity", "left"), ("value", "left"), ("unit", "left"))
    print_table(f"motion of {planned.name}, one step", columns, rows)


def check_samples(path: Path, run: RunParameters, rate: float) -> None:
    """Refuse a table that could not be written, before anything is computed."""
    check_suffix(path)
    plan_ = plan_gait(run.gait, mass=run.body.mass)
    sample_times(plan_.duration, rate)


def write_samples(planned: Planned, path: Path, rate: float) -> None:
    """Write a plan's signals at k / rate."""
    columns = plan_table(planned.plan, sample_times(planned.plan.duration, rate))
    with output_file(path) as work:
        write_columns(columns, work)


def check_picture(path: Path) -> None:
    """Refuse a picture that could not be written."""
    if path.suffix not in (".png", ".svg", ".pdf"):
        raise InputError(f"{path} must end in .png, .svg or .pdf; the suffix chooses the format.")


def write_picture(planned: Planned, path: Path) -> None:
    """Draw a plan."""
    from validation.show.plan import plot_plan

    with output_file(path) as work:
        plot_plan(planned.plan, work, title=f"plan of {planned.name}")


def write_motions(planned: Sequence[Planned], path: Path, *, force: bool) -> None:
    """Write one step of every motion into one table, whose column ``gait`` tells them apart."""
    check_suffix(path)
    tables = []
    for item in planned:
        if item.motion is not None:
            table = item.motion.table()
            tables.append({"gait": np.full(len(table["time"]), item.name, dtype=object), **table})
    columns = {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
    reports = json.dumps({item.name: describe_motion(item) for item in planned})
    with output_file(path, force=force) as work:
        write_columns(columns, work, {MOTION_METADATA: reports})


_MEANINGS = {
    "l_s": "half the COM's travel in single support",
    "l_d": "half the COM's travel in double support",
    "inverse_a_s": "ZMP travel over COM travel in single support",
    "a_d": "COM travel over ZMP travel in double support",
    "c_d": "slope of the force line in double support",
    "single_support_duration": "duration of a single support",
    "double_support_duration": "duration of a double support",
    "s": "lateral distance of COM and stance foot at a switch",
    "beta": "lateral distance of COM and midline at a switch",
    "lateral_switching_velocity": "lateral speed of the COM at a switch",
    "mean_velocity": "mean forward speed",
    "angular_momentum_y_offset": "mean of L_y about the COM",
}
if _MEANINGS.keys() != _UNITS.keys() or set(_UNITS) != {field.name for field in fields(PlanConstants)}:
    raise TypeError("a plan's constant lacks its unit or its meaning")
