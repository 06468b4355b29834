"""The controller's quadratic program, condensed on the contact forces.

Accelerations in g (``alpha = qdd / g``), forces as in :mod:`ampm.control.forces`. With B the task rows
(momentum / m, feet, toes),

    momentum rate      B_c alpha = W phi - e_z - drift_c       (physics: exact)
    feet and toes      B_f alpha ~ wanted                      (with a softness)
    posture            alpha ~ alpha_p                         (metric of the posture weights)

are eliminated by one factorisation of the 20 x 20 matrix ``S = B W^-1 B' + softness``; what is left is a QP
in 24 unknowns: nine forces per foot of six points, and six slacks of the wanted momentum rate. One workspace
serves all contact modes: a point without contact has zero bounds, so the sparsity pattern and the warm start
survive every switch.

When its answer breaks a torque or joint limit, :class:`LimitedForm` solves the whole problem with those
limits as constraints: clipping torques afterwards would cause large ZMP errors.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ampm.compiled import compiled
from ampm.control.forces import ANGULAR, NORMAL_COST, TWIST_ARM
from ampm.control.records import TIP
from ampm.linear import add_gram, substitute, triangular
from ampm.qp import QPBackend, QPSettings, QPSolution, make_backend

Array = NDArray[np.float64]

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

MOMENTUM_SLACK = np.array([1.0, 1.0, 1.0, ANGULAR, ANGULAR, ANGULAR]) / np.sqrt(
    [1e4, 1e4, 1e4, 4e3, 4e3, 0.04]
)
"""Scale of the slacks: linear and horizontal angular momentum far above everything else, L_z far below."""

L_Z = 5
"""Row of the vertical angular momentum."""
_CONE = np.array([[1, 1, 0], [1, -1, 0], [-1, 1, 0], [-1, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=float)
"""Bounds of a foot's tangential forces and twist: a pyramid with its edges on the cone, along x and y."""


@compiled
def eliminate(scaled: Array, softness: Array, rhs: Array, posture: Array, system: Array) -> bool:
    """Solve ``(B W^-1 B' + softness) y = r`` for unit net wrenches and for the rows themselves.

    Args:
        scaled: transposed task rows in the metric of the posture, shape (nv, R).
        softness: shape (R,).
        rhs: wanted accelerations less drift; the first six without contact forces, shape (R,) [g].
        posture: wanted accelerations in the metric of the posture, shape (nv,) [g].
        system: its last seven columns are y, shape (R, R + 7). The accelerations of a net wrench w are
            ``W^-1/2 (posture + scaled y (w, 1))``.

    Returns:
        Whether there is a solution: the rows are independent, and all numbers finite.
    """
    _set_up(scaled, softness, rhs, posture, system)
    if not triangular(system):
        return False
    substitute(system)
    return bool(np.isfinite(system[0, -1]))  # the first solution depends on all others


@compiled
def _set_up(scaled: Array, softness: Array, rhs: Array, posture: Array, system: Array) -> None:
    """Write matrix and right-hand sides."""
    count = len(rhs)
    system[:] = 0.0
    for e in range(count):
        system[e, e] = softness[e]
    for k in range(6):
        system[k, count + k] = 1.0
    add_gram(scaled, system)
    right = rhs.copy()
    for j in range(len(scaled)):
        for e in range(count):
            right[e] -= scaled[j, e] * posture[j]
    system[:, count + 6] = right


