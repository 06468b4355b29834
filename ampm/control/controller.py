"""Torque-level tracking of a planned gait: state and sensed contact in, joint torques out.

Every tick the controller asks for a momentum rate (the plan's, plus COM and angular momentum feedback), feet
and posture accelerations, finds contact forces and accelerations by the QP of
:mod:`ampm.control.wrench_qp`, and
turns them into torques by inverse dynamics. It never sees the simulator.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.linalg import lapack

from ampm.body.inverse_kinematics import POSTURE_WEIGHTS
from ampm.body.robot import TASK_ROWS
from ampm.control.body_tasks import MomentumTask, PostureTask
from ampm.control.contact_gate import ContactGate
from ampm.control.foot_tasks import FootTasks
from ampm.control.inverse_dynamics import InverseDynamics
from ampm.control.joint_limits import JointLimits
from ampm.control.sole_points import SolePoints
from ampm.control.wrench_qp import (
    ANGULAR,
    FORCES,
    POINTS,
    CondensedForm,
    ForceMap,
    LimitedForm,
    without_closed,
)
from ampm.qp import QPSettings, QPSolution, QPStatus
from ampm.walk import LIMITED, SOLVED, UNSOLVED, ControlOutput

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.body.robot import Robot
    from ampm.parameters import RunParameters
    from ampm.walk import Reference, State, Touch

_ROW_SCALE = np.concatenate([np.ones(3), np.full(3, ANGULAR), np.ones(TASK_ROWS - 6)])
_L_Z = 5
_NO_ANSWER = QPSolution(np.full(FORCES, np.nan), QPStatus.UNSOLVED, math.inf, 0, 0.0)


class _Rows(NamedTuple):
    """The task rows ``B alpha = rhs`` of one tick, in units of the QP.

    Attributes:
        scaled: B in the metric of the posture, shape (20, nv).
        rhs: wanted accelerations less drift; the first six without contact forces, shape (20,).
        softness: shape (20,).
        posture: wanted accelerations in the metric of the posture, shape (nv,) [g].
    """

    scaled: NDArray[np.float64]
    rhs: NDArray[np.float64]
    softness: NDArray[np.float64]
    posture: NDArray[np.float64]


class TrackingController:
    """Whole-body inverse dynamics along the :class:`~ampm.walk.Reference` of each tick.

    Args:
        robot: the body, as the controller knows it.
        run: gains, friction, solver.

    Attributes:
        acceleration: what the last tick decided on, shape (nv,) [m/s^2, rad/s^2].
        phi: its contact forces, in the unknowns of :class:`~ampm.control.wrench_qp.ForceMap`,
            shape (18,) [m g].
    """

    def __init__(self, robot: Robot, run: RunParameters) -> None:
        self.robot = robot
        gains = run.controller
        self._g, self._weight = robot.gravity, robot.mass * robot.gravity
        weights = robot.by_group(POSTURE_WEIGHTS)
        self._root_weight = np.sqrt(weights)
        self._row_scale = _ROW_SCALE[:, None] / self._root_weight
        self._to_rows = _ROW_SCALE / self._g
        self._to_wrench = [1.0 / self._weight] * 3 + [ANGULAR / self._weight] * 3

        self.gate = ContactGate(robot, 1.0 / gains.frequency, gains.contact_ramp)
        self.points = SolePoints(robot)
        self.forces = ForceMap()
        self.momentum = MomentumTask(robot, gains)
        self.posture = PostureTask(gains, self._root_weight / self._g)
        self.feet = FootTasks(robot, gains, self.gate, self.points)
        self.dynamics = InverseDynamics(robot, self.points, self.forces)
        self.limits = JointLimits(robot)
        self._torque_limit = robot.torque_limit

        settings = QPSettings(tolerance=run.solver.tolerance, max_iterations=run.solver.max_iterations)
        self.condensed = CondensedForm(run.solver.qp, settings, gains.friction)
        limit_settings = QPSettings(  # a problem of mixed scales, solved in few ticks: it is equilibrated
            tolerance=2.0 * run.solver.tolerance,
            max_iterations=4 * run.solver.max_iterations,
            rho=0.1,
            alpha=1.6,
            scaling=10,
        )
        self.limited = LimitedForm(run.solver.qp, limit_settings, robot.nv, weights, self.condensed)

        self.acceleration: NDArray[np.float64] | None = None
        self.phi = np.zeros(FORCES)
        self._landing_scale = gains.landing_share / self._weight
        self._no_force = np.zeros(2 * POINTS)
        self._right_sides = np.eye(TASK_ROWS, 7, order="F")  # LAPACK's own order
        self._load = np.ones(7)  # net wrench, and one for the tasks' own share

    # ------------------------------------------------------------------- tick

    def update(self, state: State, touch: Touch, reference: Reference) -> ControlOutput:
        """One control tick.

        Args:
            state: the measured state.
            touch: what the soles sense.
            reference: what is planned at this instant.
        """
        robot, sensed = self.robot, touch.contact
        _, q, v, lag = state
        last = reference.posture.acceleration if self.acceleration is None else self.acceleration
        robot.jacobian(q, v)
        now = v + lag * last  # the velocity at the instant of q
        terms = robot.drift(q, v, now)
        rates, com = (terms.jacobian @ now).tolist(), terms.com.tolist()
        contact, due, until_lift = (part.tolist() for part in reference.contacts)
        opening = self.gate.update(contact, due, until_lift, sensed)
        self.points.update(terms.com)
        self.forces.update(self.points.arm, opening, self.points.toe_lever)

        wrench, angular_momentum = self.momentum.wanted(reference, com, rates)
        posture = self.posture.wanted(reference.posture, q, now)
        wanted, softness = self.feet.wanted(reference.feet, q, rates[6:], contact, due)
        rows = _Rows(
            terms.jacobian * self._row_scale, self._to_rows * (wanted - terms.drift), softness, posture
        )
        columns = self._eliminate(rows)
        if columns is None:  # rows that depend on each other, or are no numbers: the last tick goes on
            alpha, phi = last / self._g, without_closed(self.phi, opening)
            solution, status = _NO_ANSWER, UNSOLVED
            torque = self.dynamics.torque(q, v, alpha, phi)
            if not np.isfinite(torque).all():
                torque = np.zeros(robot.nu)
        else:
            self.condensed.build(
                self.forces.wrench,
                [scale * part for scale, part in zip(self._to_wrench, wrench, strict=True)],
                opening,
                self._landing_force(sensed, touch.normal_force),
                float(reference.right_load),
                float(columns[_L_Z, _L_Z]),
                float(columns[_L_Z, 6]),
            )
            solution = self.condensed.solve()
            status = SOLVED if solution.solved else UNSOLVED
            phi = solution.x[:FORCES]
            if not (solution.solved or _usable(solution)):
                phi = without_closed(self.phi, opening)  # the accelerations still follow the dynamics
            self._load[:6] = self.forces.wrench @ phi
            alpha = (posture + (columns @ self._load) @ rows.scaled) / self._root_weight
            torque = self.dynamics.torque(q, v, alpha, phi)
            if self.limits.broken(q, v, alpha, torque):
                limited = self._solve_limited(q, v, rows)
                if limited.solved:
                    alpha, phi = limited.x[: robot.nv], limited.x[robot.nv : robot.nv + FORCES]
                    torque = self.dynamics.torque(q, v, alpha, phi)
                status = max(status, LIMITED if limited.solved else UNSOLVED)
                solution = _both(solution, limited)
        self.phi = phi
        self.acceleration = self._g * alpha
        return ControlOutput(
            torque=np.minimum(np.maximum(torque, -self._torque_limit), self._torque_limit),
            force=np.array(wrench[:3]),
            zmp=_zmp(com, wrench),
            angular_momentum=np.array(angular_momentum),
            point_force=self._weight * self.forces.point_forces(phi).reshape(-1, 3),
            status=status,
            residual=solution.residual,
            iterations=solution.iterations,
            seconds=solution.seconds,
        )

    # ------------------------------------------------------------------ parts

    def _eliminate(self, rows: _Rows) -> NDArray[np.float64] | None:
        """Solve ``(B W^-1 B' + softness) y = r`` for unit net wrenches and for the tasks' own share.

        Returns:
            Seven columns y, shape (20, 7), or None if the rows depend on each other. The accelerations of a
            net wrench w are ``W^-1/2 (posture + scaled' y (w, 1))``.
        """
        gram = rows.scaled @ rows.scaled.T
        gram.reshape(-1)[:: TASK_ROWS + 1] += rows.softness
        right = self._right_sides.copy(order="F")
        right[:, 6] = rows.rhs - rows.scaled @ rows.posture
        _, columns, info = lapack.dposv(gram.T, right, lower=1, overwrite_a=1, overwrite_b=1)
        # The last number depends on all others: it is not finite if any of them is not.
        return columns if info == 0 and math.isfinite(columns.item(-1)) else None

    def _landing_force(
        self, sensed: NDArray[np.bool_], normal_force: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Force that points of a landing line already carry, whatever is asked of them, shape (P,) [m g].

        The floor pushes as the foot arrives. Told of it, the QP shifts the other foot's load instead of
        letting the ZMP jump.
        """
        gate = self.gate
        if not gate.landing:
            return self._no_force
        share = np.array(gate.opening)[self.robot.point_foot, self.robot.point_group]
        return normal_force * (sensed & (share < 1.0)) * self._landing_scale

    def _solve_limited(self, q: NDArray[np.float64], v: NDArray[np.float64], rows: _Rows) -> QPSolution:
        """The whole problem again, with the limits of torque and joint range as constraints."""
        torque_map, bias = self.dynamics.torque_map(q, v)
        low, high = self.limits.acceleration_bounds(q, v)
        limit = self._torque_limit
        return self.limited.solve(
            rows.scaled * self._root_weight,
            rows.rhs,
            self.forces.wrench,
            rows.softness[6:],
            rows.posture / self._root_weight,
            torque_map / limit[:, None],
            bias / limit,
            low,
            high,
        )


def _usable(solution: QPSolution) -> bool:
    """Whether an unsolved QP's last iterate is worth more than the last tick's answer."""
    return solution.status != QPStatus.INFEASIBLE and bool(np.isfinite(solution.x).all())


def _both(first: QPSolution, second: QPSolution) -> QPSolution:
    """What two solves of one tick cost together; the second's answer."""
    return QPSolution(
        second.x,
        second.status,
        max(first.residual, second.residual),
        first.iterations + second.iterations,
        first.seconds + second.seconds,
    )


def _zmp(com: list[float], wrench: list[float]) -> NDArray[np.float64]:
    """ZMP on the floor of a wrench about the COM, shape (2,) [m]."""
    x, y, z = com
    fx, fy, fz, mx, my, _ = wrench
    return np.array([x - (z * fx + my) / fz, y - (z * fy - mx) / fz])
