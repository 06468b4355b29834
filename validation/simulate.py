"""Walk a motion in MuJoCo under torque control; the only module that owns ``MjData``.

Each step is ``mj_step1`` (kinematics, contacts, sensors), a control tick where one is due, and ``mj_step2``, so that
the controller senses the contacts of the very state it acts on. The run starts on the periodic motion.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from ampm.controller import LIMITED, UNSOLVED, ControlOutput, TrackingController
from ampm.exceptions import InputError
from ampm.reference import TrackingReference, tracking_reference
from ampm.robot import Robot
from validation.bridge import pinocchio_model, to_mujoco
from validation.record import Outcome, OutcomeName, SimulationRecord

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.gait import GaitPlan
    from ampm.motion import WholeBodyMotion
    from ampm.parameters import RunParameters
    from models.human import BodyModel

FALL_SHARE = 0.75
"""The body has fallen when its COM is lower than this share of the planned height."""

DIVERGENCE = 0.3
"""The run has diverged when the COM is farther than this from the plan [m]."""

FIRST_SIGN = 0.02
"""COM error that is told as the first sign of a failure [m]."""

_PROGRESS_STEPS = 50
_NO_POINTS = np.zeros(0, dtype=np.intp)
_XYZW = np.array([4, 5, 6, 3])  # Pinocchio's order of the root's quaternion
_BAD_ACCELERATION = int(mujoco.mjtWarning.mjWARN_BADQACC)


@dataclass(frozen=True)
class _Points:
    """Indices of the sole points' geoms and sites in the compiled model."""

    of_geom: NDArray[np.intp]
    sites: NDArray[np.intp]
    soles: NDArray[np.intp]


