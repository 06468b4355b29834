"""From a request to a planned walk: body, centroidal plan, feet and whole-body motion.

Every trial plans its gait here. Simulator and Pinocchio take a second to load: imports wait until then.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import chdir, contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from ampm.body.motion import PeriodicPosture, WholeBodyMotion
from ampm.brief import Brief
from ampm.exceptions import InputError, RefusedGait
from ampm.parameters import HUMAN, NO_PLAN, OPEN_KEYS, OPTION_TABLES, CommandParameters, RunParameters
from ampm.planner.periodic import plan_gait
from ampm.planner.plan_checks import check_steps
from ampm.presets import PRESETS
from ampm.run_file import key_info, leaves_open, load_run
from ampm.section import parse_setting
from ampm.sensor_parameters import EXACT
from ampm.walk import Planner, Replanner, WalkPlan
from validation.progress import Progress
from validation.trial import users
from validation.trial.users_plan import check_plan

if TYPE_CHECKING:
    from ampm.body.robot import Robot
    from ampm.tune.tuning import Tuned
    from models.scene import BodyModel
    from validation.trial.shapes import Shapes


_OF_ESTIMATORS = ("stand", "fix_rate", "accelerometer_noise", "accelerometer_bias", "accelerometer_drift")
_IDLE: Mapping[str, tuple[Any, Sequence[str]]] = {
    "sensors.estimator": (EXACT, [f"sensors.{name}" for name in _OF_ESTIMATORS]),
    "sensors.force_sensor": ("points", ["sensors.moment_noise", "sensors.moment_bias"]),
    "sensors.fix_rate": (0.0, ["sensors.fix_noise"]),
    "disturbance.step_height": (0.0, ["disturbance.step_number"]),
    "disturbance.mass_change": (0.0, ["disturbance.mass_segment"]),
    "gait.planner": (NO_PLAN, ["controller.stabilizer"]),
    "simulation.engine": ("mujoco", ["drake.stiffness", "drake.dissipation", "drake.approximation"]),
}
"""Keys that have no effect where another key has some value."""


@dataclass(frozen=True)
class Request:
    """One gait that a user asks for."""

    name: str  # preset, or stem of the file
    run: RunParameters  # everything that describes the run
    changed: Mapping[str, Any] = field(default_factory=dict)  # keys that settings changed, without gait.steps

    @property
    def title(self) -> str:
        """Name and changes, for a picture or a verdict."""
        return gait_title(self.name, self.changed)


def gait_title(name: str, changed: Mapping[str, Any], planner: str = "") -> str:
    """Name of a gait, what was changed in it, its planner: ``normal, gait.c_y 0.93, planner dcm``."""
    short = {key: Path(value).name if key == "body.source" else value for key, value in changed.items()}
    values = (f"{value:.6g}" if isinstance(value, float) else str(value) for value in short.values())
    parts = [name, *map(" ".join, zip(short, values, strict=True))]
    return ", ".join([*parts, f"planner {planner}"] if planner else parts)


@dataclass(frozen=True)
class Body(Brief):
    """A body for simulator and controller."""

    model: BodyModel  # the simulator's
    robot: Robot  # of planner and controller
    shapes: Shapes  # that must keep apart

    @classmethod
    def of(cls, model: BodyModel, shapes: Shapes | None = None) -> Body:
        """The body of a model, with shapes of its own."""
        from ampm.body.robot import Robot
        from validation.trial.bridge import pinocchio_model
        from validation.trial.shapes import Shapes

        compiled = model.compile()
        shapes = shapes or Shapes(compiled, model.description.trunk_segment)
        return cls(model, Robot(pinocchio_model(compiled), model.description, shapes.gaps), shapes)

    def own_robot(self) -> Robot:
        """A new robot for a user's class, whose changes reach no other part of the walk."""
        return Body.of(self.model).robot


