"""The trial of one gait: plan, walk, measure, compare, judge."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import chdir, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

from ampm.compiled import folder
from ampm.exceptions import InputError
from ampm.parameters import RunParameters
from ampm.planner.contacts import Footstep
from ampm.planner.routes import read_footsteps
from ampm.run_file import load_run
from ampm.walk import ControllerFactory, Planner
from validation.judge.compare import compare
from validation.judge.metrics import evaluate
from validation.judge.profiles import PUSHED, Profile, find_profile, own_profile, unpushed_profile
from validation.measure.measure import measure
from validation.progress import Progress, interruption
from validation.run.trial import Trial
from validation.trial.bridge import passive_joints
from validation.trial.disturbances import Disturbance, check_disturbances, describe
from validation.trial.plan import PlannedWalk, clock, load_request, plan_walk
from validation.trial.record import SimulationRecord
from validation.trial.simulate import simulate
from validation.trial.users import CONTROLLER


def walk(
    run: RunParameters | str | Path = "normal",
    *,
    controller: ControllerFactory | str | None = None,
    planner: Planner | str | Path | None = None,
    disturbances: Sequence[Disturbance] = (),
    footsteps: Sequence[Footstep] | str | Path | None = None,
    name: str | None = None,
    progress: Progress | None = None,
) -> Trial:
    """Plan a gait, walk it in MuJoCo, measure it and judge it by its own profile; nothing is written.

    :meth:`Trial.judged` judges it by another one. Values that a changed gait leaves open are found, and
    ``trial.run`` has them; ``ampm.load_run(...).as_is()`` keeps those of the preset.

    Args:
        run: parameters from :func:`ampm.load_run`, or a preset or TOML file.
        controller: makes the controller from robot, run and the run's ``controller.options``, a class for
            example; or its name. That of the run by default.
        planner: makes the plan, or a name or table: :func:`validation.trial.users.load_planner`; that of the
            run by default.
        disturbances: external forces, such as :class:`validation.Push`, beside those of the run.
        footsteps: places to walk over from rest to rest, see :func:`ampm.plan_footsteps`; or a CSV file.
        name: of the gait, for reports; that of preset or file by default.
        progress: where to report stages.

    Raises:
        InputError, MathematicalRefusal, BodilyRefusal: there is no such walk, or a user's class fails.
    """
    if not (controller is None or isinstance(controller, str) or callable(controller)):
        raise InputError(f"{controller!r} cannot be the controller; give a class or function, or a name.")
    if isinstance(planner, type) or not (isinstance(planner, str | Path | None) or hasattr(planner, "plan")):
        raise InputError(f"{planner!r:.60} cannot plan; give an object with a method plan, or a name.")
    check_disturbances(disturbances)
    if isinstance(footsteps, str | Path):
        footsteps = read_footsteps(footsteps)
    sections = {} if footsteps is None else {"footsteps": [*footsteps]}
    if sections == {"footsteps": []}:
        raise InputError("footsteps is empty; leave it out to walk the gait's own, or give at least 3.")
    request = load_request(run if isinstance(run, RunParameters) else str(run))
    given = {"gait.planner": planner, "controller.name": controller}.items()
    names = {key: str(text) for key, text in given if isinstance(text, str | Path)}
    chosen = request.run.replace(names, **sections)
    factory = controller if callable(controller) else CONTROLLER.find(*CONTROLLER.named(chosen))
    name_of_class = CONTROLLER.name_of(factory)
    CONTROLLER.check_options(name_of_class, factory, chosen.controller.options)
    if controller is not None:
        chosen = chosen.replace({"controller.name": name_of_class})
    request = replace(request, name=str(name or request.name), run=chosen)
    planned = plan_walk(request, progress, planner=None if isinstance(planner, str | Path) else planner)
    return walk_planned(planned, controller=factory, disturbances=disturbances, progress=progress)


def walk_planned(
    planned: PlannedWalk,
    profile: Profile | str | None = None,
    *,
    controller: ControllerFactory | None = None,
    disturbances: Sequence[Disturbance] = (),
    progress: Progress | None = None,
    keep: Callable[[SimulationRecord], None] = lambda record: None,
) -> Trial:
    """Walk a plan and judge the walk.

    By default the profile is the walk's own, and the controller the one that the run names. ``keep`` is
    called with the record before it is measured.
    """
    run, body, name, progress = planned.run, planned.body, planned.name, progress or Progress()
    described = [*map(describe, disturbances)]
    profile = find_profile(profile or own_profile(run, disturbances))
    taken = {"planning": planned.seconds}
    with timed(taken, "simulation"), progress.stage(f"{name}: simulation", "steps") as stage, chdir("."):

        def advance(done: int, total: int) -> None:
            interruption.check()
            stage.advance(done, total)

        record = simulate(planned, controller=controller, disturbances=disturbances, progress=advance)
        keep(record)
    with timed(taken, "measurement"), progress.stage(f"{name}: measurement"):
        measured = measure(record, planned.scene.robot.model, passive_joints(planned.scene.model.compile()))
        description = body.model.description
        comparison = compare(planned.plan, record, measured, description=description, shapes=body.shapes)
        scales = comparison.scales
        limits = {**PUSHED.limits(scales), **unpushed_profile(run).limits(scales)}
        comparison = replace(comparison, recovery_limits=MappingProxyType(limits))
        values = MappingProxyType(evaluate(comparison))
    unusual = run.model_dump(include={"disturbance", "sensors"}, exclude_defaults=True)
    texts = [f"{name}.{key} = {value!r}" for name, of in unusual.items() for key, value in of.items()]
    known = {"controller": record.controller, "planner": planned.planner, "disturbances": texts + described}
    known["notes"] = [text for text in (planned.note, body.model.findings.of_sides) if text]
    extra = {name: value for name, value in known.items() if value}
    return Trial(planned, comparison, values, profile, taken, extra)


def compile_once() -> None:
    """Compile what a walk needs, unless it was: processes that start together would all do it."""
    mark = folder() / "complete"
    if mark.exists():
        return
    run = load_run("normal", gait={"steps": 1})
    push = {"disturbance.push_y": 40.0, "disturbance.push_at": 0.1}  # the walk leaves its plan
    for changes in ({}, {"controller.stabilizer": "stepping", **push}):
        walk(run.replace(changes))
    with suppress(OSError):  # nothing is kept where nothing can be written
        mark.touch()


@contextmanager
def timed(seconds: dict[str, float], label: str) -> Iterator[None]:
    """Record the wall-clock time of a stage without that of compiling [s]."""
    start = clock()
    yield
    seconds[label] = clock() - start
