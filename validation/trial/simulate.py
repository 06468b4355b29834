"""Walk a motion under torque control, in MuJoCo or another engine.

Each step is ``step1`` (kinematics, contacts, sensors), a control tick where one is due, and ``step2``,
so that the controller senses the contacts of the state on which it acts. The run starts on the periodic
motion.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ampm.compiled import bound
from ampm.control.controller import TrackingController
from ampm.exceptions import InputError, SolverError
from ampm.parameters import DisturbanceParameters
from ampm.planner.heights import uneven
from ampm.walk import LIMITED, SOLVED, UNSOLVED, ControlOutput, State, Timing, Touch
from validation.trial import spill
from validation.trial.disturbances import Disturbance, Plant, Push, describe, pushes_of
from validation.trial.divergence import explained
from validation.trial.faults import MotorFaults, started
from validation.trial.followed import Followed
from validation.trial.log import RunLog
from validation.trial.outcome import Outcome, OutcomeName
from validation.trial.physics import Physics, quiet_mujoco
from validation.trial.readings import Sensing, make_estimator
from validation.trial.record import FLOOR, PLANS, SimulationRecord, support_height
from validation.trial.references import Course, References, Replanning
from validation.trial.scene import disturbed_model
from validation.trial.shapes import make_robot
from validation.trial.step import act, end_step, sense
from validation.trial.users import CONTROLLER, UsersCode, UsersError
from validation.trial.watch import End, Watch

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.parameters import RunParameters
    from ampm.sensors.readings import Estimator, EstimatorFactory
    from ampm.stepping.follower import SteppedTick
    from ampm.walk import Controller, ControllerFactory, Replanner, WalkPlan
    from models.scene import BodyModel

    Array = NDArray[np.float64]

_PROGRESS_STEPS = 50


def simulate(
    plan: WalkPlan,
    run: RunParameters,
    body: BodyModel,
    *,
    controller: ControllerFactory | None = None,
    estimator: EstimatorFactory | None = None,
    planner: Replanner | None = None,
    disturbances: Sequence[Disturbance] = (),
    steps: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> SimulationRecord:
    """Walk the plan and record everything.

    Args:
        plan: of the walk; it starts on the plan's own posture.
        run: gains, contact, time step; its section ``disturbance`` acts, unknown to the controller.
        body: the simulated body.
        controller: makes the controller from robot and run; the one that ``run`` names by default.
        estimator: makes the estimator; the one that ``run`` names by default.
        planner: goes on planning while walking.
        disturbances: further forces; the controller gets no information on them.
        steps: walking steps; by default those of the plan, and of a planner that goes on ``gait.steps``, or
            over footsteps all.
        progress: called with (simulation steps done, all) now and then.

    Returns:
        The record up to the end of the run, whatever the outcome; an interrupt ends the run, not the record.

    Raises:
        InputError: control period and time step do not fit, more steps than planned, or a user's class fails
            at once.
    """
    planned = plan.contacts.steps
    if steps is None and planner is not None and not run.footsteps:
        steps = run.gait.steps
    elif steps is not None and not 1 <= steps <= planned:
        raise InputError(
            f"{steps} steps were requested, but the plan has {planned}; "
            f"take 1 ... {planned} or raise gait.steps."
        )
    scene = disturbed_model(body, run, plan.contacts)
    physics = Physics(scene, run)
    disturbances = [*pushes_of(run.disturbance), *disturbances]
    dt, gains = physics.time_step, run.controller
    timing = Timing(
        lead=gains.touchdown_lead,
        early=gains.touchdown_window,
        hold=(physics.substeps - 1) * dt,
        slope=physics.substeps * dt if gains.hold == "first-order" else 0.0,
    )
    course = References(
        plan,
        timing,
        time_step=dt,
        substeps=physics.substeps,
        steps=steps,
        author=planner,
    )
    for push in disturbances:
        if isinstance(push, Push) and push.at >= course.total * dt and planner is None:
            raise InputError(
                f"a push at {push.at:g} s comes after the walk, which ends at {course.total * dt:.3g} s; "
                "push earlier, or walk more steps."
            )
        if isinstance(push, Push):  # before the walk, not when it is pushed
            Plant(physics.model, physics.data, physics.robot.description).position(push.segment)
    start = course.start
    q = start.q.copy()
    # The soles carry weight from the first instant.
    q[2] += run.disturbance.floor_height - run.simulation.start_depth
    physics.place(q, started(start.v, run.disturbance))
    factory = controller or CONTROLLER.find(run.controller.name, run.controller.options)
    with UsersCode("controller", factory):
        known = physics.robot if scene is body else make_robot(body.compile(), body.description)
        follower = factory(known, run.undisturbed, **run.controller.options)
        if hasattr(follower, "follow"):
            follower.follow(plan, timing)
    replanning = None
    if planner is not None:
        with UsersCode("planner", planner):
            replanning = Replanning(planner, course, follower)
    q[2] -= run.disturbance.floor_height  # is not known
    estimating = make_estimator(run, known, State(0.0, q, start.v, 0.5 * dt), estimator)
    loop = ClosedLoop(
        physics,
        follower,
        course,
        run,
        replanning=replanning,
        estimator=estimating,
        disturbances=disturbances,
        progress=progress,
    )
    record, metadata = loop.run(), {}
    if uneven(plan.contacts.footsteps):
        levels = sorted({step.position[2] for step in plan.contacts.footsteps})
        metadata[FLOOR] = " ".join(map(repr, levels))
        record = _with_zmp_on_floor(record, metadata)
    followed = Followed(
        tuple(course.plans),
        tuple(tick * physics.substeps * dt for tick in course.since),
        tuple(loop.stepped),
        physics.substeps * dt,
    )
    record = replace(record, followed=followed)
    if followed.moved:
        record = replace(record, tick_plan=followed.numbers(record.tick_time))
        metadata[PLANS] = str(followed.changes)
    if factory is not TrackingController:
        metadata["controller"] = CONTROLLER.name_of(factory)
    elif run.controller.stabilizer == "fixed" and (
        disturbances or run.disturbance != DisturbanceParameters()
    ):
        record = replace(record, outcome=_with_way_out(record.outcome))
    if not record.outcome.completed:
        record = replace(record, outcome=explained(record.outcome, physics.model))
    if disturbances:
        metadata["disturbances"] = "; ".join(map(describe, disturbances))
    return replace(record, metadata=metadata) if metadata else record


def _with_zmp_on_floor(record: SimulationRecord, metadata: Mapping[str, str]) -> SimulationRecord:
    """The commanded ZMP, which is on z = 0, on the plane of the contacts of the step before each tick."""
    ticks = np.arange(0, record.steps, record.substeps)
    before = np.maximum(ticks - 1, 0)
    place, load = record.point_position[before, :, 2], record.point_force[before, :, 2]
    height = np.repeat(support_height(metadata, place, load), record.substeps)[: record.steps]
    along = record.command_force[:, :2] / record.command_force[:, 2:]
    return replace(record, command_zmp=record.command_zmp + height[:, None] * along)


def _with_way_out(outcome: Outcome) -> Outcome:
    """The end of a disturbed walk, and what may survive it."""
    if outcome.name is not OutcomeName.FELL:
        return outcome
    way_out = "--set controller.stabilizer=stepping may survive this disturbance"
    return replace(outcome, cause=f"{outcome.cause}; {way_out}")


class ClosedLoop:
    """Controller and physics, step by step, and the record of it.

    Args:
        physics: placed at the start.
        controller: at its first tick.
        course: what the walk follows and when it ends; both may change at a tick.
        run: parameters; its section ``disturbance`` has the faults of the motors.
        replanning: the planner that goes on planning, if there is one.
        estimator: that makes the state; None for the true one, as the sensors of the run read it.
        disturbances: external forces.
        progress: called with (simulation steps done, all) now and then.

    Attributes:
        command: of the last tick.
        stepped: states of the stabiliser that steps, off the plan.
    """

    def __init__(
        self,
        physics: Physics,
        controller: Controller,
        course: Course,
        run: RunParameters,
        *,
        replanning: Replanning | None = None,
        estimator: Estimator | None = None,
        disturbances: Sequence[Disturbance] = (),
        progress: Callable[[int, int], None] | None = None,
    ) -> None:
        self.disturbances = [(item, UsersCode("disturbance", item)) for item in disturbances]
        self.plant = Plant(physics.model, physics.data, physics.robot.description)
        self.plant.segment(run.disturbance.push_segment)  # refused also without a force
        self.physics, self.controller, self.replanning = physics, controller, replanning
        self.users_code = UsersCode("controller", controller)
        self.stepped: list[SteppedTick] = []
        self._steps = controller if isinstance(controller, TrackingController) else None
        self.course, self.progress = course, progress
        robot, fault = physics.robot, run.disturbance
        self.faults = None
        if fault.actuation_delay or fault.torque_bias:
            self.faults = MotorFaults(run, robot.torque_limit)
        self.log = RunLog(course.total, physics)
        self.command, self._row = self.log.command, self.log.row
        self.watch = Watch(self.log.stance, run.controller.unsolved_limit, robot.description.scale)
        self.sensing = None
        if not run.sensors.perfect:
            self.sensing = Sensing(run, self.log, robot.gravity, estimator)
        self._bind()

    def _bind(self) -> None:
        """Bind the compiled functions to the log."""
        log = self.log.handle
        self._touch = Touch(self.log.touching, self.log.normal_force, self.physics.time_step)
        self._sense = bound(sense, (log,), 0)
        self._act = bound(act, (log,), 0, 0, 0.0, 0, 0.0)
        self._end_step = bound(end_step, (log,), 0, 0, self.physics.data.efc_force)

    def run(self) -> SimulationRecord:
        """Step to the end of the run; an interrupt or a user's error ends it, and the record is kept.

        Raises:
            InputError: a user's class fails in the first step, or for lack of memory or files.
        """
        done, end = 0, None
        try:
            with quiet_mujoco():
                while done < self.course.total:
                    if self.progress is not None and done % _PROGRESS_STEPS == 0:
                        self.progress(done, self.course.total)
                    end = self._step(done)
                    if end is not None:
                        done += not self.physics.body.warnings.any()
                        break
                    done += 1
            if self.progress is not None:
                self.progress(done, max(done, self.course.total))
        except SolverError as error:
            refused = done * self.physics.time_step
            end = End(OutcomeName.INFEASIBLE, f"the solver refused the QP at {refused:.3f} s: {error}")
        except InputError as error:
            # In the first step nothing is lost. Machine errors do not count as failures of the walk.
            if not done or isinstance(error.__cause__, MemoryError | OSError):
                raise
            logging.getLogger("ampm").debug("The walk ends.", exc_info=True)
            end = End(OutcomeName.CRASHED, error.fault if isinstance(error, UsersError) else str(error))
        except KeyboardInterrupt:
            end = End(OutcomeName.INTERRUPTED, "the run was interrupted by the user")
        time = done * self.physics.time_step
        if end is None:
            walked = len(self.course.step_ends)
            return self.log.close(done, Outcome(OutcomeName.COMPLETED, time, "", walked))
        walked = int(np.searchsorted(self.course.step_ends, time + 1e-6))
        return self.log.close(done, Outcome(end.name, time, end.cause, walked))

    def _step(self, k: int) -> End | None:
        """One step of the physics, with a control tick where one is due."""
        physics, end = self.physics, None
        data, time = physics.data, k * physics.time_step
        physics.engine.step1()
        if self.disturbances:
            self._disturb(k, time)
        if k % physics.substeps == 0:
            end = self.tick(k, time)
        physics.engine.step2()
        if k % spill.ROWS == 0:
            spill.release()
        if self._end_step(k, data.ncon, data.efc_force):
            return end
        if physics.body.warnings.any():
            return self.watch.blown_up(time)
        return self.watch.check(time, SOLVED)

    def _disturb(self, k: int, time: float) -> None:
        """Push the body during step k."""
        self.plant.release()
        for disturbance, users_code in self.disturbances:
            with users_code:
                disturbance.apply(time, self.plant)
        self.log.keep_pushes(k, self.plant.pushes)

    def tick(self, k: int, time: float) -> End | None:
        """One control tick; whether the walk is over."""
        body = self.physics.body
        self._sense(self.physics.data.ncon)
        reference = next(self.course.references)
        if self.sensing is None:
            state, touch = State(time, body.q, body.v, 0.5 * body.time_step), self._touch
        else:
            state, touch = self.sensing.update(self.log, k, getattr(self.controller, "acceleration", None))
        with self.users_code:
            output = self.controller.update(state, touch, reference)
            if not isinstance(output, ControlOutput):
                raise TypeError(f"it returned a value of type {type(output).__name__}, not a ControlOutput")
            if self.faults is not None:
                output = self.faults.act(output)
            if k == 0:  # NumPy spreads a single number over all joints
                self._check_shapes(output)
            self._take(output)
            self._row[0] = reference.row if output.reference is None else output.reference.row
            status, residual = int(output.status), float(output.residual)
            if status not in (SOLVED, LIMITED, UNSOLVED):
                raise ValueError(f"{status} is not a QP status")
            if not self._act(k, status, residual, int(output.iterations), float(output.seconds)):
                raise ValueError(self._not_finite())
        if self._steps is not None and self._steps.stepped is not None:
            self.stepped.append(self._steps.stepped)
        if self.replanning is not None:
            self.replanning.update(float(reference.time), state, touch)
        if self.course.total > len(self.log.record.torque):
            self.log = self.log.extended(self.course.total)
            self._bind()
        limit = self._worst_joint() if status == LIMITED else ""
        return self.watch.check(time, status, residual=residual, limit=limit)

    def _take(self, output: ControlOutput) -> None:
        """Copy a controller's output; NaN for what it does not say."""
        command, momentum = self.command, output.angular_momentum
        command.torque[:] = output.torque
        command.rate[:] = math.nan if output.rate is None else output.rate
        command.force[:] = math.nan if output.force is None else output.force
        command.zmp[:] = math.nan if output.zmp is None else output.zmp
        command.angular_momentum[:] = math.nan if momentum is None else momentum

    def _check_shapes(self, output: ControlOutput) -> None:
        """Raise a ValueError where a part of a controller's first output has another shape."""
        for name in ("torque", "rate", "force", "zmp", "angular_momentum"):
            value, wanted = getattr(output, name), getattr(self.command, name).shape
            if value is not None and np.shape(value) != wanted:
                raise ValueError(f"{name} has shape {np.shape(value)} and must have {wanted}")

    def _not_finite(self) -> str:
        """Which part of the command is not finite, in words; NaN is a rate that holds the torque."""
        command, names = self.command, self.physics.robot.joint_names
        for what, wrong in (("torque", ~np.isfinite(command.torque)), ("rate", np.isinf(command.rate))):
            if wrong.any():
                joint = int(wrong.argmax())
                return f"{what} of {names[joint]} is {getattr(command, what)[joint]}"
        return f"the COM of its reference is {command.com}"

    def _worst_joint(self) -> str:
        """The joint closest to its torque limit."""
        robot = self.physics.robot
        share = np.abs(self.command.torque) / robot.torque_limit
        worst = int(np.argmax(share))
        return f"{robot.joint_names[worst]} at {share[worst]:.0%} of its torque"