@compiled
def fill_qp(
    feet: int,
    points: Any,
    wrench: Array,
    wanted: Array,
    right_load: float,
    yaw_curvature: float,
    yaw_gradient: float,
    friction: float,
    P: Array,
    q: Array,
    A: Array,
    lower: Array,
    upper: Array,
) -> None:
    """Fill in what changes from tick to tick.

    Args:
        feet: number of feet.
        points: their limits and shares.
        wrench: W, shape (6, U).
        wanted: momentum rate plus weight, [m g] and ANGULAR [m g m], shape (6,).
        right_load: planned share of the right foot [1].
        yaw_curvature: of the posture's cost over the vertical moment.
        yaw_gradient: of the same at no moment.
        friction: coefficient that the forces may use [1].
        P: cost of the QP.
        q: its gradient at zero.
        A: its constraints.
        lower: their lower bounds.
        upper: their upper bounds.
    """
    per_foot = len(points) // feet
    unknowns, first = per_foot + 3, 6 + 6 * feet
    yaw = wrench[L_Z]
    for foot in range(feet):
        load = right_load if foot else 1.0 - right_load
        for i in range(unknowns * foot + per_foot, unknowns * (foot + 1)):
            for other in range(feet):
                for j in range(unknowns * other + per_foot, unknowns * (other + 1)):
                    P[i, j] = YAW_COST * yaw_curvature * yaw[i] * yaw[j]
            P[i, i] += TANGENT_COST / max(load, LEAST_LOAD)
            q[i] = YAW_COST * yaw_gradient * yaw[i]
        for i in range(per_foot):
            point, unknown = points[per_foot * foot + i], unknowns * foot + i
            q[unknown] = load * point.load_gradient
            if foot:
                q[unknown] -= LOAD_COST * load
            for row in (10 + 6 * foot, 11 + 6 * foot):
                A[row, unknown] = -TWIST_SHARE * friction / TWIST_ARM * point.lever
            lower[first + per_foot * foot + i] = point.least
            upper[first + per_foot * foot + i] = point.largest
    A[:6, : unknowns * feet] = wrench
    lower[:6] = wanted
    upper[:6] = wanted


class CondensedForm:
    """The QP in the contact forces: its matrices, and a backend.

    Args:
        backend: name of the solver.
        settings: of the solver.
        friction: coefficient that the forces may use [1].
        lines: of every point, by foot, shape (F, k).
    """

    def __init__(self, backend: str, settings: QPSettings, friction: float, lines: NDArray[np.int64]) -> None:
        feet, per_foot = lines.shape
        unknowns = per_foot + 3
        self.forces = feet * unknowns
        size, rows = self.forces + 6, 6 + 6 * feet + lines.size
        by_foot = np.arange(self.forces).reshape(feet, unknowns)
        self.normals, self._tangents = by_foot[:, :per_foot].ravel(), by_foot[:, per_foot:].ravel()
        base = np.ones(size)
        base[self.normals] = np.where(lines.ravel() == TIP, TIP_COST, NORMAL_COST)
        base[self._tangents] = TANGENT_COST
        self.P, self.q, self.A = np.diag(base), np.zeros(size), np.zeros((rows, size))
        self.lower, self.upper = np.full(rows, -np.inf), np.zeros(rows)
        self._right = slice(unknowns, unknowns + per_foot)
        self.P[self._right, self._right] += LOAD_COST
        self.A[np.arange(6), self.forces + np.arange(6)] = -MOMENTUM_SLACK
        for foot in range(feet):
            cone = slice(6 + 6 * foot, 12 + 6 * foot)
            self.A[cone, by_foot[foot, :per_foot]] = -friction
            self.A[cone, by_foot[foot, per_foot:]] = _CONE
        self.A[rows - lines.size + np.arange(lines.size), self.normals] = 1.0
        self.lower[-lines.size :] = 0.0
        self.backend: QPBackend = make_backend(backend, self.P_mask(), self.A_mask(), settings)

    def P_mask(self) -> NDArray[np.bool_]:
        """Where the cost matrix may ever be other than zero."""
        mask = np.eye(len(self.q), dtype=bool)
        mask[np.ix_(self._tangents, self._tangents)] = True
        mask[self._right, self._right] = True
        return mask

    def A_mask(self) -> NDArray[np.bool_]:
        """Where the constraint matrix may ever be other than zero."""
        mask = self.A != 0.0
        mask[2:5, self.normals] = True
        for x, y, twist in self._tangents.reshape(-1, 3):
            mask[[0, 4, 5], x] = mask[[1, 3, 5], y] = mask[3:6, twist] = True
        return mask

    def solve(self) -> QPSolution:
        """Solve what :func:`fill_qp` filled in: first the forces, then six slacks."""
        return self.backend.solve(self.P, self.q, self.A, self.lower, self.upper)
