"""The trial of one gait: plan, walk, measure, compare, judge."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

from ampm.body.orbit import solve_motion
from ampm.compiled import compilation, folder
from ampm.exceptions import InputError
from ampm.parameters import RunParameters
from ampm.planner.contacts import Footstep
from ampm.planner.routes import as_rows
from ampm.planner.support import plan_steps
from ampm.run_file import load_run
from ampm.sensors.readings import EstimatorFactory
from ampm.walk import ControllerFactory, Planner
from validation.judge import profiles
from validation.judge.compare import compare
from validation.judge.metrics import evaluate
from validation.judge.profiles import DEFAULT, Profile
from validation.judge.uncertainty import Uncertainty
from validation.judge.verdict import judge
from validation.measure.measure import measure
from validation.progress import Progress, interruption
from validation.run.trial import Trial
from validation.trial.bridge import passive_joints, to_pinocchio
from validation.trial.disturbances import Disturbance, describe
from validation.trial.plan import PlannedWalk, load_request, make_body, plan_walk
from validation.trial.record import SimulationRecord
from validation.trial.simulate import simulate
from validation.trial.users import CONTROLLER, check_planner


def walk(
    run: RunParameters | str | Path = "normal",
    *,
    controller: ControllerFactory | str | None = None,
    planner: Planner | str | None = None,
    disturbances: Sequence[Disturbance] = (),
    footsteps: Sequence[Footstep] | None = None,
    profile: Profile | str | None = None,
    uncertainty: Uncertainty | None = None,
    name: str | None = None,
    progress: Progress | None = None,
) -> Trial:
    """Plan a gait, walk it in MuJoCo, measure it and judge it; nothing is written.

    What a changed gait leaves open is found, ``trial.run`` has it; ``ampm.load_run(...).as_is()`` walks as it
    is.

    Args:
        run: parameters from :func:`ampm.load_run`, or a preset or TOML file.
        controller: makes the controller from robot, run and the run's ``controller.options``, a class for
            example; or its name. That of the run by default.
        planner: makes the plan, or a name, see :func:`validation.trial.users.load_planner`; that of the
            run by default.
        disturbances: external forces, such as :class:`validation.Push`, beside those of the run.
        footsteps: places to walk over from rest to rest, see :func:`ampm.plan_footsteps`.
        profile: tolerances, or the name of a profile; by default that of the preset if ``run`` is its name,
            and ``pushed`` with a push.
        uncertainty: numerical uncertainty of the metrics, from a convergence study.
        name: of the gait, for reports; that of preset or file by default.
        progress: where to report stages.

    Raises:
        InputError, MathematicalRefusal, BodilyRefusal: there is no such walk, or a user's class fails.
    """
    for value, good, wanted in (
        (
            controller,
            controller is None or isinstance(controller, str) or callable(controller),
            "controller; give a class or function that makes one, or a name",
        ),
        (planner, not isinstance(planner, type), "planner; give an object of this class"),
        (disturbances, isinstance(disturbances, list | tuple), "disturbances; give a list of them"),
    ):
        if not good:
            raise InputError(f"{value!r} cannot be the {wanted}.")
    request = load_request(run if isinstance(run, RunParameters) else str(run))
    request = replace(request, name=name or request.name)
    if footsteps is not None:
        if not len(footsteps):
            raise InputError("footsteps holds none; leave it out to walk the gait's own, or give at least 4.")
        request = replace(request, run=request.run.replace({}, footsteps=as_rows(footsteps)))
    names = {"gait.planner": planner, "controller.name": controller}
    named = {key: name for key, name in names.items() if isinstance(name, str)}
    request = replace(request, run=request.run.replace(named))
    options = request.run.controller.options
    factory = controller if callable(controller) else CONTROLLER.find(request.run.controller.name, options)
    if isinstance(planner, str):
        check_planner(request.run.gait.planner, request.run.planner.options)
        planner = None
    name_of_class = CONTROLLER.name_of(factory)
    CONTROLLER.check_options(name_of_class, factory, options)
    if controller is not None:
        request = replace(request, run=request.run.replace({"controller.name": name_of_class}))
    if not isinstance(profile, Profile):
        own = profiles.own_profile(request.name, request.run, disturbances)
        profile = own if profile is None else profiles.profile(profile)
    seconds: dict[str, float] = {}
    with timed(seconds, "planning"):
        planned = plan_walk(request, progress, planner=planner)
    return walk_planned(
        planned,
        profile,
        controller=factory,
        disturbances=disturbances,
        uncertainty=uncertainty,
        progress=progress,
        seconds=seconds,
    )


def walk_planned(
    planned: PlannedWalk,
    profile: Profile = DEFAULT,
    *,
    controller: ControllerFactory | None = None,
    estimator: EstimatorFactory | None = None,
    disturbances: Sequence[Disturbance] = (),
    uncertainty: Uncertainty | None = None,
    progress: Progress | None = None,
    seconds: Mapping[str, float] | None = None,
    keep: Callable[[SimulationRecord], None] = lambda record: None,
) -> Trial:
    """Walk a plan and judge the walk.

    Args:
        planned: see :func:`validation.trial.plan.plan_walk`.
        profile: tolerances.
        controller: makes the controller from robot and run; the one that the run names by default.
        estimator: makes the estimator; the one that the run names by default.
        disturbances: external forces.
        uncertainty: numerical uncertainty of the metrics.
        progress: where to report stages.
        seconds: wall-clock time of earlier stages.
        keep: called with the record before it is measured.
    """
    run, body, progress = planned.run, planned.body, progress or Progress()
    taken = dict(seconds or {})
    with timed(taken, "simulation"), progress.stage(f"{planned.name}: simulation", "steps") as stage:

        def advance(done: int, total: int) -> None:
            interruption.check()
            stage.advance(done, total)

        record = simulate(
            planned, controller=controller, estimator=estimator, disturbances=disturbances, progress=advance
        )
        keep(record)
    with timed(taken, "measurement"), progress.stage(f"{planned.name}: measurement"):
        passive = passive_joints(planned.scene.model.compile())
        measured = measure(record, planned.scene.robot.model, to_pinocchio, passive)
        description = body.model.description
        comparison = compare(planned.plan, record, measured, description=description, shapes=body.shapes)
        metrics = MappingProxyType(evaluate(comparison))
        verdict = judge(metrics, profile, comparison.scales, uncertainty, ended=record.outcome.ending)
    extra: dict[str, Any] = {}
    if record.controller:
        extra["controller"] = record.controller
    if planned.planner:
        extra["planner"] = planned.planner
    unusual = run.disturbance.model_dump(exclude_defaults=True)
    sensors = run.sensors.model_dump(exclude_defaults=True)
    unusual |= {f"sensors.{key}": value for key, value in sensors.items()}
    if texts := [f"{key} = {value!r}" for key, value in unusual.items()] + list(map(describe, disturbances)):
        extra["disturbances"] = texts
    return Trial(planned, record, comparison, metrics, verdict, MappingProxyType(taken), uncertainty, extra)


def compile_once() -> None:
    """Compile what a walk needs, unless it was: processes that start together would all do it."""
    mark = folder() / "complete"
    if mark.exists():
        return
    run = load_run("normal", gait={"steps": 1})
    body = make_body(run)
    plan = plan_steps(run.gait, run.body.mass, run.foot, body.model.description.sole)
    solve_motion(plan, run, body.robot)
    push = {"disturbance.push_y": 40.0, "disturbance.push_at": 0.1}  # the walk leaves its plan
    for changes in ({}, {"controller.stabilizer": "stepping", **push}):
        walk(run.replace(changes))
    with suppress(OSError):  # nothing is kept where nothing can be written
        mark.touch()


@contextmanager
def timed(seconds: dict[str, float], label: str) -> Iterator[None]:
    """Record the wall-clock time of a stage without that of compiling [s]."""
    start = time.perf_counter() - compilation.seconds
    yield
    seconds[label] = time.perf_counter() - compilation.seconds - start
