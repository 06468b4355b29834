"""The controller's quadratic program, condensed on the contact forces.

Accelerations in g (``alpha = qdd / g``), forces as in :mod:`ampm.control.forces`. With B the task rows
(momentum / m, feet, toes),

    momentum rate      B_c alpha = W phi - e_z - drift_c       (physics: exact)
    feet and toes      B_f alpha ~ wanted                      (with a softness)
    posture            alpha ~ alpha_p                         (metric of the posture weights)

are eliminated by one Cholesky factorisation of the 20 x 20 matrix ``S = B W^-1 B' + softness``; what is left
is a QP in 24 unknowns: nine forces per foot and six slacks of the wanted momentum rate. One workspace serves
all contact modes: a point without contact has zero bounds, so the sparsity pattern and the warm start survive
every switch.

When its answer breaks a torque or joint limit, :class:`LimitedForm` solves the whole problem with those
limits as constraints: clipping torques afterwards would cause large ZMP errors.
"""

from __future__ import annotations

import math
from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.linalg import lapack

from ampm.body.robot import POINTS, SOLES
from ampm.control.forces import ANGULAR, FOOT, FORCES, NORMAL_COST, NORMALS, TWIST_ARM
from ampm.qp import QPBackend, QPSettings, QPSolution, make_backend

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from ampm.control.forces import ForceMap, Openings

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

CONDENSED_SIZE = FORCES + 6
"""Unknowns of the condensed form."""

CONDENSED_ROWS = 6 + 12 + 2 * POINTS
"""Constraints of the condensed form."""

