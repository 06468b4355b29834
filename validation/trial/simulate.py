"""Walk a motion in MuJoCo under torque control; the only module that owns ``MjData``.

Each step is ``mj_step1`` (kinematics, contacts, sensors), a control tick where one is due, and ``mj_step2``,
so that the controller senses the contacts of the state on which it acts. The run starts on the periodic
motion.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from ampm.compiled import Bundle, bound, compiled
from ampm.control.controller import TrackingController
from ampm.exceptions import InputError, SolverError
from ampm.parameters import steps_per_tick
from ampm.planner.heights import uneven
from ampm.vectors import put, turned, vector
from ampm.walk import LIMITED, ControlOutput, State, Timing, Touch
from validation.trial.bridge import to_mujoco
from validation.trial.controllers import find_controller, name_of
from validation.trial.disturbances import Disturbance, Plant, Push, pushes_of
from validation.trial.faults import FaultyController, behind_faults, started
from validation.trial.log import RunLog, SolePoints
from validation.trial.origin import moved_references
from validation.trial.outcome import Outcome, OutcomeName
from validation.trial.record import FLOOR, SimulationRecord
from validation.trial.restart import carry_on, quiet_mujoco
from validation.trial.scene import disturbed_model
from validation.trial.shapes import make_robot
from validation.trial.users import UsersCode
from validation.trial.watch import End, Stance, Watch

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.parameters import RunParameters
    from ampm.walk import Controller, ControllerFactory, Reference, WalkPlan
    from models.scene import BodyModel

    Array = NDArray[np.float64]

_PROGRESS_STEPS = 50
_TICKS = 16_384  # of a table of references
_BAD_STATE = slice(int(mujoco.mjtWarning.mjWARN_BADQPOS), int(mujoco.mjtWarning.mjWARN_BADQACC) + 1)


class Physics:
    """One simulation: model, data, and the quantities read at every step.

    Args:
        body_model: MJCF and its description.
        run: time step and control frequency.

    Raises:
        InputError: the control period is no multiple of the time step.
    """

    def __init__(self, body_model: BodyModel, run: RunParameters) -> None:
        self.model = body_model.compile()
        self.data = mujoco.MjData(self.model)
        self.robot = make_robot(self.model, body_model.description)
        self.time_step = float(self.model.opt.timestep)
        self.substeps = steps_per_tick(run.controller.frequency, self.time_step)
        description = body_model.description
        self.points = SolePoints(
            self.model,
            tuple(site for _, _, site in description.sole_points()),
            tuple(leg.sole_frame for leg in description.legs),
        )
        self.q, self.v = np.zeros(self.robot.nq), np.zeros(self.robot.nv)
        # Views of MuJoCo's own memory.
        root = self.model.body(description.root_segment).id
        rotations = self.data.xmat.reshape(-1, 3, 3)
        state = self.data.qpos, self.data.qvel, rotations[root], self.q, self.v
        self._convert = bound(convert_state, state)
        self.com = self.data.subtree_com[root]
        self.trunk = self._axes(description.trunk_frame)[:, 2]  # its long axis
        sites = self.points.sites[-2:]
        self.soles = self.data.site_xpos[sites[0] : sites[1] + 1 : sites[1] - sites[0]]

    def _axes(self, name: str) -> Array:
        """Axes of a segment, or of a site, to world; a view of shape (3, 3)."""
        site = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_SITE, name)
        flat = self.data.xmat[self.model.body(name).id] if site < 0 else self.data.site_xmat[site]
        return np.asarray(flat.reshape(3, 3))

    def place(self, q: NDArray[np.float64], v: NDArray[np.float64]) -> None:
        """Set the state from Pinocchio's coordinates."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:], self.data.qvel[:] = to_mujoco(q, v)

    def state(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """State in Pinocchio's coordinates after ``mj_step1``; the next call overwrites the arrays."""
        self._convert()
        return self.q, self.v


@compiled
def convert_state(qpos: Array, qvel: Array, root_rotation: Array, q: Array, v: Array) -> None:
    """A state of MuJoCo in Pinocchio's coordinates, with the root's rotation to world, shape (3, 3)."""
    q[:] = qpos
    q[3], q[4], q[5], q[6] = qpos[4], qpos[5], qpos[6], qpos[3]
    v[:] = qvel
    put(v[0:3], turned(root_rotation.T, vector(qvel[0:3])))


@compiled
def apply(own: Any, torque: Array, rate: Array, centre: Array, trunk: Array, feet: Array) -> None:
    """Let the torque of a tick act, and take over the planned COM, trunk axis and soles."""
    for j in range(len(torque)):
        own.ctrl[j], own.torque[j], own.rate[j] = torque[j], torque[j], rate[j]
    for axis in range(3):
        own.planned[0, axis], own.planned[1, axis] = centre[0, axis], trunk[axis, 2]
        own.planned[2, axis], own.planned[3, axis] = feet[0, axis], feet[1, axis]


def simulate(
    plan: WalkPlan,
    run: RunParameters,
    body: BodyModel,
    *,
    controller: ControllerFactory | None = None,
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
        disturbances: further forces; the controller gets no information on them.
        steps: walking steps, the plan's by default.
        progress: called with (simulation steps done, all) now and then.

    Returns:
        The record up to the end of the run, whatever the outcome; an interrupt ends the run, not the record.

    Raises:
        InputError: control period and time step do not fit, more steps than planned, or a user's class fails.
    """
    planned = plan.contacts.steps
    steps = planned if steps is None else steps
    if not 1 <= steps <= planned:
        raise InputError(
            f"{steps} steps were requested, but the plan has {planned}; "
            f"take 1 ... {planned} or raise gait.steps"
        )
    scene = disturbed_model(body, run, plan.contacts)
    physics = Physics(scene, run)
    disturbances = [*pushes_of(run.disturbance), *disturbances]
    dt, step_ends = physics.time_step, plan.contacts.step_ends[:steps]
    total = int(np.floor(step_ends[-1] / dt + 1e-9))
    for push in disturbances:
        if isinstance(push, Push) and push.at >= total * dt:
            raise InputError(
                f"a push at {push.at:g} s comes after the walk, which ends at {total * dt:.3g} s; "
                "push earlier, or walk more steps."
            )
        if isinstance(push, Push):  # before the walk, not when it is pushed
            Plant(physics.model, physics.data, physics.robot.description).position(push.segment)
    gains = run.controller
    timing = Timing(
        lead=gains.touchdown_lead,
        early=gains.touchdown_window,
        hold=(physics.substeps - 1) * dt,
        slope=physics.substeps * dt if gains.hold == "first-order" else 0.0,
    )
    references = _references(plan, np.arange(0, total, physics.substeps, dtype=np.float64) * dt, timing)
    if run.disturbance.origin:
        references = moved_references(references, run.disturbance.origin)
    first = next(references)
    start = first.posture
    q = start.q.copy()
    # The soles carry weight from the first instant.
    q[2] += run.disturbance.floor_height - run.simulation.start_depth
    physics.place(q, started(start.v, run.disturbance))
    factory = controller or find_controller(run.controller.name)
    own = factory is TrackingController
    with contextlib.nullcontext() if own else UsersCode("controller", factory):
        known = physics.robot if scene is body else make_robot(body.compile(), body.description)
        follower = factory(known, run.undisturbed)
        if hasattr(follower, "follow"):
            follower.follow(plan, timing)
        follower = behind_faults(follower, run, known)
    loop = ClosedLoop(
        physics, follower, chain([first], references), run, step_ends, total, progress, disturbances
    )
    if uneven(plan.contacts.footsteps):
        heights = sorted({step.position[2] for step in plan.contacts.footsteps})
        loop.log.metadata[FLOOR] = " ".join(map(repr, heights))
    record = loop.run()
    metadata = loop.log.metadata | ({} if own else {"controller": name_of(factory)})
    if disturbances:
        metadata["disturbances"] = "; ".join(str(disturbance) for disturbance in disturbances)
    return replace(record, metadata=metadata) if metadata else record


def _references(plan: WalkPlan, times: Array, timing: Timing) -> Iterator[Reference]:
    """One reference for each tick, from tables of a part of the walk, to bound the memory."""
    for start in range(0, len(times), _TICKS):
        before = min(start, 1)  # rates of change need the ticks on both sides
        table = plan.table(times[start - before : start + _TICKS + 1], timing)
        yield from table[before : before + _TICKS]


class ClosedLoop:
    """Controller and physics, step by step, and the record of it.

    Args:
        physics: placed at the start.
        controller: at its first tick.
        references: one for each control tick.
        run: parameters.
        step_ends: when each step ends, to count those completed, shape (steps,) [s].
        total: simulation steps.
        progress: called with (simulation steps done, all) now and then.
        disturbances: external forces.
    """

    def __init__(
        self,
        physics: Physics,
        controller: Controller,
        references: Iterable[Reference],
        run: RunParameters,
        step_ends: NDArray[np.float64],
        total: int,
        progress: Callable[[int, int], None] | None = None,
        disturbances: Sequence[Disturbance] = (),
    ) -> None:
        self.disturbances = [(item, UsersCode("disturbance", item)) for item in disturbances]
        self.plant = Plant(physics.model, physics.data, physics.robot.description)
        self.plant.segment(run.disturbance.push_segment)  # refused also without a force
        self.physics, self.controller, self.references = physics, controller, iter(references)
        behind = controller.controller if isinstance(controller, FaultyController) else controller
        self.own = type(behind) is TrackingController
        self.users_code = contextlib.nullcontext() if self.own else UsersCode("controller", behind)
        self.torque, self.rate, limit = *np.zeros((2, physics.robot.nu)), physics.robot.torque_limit.copy()
        self.carry_on = bound(carry_on, (self.torque, self.rate, limit, physics.data.ctrl), 0.0)
        self.step_ends, self.total, self.progress = step_ends, total, progress
        self.log = RunLog(total, physics.model, physics.data, physics.points, physics.substeps)
        self.log.start(physics.data)
        self.watch = Watch(run.controller.unsolved_limit, physics.robot.description.scale)
        planned = np.zeros((4, 3))  # COM, trunk and soles
        self.stance = Stance(physics.com, physics.trunk, physics.soles, planned[0], planned[1], planned[2:])
        acts = Bundle(torque=self.torque, rate=self.rate, ctrl=physics.data.ctrl, planned=planned)
        self.no_rate, table = np.full(len(limit), np.nan), np.zeros((4, 4))[::2, ::2]  # any steps
        self.apply = bound(apply, (acts,), limit, limit, *[table] * 3)
        self.warnings = physics.data.warning.number[_BAD_STATE]  # a view

    def run(self) -> SimulationRecord:
        """Step to the end of the run; an interrupt ends the run, and the record is kept."""
        done, end = 0, None
        try:
            with quiet_mujoco():
                for k in range(self.total):
                    if self.progress is not None and k % _PROGRESS_STEPS == 0:
                        self.progress(k, self.total)
                    end = self._step(k)
                    if any(self.warnings.tolist()):  # MuJoCo has reset the state instead of stepping it
                        end = self.watch.blown_up(k * self.physics.time_step)
                        break
                    done = k + 1
                    if end is not None:
                        break
            if self.progress is not None:
                self.progress(done, self.total)
        except SolverError as error:
            refused = done * self.physics.time_step
            end = End(OutcomeName.INFEASIBLE, f"the solver refused the QP at {refused:.3f} s: {error}")
        except KeyboardInterrupt:
            end = End(OutcomeName.INTERRUPTED, "the run was interrupted by the user")
        time = done * self.physics.time_step
        if end is None:
            walked = len(self.step_ends)
            return self._record(done, Outcome(OutcomeName.COMPLETED, time, "", walked))
        walked = int(np.searchsorted(self.step_ends, time + 1e-6))
        return self._record(done, Outcome(end.name, time, end.cause, walked))

    def _step(self, k: int) -> End | None:
        """One step of the physics, with a control tick where one is due."""
        physics, end = self.physics, None
        model, data, time, since = physics.model, physics.data, k * physics.time_step, k % physics.substeps
        if since:
            self.carry_on(since * physics.time_step)
        if since and not self.disturbances:
            mujoco.mj_step(model, data)
        else:
            mujoco.mj_step1(model, data)
            if self.disturbances:
                self._disturb(k, time)
            if not since:
                end = self._tick(k, time)
            mujoco.mj_step2(model, data)
        self.log.keep(k, data)
        if since:
            end = self.watch.check_between_ticks(time, self.stance)
        return end

    def _disturb(self, k: int, time: float) -> None:
        """Push the body during step k."""
        self.plant.release()
        for disturbance, users_code in self.disturbances:
            with users_code:
                disturbance.apply(time, self.plant)
        self.log.keep_pushes(k, self.plant.pushes)

    def _tick(self, k: int, time: float) -> End | None:
        """One control tick; whether the walk is over."""
        physics = self.physics
        self.log.sense(physics.data)
        reference = next(self.references)
        state = State(time, *physics.state(), 0.5 * physics.time_step)
        touch = Touch(self.log.touching.copy(), self.log.normal_force.copy(), physics.time_step)
        with self.users_code:
            output = self.controller.update(state, touch, reference)
            if not self.own:
                output = self._checked(output)
            reference = reference if output.reference is None else output.reference
            self.log.keep_command(k, output, reference)
        rate = self.no_rate if output.rate is None else output.rate
        planned = reference.centre, reference.posture.trunk, reference.feet.values
        self.apply(output.torque, rate, *(np.asarray(part, np.float64) for part in planned))
        return self.watch.check(
            time,
            self.stance,
            output.status,
            gap=self.log.zmp_gap(k),
            residual=output.residual,
            limit=self._worst_joint(output) if output.status == LIMITED else "",
        )

    def _checked(self, output: ControlOutput) -> ControlOutput:
        """Output of a user's controller, if it can be applied."""
        if not isinstance(output, ControlOutput):
            raise TypeError(f"it returned a value of type {type(output).__name__}, not a ControlOutput")
        torque = np.asarray(output.torque, dtype=np.float64)
        for what, values in (("torque", torque), ("rate", output.rate)):
            if values is None:
                continue
            if np.shape(values) != self.torque.shape:
                raise ValueError(f"{what} of shape {np.shape(values)}, not {self.torque.shape}")
            if (bad := ~np.isfinite(values)).any():
                worst = int(np.argmax(bad))
                raise ValueError(f"{what} of {self.physics.robot.joint_names[worst]} is {values[worst]}")
        limit = self.physics.robot.torque_limit
        known: dict[str, Any] = {"torque": np.clip(torque, -limit, limit)}  # as the motors do
        for name, size in (("force", 3), ("zmp", 2), ("angular_momentum", 3), ("rate", len(limit))):
            if (value := getattr(output, name)) is not None:
                known[name] = np.empty(size)
                known[name][:] = value
        return output._replace(**known)

    def _worst_joint(self, output: ControlOutput) -> str:
        """The joint closest to its torque limit."""
        robot = self.physics.robot
        share = np.abs(output.torque) / robot.torque_limit
        worst = int(np.argmax(share))
        return f"{robot.joint_names[worst]} at {share[worst]:.0%} of its torque"

    def _record(self, done: int, outcome: Outcome) -> SimulationRecord:
        dt, robot = self.physics.time_step, self.physics.robot
        kept = self.log.close(done, self.physics.data)
        sensors = kept.pop("sensors")
        return SimulationRecord(
            time=np.arange(done + 1, dtype=np.float64) * dt,
            point_foot=robot.point_foot,
            point_group=robot.point_group,
            com=sensors.pop("com"),
            angular_momentum=sensors.pop("angular_momentum"),
            sensors=sensors,
            tick_time=np.arange(kept["qp_time"].size, dtype=np.float64) * (self.physics.substeps * dt),
            outcome=outcome,
            mass=robot.mass,
            gravity=robot.gravity,
            time_step=dt,
            friction=float(self.physics.model.geom("floor").friction[0]),
            torque_limit=robot.torque_limit,
            joint_range=np.stack([robot.lower, robot.upper], axis=1),
            joint_names=robot.joint_names,
            point_sites=self.physics.points.names,
            sole_sites=self.physics.points.sole_names,
            **kept,
        )
