"""The whole problem of a tick, with limits of torque and joint range: for the few ticks that break one.

A joint may run towards the end of its range as fast as it can still brake before it.
"""

import math

import numpy as np
from numpy.typing import NDArray

from ampm.body.robot import Robot
from ampm.compiled import compiled
from ampm.control.contact_qp import ContactQP
from ampm.control.workspace import Joints
from ampm.qp import QPSettings, QPSolution, make_backend

Array = NDArray[np.float64]

_BRAKE = 500.0  # deceleration with which a joint may run towards its limit [rad/s^2]
_BRAKE_TIME = 0.01  # time in which a joint that runs faster is slowed down [s]
_LARGEST = 200.0  # largest acceleration that brings back a joint far outside [g]


class LimitedForm:
    """The whole problem, torque and joint limits as constraints: accelerations, forces, slacks.

    Args:
        backend: name of the solver.
        settings: of the solver.
        weights: posture weights, shape (nv,).
        rows: of the tasks.
        contact_qp: supplies the force part of cost and constraints.
    """

    TASK_COST = 1e-3
    """Weights of the deviations from posture, feet and toes; that of the momentum is one, so it has priority
    here, too."""

    def __init__(
        self, backend: str, settings: QPSettings, weights: Array, rows: int, contact_qp: ContactQP
    ) -> None:
        nv = len(weights)
        self.nv, self.nu = nv, nv - 6
        self._weights = self.TASK_COST * weights
        self._contact_qp = contact_qp
        self._soft = rows - 6
        force_rows, force_unknowns = contact_qp.problem.A.shape
        n = nv + force_unknowns + self._soft
        self._phi = slice(nv, nv + contact_qp.forces)
        self._force_unknowns = slice(nv, nv + force_unknowns)
        start = 6 + force_rows + self._soft
        m = start + 2 * self.nu
        self.P, self.q = np.zeros((n, n)), np.zeros(n)
        self.A, self.lower, self.upper = np.zeros((m, n)), np.zeros(m), np.zeros(m)
        self.P[np.arange(nv), np.arange(nv)] = self._weights
        self.P[-self._soft :, -self._soft :] = self.TASK_COST * np.eye(self._soft)
        self._dynamics, self._force_rows = slice(0, 6), slice(6, 6 + force_rows)
        self._task_rows = slice(6 + force_rows, start)
        self._torque_rows, self._joint_rows = slice(start, start + self.nu), slice(start + self.nu, m)
        self.A[self._joint_rows, 6:nv] = np.eye(self.nu)
        P_mask = np.eye(n, dtype=bool)
        P_mask[self._force_unknowns, self._force_unknowns] = contact_qp.P_mask()
        self._backend = make_backend(backend, P_mask, self._A_mask(), settings)

    def _A_mask(self) -> NDArray[np.bool_]:
        mask = self.A != 0.0
        mask[self._dynamics, : self.nv] = True
        mask[self._dynamics, self._phi] = self._contact_qp.A_mask()[:6, : self._contact_qp.forces]
        mask[self._force_rows, self._force_unknowns] = self._contact_qp.A_mask()
        mask[self._task_rows, : self.nv] = True
        mask[self._task_rows, -self._soft :] = np.eye(self._soft, dtype=bool)
        mask[self._torque_rows, : self._phi.stop] = True
        return mask

    def solve(
        self,
        rows: Array,
        offset: Array,
        wrench: Array,
        softness: Array,
        posture: Array,
        torque_map: Array,
        torque_bias: Array,
        joint_lower: Array,
        joint_upper: Array,
    ) -> QPSolution:
        """Solve with the contact QP's current forces, costs and wanted momentum.

        Args:
            rows: B, shape (R, nv).
            offset: right-hand side of the rows: the first six without forces, shape (R,).
            wrench: W, shape (6, U).
            softness: of the rows of feet and toes, shape (R - 6,).
            posture: wanted accelerations, shape (nv,) [g].
            torque_map: torques over the limit per unit of (alpha, phi), shape (nu, nv + U).
            torque_bias: torques over the limit at zero, shape (nu,).
            joint_lower: least accelerations of the hinges, shape (nu,) [g].
            joint_upper: largest ones, shape (nu,) [g].

        Returns:
            Unknowns alpha, phi, slacks.
        """
        c, nv = self._contact_qp.problem, self.nv
        self.P[self._force_unknowns, self._force_unknowns] = c.P
        self.q[:nv] = -self._weights * posture
        self.q[self._force_unknowns] = c.q
        A, lower, upper = self.A, self.lower, self.upper
        A[self._dynamics, :nv], A[self._dynamics, self._phi] = rows[:6], -wrench
        A[self._force_rows, self._force_unknowns] = c.A
        A[self._task_rows, :nv] = rows[6:]
        np.fill_diagonal(A[self._task_rows, -self._soft :], np.sqrt(softness))
        A[self._torque_rows, : self._phi.stop] = torque_map
        lower[self._dynamics] = upper[self._dynamics] = offset[:6]
        lower[self._force_rows], upper[self._force_rows] = c.lower, c.upper
        lower[self._task_rows] = upper[self._task_rows] = offset[6:]
        lower[self._torque_rows] = -1.0 - torque_bias
        upper[self._torque_rows] = 1.0 - torque_bias
        lower[self._joint_rows], upper[self._joint_rows] = joint_lower, joint_upper
        return self._backend.solve(self.P, self.q, A, lower, upper)


@compiled
def braking_rate(room: float) -> float:
    """Rate from which a joint can brake within the room before its limit [rad/s]."""
    return math.sqrt(2.0 * _BRAKE * max(room, 0.0))


@compiled
def limit_broken(q: Array, v: Array, acceleration: Array, joints: Joints) -> bool:
    """Whether an answer breaks a torque limit, or makes a joint too fast to brake before its range ends.

    Args:
        q: Pinocchio configuration, shape (nq,).
        v: velocity, shape (nv,).
        acceleration: shape (nv,) [rad/s^2].
        joints: torques, their limits and the joints' ranges.
    """
    for j in range(len(joints.torque)):
        rate = v[6 + j] + _BRAKE_TIME * acceleration[6 + j]
        if (
            abs(joints.torque[j]) > joints.torque_limit[j]
            or rate > braking_rate(joints.upper[j] - q[7 + j])
            or -rate > braking_rate(q[7 + j] - joints.lower[j])
        ):
            return True
    return False


def acceleration_bounds(robot: Robot, q: Array, v: Array) -> tuple[Array, Array]:
    """Accelerations that keep every joint able to brake before its limits, shape (nu,) each [g].

    Args:
        robot: its joint ranges.
        q: Pinocchio configuration, shape (nq,).
        v: velocity, shape (nv,).
    """
    up = np.array([braking_rate(room) for room in robot.upper - q[7:]])
    down = np.array([braking_rate(room) for room in q[7:] - robot.lower])
    scale = 1.0 / (_BRAKE_TIME * robot.gravity)
    low, high = scale * (-down - v[6:]), scale * (up - v[6:])
    return np.minimum(low, _LARGEST), np.maximum(high, -_LARGEST)
