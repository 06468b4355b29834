"""Torque-level tracking of a planned gait: state and sensed contact in, joint torques out.

Every tick the controller asks for a momentum rate (the plan's, plus COM and angular momentum feedback), feet and
posture accelerations, finds contact forces and accelerations by the QP of :mod:`ampm.wrench_qp`, and turns them
into torques by inverse dynamics. It never sees the simulator.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pinocchio as pin
from scipy.linalg import lapack

from ampm.contact_gate import ContactGate
from ampm.inverse_kinematics import POSTURE_WEIGHTS
from ampm.qp import QPSettings, QPSolution, QPStatus
from ampm.robot import TASK_ROWS
from ampm.wrench_qp import ANGULAR, POINTS, STANCE, SWING, CondensedForm, ForceMap, LimitedForm

if TYPE_CHECKING:
    from collections.abc import Sequence

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


class ControlOutput(NamedTuple):
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
        self.limited = LimitedForm(run.solver.qp, limit_settings, robot.nv, self._weights, self.condensed)
        self.forces = ForceMap()
        self._local = self._local_points()
        self._trunk = self._reference_trunk()
        self._lag = velocity_lag
        self._acceleration = reference.acceleration[0].copy()
        self._tick = 0
        self._unsolved = 0
        self._phi, self._no_force = np.zeros(18), np.zeros(2 * POINTS)
        self._eye6 = np.eye(TASK_ROWS, 7)
        self._g = robot.gravity
        self._weight = robot.mass * robot.gravity
        self._frames = tuple(
            frame for pair in zip(robot.sole_frames, robot.toe_frames, strict=True) for frame in pair
        )
        self._placements = [robot.placements[frame] for frame in self._frames]
        self._trunk_rotation = robot.placements[robot.trunk_frame].rotation
        self._pose = np.zeros((4, 4, 4))  # homogeneous, in the order of _frames
        self._load = np.ones(7)  # net wrench, and one for the tasks' own share
        self._sole = np.zeros((2, 3))  # reference points about the COM
        self._arm = np.zeros((2, POINTS, 3))  # sole points about the COM
        self._toe_lever = np.zeros((2, 2, 3))  # toe moment per force at the two tips
        self._toe_joints = [int(joint) for joint in robot.toe_joints]
        self._torque_limit = robot.torque_limit
        self._lower, self._upper = robot.lower, robot.upper
        self._tested = np.zeros((3, robot.nu))  # torques, joint rates shortly ahead up and down
        self._bounds = np.zeros((3, robot.nu))
        self._bounds[0] = robot.torque_limit
        # Wanted motion of soles (linear, angular about y) and toes by tick, for one look-up a foot.
        self._foot_reference = np.concatenate(
            [
                reference.foot_position,
                reference.foot_velocity,
                reference.foot_acceleration,
                np.stack(
                    [
                        np.cos(reference.pitch),
                        np.sin(reference.pitch),
                        reference.pitch_velocity,
                        reference.pitch_acceleration,
                        reference.toe,
                        reference.toe_velocity,
                        reference.toe_acceleration,
                    ],
                    axis=2,
                ),
            ],
            axis=2,
        )
        self._scale = _ROW_SCALE[:, None] / self._root_weight
        self._to_rows = _ROW_SCALE / self._g
        self._posture_scale = self._root_weight / self._g
        mass, weight = robot.mass, robot.mass * robot.gravity
        self._to_wrench = np.repeat([1.0 / weight, ANGULAR / weight], 3)
        # Feedforward wrench, momentum and its gain, by tick.
        self._wrench_reference = np.hstack([mass * reference.com_acceleration, reference.moment])
        self._wrench_reference[:, 2] += weight
        self._momentum_reference = np.hstack([mass * reference.com_velocity, reference.angular_momentum])
        self._momentum_gain = np.repeat([run.controller.com_damping, run.controller.momentum_gain], 3)
        # Softness of the task rows by which feet stand.
        self._soft = {
            (left, right): np.concatenate(
                [
                    np.zeros(6),
                    np.full(6, STANCE if left else SWING),
                    np.full(6, STANCE if right else SWING),
                    [0, 0],
                ]
            )
            for left in (False, True)
            for right in (False, True)
        }

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
        """What is fixed to each frame of ``_frames``, homogeneous, shape (4, 4, 4).

        Soles: heel and ball points. Toes: tip points, and of each the direction ``e_y x point``, which turned to
        world is the toe joint's moment per force at that point.
        """
        robot = self.robot
        data = robot.model.createData()
        pin.framesForwardKinematics(robot.model, data, pin.neutral(robot.model))
        local = np.zeros((4, 4, 4))
        for index, (frame, foot) in enumerate(zip(robot.point_frames, robot.point_foot, strict=True)):
            point = index % POINTS
            tip = point >= 4
            base = robot.toe_frames[foot] if tip else robot.sole_frames[foot]
            x, y, z = data.oMf[base].actInv(data.oMf[frame].translation)
            local[2 * foot + tip, point % 4] = x, y, z, 1.0
            if tip:
                local[2 * foot + 1, 2 + point % 4] = z, 0.0, -x, 0.0
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
        ref, robot = self.reference, self.robot
        robot.jacobian(q, v)
        now = v + self._lag * self._acceleration  # the velocity at the instant of q
        terms = robot.drift(q, v, now)
        rates = terms.jacobian @ now
        momentum = rates[:6] * robot.mass
        contact, due = ref.contact[k].tolist(), ref.due[k].tolist()
        opening = self._gate.update(contact, due, ref.until_lift[k].tolist(), sensed)
        self._locate_points(terms.com)
        self.forces.update(self._arm, opening, self._toe_lever)

        wrench, wanted_momentum = self._wanted_momentum(k, terms.com, momentum)
        posture = self._posture(k, q, now)
        wanted_tasks, soft = self._foot_tasks(k, q, rates[6:].tolist(), contact, due)
        rhs = self._to_rows * (wanted_tasks - terms.drift)
        scaled = terms.jacobian * self._scale  # rows in units of the QP, in the metric of the posture
        gram = scaled @ scaled.T
        gram.reshape(-1)[:: TASK_ROWS + 1] += soft
        right = self._eye6.copy(order="F")  # LAPACK's own order: no copies
        right[:, 6] = rhs - scaled @ posture
        _, columns, info = lapack.dposv(gram.T, right, lower=1, overwrite_a=1, overwrite_b=1)
        if info != 0:
            return self._hold(k, wrench, wanted_momentum, terms.com)
        self.condensed.build(
            self.forces.wrench,
            self._to_wrench * wrench,
            opening,
            self._landing_force(sensed, normal_force),
            float(ref.right_load[k]),
            float(columns[5, 5]),
            float(columns[5, 6]),
        )
        solution = self.condensed.solve()
        status = SOLVED if solution.solved else UNSOLVED
        if solution.status == QPStatus.INFEASIBLE or not math.isfinite(np.add.reduce(solution.x)):
            phi = self._phi  # the last good forces; the accelerations still follow the dynamics
        else:
            phi = solution.x[:18]
        self._load[:6] = self.forces.wrench @ phi
        alpha = (posture + (columns @ self._load) @ scaled) / self._root_weight
        torque = self._torque(q, v, alpha, phi)
        if self._breaks_limits(q, v, alpha, torque):
            limited = self._solve_limited(
                q, v, scaled * self._root_weight, rhs, soft, posture / self._root_weight
            )
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
        limit = self._torque_limit
        return ControlOutput(
            torque=np.minimum(np.maximum(torque, -limit), limit),
            com=ref.com[k],
            force=wrench[:3],
            zmp=_zmp(terms.com, wrench),
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
        wrench: NDArray[np.float64],
        momentum: NDArray[np.float64],
        com: NDArray[np.float64],
    ) -> ControlOutput:
        """Dependent tasks: no accelerations follow, so no torques either."""
        self._unsolved += 1
        return ControlOutput(
            torque=np.zeros(self.robot.nu),
            com=self.reference.com[k],
            force=wrench[:3],
            zmp=_zmp(com, wrench),
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
        gate = self._gate
        if not gate.landing:
            return self._no_force
        share = np.array(gate.opening)[self.robot.point_foot, self.robot.point_group]
        return normal_force * (sensed & (share < 1.0)) * (self.gains.landing_share / self._weight)

    # ------------------------------------------------------------------ tasks

    def _locate_points(self, com: NDArray[np.float64]) -> None:
        """Soles and sole points about the COM, and the toes' levers, world axes."""
        robot, pose = self.robot, self._pose
        pin.updateFramePlacements(robot.model, robot.data)
        for index, placement in enumerate(self._placements):
            pose[index] = placement.homogeneous
        pose[:, :3, 3] -= com
        self._sole = pose[::2, :3, 3]
        world = (self._local @ pose.transpose(0, 2, 1)).reshape(2, 8, 4)
        self._arm, self._toe_lever = world[:, :POINTS, :3], world[:, POINTS:, :3]

    def _wanted_momentum(
        self, k: int, com: NDArray[np.float64], momentum: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Net force [N] and moment about the COM [N m], shape (6,), and angular momentum [N m s], shape (3,)."""
        ref, robot, gains = self.reference, self.robot, self.gains
        wanted = ref.angular_momentum[k].copy()
        # The periodic motion is an unstable orbit: a trunk that has tilted is brought back by a little more or
        # less angular momentum than planned, slowly.
        turn = self._trunk[k] @ self._trunk_rotation.T
        (_, _, xz), (_, _, yz), (zx, zy, _) = turn.tolist()
        wanted[:2] += (0.5 * gains.trunk_gain * (zy - yz), 0.5 * gains.trunk_gain * (xz - zx))
        error = self._momentum_reference[k] - momentum
        error[3:] = wanted - momentum[3:]
        wrench = self._momentum_gain * error
        wrench += self._wrench_reference[k]
        wrench[:3] += (robot.mass * gains.com_stiffness) * (ref.com[k] - com)
        return wrench, wanted

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
        """Accelerations that follow the periodic motion, in the metric of the posture, shape (nv,) [g]."""
        ref, gains = self.reference, self.gains
        reference = ref.q[k]
        wanted = ref.v[k] - v
        wanted *= gains.posture_damping
        wanted += ref.acceleration[k]
        wanted[6:] += gains.posture_stiffness * (reference[7:] - q[7:])
        # Root rotation: small-angle error in the root's axes, from the quaternions' product.
        x, y, z, w = q[3:7].tolist()
        a, b, c, d = reference[3:7].tolist()
        gain = 2.0 * gains.posture_stiffness
        wanted[3:6] += (
            gain * (w * a - d * x - y * c + z * b),
            gain * (w * b - d * y - z * a + x * c),
            gain * (w * c - d * z - x * b + y * a),
        )
        wanted *= self._posture_scale
        return wanted

    def _foot_tasks(
        self,
        k: int,
        q: NDArray[np.float64],
        rates: list[float],
        contact: list[list[bool]],
        due: list[list[bool]],
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Wanted accelerations of soles and toes, the COM's without contact forces, and the rows' softness.

        In plain numbers: vectors of three are too short for arrays to be worth their while.
        """
        gains, gate = self.gains, self._gate
        tasks = [0.0, 0.0, -self._g, 0.0, 0.0, 0.0]
        toes, stands = [], []
        for foot in (0, 1):
            touching, due_now = gate.touching[foot], due[foot]
            planned = [c or (due_now[i] and touching[i]) for i, c in enumerate(contact[foot])]
            reference = self._foot_reference[k, foot].tolist()
            cosine, sine, pitch_rate, pitch_acceleration, toe, toe_rate, toe_acceleration = reference[9:]
            # Small-angle rotation error of R_wanted R^T, R_wanted a turn about y.
            (xx, xy, xz, _), (yx, _, yz, _), (zx, zy, zz, _), _ = self._pose[2 * foot].tolist()
            tilt = (
                0.5 * (cosine * yz - sine * yx - zy),
                0.5 * (cosine * zx + sine * zz + sine * xx - cosine * xz),
                0.5 * (xy - cosine * yx - sine * yz),
            )
            velocity, omega = rates[6 * foot : 6 * foot + 3], rates[6 * foot + 3 : 6 * foot + 6]
            stand = True in planned
            if stand:
                tasks += self._stance_task(
                    foot, planned, contact[foot], velocity, omega, tilt, pitch_rate, pitch_acceleration
                )
            else:
                stiffness, damping = gains.swing_stiffness, gains.swing_damping
                position = self._placements[2 * foot].translation.tolist()
                for i in (0, 1, 2):
                    tasks.append(
                        reference[6 + i]
                        + stiffness * (reference[i] - position[i])
                        + damping * (reference[3 + i] - velocity[i])
                    )
                tasks += (
                    stiffness * tilt[0] - damping * omega[0],
                    stiffness * tilt[1] + damping * (pitch_rate - omega[1]) + pitch_acceleration,
                    stiffness * tilt[2] - damping * omega[2],
                )
            stands.append(stand)
            toes.append(
                toe_acceleration
                + gains.swing_damping * (toe_rate - rates[12 + foot])
                + gains.swing_stiffness * (toe - q.item(self._toe_joints[foot] + 1))
            )
        return np.array(tasks + toes), self._soft[stands[0], stands[1]]

    def _stance_task(
        self,
        foot: int,
        planned: list[bool],
        contact: list[bool],
        velocity: list[float],
        omega: list[float],
        tilt: tuple[float, float, float],
        pitch_rate: float,
        pitch_acceleration: float,
    ) -> list[float]:
        """Wanted acceleration of a sole in contact, linear then angular [m/s^2, rad/s^2]."""
        gains, held, opening = self.gains, self._gate.touched[foot], self._gate.opening[foot]
        # A foot that has not yet taken its load is pressed down, or it would bounce.
        press = 1.0 - max(opening[_HEEL], opening[_BALL]) if True in contact else 0.0
        damping = gains.stance_damping + press * (gains.touchdown_damping - gains.stance_damping)
        vx, vy, vz = velocity
        vz += press * gains.touchdown_velocity
        wx, wy, wz = omega
        if False not in planned and held[_HEEL] and held[_BALL]:  # flat
            still = -gains.stance_damping
            return [-damping * vx, -damping * vy, -damping * vz, still * wx, still * wy, still * wz]
        stiffness, rolling = gains.roll_stiffness, gains.roll_damping
        sx, sy, sz = (stiffness * e - rolling * w for e, w in zip(tilt, omega, strict=True))
        if False not in planned:  # a line is late: turn it to the floor
            rate = gains.touchdown_rate if held[_HEEL] else -gains.touchdown_rate
            sy = rolling * ((rate if True in held else 0.0) - wy)
        else:  # rolling on heel or toes
            sy += pitch_acceleration + rolling * pitch_rate
            if not planned[_BALL]:
                sy -= stiffness * gains.roll_down_bias
        pivot = self._pivot(foot, held if True in held else planned)
        slide = _cross(omega, pivot)
        turn, centripetal = _cross((sx, sy, sz), pivot), _cross(omega, slide)
        return [
            -damping * (vx + slide[0]) - turn[0] - centripetal[0],
            -damping * (vy + slide[1]) - turn[1] - centripetal[1],
            -damping * (vz + slide[2]) - turn[2] - centripetal[2],
            sx,
            sy,
            sz,
        ]

    def _pivot(self, foot: int, held: list[bool]) -> list[float]:
        """Middle of the line that holds a rolling foot, from the sole's reference point [m]."""
        first = 0 if held[_HEEL] else 2
        arm = self._arm[foot]
        return (0.5 * (arm[first] + arm[first + 1]) - self._sole[foot]).tolist()

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
        left, right = self.forces.foot_wrenches(phi).tolist()
        (lx, ly, lz), (rx, ry, rz) = self._sole.tolist()  # moments: from about the COM to about the soles
        fx, fy, fz, mx, my, mz, left_toe = left
        gx, gy, gz, nx, ny, nz, right_toe = right
        loads = np.array(
            [
                fx,
                fy,
                fz,
                mx / ANGULAR - ly * fz + lz * fy,
                my / ANGULAR - lz * fx + lx * fz,
                mz / ANGULAR - lx * fy + ly * fx,
                gx,
                gy,
                gz,
                nx / ANGULAR - ry * gz + rz * gy,
                ny / ANGULAR - rz * gx + rx * gz,
                nz / ANGULAR - rx * gy + ry * gx,
                left_toe,
                right_toe,
            ]
        )
        total -= (self._weight * loads) @ robot._terms.jacobian[6:]
        return total[6:]

    def _breaks_limits(
        self,
        q: NDArray[np.float64],
        v: NDArray[np.float64],
        alpha: NDArray[np.float64],
        torque: NDArray[np.float64],
    ) -> bool:
        tested, bounds = self._tested, self._bounds
        np.abs(torque, out=tested[0])
        np.multiply(_BRAKE_TIME * self._g, alpha[6:], out=tested[1])
        tested[1] += v[6:]
        np.negative(tested[1], out=tested[2])
        self._braking_rates(q, out=bounds[1:])
        return bool((tested > bounds).any())

    def _braking_rates(self, q: NDArray[np.float64], out: NDArray[np.float64]) -> NDArray[np.float64]:
        """Rates up and down from which every joint can brake before its limits, shape (2, nu) [rad/s]."""
        np.subtract(self._upper, q[7:], out=out[0])
        np.subtract(q[7:], self._lower, out=out[1])
        np.maximum(out, 0.0, out=out)
        out *= 2.0 * _BRAKE
        return np.sqrt(out, out=out)

    def _joint_bounds(
        self, q: NDArray[np.float64], v: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Accelerations that keep every joint able to brake before its limits, shape (nu,) each [g]."""
        up, down = self._braking_rates(q, np.empty((2, self.robot.nu)))
        scale = 1.0 / (_BRAKE_TIME * self._g)
        return scale * (-down - v[6:]), scale * (up - v[6:])

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


def _cross(a: Sequence[float], b: Sequence[float]) -> list[float]:
    """Cross product of two vectors in plain numbers."""
    ax, ay, az = a
    bx, by, bz = b
    return [ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx]


def _zmp(com: NDArray[np.float64], wrench: NDArray[np.float64]) -> NDArray[np.float64]:
    """ZMP on the floor of a wrench about the COM, shape (2,) [m]."""
    x, y, z = com.tolist()
    fx, fy, fz, mx, my, _ = wrench.tolist()
    return np.array([x - (z * fx + my) / fz, y - (z * fy - mx) / fz])