@dataclass(frozen=True)
class PlannedWalk(Brief):
    """What a walk is simulated from."""

    request: Request  # name and parameters, with the values that were found
    plan: WalkPlan  # COM, momentum, feet and posture
    body: Body  # that walks
    planner: str = ""  # name of the planner that made the plan, empty for the default one
    # the values that were found, with their margins; None if nothing was searched for
    tuned: Tuned | None = None
    replanner: Replanner | None = None  # the planner, if it goes on planning while its plan is walked
    note: str = ""  # how the steps of a user's planner differ from those of the run
    seconds: float = 0.0  # wall-clock time of planning

    @property
    def name(self) -> str:
        """The gait's name."""
        return self.request.name

    @property
    def run(self) -> RunParameters:
        """Parameters of the run."""
        return self.request.run

    @cached_property
    def scene(self) -> Body:
        """The body in its world as it is simulated; ``body`` itself if the run changes neither.

        Raises :class:`InputError` if the run's disturbance does not fit the body or its plan.
        """
        from validation.trial.scene import disturbed_model

        model = disturbed_model(self.body.model, self.run, self.plan.contacts)
        return self.body if model is self.body.model else Body.of(model)

    @property
    def motion(self) -> WholeBodyMotion:
        """The periodic whole-body step; raises InputError if the walk has another posture."""
        if isinstance(self.plan.posture, PeriodicPosture):
            return self.plan.posture.motion
        kind = type(self.plan.posture).__name__
        raise InputError(f"{self.name} walks with {kind}, not with a periodic motion; plan a periodic gait.")


def load_request(
    gait: Request | RunParameters | str | None,
    settings: Sequence[str] = (),
    *,
    as_is: bool = False,
    walked: bool = True,
    sections: Mapping[str, Any] = MappingProxyType({}),
) -> Request:
    """Resolve one gait and its settings.

    Args:
        gait: preset or TOML file; None for `normal`, or the own gait of another body than the human. Or
            parameters, which take only ``sections``. Or a request, which is returned.
        settings: ``key=value`` texts.
        as_is: every value counts as given, so that nothing is found.
        walked: whether controller and estimator are needed; else no class of theirs is imported.
        sections: values by section and key, after the settings.

    Raises:
        InputError: unknown gait, key or controller, or a bad value.
    """
    if isinstance(gait, Request | RunParameters) and settings:
        raise InputError("settings are for a preset or file; change parameters by their method replace.")
    if isinstance(gait, Request):
        return gait
    if isinstance(gait, RunParameters):
        tables = {name: keys for name, keys in sections.items() if isinstance(keys, Mapping)}
        values = {f"{name}.{key}": value for name, keys in tables.items() for key, value in keys.items()}
        others = {name: value for name, value in sections.items() if name not in tables}  # footsteps
        return Request("walk", own_gait(gait.replace(values, **others) if sections else gait))
    run = load_run(gait, settings, **sections)
    if gait is None and run.body.source == HUMAN:
        return load_request("normal", settings, as_is=as_is, walked=walked, sections=sections)
    run = own_gait(run).as_is() if as_is else own_gait(run)
    if walked:
        users.check_classes(run)
    path = Path(run.body.source if gait is None else gait)
    # A run folder's own run.toml is named after the folder.
    name = path.resolve().parent.name if path.name == "run.toml" else path.stem
    if gait is not None and gait in PRESETS:  # a dot in its name begins no suffix
        name = gait
    elif name in PRESETS:  # whose profile it must not get
        name += ".toml"
    keys = dict(map(parse_setting, settings))
    for options, key in OPTION_TABLES.items():
        if "," in str(keys.get(key)):
            keys |= {f"{options}.{option}": value for option, value in run.value(options).items()}
    named = ["gait.steps", "gait.planner", *(["body.source"] if gait is None else [])]  # by the title itself
    return Request(name, run, {key: run.value(key) for key in keys if key not in named})


def load_requests(gaits: Sequence[str | None], settings: Sequence[str] = (), **options: Any) -> list[Request]:
    """Resolve gaits with the same settings, as :func:`load_request`; each has its own name and a plan."""
    resolved = [load_request(gait, settings, **options) for gait in gaits]
    name, count = Counter(item.name for item in resolved).most_common(1)[0]
    if count > 1:
        raise InputError(f"{count} gaits are named {name!r}; give every gait once, by its own name.")
    for item in resolved:
        check_formula(item)
    return resolved


def check_formula(request: Request) -> None:
    """Refuse a gait whose formula has no solution, unless values that it leaves open may give one."""
    if not leaves_open(request.run) or request.run.gait.c_y <= 0.0:
        with _way_out(request.run):
            plan_gait(request.run.gait, request.run.body.mass)


@contextmanager
def _way_out(run: RunParameters) -> Iterator[None]:
    """Note at a refusal that given values could be left open."""
    try:
        yield
    except RefusedGait as error:
        if run.given >= set(OPEN_KEYS):
            error.add_note(
                "all values count as given; leave out --as-is, or keys such as gait.com_height from the "
                "file, to have open values found"
            )
        raise


