"""Walk a motion under torque control, in MuJoCo or another engine.

Each step is ``step1`` (kinematics, contacts, sensors), a control tick where one is due, and ``step2``,
so that the controller senses the contacts of the state on which it acts. The run starts on the periodic
motion.
"""

import copy
import logging
import math
import pickle
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np

from ampm.compiled import bound
from ampm.control.controller import TrackingController
from ampm.control.workspace import SteppingState
from ampm.exceptions import InputError, SolverError, words_of
from ampm.geometry import Array
from ampm.parameters import NO_PLAN, DisturbanceParameters, RunParameters
from ampm.planners import StandingPlanner
from ampm.reference import Reference
from ampm.sensor_parameters import EXACT
from ampm.sensors.readings import Estimator
from ampm.walk import LIMITED, SOLVED, UNSOLVED, Controller, ControllerFactory, ControlOutput, State, Touch
from validation.trial.disturbances import Disturbance, MotorFaults, Plant, Push, pushes_of, release
from validation.trial.followed import Followed
from validation.trial.log import RunLog, act, end_step, sense
from validation.trial.outcome import Outcome, OutcomeName
from validation.trial.physics import Physics, firm_dampers, quiet_mujoco
from validation.trial.plan import PlannedWalk
from validation.trial.readings import DivergedEstimate, Sensors, make_estimator
from validation.trial.record import SimulationRecord, measured_supports, support_height
from validation.trial.references import References
from validation.trial.scene import surfaces
from validation.trial.users import CONTROLLER, UsersCode, UsersError, real_numbers
from validation.trial.users_plan import judged_facts
from validation.trial.watch import Watch

_PROGRESS_STEPS = 50
_FLOAT = np.dtype(np.float64)


def simulate(
    planned: PlannedWalk,
    *,
    controller: ControllerFactory | None = None,
    disturbances: Sequence[Disturbance] = (),
    progress: Callable[[int, int], None] | None = None,
) -> SimulationRecord:
    """Walk a plan and record everything.

    All steps of the plan are walked; of a planner that replans ``gait.steps``, or all footsteps.

    Args:
        planned: it starts on the plan's own posture; the disturbances of its run are unknown to the
            controller.
        controller: makes the controller from robot and run; the one that the run names by default.
        disturbances: further forces, likewise unknown.
        progress: called with (simulation steps done, all) now and then.

    Returns:
        The record up to the end of the run, whatever the outcome; an interrupt ends the run, not the record.

    Raises:
        InputError: control period and time step do not fit, or a user's class fails at once.
    """
    plan, run, replanner = planned.plan, planned.run, planned.replanner
    steps = None if replanner is None or run.footsteps else run.gait.steps
    physics = Physics(planned.scene, run)
    make_controller = controller or CONTROLLER.find(*CONTROLLER.named(run))
    robot = planned.body.own_robot()
    with UsersCode("controller", make_controller):
        follower = make_controller(robot, run.undisturbed, **run.controller.options)
    course = References(plan, run, physics, steps=steps, planner=replanner, controller=follower)
    end = math.inf if replanner else course.total * physics.time_step
    forces = forces_of(run, copied(disturbances), end)
    stood = stand(planned, physics) if run.sensors.stand and run.sensors.estimator != EXACT else None
    start = place(physics, run, course.table[0])
    if stood is not None:
        with UsersCode("estimator", stood):
            stood.begin(start)
    estimating = make_estimator(run, planned.body, start) if stood is None else stood
    loop = ClosedLoop(physics, follower, course, run, estimator=estimating, disturbances=forces)
    judged, model = judged_facts(plan), pickle.dumps(physics.model)
    record = loop.run(progress)
    if judged_facts(plan) != judged:
        raise InputError("the planner changed its plan after handing it over; let replan make another one.")
    if pickle.dumps(physics.model) != model:
        raise InputError("a user's class changed the simulated model in the walk; keep to its arguments.")
    if replanner is not None and record.outcome.completed:
        forces_of(run, disturbances, record.outcome.time)
    followed = Followed(tuple(course.plans), np.array(loop.stepped), course.tick)
    outcome, ours = record.outcome, make_controller is TrackingController
    disturbed = bool(forces) or run.disturbance != DisturbanceParameters()
    fixed, way_out = ours and run.controller.stabilizer == "fixed", ""
    if outcome.name is OutcomeName.FELL and disturbed and fixed and outcome.steps_completed:
        way_out = "--set controller.stabilizer=stepping may survive this disturbance"
    elif outcome.name is OutcomeName.DIVERGED:
        way_out = firm_dampers(physics.model)
    if plan.command is not None:
        outcome = replace(outcome, steps_completed=measured_supports(record)[1])
    record = replace(
        record,
        outcome=replace(outcome, cause=f"{outcome.cause}; {way_out}") if way_out else outcome,
        controller="" if ours else CONTROLLER.name_of(make_controller),
        followed=followed,
        changes=followed.changes,
        tick_plan=followed.numbers(record.tick_time),
    )
    floor = surfaces(run.disturbance, plan.contacts)
    return record if np.array_equal(floor, [0.0]) else _with_floor(record, floor)


