"""From a request to a planned walk: body, centroidal plan, feet and whole-body motion.

Every trial starts here, so that a gait is planned in one way only.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import platformdirs

from ampm.exceptions import InputError
from ampm.parameters import RunParameters
from ampm.planner.periodic import plan_gait
from ampm.run_file import PRESETS, load_run
from validation.progress import Progress
from validation.trial.users import UsersCode

if TYPE_CHECKING:
    from ampm.body.motion import WholeBodyMotion
    from ampm.body.robot import Robot
    from ampm.planners import WalkRequest
    from ampm.tune.tuning import Tuned
    from ampm.walk import Planner, WalkPlan
    from models.human import BodyModel
    from validation.trial.shapes import Shapes


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
    """A body as both sides need it.

    Attributes:
        model: the simulator's.
        robot: of planner and controller.
        shapes: that must keep apart.
    """

    model: BodyModel
    robot: Robot
    shapes: Shapes


@dataclass(frozen=True)
class PlannedWalk:
    """All that a walk starts from.

    Attributes:
        request: name and parameters.
        plan: COM, momentum, feet and posture.
        body: that walks.
        planner: name of the class that made the plan, empty for the built-in one.
    """

    request: Request
    plan: WalkPlan
    body: Body
    planner: str = ""

    @property
    def name(self) -> str:
        """The gait's name."""
        return self.request.name

    @property
    def run(self) -> RunParameters:
        """Parameters of the run."""
        return self.request.run

    @property
    def motion(self) -> WholeBodyMotion:
        """The periodic whole-body step.

        Raises:
            InputError: the walk has another posture.
        """
        from ampm.body.motion import PeriodicPosture  # here, not above: NumPy takes long to load

        if isinstance(self.plan.posture, PeriodicPosture):
            return self.plan.posture.motion
        kind = type(self.plan.posture).__name__
        raise InputError(f"{self.name} walks with {kind}, which has no periodic motion; plan it without.")

    @cached_property
    def zmp_margin(self) -> float:
        """Least distance of the planned ZMP from the edge of the support polygon [m]."""
        return self.plan.least_zmp_margin()[0]


@dataclass(frozen=True)
class TunedWalk(PlannedWalk):
    """A walk whose free choices are made; its plan is the one that the search has confirmed.

    Attributes:
        tuned: choices and margins.
    """

    tuned: Tuned = field(kw_only=True)


def load_request(gait: str, settings: Sequence[str] = ()) -> Request:
    """Resolve one gait and its settings.

    Args:
        gait: preset or TOML file.
        settings: ``key=value`` texts.

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


def load_requests(gaits: Sequence[str], settings: Sequence[str] = (), *, check: bool = True) -> list[Request]:
    """Resolve several gaits.

    Args:
        gaits: presets or TOML files.
        settings: ``key=value`` texts, the same for all.
        check: refuse what has no plan before any of them walks; off for gaits that are yet to be tuned.

    Raises:
        InputError: as :func:`load_request`, or two gaits of one name.
        MathematicalRefusal: a gait has no plan.
    """
    resolved = [load_request(gait, settings) for gait in gaits]
    names = [item.name for item in resolved]
    for name in names:
        if names.count(name) > 1:
            raise InputError(
                f"{names.count(name)} gaits are named {name!r}; give every gait once, by its own name."
            )
    for item in resolved if check else ():
        plan_gait(item.run.gait, item.run.body.mass)
    return resolved


def make_body(run: RunParameters) -> Body:
    """Build the body of a run."""
    # Here, not above: simulator and Pinocchio take a second to load.
    from models.human import build
    from validation.trial.shapes import Shapes, make_robot

    model = build(run.body, run.contact, run.simulation)
    compiled = model.compile()
    shapes = Shapes(compiled)
    return Body(model, make_robot(compiled, model.description, shapes), shapes)


def plan_walk(
    request: Request, progress: Progress | None = None, *, planner: Planner[WalkRequest] | None = None
) -> PlannedWalk:
    """Plan a walk with its body.

    Args:
        request: the gait.
        progress: where to report stages.
        planner: :class:`ampm.planners.AmpmPeriodic` by default.

    Raises:
        InputError, MathematicalRefusal, BodilyRefusal: the request cannot be met, or a user's planner fails.
    """
    run, progress = request.run, progress or Progress()
    if planner is None:
        plan_gait(run.gait, run.body.mass)  # refuse bad mathematics before a body is built
    # Here, not above: Pinocchio takes long to load.
    from ampm.planners import AmpmPeriodic, WalkRequest
    from ampm.walk import WalkPlan

    with progress.stage(f"{request.name}: body"):
        body = make_body(run)
    name = "" if planner is None else type(planner).__name__
    planner = planner or AmpmPeriodic()
    with progress.stage(f"{request.name}: whole-body motion") as stage:
        wanted = WalkRequest(run, body.robot, stage.note, motion_cache())
        with UsersCode("planner", planner) if name else nullcontext():
            plan = planner.plan(wanted)
            if not isinstance(plan, WalkPlan):
                raise TypeError(f"it made a {type(plan).__name__}, not a WalkPlan")
    return PlannedWalk(request, plan, body, name)


def tune_walk(request: Request, progress: Progress | None = None) -> TunedWalk:
    """Make the free choices of a gait; what a preset, a file or a setting names stays as it is.

    Args:
        request: the gait; ``request.run`` knows which keys were named.
        progress: where to report stages.

    Raises:
        InputError: every free choice is named already.
        MathematicalRefusal, BodilyRefusal: no choice walks; :class:`ampm.tune.refusal.NoFeasibleChoice`,
            a BodilyRefusal, says which limit stayed broken.
    """
    # Here, not above: Pinocchio takes long to load.
    from ampm.tune.free_choices import FREE_KEYS, named_keys
    from ampm.tune.tuning import tune

    if set(FREE_KEYS) <= named_keys(request.run):
        raise InputError(
            f"{request.name} names every free choice, so there is nothing to tune; leave out what is to be "
            "found, for example gait.com_height."
        )
    with (progress or Progress()).stage(f"{request.name}: free choices") as stage:
        body = make_body(request.run)
        tuned = tune(request.run, body.robot, progress=stage.note, cache=motion_cache())
    return TunedWalk(Request(request.name, tuned.run), tuned.plan, body, tuned=tuned)


def motion_cache() -> Path | None:
    """Folder of solved motions, in the user's cache; None if it cannot be written."""
    folder = platformdirs.user_cache_path("ampm") / "motions"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    return folder