def own_gait(run: RunParameters) -> RunParameters:
    """The run with mass and height of its body; of another body than the human with a gait of its size."""
    if run.body.source == HUMAN:
        return run
    from ampm.tune.first_gait import first_gait
    from models.load import build_body

    return first_gait(run, build_body(run).description)


def make_body(run: RunParameters) -> Body:
    """Build the body of a run; raises InputError if it cannot be read, or Drake cannot step it."""
    from models.load import build_body
    from validation.trial.engine import check_drake

    model = build_body(run)
    if run.simulation.engine == "drake":
        check_drake(run, model.compile())
    return Body.of(model)


def clock() -> float:
    """Wall-clock time without that of compiling [s]."""
    from ampm.compiled import compilation

    return time.perf_counter() - compilation.seconds


def plan_walk(
    request: Request, progress: Progress | None = None, *, planner: Planner | None = None
) -> PlannedWalk:
    """Plan a walk with its body.

    Where gait, body and feet are those of no preset, the values that the request leaves open are found first
    and reported (:func:`ampm.run_file.leaves_open`), for the AMPM's plan: the other planners of
    :data:`ampm.planner.step_planners.STEP_PLANNERS` have its footsteps, times and feet. Over footsteps only
    another body, or height, gets values found, those of its own gait. Any other planner gets the request
    unchanged.

    The planner is that of the run by default, and for footsteps :class:`ampm.planners.FootstepPlanner`.
    Raises InputError or RefusedGait if the request cannot be met, or a user's planner fails.
    """
    begun, progress = clock(), progress or Progress()
    asked = run = request.run
    from ampm.planners import FootstepPlanner, PeriodicPlanner, StandingPlanner, TablePlanner

    is_object = planner is not None
    if planner is None:
        planner = users.load_planner(run.gait.planner, run.planner.options)
        if run.footsteps and run.gait.planner == "ampm":
            planner = FootstepPlanner()
            human = run.body.source == HUMAN and run.body.height == key_info("body.height").default
            if not human and leaves_open(run):  # height and feet of its own gait
                request = tune_walk(replace(request, run=run.replace({}, footsteps=())), progress).request
                request = replace(request, run=request.run.replace({}, footsteps=run.footsteps))
                run = request.run
    declared = vars(type(planner))  # see ampm.walk.Planner
    # Ours need no checks of their plans. A class that only says so would not be held to the run.
    checked = type(planner) in (PeriodicPlanner, FootstepPlanner, StandingPlanner)
    with users.UsersCode("planner", planner):
        name = str(getattr(planner, "name", type(planner).__name__)).strip()
    if not checked and (not name or name in users.PLANNER.known):  # of a user's class
        name = type(planner).__name__
        name = users.PLANNER.name_of(planner) if name in users.PLANNER.known else name
    if is_object:
        of_class = name if checked and name in users.PLANNER.known else users.PLANNER.name_of(planner)
        run = run.replace({"gait.planner": of_class})
        request = replace(request, run=run)
    _check_request(request, name, declared, progress, is_ours=checked)
    body = None
    if declared.get("tunes", False):
        name = "" if name == "ampm" else name
        if leaves_open(run):
            tuned = tune_walk(request, progress)
            if not name:
                return replace(tuned, seconds=clock() - begun)
            request, run, body = tuned.request, tuned.run, tuned.body
        check_formula(request)  # before a body is built
    if body is None:
        with progress.stage(f"{request.name}: body"):
            body = make_body(run)
    replanner: Any = planner if users.replan_period(planner) < math.inf else None
    note = ""
    with (
        progress.stage(f"{request.name}: whole-body motion"),
        _way_out(asked) if checked else users.UsersCode("planner", planner),
        chdir("."),  # relative paths hold after it
    ):
        plan = planner.plan(run.undisturbed, body.robot if checked else body.own_robot())
        if not isinstance(plan, WalkPlan):
            raise TypeError(f"it made {users.planner_problem(plan)}")
        if not checked:
            check_plan(plan, run, body.robot)
            is_table = type(planner) is TablePlanner
            if problem := check_steps(plan.contacts, run, is_table=is_table, goes_on=replanner is not None):
                note = f"The planner {name} plans {problem}."
                progress.say(f"{request.name}: {note}")
    return PlannedWalk(request, plan, body, name, None, replanner, note, clock() - begun)


