"""Torque-level tracking of a planned gait: state and sensed contact in, joint torques out.

Every tick the controller asks for a momentum rate (the plan's, plus COM and angular momentum feedback), feet and
posture accelerations, finds contact forces and accelerations by the QP of :mod:`ampm.wrench_qp`, and turns them
into torques by inverse dynamics. It never sees the simulator.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from scipy.linalg import lapack

from ampm.contact_gate import ContactGate
from ampm.inverse_kinematics import POSTURE_WEIGHTS
from ampm.qp import QPSettings, QPSolution, QPStatus
from ampm.robot import TASK_ROWS
from ampm.wrench_qp import ANGULAR, POINTS, STANCE, SWING, CondensedForm, ForceMap, LimitedForm

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.parameters import RunParameters
    from ampm.reference import TrackingReference
    from ampm.robot import Robot

SOLVED, LIMITED, UNSOLVED = 0, 1, 2
"""Status of a tick: solved; solved in the form with limits; unsolved, the fallback's torques were used."""

_HEEL, _BALL, _TIP = 0, 1, 2
_BRAKE = 500.0  # deceleration with which a joint may run towards its limit [rad/s^2]
_BRAKE_TIME = 0.01  # time in which a joint that runs faster is slowed down [s]
_ROW_SCALE = np.concatenate([np.ones(3), np.full(3, ANGULAR), np.ones(TASK_ROWS - 6)])


@dataclass(frozen=True)
class ControlOutput:
    """What one tick decided.

    Attributes:
        torque: joint torques, shape (nu,) [N m].
        com: COM that the controller steers to, shape (3,) [m].
        force: net ground force that it asked for, shape (3,) [N].
        zmp: ZMP of the wrench that it asked for, shape (2,) [m].
        angular_momentum: about the COM, that it asked for, shape (3,) [N m s].
        point_force: the QP's force at every sole point, shape (P, 3) [N].
        status: SOLVED, LIMITED or UNSOLVED.
        residual: of the QP.
        iterations: of the QP.
        seconds: wall-clock time of the QP [s].
    """

    torque: NDArray[np.float64]
    com: NDArray[np.float64]
    force: NDArray[np.float64]
    zmp: NDArray[np.float64]
    angular_momentum: NDArray[np.float64]
    point_force: NDArray[np.float64]
    status: int
    residual: float
    iterations: int
    seconds: float


