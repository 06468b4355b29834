"""The whole problem of a tick, with limits of torque and joint range: for the few ticks that break one.

A joint may run towards the end of its range as fast as it can still brake before it.
"""

import math

import numpy as np

from ampm.body.inverse_kinematics import POSTURE_WEIGHTS
from ampm.body.robot import Robot
from ampm.compiled import compiled
from ampm.control.contact_qp import ContactQP
from ampm.control.qp import QPProblem, QPSettings, QPSolution, QPSolver
from ampm.control.workspace import Joints, Workspace
from ampm.geometry import Array

_BRAKE = 500.0  # deceleration with which a joint may run towards its limit [rad/s^2]
_BRAKE_TIME = 0.01  # time in which a joint that runs faster is slowed down [s]
_LARGEST = 200.0  # largest acceleration that brings back a joint far outside [g]
_END_SOFTNESS = 1e-2  # softness of the task of a toe at the end of its range


class LimitedQP:
    """The whole problem, torque and joint limits as constraints: accelerations, forces, slacks.

    Args:
        settings: of the solver.
        robot: the body, as the controller knows it.
        contact_qp: supplies the force part of cost and constraints.
    """

    TASK_COST = 1e-3
    """Weights of the deviations from posture, feet and toes; that of the momentum is one, so it has priority
    here, too."""

    def __init__(self, settings: QPSettings, robot: Robot, contact_qp: ContactQP) -> None:
        nv, nu, soft = robot.nv, robot.nu, robot.task_rows - 6
        force_rows, force_unknowns = contact_qp.problem.A.shape
        n, task_rows = nv + force_unknowns + soft, 6 + force_rows
        m = task_rows + soft + 2 * nu
        self._contact_qp, self._weights = contact_qp, self.TASK_COST * robot.by_group(POSTURE_WEIGHTS)
        # Unknowns: accelerations, forces and their slacks, slacks of the soft tasks.
        self._accelerations, self._forces = slice(nv), slice(nv, nv + contact_qp.forces)
        self._force_unknowns, self._slacks = slice(nv, nv + force_unknowns), slice(n - soft, n)
        # Rows: momentum, forces, soft tasks, torques, joint rates.
        self._momentum, self._force_rows = slice(6), slice(6, task_rows)
        self._tasks = slice(task_rows, task_rows + soft)
        self._torques, self._joints = slice(m - 2 * nu, m - nu), slice(m - nu, m)
        self.problem = QPProblem(np.zeros((n, n)), np.zeros(n), np.zeros((m, n)), np.zeros(m), np.zeros(m))
        P, A = self.problem.P, self.problem.A
        P[self._accelerations, self._accelerations] = np.diag(self._weights)
        P[self._slacks, self._slacks] = self.TASK_COST * np.eye(soft)
        A[self._joints, 6:nv] = np.eye(nu)
        P_mask, A_mask = P != 0.0, A != 0.0
        P_mask[self._force_unknowns, self._force_unknowns] = contact_qp.P_mask()
        A_mask[self._momentum, self._accelerations] = A_mask[self._tasks, self._accelerations] = True
        A_mask[self._momentum, self._forces] = contact_qp.A_mask()[:6, : contact_qp.forces]
        A_mask[self._force_rows, self._force_unknowns] = contact_qp.A_mask()
        A_mask[self._tasks, self._slacks] = np.eye(soft, dtype=bool)
        A_mask[self._torques, self._accelerations] = A_mask[self._torques, self._forces] = True
        self._solver = QPSolver(self.problem, P_mask, A_mask, settings)

    def solve(self, work: Workspace, torque_map: Array, bias: Array) -> QPSolution:
        """Solve with the contact QP's forces, costs and wanted momentum of this tick.

        Args:
            work: of a tick whose contact QP is filled in.
            torque_map: torques per unit of (acceleration / g, forces), shape (nu, nv + U) [N m].
            bias: torques at zero, shape (nu,) [N m].

        Returns:
            Unknowns: accelerations [g], forces and their slacks, slacks of the soft tasks.
        """
        forces, limit, tasks = self._contact_qp.problem, work.joints.torque_limit, work.tasks
        rows, sqrt_weight, softness = tasks.jacobian.T, work.motion.sqrt_weight, tasks.softness.copy()
        low, high = acceleration_bounds(work.sensed.q, work.sensed.v, work.joints, work.body.gravity)
        for foot in work.body.feet:
            row, toe = foot["toe_row"], foot["toe"] - 6
            if row >= 0 and not low[toe] <= tasks.rhs[row] <= high[toe]:
                softness[row] = _END_SOFTNESS  # an exact row would contradict the limit
        P, q, A, lower, upper = self.problem
        P[self._force_unknowns, self._force_unknowns] = forces.P
        q[self._accelerations] = -self._weights * (tasks.posture / sqrt_weight)
        q[self._force_unknowns] = forces.q
        A[self._momentum, self._accelerations] = rows[:6] * sqrt_weight
        A[self._momentum, self._forces] = -work.contact.wrench_map
        A[self._force_rows, self._force_unknowns] = forces.A
        A[self._tasks, self._accelerations] = rows[6:] * sqrt_weight
        np.fill_diagonal(A[self._tasks, self._slacks], np.sqrt(softness[6:]))
        A[self._torques, : self._forces.stop] = torque_map / limit[:, None]
        lower[self._momentum] = upper[self._momentum] = tasks.rhs[:6]
        lower[self._force_rows], upper[self._force_rows] = forces.lower, forces.upper
        lower[self._tasks] = upper[self._tasks] = tasks.rhs[6:]
        lower[self._torques], upper[self._torques] = -1.0 - bias / limit, 1.0 - bias / limit
        lower[self._joints], upper[self._joints] = low, high
        return self._solver.solve()


@compiled
def braking_rate(room: float) -> float:
    """Rate from which a joint can brake within the room before its limit [rad/s]."""
    return math.sqrt(2.0 * _BRAKE * max(room, 0.0))


@compiled
def limit_broken(q: Array, v: Array, acceleration: Array, joints: Joints) -> bool:
    """Whether a tick breaks a torque limit, or makes a joint too fast to brake before its range ends."""
    torque, limit, lower, upper = joints.torque, joints.torque_limit, joints.lower, joints.upper
    for j in range(len(torque)):
        rate = v[6 + j] + _BRAKE_TIME * acceleration[6 + j]
        if (
            abs(torque[j]) > limit[j]
            or rate > braking_rate(upper[j] - q[7 + j])
            or -rate > braking_rate(q[7 + j] - lower[j])
        ):
            return True
    return False


def acceleration_bounds(q: Array, v: Array, joints: Joints, gravity: float) -> tuple[Array, Array]:
    """Least and largest accelerations with which all joints can brake within their ranges, (nu,) each [g]."""
    up = np.array([braking_rate(room) for room in joints.upper - q[7:]])
    down = np.array([braking_rate(room) for room in q[7:] - joints.lower])
    scale = 1.0 / (_BRAKE_TIME * gravity)
    low, high = scale * (-down - v[6:]), scale * (up - v[6:])
    return np.minimum(low, _LARGEST), np.maximum(high, -_LARGEST)