def stand(planned: PlannedWalk, physics: Physics) -> Any:
    """The run's estimator with what it found, standing on two soles side by side before the walk.

    Raises :class:`InputError` if the floor is not level, the estimator has no ``begin``, or the body falls.
    """
    robot, way_out = planned.body.own_robot(), "or sensors.stand = 0"
    if not np.array_equal(surfaces(planned.run.disturbance, planned.plan.contacts), [0.0]):
        raise InputError(f"sensors.stand needs a level floor at z = 0; take no slopes or heights, {way_out}.")
    still = {"gait.planner": NO_PLAN, "command.settling": 0.0}
    run = planned.run.replace({**still, "command.duration": planned.run.sensors.stand}, footsteps=())
    controller = TrackingController(robot, run.undisturbed)
    course = References(StandingPlanner().plan(run.undisturbed, robot), run, physics, controller=controller)
    estimator = make_estimator(run, planned.body, place(physics, run, course.table[0]))
    if not hasattr(estimator, "begin"):
        raise InputError(f"the estimator {run.sensors.estimator} has no method begin; add it, {way_out}.")
    outcome = ClosedLoop(physics, controller, course, run, estimator=estimator).run().outcome
    if not outcome.completed:
        raise InputError(f"the body does not stand before a walk: {outcome.cause}; lower errors, {way_out}.")
    return estimator


def forces_of(run: RunParameters, disturbances: Sequence[Disturbance], end: float) -> list[Disturbance]:
    """The push of a run and further forces; raises InputError if one never acts before a walk's end [s]."""
    forces, step = [*pushes_of(run.disturbance), *disturbances], run.simulation.time_step
    longer = "raise command.duration" if run.gait.planner == NO_PLAN else "walk more steps"
    for push in forces:
        if isinstance(push, Push) and push.at > end - (1.0 - 1e-9) * step:
            raise InputError(
                f"a push at {push.at:g} s is after the end, at {end:.6g} s; push earlier, or {longer}."
            )
        if isinstance(push, Push) and push.duration < (1.0 - 1e-9) * step:
            rule = f"shorter than simulation.time_step = {step:g} s"
            raise InputError(f"a push of {push.duration:g} s is {rule}; let it last longer.")
    return forces


def copied(disturbances: Sequence[Disturbance]) -> list[Disturbance]:
    """Copies with which a walk or an episode begins; raises InputError for one that cannot be copied."""
    copies, shared = list[Disturbance](), dict[int, Any]()
    for item in disturbances:
        try:
            copies.append(copy.deepcopy(item, shared))
        except Exception as error:  # of a user's class
            raise InputError(
                f"the disturbance {type(item).__qualname__} cannot be copied, and every walk takes a copy "
                f"({type(error).__name__}: {words_of(error)}); open files and the like in its method apply."
            ) from error
    return copies


def place(physics: Physics, run: RunParameters, start: Reference) -> State:
    """Place the body on a reference's posture, with errors of the run; returns the state that is known."""
    q, v, off = start.q.copy(), start.v.copy(), run.disturbance
    if off.start_velocity:
        v[:3] += off.start_velocity * np.random.default_rng([off.seed, 2]).standard_normal(3)
    # The soles carry weight from the first instant.
    q[2] += off.floor_height - run.simulation.start_depth
    physics.place(q, v)
    q[2] -= off.floor_height  # which the controller does not know
    return State(0.0, q, start.v, 0.5 * physics.time_step)


def _with_floor(record: SimulationRecord, floor: Array) -> SimulationRecord:
    """A record with the heights of its floor; the commanded ZMP, which is on z = 0, moves onto the floor.

    The height of the floor at a tick is that under the contacts of the step before it.
    """
    before = np.maximum(np.arange(0, record.steps, record.substeps) - 1, 0)
    at = record.point_position[before, :, 2] + record.point_penetration[before]
    load = record.point_force[before, :, 2]
    height = np.repeat(support_height(floor, at, load), record.substeps)[: record.steps]
    along = record.command_force[:, :2] / record.command_force[:, 2:]
    return replace(record, floor=floor, command_zmp=record.command_zmp + height[:, None] * along)