L_Z = 5
"""Row of the vertical angular momentum."""
_COST = np.tile([NORMAL_COST] * SOLES + [TIP_COST] * (POINTS - SOLES), 2)
_TANGENT = np.concatenate([np.arange(POINTS, FOOT), FOOT + np.arange(POINTS, FOOT)])
_CONE = np.array([[1, 1, 0], [1, -1, 0], [-1, 1, 0], [-1, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=float)
"""Bounds of a foot's tangential forces and twist: a pyramid with its edges on the cone, along x and y."""


class Rows(NamedTuple):
    """The task rows ``B alpha = rhs`` of one tick, in units of the QP.

    Attributes:
        scaled: B in the metric of the posture, shape (20, nv).
        rhs: wanted accelerations less drift; the first six without contact forces, shape (20,).
        softness: shape (20,).
        posture: wanted accelerations in the metric of the posture, shape (nv,) [g].
    """

    scaled: Array
    rhs: Array
    softness: Array
    posture: Array

    def eliminate(self) -> Array | None:
        """Solve ``(B W^-1 B' + softness) y = r`` for unit net wrenches and for the rows themselves.

        Returns:
            Seven columns y, shape (20, 7), or None if the rows depend on each other. The accelerations of a
            net wrench w are ``W^-1/2 (posture + scaled' y (w, 1))``.
        """
        count = len(self.rhs)
        gram = self.scaled @ self.scaled.T
        gram.reshape(-1)[:: count + 1] += self.softness
        right = _unit_wrenches(count).copy(order="F")  # LAPACK's own order
        right[:, 6] = self.rhs - self.scaled @ self.posture
        _, columns, info = lapack.dposv(gram.T, right, lower=1, overwrite_a=1, overwrite_b=1)
        # The last number depends on all others: it is finite only if all are.
        return columns if info == 0 and math.isfinite(columns.item(-1)) else None


@cache
def _unit_wrenches(count: int) -> Array:
    """Right-hand sides of the six unit wrenches and a place for one more, shape (count, 7)."""
    return np.eye(count, 7, order="F")


class CondensedForm:
    """The QP in 24 unknowns: builds its matrices, and solves it by a backend.

    Args:
        backend: name of the solver.
        settings: of the ADMM solver.
        friction: coefficient that the forces may use [1].
    """

    def __init__(self, backend: str, settings: QPSettings, friction: float) -> None:
        self.P = np.zeros((CONDENSED_SIZE, CONDENSED_SIZE))
        self.q = np.zeros(CONDENSED_SIZE)
        self.A = np.zeros((CONDENSED_ROWS, CONDENSED_SIZE))
        self.lower, self.upper = np.full(CONDENSED_ROWS, -np.inf), np.zeros(CONDENSED_ROWS)
        self._base = np.zeros(CONDENSED_SIZE)
        self._base[NORMALS], self._base[_TANGENT], self._base[FORCES:] = _COST, TANGENT_COST, 1.0
        self.P[np.arange(CONDENSED_SIZE), np.arange(CONDENSED_SIZE)] = self._base
        self.P[FOOT : FOOT + POINTS, FOOT : FOOT + POINTS] += LOAD_COST
        self._right = slice(FOOT, FOOT + POINTS)
        self.A[np.arange(6), FORCES + np.arange(6)] = -MOMENTUM_SLACK
        row = 6
        for foot in (0, 1):
            points = slice(FOOT * foot, FOOT * foot + POINTS)
            self.A[row : row + 6, points] = -friction
            self.A[row : row + 6, points.stop : points.stop + 3] = _CONE
            row += 6
        self.A[row + np.arange(2 * POINTS), NORMALS] = 1.0
        # Views of the parts of the matrices that change from tick to tick.
        by_foot = self.P[:FORCES, :FORCES].reshape(2, FOOT, 2, FOOT)
        self._tangent_block = by_foot[:, POINTS:, :, POINTS:]
        self._tangent_gradient = self.q[:FORCES].reshape(2, FOOT)[:, POINTS:]
        self._sole_gradients = self.q[:SOLES], self.q[FOOT : FOOT + SOLES]
        self._right_gradient = self.q[self._right]
        self._wrench = self.A[:6, :FORCES]
        by_foot = self.A[6:row, :FORCES].reshape(2, 6, 2, FOOT)
        self._twists = [by_foot[foot, 4:, foot, :POINTS] for foot in (0, 1)]
        self._twist_friction = -TWIST_SHARE * friction / TWIST_ARM
        self._least, self._largest = self.lower[row:], self.upper[row:]
        self._least[:] = 0.0
        self._backend: QPBackend = make_backend(backend, self.P_mask(), self.A_mask(), settings)

    def P_mask(self) -> NDArray[np.bool_]:
        """Where the cost matrix may ever be other than zero, shape (24, 24)."""
        mask = np.eye(CONDENSED_SIZE, dtype=bool)
        mask[np.ix_(_TANGENT, _TANGENT)] = True
        mask[self._right, self._right] = True
        return mask

    def A_mask(self) -> NDArray[np.bool_]:
        """Where the constraint matrix may ever be other than zero, shape (30, 24)."""
        mask = self.A != 0.0
        for foot in (0, 1):
            c = FOOT * foot
            mask[2:5, c : c + POINTS] = True
            for column, rows in enumerate(((0, 4, 5), (1, 3, 5), (3, 4, 5)), start=c + POINTS):
                mask[rows, column] = True
        return mask

    def build(
        self,
        forces: ForceMap,
        wanted: Sequence[float] | Array,
        openings: Openings,
        landing: Array | None,
        right_load: float,
        yaw_curvature: float,
        yaw_gradient: float,
    ) -> None:
        """Fill the matrices.

        Args:
            forces: effect of the unknowns.
            wanted: momentum rate plus weight, [m g] and ANGULAR [m g m], six numbers.
            openings: of the points.
            landing: least force of landing points, shape (12,) [m g], None if nothing lands.
            right_load: planned share of the right foot [1].
            yaw_curvature: of the posture's cost over the vertical moment.
            yaw_gradient: of the same at no moment.
        """
        row = forces.wrench[L_Z].take(_TANGENT)
        block = row[:, None] * (YAW_COST * yaw_curvature * row)
        for foot, load in enumerate((1.0 - right_load, right_load)):
            own = np.arange(3 * foot, 3 * foot + 3)
            block[own, own] += TANGENT_COST / max(load, LEAST_LOAD)
            np.multiply(self._twist_friction, forces.twist_lever[foot], out=self._twists[foot])
        self._tangent_block[:] = block.reshape(2, 3, 2, 3)
        self._tangent_gradient[:] = (YAW_COST * yaw_gradient * row).reshape(2, 3)
        left, right = self._sole_gradients
        np.multiply(1.0 - right_load, openings.load_cost[0], out=left)
        self._right_gradient[:] = -LOAD_COST * right_load
        right += right_load * openings.load_cost[1]
        self._wrench[:] = forces.wrench
        self.lower[:6] = self.upper[:6] = wanted
        least, largest = openings.least, openings.largest
        if landing is not None:
            least = np.maximum(least, landing)
            largest = np.maximum(largest, least)
        self._least[:], self._largest[:] = least, largest

    def solve(self) -> QPSolution:
        """Solve what :meth:`build` filled in; the first 18 unknowns are phi."""
        return self._backend.solve(self.P, self.q, self.A, self.lower, self.upper)
