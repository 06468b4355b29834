"""The controller's quadratic program, condensed on the contact forces.

The accelerations of :mod:`ampm.control.tick`, in g, are eliminated by one factorisation of the 20 x 20 matrix
``S = B W_p^-1 B' + softness``, with the posture weights W_p; what is left is a QP in 24 unknowns: nine forces
per foot of six points (:mod:`ampm.control.forces`), and six slacks of the wanted momentum rate. One workspace
serves all contact modes: a point without contact has zero bounds, so the sparsity pattern and the warm start
survive every switch.

When its answer breaks a torque or joint limit, :class:`LimitedQP` solves the whole problem with those
limits as constraints: clipping torques afterwards would cause large ZMP errors.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ampm.body.robot import L_Z
from ampm.compiled import compiled
from ampm.control.forces import NORMAL_COST, TWIST_ARM, change_cost
from ampm.control.qp import QPProblem, QPSettings, QPSolver
from ampm.control.workspace import ANGULAR, Tasks, Workspace
from ampm.linear import add_combination, add_gram, substitute, triangular
from ampm.planner.feet import TIP

TANGENT_COST = 0.6
"""Regularisation of tangential forces and twists of a foot that carries the weight. It grows with one over
the foot's planned share of the load, so that each foot uses the same share of its friction."""
LEAST_LOAD = 0.005
"""Least share of the load in that cost [1]."""
TIP_COST = 6.0
"""Regularisation of the toe tips' normal forces: the light toe segment yields under load, so it follows the
floor unless the ZMP needs it."""
LOAD_COST = 30.0
"""Cost of deviating from the planned share of the load between the feet, also for a foot that touches
early."""
YAW_COST = 0.3
"""Weight of the influence of the posture on the vertical moment, which no plan has: far below the momentum's,
or a yaw that the friction cannot give would move the ZMP."""
TWIST_SHARE = 0.5
"""Share of the friction at its points with which a foot may twist; the rest is left for the forces along."""
MOMENTUM_SLACK = np.repeat([1.0, ANGULAR], 3) / np.sqrt([1e4, 1e4, 1e4, 4e3, 4e3, 0.04])
"""Scale of the slacks: linear and horizontal angular momentum far above everything else, L_z far below."""
_CONE = np.array([[1, 1, 0], [1, -1, 0], [-1, 1, 0], [-1, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=float)
"""Bounds of a foot's tangential forces and twist: a pyramid with its edges on the cone, along x and y."""


@compiled
def eliminate_tasks(tasks: Tasks) -> bool:
    """Solve ``(B W_p^-1 B' + softness) y = r`` for six unit net wrenches, and for the wanted accelerations.

    Args:
        tasks: Jacobian and posture in units of the QP, softness and right-hand side. The last seven columns
            of ``system`` become y. The accelerations of a net wrench w are
            ``W_p^-1/2 (posture + jacobian y (w, 1))``.

    Returns:
        Whether there is a solution: the rows are independent, and all numbers finite.
    """
    system, count = tasks.system, len(tasks.rhs)
    system[:] = 0.0
    for e in range(count):
        system[e, e] = tasks.softness[e]
    for k in range(6):
        system[k, count + k] = 1.0
    add_gram(tasks.jacobian, tasks.jacobian, system)
    right = tasks.rhs.copy()
    add_combination(-1.0, tasks.jacobian, tasks.posture, right)
    system[:, count + 6] = right
    if not triangular(system):
        return False
    substitute(system)
    return bool(np.isfinite(system[0, -1]))  # the first solution depends on all others


@compiled
def fill_qp(work: Workspace) -> None:
    """Fill in what changes in the QP from tick to tick.

    Points have their force limits and shares, the contact its wrench map and wanted wrench; the eliminated
    tasks give the posture's cost over the vertical moment.
    """
    points, contact, system, problem = work.body.points, work.contact, work.tasks.system, work.problem
    smoothing = change_cost(work.gains.force_smoothing, work.gains.frequency)
    P, q, A, lower, upper = problem.P, problem.q, problem.A, problem.lower, problem.upper
    per_foot, rows, first = len(points) // 2, len(system), len(lower) - len(points)
    tangents = points[0].tangent, points[per_foot].tangent
    yaw, yaw_curvature, yaw_gradient = contact.wrench_map[L_Z], system[L_Z, rows + L_Z], system[L_Z, rows + 6]
    for foot in range(2):
        load = work.wanted.right_load[0] if foot else 1.0 - work.wanted.right_load[0]
        for i in range(tangents[foot], tangents[foot] + 3):
            for tangent in tangents:
                for j in range(tangent, tangent + 3):
                    P[i, j] = YAW_COST * yaw_curvature * yaw[i] * yaw[j]
            P[i, i] += TANGENT_COST / max(load, LEAST_LOAD)
            q[i] = YAW_COST * yaw_gradient * yaw[i]
        for i in range(per_foot * foot, per_foot * (foot + 1)):
            point, normal = points[i], points[i].normal
            q[normal] = load * point.load_gradient - smoothing * contact.forces[normal]
            if foot:
                q[normal] -= LOAD_COST * load
            for row in (10 + 6 * foot, 11 + 6 * foot):
                A[row, normal] = -TWIST_SHARE * work.gains.friction / TWIST_ARM * point.lever
            lower[first + i], upper[first + i] = point.least, point.largest
    A[:6, : contact.wrench_map.shape[1]] = contact.wrench_map
    lower[:6] = contact.wrench
    upper[:6] = contact.wrench


class ContactQP:
    """The QP in the contact forces, then six slacks: its matrices, which :func:`fill_qp` fills, and solver.

    Args:
        settings: of the solver.
        gains: of the controller.
        lines: line of every point, by foot, shape (F, k).
    """

    def __init__(self, settings: QPSettings, gains: Any, lines: NDArray[np.int64]) -> None:
        feet, per_foot = lines.shape
        unknowns = per_foot + 3
        self.forces = feet * unknowns
        size, rows = self.forces + 6, 6 + 6 * feet + lines.size
        by_foot = np.arange(self.forces).reshape(feet, unknowns)
        self.normals, self._tangents = by_foot[:, :per_foot].ravel(), by_foot[:, per_foot:].ravel()
        base = np.ones(size)
        smoothing = change_cost(gains.force_smoothing, gains.frequency)
        base[self.normals] = smoothing + np.where(lines.ravel() == TIP, TIP_COST, NORMAL_COST)
        base[self._tangents] = TANGENT_COST
        P, A = np.diag(base), np.zeros((rows, size))
        self.problem = QPProblem(P, np.zeros(size), A, np.full(rows, -np.inf), np.zeros(rows))
        self._right = slice(unknowns, unknowns + per_foot)
        P[self._right, self._right] += LOAD_COST
        A[np.arange(6), self.forces + np.arange(6)] = -MOMENTUM_SLACK
        for foot in range(feet):
            cone = slice(6 + 6 * foot, 12 + 6 * foot)
            A[cone, by_foot[foot, :per_foot]] = -gains.friction
            A[cone, by_foot[foot, per_foot:]] = _CONE
        A[rows - lines.size + np.arange(lines.size), self.normals] = 1.0
        self.problem.lower[-lines.size :] = 0.0
        self.solver = QPSolver(self.problem, self.P_mask(), self.A_mask(), settings)

    def P_mask(self) -> NDArray[np.bool_]:
        """Where the cost matrix may ever be other than zero."""
        mask = np.eye(len(self.problem.q), dtype=bool)
        mask[np.ix_(self._tangents, self._tangents)] = True
        mask[self._right, self._right] = True
        return mask

    def A_mask(self) -> NDArray[np.bool_]:
        """Where the constraint matrix may ever be other than zero."""
        mask = self.problem.A != 0.0
        mask[2:5, self.normals] = True
        for x, y, twist in self._tangents.reshape(-1, 3):
            mask[[0, 4, 5], x] = mask[[1, 3, 5], y] = mask[3:6, twist] = True
        return mask