def _check_request(
    request: Request, name: str, declared: Mapping[str, Any], progress: Progress, *, is_ours: bool
) -> None:
    """Refuse what a planner does not do, by what its class says, and tell which keys have no effect."""
    run = request.run
    for key, (value, names) in _IDLE.items():
        idle = [name for name in names if run.value(name) != key_info(name).default]
        if idle and run.value(key) == value:
            progress.say(f"{request.name}: {key} = {value} does not use: {', '.join(idle)}")
    pushes = [f"disturbance.push_{name}" for name in ("at", "duration", "segment")]
    idle = [key for key in pushes if run.value(key) != key_info(key).default]
    if idle and not any(run.value(f"disturbance.push_{axis}") for axis in "xyz"):
        progress.say(f"{request.name}: no force in disturbance.push_x, y or z; not used: {', '.join(idle)}")
    commanded = any(key.startswith("command.") for key in request.changed)
    follows = name == NO_PLAN or not (is_ours or "gait_keys" in declared)
    if (commanded or run.command != CommandParameters()) and not follows:
        raise InputError(
            f"the planner {name or 'ampm'} follows no command; leave out command.*, or take --planner none.",
            way_out="walk with --planner none",
        )
    if name == NO_PLAN and run.controller.name in users.CONTROLLER.known and any(run.command.at(math.inf)):
        stands = f"the controller {run.controller.name} follows no command: it stands"
        progress.say(f"{request.name}: {stands}; give one of your own with --controller")
    if run.footsteps and not declared.get("plans_footsteps", True):
        raise InputError(f"the planner {name} does not plan footsteps; leave out these or the planner.")
    if run.footsteps and run.gait.steps not in (key_info("gait.steps").default, len(run.footsteps) - 2):
        progress.say(f"{request.name}: walks its footsteps, not gait.steps")
    if "gait_keys" in declared:
        noted = {"gait.steps", "gait.slope", "gait.cross_slope"} & run.given
        noted = {key for key in noted if run.value(key) != key_info(key).default}
        unused = {*request.changed, *noted} - {*declared["gait_keys"]}
        of_plan = ("gait.", "foot.", "body.lean", "body.pelvis_") if name == NO_PLAN else "gait."
        if keys := ", ".join(sorted(key for key in unused if key.startswith(of_plan))):
            progress.say(f"{request.name}: the planner {name} does not use: {keys}")


def tune_walk(request: Request, progress: Progress | None = None) -> PlannedWalk:
    """Find the values that a request leaves open, changed or not; given values are kept.

    Raises:
        InputError: nothing is open.
        MathematicalRefusal, BodilyRefusal: nothing walks; a :class:`ampm.tune.tuning.NoFeasibleChoice` says
            which limit stayed broken.
    """
    from ampm.planners import PeriodicPlanner
    from ampm.tune.tuning import tune

    run, progress = request.run, progress or Progress()
    if run.given >= set(OPEN_KEYS):
        raise InputError(
            f"{request.name} gives every value: nothing is open; leave out some, such as gait.com_height."
        )
    with progress.stage(f"{request.name}: search of open values") as stage:
        body = make_body(run)
        # Legs of different length repeat no step.
        level = run.replace({"gait.cross_slope": 0.0}).giving(run.given)
        tuned = tune(level, body.robot, progress=stage.note)
    if run.gait.cross_slope:
        across = tuned.run.replace({"gait.cross_slope": run.gait.cross_slope})
        tuned = replace(tuned, run=across, plan=PeriodicPlanner().plan(across, body.robot))
    if leaves_open(run):
        progress.say(f"{request.title}: {_summary(run, tuned)}")
    return PlannedWalk(replace(request, run=tuned.run), tuned.plan, body, tuned=tuned)


def complete(request: Request, progress: Progress | None = None) -> Request:
    """The request with all values, including those that planning would find."""
    return tune_walk(request, progress).request if leaves_open(request.run) else request


def _summary(run: RunParameters, tuned: Tuned) -> str:
    """One line: the values found, and in brackets those before, which for another body mean nothing."""
    from ampm.tune.first_gait import EASY_KEYS

    def text(value: float | str) -> str:
        return value if isinstance(value, str) else f"{value:.3g}"

    new = {key: value for key, value in tuned.values.items() if value != run.value(key)}
    if not new:
        return "the open values fit as they are"
    if run.body.source == HUMAN:
        items = ", ".join(f"{key} {text(value)} ({text(run.value(key))})" for key, value in new.items())
        return f"found {items}; --as-is keeps the values in brackets"
    found = "found " + ", ".join(f"{key} {text(value)}" for key, value in new.items())
    own = [f"{key} {text(run.value(key))}" for key in EASY_KEYS if key not in run.given]
    return f"took {', '.join(own)} for the body's size; {found}" if own else found