class Physics:
    """One simulation: model, data, and what is read from them at every step.

    Args:
        body_model: MJCF and its description.
        run: time step and control frequency.

    Raises:
        InputError: the control period is no multiple of the time step.
    """

    def __init__(self, body_model: BodyModel, run: RunParameters) -> None:
        self.model = body_model.compile()
        self.data = mujoco.MjData(self.model)
        self.robot = Robot(pinocchio_model(self.model), body_model.description)
        self.time_step = float(self.model.opt.timestep)
        ratio = 1.0 / (run.controller.frequency * self.time_step)
        self.substeps = round(ratio)
        if self.substeps < 1 or abs(ratio - self.substeps) > 1e-9 * ratio:
            raise InputError(
                f"controller.frequency = {run.controller.frequency:g} Hz gives a tick every {ratio:.4g} time steps of "
                f"{self.time_step:g} s; it must be a whole number: choose for example "
                f"controller.frequency = {1.0 / (max(1, self.substeps) * self.time_step):g}"
            )
        description = body_model.description
        sites = [site for _, _, site in description.sole_points()]
        of_geom = np.full(self.model.ngeom, -1, dtype=np.intp)
        for index, name in enumerate(sites):
            of_geom[self.model.geom(name).id] = index
        self.points = _Points(
            of_geom=of_geom,
            sites=np.array([self.model.site(name).id for name in sites]),
            soles=np.array([self.model.site(leg.sole_frame).id for leg in description.legs]),
        )
        self.root = self.model.body(description.root_segment).id
        self.q, self.v = np.zeros(self.robot.nq), np.zeros(self.robot.nv)
        self._root_rotation = self.data.xmat[self.root].reshape(3, 3)  # a view

    def place(self, q: NDArray[np.float64], v: NDArray[np.float64]) -> None:
        """Set the state from Pinocchio's coordinates."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:], self.data.qvel[:] = to_mujoco(q, v)

    def state(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """State in Pinocchio's coordinates, after ``mj_step1``; the arrays are overwritten by the next call."""
        qpos, qvel, q, v = self.data.qpos, self.data.qvel, self.q, self.v
        q[:] = qpos
        q[3:7] = qpos[_XYZW]
        v[:] = qvel
        v[:3] = qvel[:3].dot(self._root_rotation)  # world to root axes
        return q, v

    def sensed(self, point: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Whether each sole point is in contact, shape (P,), from :meth:`touching_points`."""
        touching = np.zeros(len(self.points.sites) + 1, dtype=bool)
        touching[point] = True
        return touching[:-1]  # the last stands for all that is no sole point

    def touching_points(self) -> NDArray[np.intp]:
        """Sole point of every contact after ``mj_step1``, -1 for none, shape (ncon,)."""
        if not self.data.ncon:
            return _NO_POINTS
        # MuJoCo sorts the two geoms of a contact by type: the floor, a plane, comes first.
        return self.points.of_geom[self.data.contact.geom[:, 1]]


@dataclass
class _Log:
    """Preallocated arrays of a run."""

    q: NDArray[np.float64]
    qd: NDArray[np.float64]
    torque: NDArray[np.float64]
    warmstart: NDArray[np.float64]
    point: NDArray[np.intp]
    address: NDArray[np.intp]
    frame: NDArray[np.float64]
    place: NDArray[np.float64]
    distance: NDArray[np.float64]
    constraint_force: NDArray[np.float64]
    sites: NDArray[np.float64]
    rotation: NDArray[np.float64]
    sensors: NDArray[np.float64]

    @classmethod
    def empty(cls, steps: int, physics: Physics) -> _Log:
        m, p = physics.model, len(physics.points.sites)
        return cls(
            q=np.empty((steps + 1, m.nq)),
            qd=np.empty((steps + 1, m.nv)),
            torque=np.empty((steps, m.nu)),
            warmstart=np.empty((steps, m.nv)),
            point=np.full((steps, p), -1, dtype=np.intp),
            address=np.full((steps, p), -1, dtype=np.intp),
            frame=np.zeros((steps, p, 9)),
            place=np.zeros((steps, p, 3)),
            distance=np.zeros((steps, p)),
            constraint_force=np.zeros((steps, 3 * p + 2 * m.njnt)),
            sites=np.empty((steps + 1, m.nsite, 3)),
            rotation=np.empty((steps + 1, 2, 9)),
            sensors=np.empty((steps + 1, m.nsensordata)),
        )

    def keep_contacts(self, k: int, data: mujoco.MjData, point: NDArray[np.intp]) -> NDArray[np.float64]:
        """Copy the contacts of step k as they are; :meth:`sole_contacts` sorts them out after the run.

        Args:
            k: step.
            data: after ``mj_step2``.
            point: sole point of every contact, -1 for none.

        Returns:
            The sole points' normal forces, shape (P,) [N].
        """
        n, rows = data.ncon, data.nefc
        normal = np.zeros(self.point.shape[1] + 1)
        if n:
            contact = data.contact
            address = contact.efc_address
            self.point[k, :n], self.address[k, :n] = point, address
            self.frame[k, :n], self.place[k, :n] = contact.frame, contact.pos
            self.distance[k, :n] = contact.dist
            self.constraint_force[k, :rows] = data.efc_force
            normal[point] = self.constraint_force[k].take(address)
        return normal[:-1]  # the last stands for all that is no sole point

    def sole_contacts(
        self, done: int
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Force (K, P, 3), place (K, P, 3) and depth (K, P) of every sole point in the steps done."""
        points = self.point.shape[1]
        force, place = np.zeros((done, points, 3)), np.zeros((done, points, 3))
        depth = np.zeros((done, points))
        step, slot = np.nonzero((self.point[:done] >= 0) & (self.address[:done] >= 0))
        point = self.point[step, slot]
        rows = self.address[step, slot, None] + np.arange(3)  # normal and two tangents
        local = self.constraint_force[step[:, None], rows]
        # A point is a sphere over a plane: one contact at most.
        force[step, point] = np.einsum("ck,ckj->cj", local, self.frame[step, slot].reshape(-1, 3, 3))
        place[step, point], depth[step, point] = self.place[step, slot], -self.distance[step, slot]
        return force, place, depth


def simulate(
    plan: GaitPlan,
    motion: WholeBodyMotion,
    run: RunParameters,
    body_model: BodyModel,
    *,
    steps: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> SimulationRecord:
    """Walk the plan and record everything.

    Args:
        plan: with feet; the constant of L_y is taken from the motion.
        motion: the periodic whole-body step.
        run: gains, contact, time step.
        body_model: the simulated body.
        steps: walking steps, the plan's by default.
        progress: called with (simulation steps done, all) now and then.

    Returns:
        The record up to the end of the run, whatever the outcome; an interrupt ends the run, not the record.

    Raises:
        InputError: control period and time step do not fit, or more steps than planned.
    """
    steps = plan.parameters.steps if steps is None else steps
    if not 1 <= steps <= plan.parameters.steps:
        raise InputError(
            f"{steps} steps were asked for, but the plan has {plan.parameters.steps}; "
            f"ask for 1 ... {plan.parameters.steps} or raise gait.steps"
        )
    physics = Physics(body_model, run)
    plan = plan.with_angular_momentum_offset(motion.report.angular_momentum_y_offset)
    dt = physics.time_step
    duration = steps * plan.constants.step_duration
    total = int(np.floor(duration / dt + 1e-9))
    ticks = np.arange(0, total, physics.substeps) * dt
    reference = tracking_reference(
        plan,
        motion,
        physics.robot,
        ticks,
        lead=run.controller.touchdown_lead,
        early=run.controller.touchdown_window,
    )
    controller = TrackingController(physics.robot, reference, run, velocity_lag=0.5 * dt)
    start = motion.sample(np.zeros(1), physics.robot)
    q = start.q[0].copy()
    q[2] -= run.simulation.start_depth  # the soles carry weight from the first instant
    physics.place(q, start.v[0])
    return _Walk(physics, controller, reference, plan, run, total, progress).run()


class _Walk:
    """The closed loop of one run."""

    def __init__(
        self,
        physics: Physics,
        controller: TrackingController,
        reference: TrackingReference,
        plan: GaitPlan,
        run: RunParameters,
        total: int,
        progress: Callable[[int, int], None] | None,
    ) -> None:
        self.physics, self.controller, self.reference = physics, controller, reference
        self.plan, self.run_parameters = plan, run
        self.total, self.progress = total, progress
        self.outputs: list[ControlOutput] = []
        self.log = _Log.empty(total, physics)
        self.normal_force = np.zeros(len(physics.points.sites))
        self.warnings = physics.data.warning.number  # a view
        self.first_sign = ""
        self.unsolved_ticks = round(run.controller.unsolved_limit * run.controller.frequency)

    def run(self) -> SimulationRecord:
        done, name, cause = 0, OutcomeName.COMPLETED, ""
        try:
            with _quiet_mujoco():
                for k in range(self.total):
                    ended = self._step(k)
                    done = k + 1
                    if ended is not None:
                        name, cause = ended
                        break
                    if self.progress is not None and k % _PROGRESS_STEPS == 0:
                        self.progress(k, self.total)
        except KeyboardInterrupt:
            name, cause = OutcomeName.INTERRUPTED, "the run was interrupted by the user"
        if self.progress is not None:
            self.progress(done, self.total)
        self._finish(done)
        dt = self.physics.time_step
        walked = int(np.floor(done * dt / self.plan.constants.step_duration + 1e-6))
        if name == OutcomeName.COMPLETED:
            walked = round(self.total * dt / self.plan.constants.step_duration)
        elif self.first_sign and name != OutcomeName.INTERRUPTED:
            cause = f"{cause}; the first sign was {self.first_sign}"
        return self._record(done, Outcome(name, done * dt, cause, walked))

    def _step(self, k: int) -> tuple[OutcomeName, str] | None:
        physics, log = self.physics, self.log
        model, data = physics.model, physics.data
        log.warmstart[k] = data.qacc_warmstart
        mujoco.mj_step1(model, data)
        log.q[k], log.qd[k] = data.qpos, data.qvel
        log.sites[k] = data.site_xpos
        log.rotation[k] = data.site_xmat[physics.points.soles]
        point = physics.touching_points()
        if k % physics.substeps == 0:
            q, v = physics.state()
            output = self.controller.update(q, v, physics.sensed(point), self.normal_force)
            self.outputs.append(output)
            data.ctrl[:] = output.torque
            ended = self._watch(k, output)
            if ended is not None:
                log.torque[k] = data.ctrl
                mujoco.mj_step2(model, data)
                log.sensors[k] = data.sensordata
                return ended
        log.torque[k] = data.ctrl
        mujoco.mj_step2(model, data)
        self.normal_force = log.keep_contacts(k, data, point)
        log.sensors[k] = data.sensordata
        if self.warnings[_BAD_ACCELERATION] or not math.isfinite(np.add.reduce(data.qpos)):
            return (
                OutcomeName.DIVERGED,
                f"the accelerations left all bounds at {(k + 1) * physics.time_step:.3f} s",
            )
        return None

    def _watch(self, k: int, output: ControlOutput) -> tuple[OutcomeName, str] | None:
        """End of the run by the state at tick ``k``, if any; remembers the first sign of trouble."""
        com = self.physics.data.subtree_com[self.physics.root].tolist()
        wanted = output.com.tolist()
        time = k * self.physics.time_step
        error = [a - b for a, b in zip(com, wanted, strict=True)]
        size = math.hypot(*error)
        if not self.first_sign:
            if output.status == UNSOLVED:
                self.first_sign = f"an unsolved QP at {time:.3f} s (residual {output.residual:.2g})"
            elif size > FIRST_SIGN:
                axis = "xyz"[int(np.argmax(np.abs(error)))]
                self.first_sign = (
                    f"a COM {size * 1e3:.0f} mm off the plan, mostly along {axis}, at {time:.3f} s"
                )
            elif output.status == LIMITED:
                limit = self.physics.robot.torque_limit
                worst = int(np.argmax(np.abs(output.torque) / limit))
                joint = self.physics.robot.joint_names[worst]
                share = abs(output.torque[worst]) / limit[worst]
                self.first_sign = (
                    f"a torque or joint limit at {time:.3f} s ({joint} at {share:.0%} of its torque)"
                )
        if self.controller.unsolved_in_a_row > self.unsolved_ticks:
            return OutcomeName.INFEASIBLE, f"the QP stayed unsolved until {time:.3f} s"
        if not math.isfinite(size):
            return OutcomeName.DIVERGED, f"the state is no longer finite at {time:.3f} s"
        if com[2] < FALL_SHARE * wanted[2]:
            return OutcomeName.FELL, f"the COM sank to {com[2]:.2f} m at {time:.3f} s"
        if size > DIVERGENCE:
            return OutcomeName.DIVERGED, f"the COM was {size:.2f} m off the plan at {time:.3f} s"
        return None

    def _finish(self, done: int) -> None:
        """State and sensors at the end of the last step."""
        physics, log = self.physics, self.log
        mujoco.mj_forward(physics.model, physics.data)
        log.q[done], log.qd[done] = physics.data.qpos, physics.data.qvel
        log.sites[done] = physics.data.site_xpos
        log.rotation[done] = physics.data.site_xmat[physics.points.soles]
        log.sensors[done] = physics.data.sensordata

    def _record(self, done: int, outcome: Outcome) -> SimulationRecord:
        physics, log = self.physics, self.log
        model, dt, robot = physics.model, physics.time_step, physics.robot
        hold = np.arange(done) // physics.substeps
        ticks = len(self.outputs)
        sensors = {}
        for i in range(model.nsensor):
            start, size = model.sensor_adr[i], model.sensor_dim[i]
            sensors[model.sensor(i).name] = log.sensors[: done + 1, start : start + size]
        point_sites = log.sites[: done + 1, physics.points.sites]
        force, place, depth = log.sole_contacts(done)
        position = np.where(depth[..., None] > 0.0, place, point_sites[:-1])
        rotation = log.rotation[: done + 1].reshape(-1, 3, 3)
        xyzw = Rotation.from_matrix(rotation).as_quat().reshape(done + 1, 2, 4)

        def held(name: str) -> NDArray[np.float64]:
            shape = np.shape(getattr(self.outputs[0], name)) if ticks else (3,)
            values = np.array([getattr(o, name) for o in self.outputs]).reshape(ticks, *shape)
            return values[hold]

        return SimulationRecord(
            time=np.arange(done + 1) * dt,
            q=log.q[: done + 1],
            qd=log.qd[: done + 1],
            torque=log.torque[:done],
            warmstart=log.warmstart[:done],
            point_force=force,
            point_position=position,
            point_penetration=depth,
            point_velocity=np.diff(point_sites, axis=0) / dt,
            point_foot=robot.point_foot,
            point_group=robot.point_group,
            com=sensors["com"],
            angular_momentum=sensors["angular_momentum"],
            foot_position=log.sites[: done + 1, physics.points.soles],
            foot_rotation=xyzw[..., [3, 0, 1, 2]],
            sensors={k: v for k, v in sensors.items() if k not in ("com", "angular_momentum")},
            command_com=held("com"),
            command_zmp=held("zmp"),
            command_force=held("force"),
            command_angular_momentum=held("angular_momentum"),
            command_point_force=held("point_force"),
            tick_time=np.arange(ticks) * (physics.substeps * dt),
            qp_status=np.array([o.status for o in self.outputs], dtype=np.int8),
            qp_residual=np.array([o.residual for o in self.outputs]),
            qp_iterations=np.array([o.iterations for o in self.outputs], dtype=np.int32),
            qp_time=np.array([o.seconds for o in self.outputs]),
            outcome=outcome,
            mass=robot.mass,
            gravity=robot.gravity,
            time_step=dt,
            friction=self.run_parameters.contact.friction,
            torque_limit=robot.torque_limit,
            joint_range=np.stack([robot.lower, robot.upper], axis=1),
            joint_names=robot.joint_names,
        )


@contextlib.contextmanager
def _quiet_mujoco() -> Iterator[None]:
    """Keep MuJoCo from writing MUJOCO_LOG.TXT into the working folder; outcomes tell of its warnings."""
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(None)