class TrackingController:
    """Whole-body inverse dynamics along a :class:`~ampm.reference.TrackingReference`.

    Args:
        robot: the body, as the controller knows it.
        reference: one row per control tick.
        run: gains, friction, solver.
        velocity_lag: how much older the sensed velocities are than the sensed positions [s]. A difference
            quotient, and a semi-implicit integrator's velocity, is the mean over the last step: half a step old.
    """

    def __init__(
        self, robot: Robot, reference: TrackingReference, run: RunParameters, *, velocity_lag: float = 0.0
    ) -> None:
        self.robot, self.reference = robot, reference
        self.gains = run.controller
        self._gate = ContactGate(robot, 1.0 / run.controller.frequency, run.controller.contact_ramp)
        settings = QPSettings(tolerance=run.solver.tolerance, max_iterations=run.solver.max_iterations)
        self.condensed = CondensedForm(run.solver.qp, settings, run.controller.friction)
        self._weights = self._posture_weights()
        self._root_weight = np.sqrt(self._weights)
        limit_settings = QPSettings(  # a problem of mixed scales, solved in few ticks: it is equilibrated
            tolerance=run.solver.tolerance,
            max_iterations=10 * run.solver.max_iterations,
            rho=0.1,
            alpha=1.6,
            scaling=10,
        )
        self.limited = LimitedForm(
            run.solver.qp, limit_settings, robot.nv, self._weights, self.condensed
        )
        self.forces = ForceMap.empty()
        self._local = self._local_points()
        self._trunk = self._reference_trunk()
        self._lag = velocity_lag
        self._acceleration = reference.acceleration[0].copy()
        self._tick = 0
        self._unsolved = 0
        self._phi = np.zeros(18)
        self._eye6 = np.eye(TASK_ROWS, 7)
        self._g = robot.gravity
        self._weight = robot.mass * robot.gravity
        self._arm, self._relative = np.zeros((2, POINTS, 3)), np.zeros((2, POINTS, 3))
        self._rhs = np.zeros(TASK_ROWS)
        self._soft = np.zeros(TASK_ROWS)

    def _posture_weights(self) -> NDArray[np.float64]:
        robot = self.robot
        weights = np.empty(robot.nv)
        weights[:3] = POSTURE_WEIGHTS["root_linear"]
        weights[3:6] = POSTURE_WEIGHTS["root_angular"]
        for legs in robot.leg_joints:
            weights[legs] = POSTURE_WEIGHTS["legs"]
        weights[robot.trunk_joints] = POSTURE_WEIGHTS["trunk"]
        weights[robot.arm_joints] = POSTURE_WEIGHTS["arms"]
        return weights

    def _local_points(self) -> NDArray[np.float64]:
        """Sole points in the sole frame (heel, ball) or the toe frame (tip), shape (2, 6, 3)."""
        robot = self.robot
        data = robot.model.createData()
        pin.framesForwardKinematics(robot.model, data, pin.neutral(robot.model))
        local = np.zeros((2, POINTS, 3))
        for index, (frame, foot, group) in enumerate(
            zip(robot.point_frames, robot.point_foot, robot.point_group, strict=True)
        ):
            base = robot.toe_frames[foot] if group == _TIP else robot.sole_frames[foot]
            local[foot, index % POINTS] = data.oMf[base].actInv(data.oMf[frame].translation)
        return local

    @property
    def ticks(self) -> int:
        """Ticks made so far."""
        return self._tick

    @property
    def unsolved_in_a_row(self) -> int:
        """How many of the latest ticks in a row had an unsolved QP."""
        return self._unsolved

    # ------------------------------------------------------------------- tick

    def update(
        self,
        q: NDArray[np.float64],
        v: NDArray[np.float64],
        sensed: NDArray[np.bool_],
        normal_force: NDArray[np.float64],
    ) -> ControlOutput:
        """One control tick.

        Args:
            q: Pinocchio configuration, shape (nq,).
            v: Pinocchio velocity, shape (nv,).
            sensed: sole points in contact, shape (P,).
            normal_force: latest sensed normal force of every sole point, shape (P,) [N].
        """
        k = self._tick
        self._tick += 1
        ref, robot, gains = self.reference, self.robot, self.gains
        robot.jacobian(q, v)
        now = v + self._lag * self._acceleration  # the velocity at the instant of q
        terms = robot.drift(q, v, now)
        momentum = terms.jacobian[:6] @ now * robot.mass
        opening = self._gate.update(ref.contact[k], ref.due[k], ref.until_lift[k], sensed)
        self._locate_points(terms.com)
        self.forces.update(self._arm, opening.reshape(2, POINTS))

        force, moment, wanted_momentum = self._wanted_momentum(k, q, terms.com, momentum)
        posture = self._posture(k, q, now)
        rows = terms.jacobian * _ROW_SCALE[:, None]
        drift = terms.drift * _ROW_SCALE / self._g
        rhs, soft = self._rhs, self._soft
        rhs[:6] = -drift[:6]
        rhs[2] -= 1.0
        self._foot_tasks(k, q, now, sensed, terms.jacobian, rhs, soft)
        rhs[6:] -= drift[6:]

        scaled = rows / self._root_weight
        gram = scaled @ scaled.T
        gram.flat[:: TASK_ROWS + 1] += soft
        right = self._eye6.copy()
        right[:, 6] = rhs - rows @ posture
        _, columns, info = lapack.dposv(gram, right, lower=1)
        if info != 0:
            return self._hold(k, force, moment, wanted_momentum, terms.com)
        wanted = np.concatenate([force / self._weight, moment * (ANGULAR / self._weight)])
        self.condensed.build(
            self.forces.wrench,
            wanted,
            opening,
            self._landing_force(sensed, normal_force),
            float(ref.right_load[k]),
            columns[5, 5],
            columns[5, 6],
        )
        solution = self.condensed.solve()
        status = SOLVED if solution.solved else UNSOLVED
        if solution.status == QPStatus.INFEASIBLE or not np.isfinite(solution.x).all():
            phi = self._phi  # the last good forces; the accelerations still follow the dynamics
        else:
            phi = solution.x[:18]
        multiplier = columns[:, :6] @ (self.forces.wrench @ phi) + columns[:, 6]
        alpha = posture + (multiplier @ scaled) / self._root_weight
        torque = self._torque(q, v, alpha, phi)
        if self._breaks_limits(q, v, alpha, torque):
            limited = self._solve_limited(q, v, rows, rhs, soft, posture)
            if limited.solved:
                alpha, phi = limited.x[: robot.nv], limited.x[robot.nv : robot.nv + 18]
                torque = self._torque(q, v, alpha, phi)
                status = max(status, LIMITED) if status != UNSOLVED else UNSOLVED
            else:
                status = UNSOLVED
            solution = QPSolution(
                solution.x,
                limited.status,
                max(solution.residual, limited.residual),
                solution.iterations + limited.iterations,
                solution.seconds + limited.seconds,
            )
        self._phi = phi
        self._acceleration = self._g * alpha
        self._unsolved = self._unsolved + 1 if status == UNSOLVED else 0
        limit = robot.torque_limit
        return ControlOutput(
            torque=np.clip(torque, -limit, limit),
            com=ref.com[k],
            force=force,
            zmp=_zmp(terms.com, force, moment),
            angular_momentum=wanted_momentum,
            point_force=self._weight * self.forces.point_forces(phi).reshape(-1, 3),
            status=status,
            residual=solution.residual,
            iterations=solution.iterations,
            seconds=solution.seconds,
        )

    def _hold(
        self,
        k: int,
        force: NDArray[np.float64],
        moment: NDArray[np.float64],
        momentum: NDArray[np.float64],
        com: NDArray[np.float64],
    ) -> ControlOutput:
        """Dependent tasks: no accelerations follow, so no torques either."""
        self._unsolved += 1
        return ControlOutput(
            torque=np.zeros(self.robot.nu),
            com=self.reference.com[k],
            force=force,
            zmp=_zmp(com, force, moment),
            angular_momentum=momentum,
            point_force=np.zeros((2 * POINTS, 3)),
            status=UNSOLVED,
            residual=np.inf,
            iterations=0,
            seconds=0.0,
        )

    def _landing_force(
        self, sensed: NDArray[np.bool_], normal_force: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Force that points of a landing line already carry, whatever is asked of them, shape (P,) [m g].

        The floor pushes as the foot arrives. Told of it, the QP shifts the other foot's load instead of letting
        the ZMP jump.
        """
        landing = sensed & (self._gate.opening[self.robot.point_foot, self.robot.point_group] < 1.0)
        return np.where(landing, normal_force * (self.gains.landing_share / self._weight), 0.0)

    # ------------------------------------------------------------------ tasks

    def _locate_points(self, com: NDArray[np.float64]) -> None:
        """Sole points about the COM and about their sole's reference point, world axes."""
        robot = self.robot
        for foot in (0, 1):
            pose = robot.sole_pose(foot)
            toe = pin.updateFramePlacement(robot.model, robot.data, robot.toe_frames[foot])
            local, relative = self._local[foot], self._relative[foot]
            sole = pose.translation
            relative[:4] = local[:4] @ pose.rotation.T
            relative[4:] = local[4:] @ toe.rotation.T + (toe.translation - sole)
            self._arm[foot] = relative + (sole - com)

    def _wanted_momentum(
        self, k: int, q: NDArray[np.float64], com: NDArray[np.float64], momentum: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Net force [N], moment about the COM [N m] and angular momentum [N m s] that are asked for."""
        ref, robot, gains = self.reference, self.robot, self.gains
        acceleration = (
            ref.com_acceleration[k]
            + gains.com_stiffness * (ref.com[k] - com)
            + gains.com_damping * (ref.com_velocity[k] - momentum[:3] / robot.mass)
        )
        force = robot.mass * acceleration
        force[2] += self._weight
        wanted = ref.angular_momentum[k].copy()
        # The periodic motion is an unstable orbit: a trunk that has tilted is brought back by a little more or
        # less angular momentum than planned, slowly.
        tilt = self._trunk[k] @ robot.rotation_of(robot.trunk_frame).T
        wanted[0] += gains.trunk_gain * 0.5 * (tilt[2, 1] - tilt[1, 2])
        wanted[1] += gains.trunk_gain * 0.5 * (tilt[0, 2] - tilt[2, 0])
        moment = ref.moment[k] + gains.momentum_gain * (wanted - momentum[3:])
        return force, moment, wanted

    def _reference_trunk(self) -> NDArray[np.float64]:
        """Trunk orientation of the motion at every tick, shape (T, 3, 3)."""
        robot = self.robot
        data = robot.model.createData()
        trunk = np.empty((len(self.reference), 3, 3))
        for k, q in enumerate(self.reference.q):
            pin.forwardKinematics(robot.model, data, q)
            trunk[k] = pin.updateFramePlacement(robot.model, data, robot.trunk_frame).rotation
        return trunk

    def _posture(self, k: int, q: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
        """Accelerations that follow the periodic motion, shape (nv,) [g]."""
        ref, gains = self.reference, self.gains
        reference = ref.q[k]
        wanted = ref.acceleration[k] + gains.posture_damping * (ref.v[k] - v)
        wanted[6:] += gains.posture_stiffness * (reference[7:] - q[7:])
        # Root rotation: small-angle error in the root's axes, from the quaternions' product.
        x, y, z, w = q[3:7]
        a, b, c, d = reference[3:7]
        wanted[3] += 2.0 * gains.posture_stiffness * (w * a - d * x - y * c + z * b)
        wanted[4] += 2.0 * gains.posture_stiffness * (w * b - d * y - z * a + x * c)
        wanted[5] += 2.0 * gains.posture_stiffness * (w * c - d * z - x * b + y * a)
        return wanted / self._g

    def _foot_tasks(
        self,
        k: int,
        q: NDArray[np.float64],
        v: NDArray[np.float64],
        sensed: NDArray[np.bool_],
        jacobian: NDArray[np.float64],
        rhs: NDArray[np.float64],
        soft: NDArray[np.float64],
    ) -> None:
        """Wanted accelerations of soles and toes [g] and their softness."""
        ref, gains, robot = self.reference, self.gains, self.robot
        rates = jacobian[6:] @ v
        for foot in (0, 1):
            row = 6 + 6 * foot
            velocity, omega = rates[6 * foot : 6 * foot + 3], rates[6 * foot + 3 : 6 * foot + 6]
            touching = sensed[POINTS * foot : POINTS * (foot + 1)].reshape(3, 2).any(axis=1)
            planned = ref.contact[k, foot] | (ref.due[k, foot] & touching)
            pose = robot.sole_pose(foot)
            pitch, pitch_rate = ref.pitch[k, foot], ref.pitch_velocity[k, foot]
            c, s = np.cos(pitch), np.sin(pitch)
            R = pose.rotation
            # Small-angle rotation error of R_wanted R^T, R_wanted a turn about y.
            e = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]) @ R.T
            tilt = 0.5 * np.array([e[2, 1] - e[1, 2], e[0, 2] - e[2, 0], e[1, 0] - e[0, 1]])
            if not planned.any():
                spin = gains.swing_stiffness * tilt - gains.swing_damping * omega
                spin[1] += ref.pitch_acceleration[k, foot] + gains.swing_damping * pitch_rate
                acceleration = (
                    ref.foot_acceleration[k, foot]
                    + gains.swing_stiffness * (ref.foot_position[k, foot] - pose.translation)
                    + gains.swing_damping * (ref.foot_velocity[k, foot] - velocity)
                )
                softness = SWING
            else:
                held = self._gate.touched[foot]
                flat = planned.all() and held[_HEEL] and held[_BALL]
                pivot = np.zeros(3) if flat else self._pivot(foot, held if held.any() else planned)
                if flat:
                    spin = -gains.stance_damping * omega
                else:  # rolling on heel or toes
                    spin = gains.roll_stiffness * tilt - gains.roll_damping * omega
                    if planned.all():  # a line is late: turn it to the floor
                        rate = gains.touchdown_rate if held[_HEEL] else -gains.touchdown_rate
                        spin[1] = gains.roll_damping * ((rate if held.any() else 0.0) - omega[1])
                    else:
                        spin[1] += ref.pitch_acceleration[k, foot] + gains.roll_damping * pitch_rate
                        if not planned[_BALL]:
                            spin[1] -= gains.roll_stiffness * gains.roll_down_bias
                # A foot that has not yet taken its load is pressed down, or it would bounce.
                opening = self._gate.opening[foot]
                press = 1.0 - max(opening[_HEEL], opening[_BALL]) if ref.contact[k, foot].any() else 0.0
                damping = gains.stance_damping + press * (gains.touchdown_damping - gains.stance_damping)
                drop = velocity + _cross(omega, pivot)
                drop[2] += press * gains.touchdown_velocity
                acceleration = (
                    -damping * drop - _cross(spin, pivot) - _cross(omega, _cross(omega, pivot))
                )
                softness = STANCE
            rhs[row : row + 3], rhs[row + 3 : row + 6] = acceleration, spin
            soft[row : row + 6] = softness
            joint = robot.toe_joints[foot]
            rhs[18 + foot] = (
                ref.toe_acceleration[k, foot]
                + gains.swing_damping * (ref.toe_velocity[k, foot] - v[joint])
                + gains.swing_stiffness * (ref.toe[k, foot] - q[joint + 1])
            )
        rhs[6:] /= self._g

    def _pivot(self, foot: int, held: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Middle of the line that holds a rolling foot, from the sole's reference point, shape (3,) [m]."""
        relative = self._relative[foot]
        first = 0 if held[_HEEL] else 2
        return 0.5 * (relative[first] + relative[first + 1])

    # ---------------------------------------------------------------- results

    def _torque(
        self,
        q: NDArray[np.float64],
        v: NDArray[np.float64],
        alpha: NDArray[np.float64],
        phi: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Inverse dynamics, shape (nu,) [N m]."""
        robot = self.robot
        total = pin.rnea(robot.model, robot.data, q, v, self._g * alpha)
        forces = self._weight * self.forces.point_forces(phi)
        jacobian = robot._terms.jacobian
        for foot in (0, 1):
            f, r = forces[foot], self._relative[foot]
            wrench = np.empty(6)
            wrench[:3] = f.sum(axis=0)
            wrench[3] = r[:, 1] @ f[:, 2] - r[:, 2] @ f[:, 1]
            wrench[4] = r[:, 2] @ f[:, 0] - r[:, 0] @ f[:, 2]
            wrench[5] = r[:, 0] @ f[:, 1] - r[:, 1] @ f[:, 0]
            total = total - wrench @ jacobian[6 + 6 * foot : 12 + 6 * foot]
            total[robot.toe_joints[foot]] -= self._toe_moment(foot, f)
        return total[6:]

    def _toe_moment(self, foot: int, f: NDArray[np.float64]) -> float:
        """Moment of the tips' forces about the toe axis [N m]."""
        robot = self.robot
        toe = robot.data.oMf[robot.toe_frames[foot]]
        sole = robot.data.oMf[robot.sole_frames[foot]].translation
        arm = self._relative[foot, 4:] + (sole - toe.translation)
        moment = _cross(arm[0], f[4]) + _cross(arm[1], f[5])
        return float(toe.rotation[:, 1] @ moment)

    def _breaks_limits(
        self,
        q: NDArray[np.float64],
        v: NDArray[np.float64],
        alpha: NDArray[np.float64],
        torque: NDArray[np.float64],
    ) -> bool:
        if (np.abs(torque) > self.robot.torque_limit).any():
            return True
        low, high = self._joint_bounds(q, v)
        return bool((alpha[6:] < low).any() or (alpha[6:] > high).any())

    def _joint_bounds(
        self, q: NDArray[np.float64], v: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Accelerations that keep every joint able to brake before its limits, shape (nu,) each [g]."""
        robot, angle, rate = self.robot, q[7:], v[6:]
        down = np.sqrt(2.0 * _BRAKE * np.maximum(angle - robot.lower, 0.0))
        up = np.sqrt(2.0 * _BRAKE * np.maximum(robot.upper - angle, 0.0))
        scale = 1.0 / (_BRAKE_TIME * self._g)
        return scale * (-down - rate), scale * (up - rate)

    def _solve_limited(
        self,
        q: NDArray[np.float64],
        v: NDArray[np.float64],
        rows: NDArray[np.float64],
        rhs: NDArray[np.float64],
        soft: NDArray[np.float64],
        posture: NDArray[np.float64],
    ) -> QPSolution:
        robot, g = self.robot, self._g
        limit = robot.torque_limit
        mass = pin.crba(robot.model, robot.data, q)
        mass = np.triu(mass) + np.triu(mass, 1).T
        bias = pin.nle(robot.model, robot.data, q, v)[6:]
        forces = np.empty((robot.nu, 18))
        still = -self._torque(q, v, np.zeros(robot.nv), np.zeros(18))
        for i in range(18):
            unit = np.zeros(18)
            unit[i] = 1.0
            forces[:, i] = self._torque(q, v, np.zeros(robot.nv), unit) + still
        torque_map = np.hstack([g * mass[6:], forces]) / limit[:, None]
        low, high = self._joint_bounds(q, v)
        ceiling = 200.0  # a joint far outside is brought back no harder than this [g]
        return self.limited.solve(
            rows,
            rhs,
            self.forces.wrench,
            soft[6:],
            posture,
            torque_map,
            bias / limit,
            np.ones(robot.nu),
            np.clip(low, -np.inf, ceiling),
            np.clip(high, -ceiling, np.inf),
        )


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Cross product of two 3-vectors; numpy's own is ten times slower."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _zmp(
    com: NDArray[np.float64], force: NDArray[np.float64], moment: NDArray[np.float64]
) -> NDArray[np.float64]:
    """ZMP on the floor of a wrench about the COM, shape (2,) [m]."""
    return np.array(
        [
            com[0] - (com[2] * force[0] + moment[1]) / force[2],
            com[1] - (com[2] * force[1] - moment[0]) / force[2],
        ]
    )