class ClosedLoop:
    """Controller and physics, a control tick at a time, and the record of it.

    The physics are placed at the start. The controller is None if the caller gives outputs to :meth:`act`.
    The estimator is None if the controller gets the true state, as the sensors of the run read it.

    Attributes:
        command: of the last tick.
        done: whole steps of the physics.
        stepped: states of the stabiliser that steps, off the plan.
    """

    def __init__(
        self,
        physics: Physics,
        controller: Controller | None,
        course: References,
        run: RunParameters,
        *,
        estimator: Estimator | None = None,
        disturbances: Sequence[Disturbance] = (),
    ) -> None:
        self.disturbances = [(item, UsersCode("disturbance", item, walking=True)) for item in disturbances]
        self.plant = Plant(physics)
        pushes = [item for item in disturbances if isinstance(item, Push)]
        for segment in (run.disturbance.push_segment, *(push.segment for push in pushes)):
            self.plant.segment(segment)  # refused before the walk, the run's also without a force
        self.physics, self.controller, self.course = physics, controller, course
        self.users_code = UsersCode("controller", controller, walking=True)
        self.done, self.stepped = 0, list[SteppingState]()
        robot, fault = physics.robot, run.disturbance
        self.faults = MotorFaults(run, robot.nu) if fault.actuation_delay or fault.torque_bias else None
        self.log = RunLog(course.total, physics)
        self.command, self._row = self.log.command, self.log.row
        names = ("torque", "rate", "force", "zmp", "angular_momentum")
        self._parts = [(name, (part := getattr(self.command, name)), part.shape) for name in names]
        planned = run.gait.planner != NO_PLAN
        self.watch = Watch(self.log.stance, run.controller.unsolved_limit, robot.description.scale, planned)
        self._touch = Touch(self.log.touching, self.log.normal_force, physics.time_step)
        self.sensors = None if run.sensors.perfect else Sensors(run, self.log, estimator)
        self._estimates = estimator is not None
        self._bind()

    def _bind(self) -> None:
        """Bind the compiled functions to the log."""
        log = self.log.handle
        self._sense = bound(sense, (log,), 0)
        self._act = bound(act, (log,), 0, 0, 0.0, 0, 0.0)
        self._end_step = bound(end_step, (log,), 0, 0, self.physics.data.efc_force)

    def run(self, progress: Callable[[int, int], None] | None = None) -> SimulationRecord:
        """Walk to the end of the course; an interrupt or a user's error ends it, and the record is kept.

        Raises :class:`InputError` if a user's class fails in the first step, or for lack of memory or files.
        """
        end, course, controller = None, self.course, cast("Controller", self.controller)
        try:
            with quiet_mujoco():
                while end is None and self.done < course.total:
                    if progress is not None and self.done % _PROGRESS_STEPS < self.physics.substeps:
                        progress(self.done, course.total)
                    sensed = self.sense()
                    with self.users_code:
                        output = controller.update(*sensed)
                    end = self.act(output)
            if progress is not None:
                progress(self.done, max(self.done, course.total))
        except DivergedEstimate as error:
            end = self.watch.blown_up(self.done * self.physics.time_step, str(error))
        except SolverError as error:
            refused = self.done * self.physics.time_step
            cause = f"the solver refused the QP at {refused:.3f} s: {error}"
            end = Outcome(OutcomeName.INFEASIBLE, refused, cause, 0)
        except InputError as error:
            # In the first step nothing is lost. Machine errors do not count as failures of the walk.
            if not self.done or isinstance(error.__cause__, MemoryError | OSError):
                raise
            logging.getLogger("ampm").debug("The walk ends.", exc_info=True)
            cause = error.fault if isinstance(error, UsersError) else str(error)
            end = Outcome(OutcomeName.CRASHED, 0.0, cause, 0)
        except KeyboardInterrupt:
            end = Outcome(OutcomeName.INTERRUPTED, 0.0, "Ctrl-C", 0)
        time, steps = self.done * self.physics.time_step, len(course.step_ends)
        if end is not None:
            steps = int(np.searchsorted(course.step_ends, time + 1e-6))
        end = end or Outcome(OutcomeName.COMPLETED, time, "", steps)
        return self.log.close(self.done, replace(end, time=time, steps_completed=steps))

    def sense(self) -> tuple[State, Touch, Reference]:
        """Begin a control tick; what the controller gets."""
        self._begin_step()
        return self.read()

    def read(self) -> tuple[State, Touch, Reference]:
        """What the sensors of this tick read, and what the walk follows; benchmarks time it with `apply`."""
        physics, k = self.physics, self.done
        self._sense(physics.data.ncon)
        reference = next(self.course.references)
        self._planned = reference.row  # of which a user's controller may change nothing
        if self.sensors is None:
            body = physics.body
            state, touch = State(k * physics.time_step, body.q, body.v, 0.5 * body.time_step), self._touch
        else:
            with self.users_code:
                commanded = getattr(self.controller, "acceleration", None) if self._estimates else None
                if commanded is not None:
                    name, shape = "'acceleration', which the estimator reads,", (physics.robot.nv,)
                    commanded = real_numbers(name, commanded, shape, finite=True).astype(np.float64)
            state, touch = self.sensors.update(k, commanded)
        self._sensed = state, touch  # of which the controller gets copies
        touch = Touch(np.array(touch.contact), np.array(touch.normal_force), touch.age, touch.threshold)
        return State(state.time, np.array(state.q), np.array(state.v), state.velocity_lag), touch, reference

    def act(self, output: ControlOutput) -> Outcome | None:
        """Let the output of a tick act until the next one is due; whether the walk is over."""
        end, first = self.apply(output), self.done
        until = max(first + 1, min(first + self.physics.substeps, self.course.total))
        while True:
            end = self._finish_step(end)
            if end is not None or self.done >= until:
                return end
            self._begin_step()

    def _begin_step(self) -> None:
        self.physics.engine.step1()
        if not self.disturbances:
            return
        release(self.plant)
        for disturbance, users_code in self.disturbances:
            with users_code:
                disturbance.apply(self.done * self.physics.time_step, self.plant)
        self.log.keep_pushes(self.done, self.plant.pushes)

    def _finish_step(self, end: Outcome | None) -> Outcome | None:
        """End a step of the physics; whether the walk is over, as it is if its tick said so."""
        physics, k = self.physics, self.done
        data, time = physics.data, k * physics.time_step
        physics.engine.step2()
        goes_on = self._end_step(k, data.ncon, data.efc_force)
        if not goes_on and physics.body.warnings.any():
            return self.watch.blown_up(time)
        self.done += 1
        return end if goes_on else self.watch.check(time, SOLVED)

    def apply(self, output: ControlOutput) -> Outcome | None:
        """Set and keep the command of this tick, and plan again; whether the walk is over."""
        planned, k = self._planned, self.done
        with self.users_code:
            if not isinstance(output, ControlOutput):
                raise TypeError(f"it returned {type(output).__name__}; return ampm.ControlOutput(torque)")
            self._take(output)
            if self.faults is not None:
                self.faults.act(self.command.torque, self.command.rate)
            self._row[0] = planned if output.reference is None else output.reference.row
            # A user's controller does not say what a fall is.
            self.log.stands_by[0] = self._row[0] if type(self.controller) is TrackingController else planned
            status, residual, seconds = output.status, np.float64(output.residual), np.float64(output.seconds)
            if status not in (SOLVED, LIMITED, UNSOLVED):
                raise ValueError(f"{status} is not a QP status")
            if not self._act(k, int(status), residual, int(output.iterations or 0), seconds):
                raise ValueError(self._not_finite())
        if isinstance(self.controller, TrackingController) and self.controller.stepped is not None:
            self.stepped.append(self.controller.stepped)
        self.course.replan(float(planned["time"]), *self._sensed)
        if self.course.total > self.log.steps:
            self.log.extend(self.course.total)
            self._bind()
        limit = ""
        if status == LIMITED:
            robot, q = self.physics.robot, self.physics.body.q[7:]
            share = np.abs(self.command.torque) / robot.torque_limit
            room = np.minimum(q - robot.lower, robot.upper - q)
            limit = f"{robot.joint_names[share.argmax()]} at {100 * share.max():.0f} % of its torque"
            if share.max() < 0.99:  # it was the other one
                limit = f"{robot.joint_names[room.argmin()]} {room.min():.2g} rad from its end"
        return self.watch.check(k * self.physics.time_step, status, residual=residual, limit=limit)

    def _take(self, output: ControlOutput) -> None:
        """Copy a controller's output, NaN for what it does not say; ValueError of another shape or type."""
        for name, target, shape in self._parts:
            value = getattr(output, name)
            if value is None:  # of a torque: refused by `act`
                target.fill(math.nan)
            elif type(value) is np.ndarray and value.dtype is _FLOAT and value.shape == shape:
                target[:] = value  # nearly always; a call takes longer
            else:
                target[:] = real_numbers(name, value, shape)
        if output.rate is not None and math.isnan(self.command.rate[0]):  # of the others see `act`
            raise ValueError(self._not_finite())

    def _not_finite(self) -> str:
        """Which part of the command is not finite, in words."""
        command, names = self.command, self.physics.robot.joint_names
        for what in ("torque", "rate"):
            wrong = ~np.isfinite(getattr(command, what))
            if wrong.any():
                joint = int(wrong.argmax())
                return f"{what} of {names[joint]} is {getattr(command, what)[joint]}"
        return f"the COM of its reference is {command.com}"
