"""The controller's quadratic program, condensed on the contact forces.

Units: forces in m g, accelerations in g (``alpha = qdd / g``), angular momentum rows in m and times
:data:`ANGULAR` so that all rows are of one size. With B the task rows (momentum / m, feet, toes),

    momentum rate      B_c alpha = W phi - e_z - drift_c       (physics: exact)
    feet and toes      B_f alpha ~ wanted                      (softness :data:`STANCE`, :data:`SWING`)
    posture            alpha ~ alpha_p                         (metric of the posture weights)

are eliminated by one Cholesky factorisation of the 20 x 20 matrix ``S = B W^-1 B' + softness``; what is left
is a QP in 24 unknowns: nine forces per foot (six normal, two tangential, one twist about the vertical) and
six slacks of the wanted momentum rate. One workspace serves all contact modes: a point without contact has
zero bounds, so the sparsity pattern and the warm start survive every switch.

When its answer breaks a torque or joint limit, :class:`LimitedForm` solves the whole problem with those
limits as constraints: clipping torques afterwards would throw the ZMP away.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ampm.body.robot import TASK_ROWS
from ampm.qp import QPBackend, QPSettings, QPSolution, make_backend

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

ANGULAR = 3.0
"""Scale of the angular momentum rows [1/m]: makes a metre of lever as large as a third of a weight."""

TWIST_ARM = 0.1
"""Lever that turns a twisting moment into a force of the size of the others [m]."""

STANCE, SWING = 1e-8, 1e-4
"""Softness of a foot's acceleration task when it stands and when it swings, in the metric of the posture."""

NORMAL_COST, TANGENT_COST = 0.6, 0.15
"""Regularisation of normal and of tangential forces and twists."""

TIP_COST = 6.0
"""Regularisation of the toe tips' normal forces: the light toe segment yields under load, so it is left to
follow the floor unless the ZMP needs it."""

LOAD_COST = 30.0
"""Cost of leaving the planned share of the load between the feet, also for a foot that touches early."""

YAW_COST = 0.3
"""Weight of the posture's say in the vertical moment, which no plan has: far below the momentum's, or a yaw
that the friction cannot give would move the ZMP."""

LARGEST_NORMAL = 0.6
"""Largest normal force of one point [m g]."""

TWIST_FRICTION = 0.3
"""Largest twist over normal force, in units of :data:`TWIST_ARM`."""

LEAST_NORMAL = 0.004
"""Least normal force of an open point [m g]: enough to keep it from chattering on a compliant floor."""

MOMENTUM_SLACK = np.array([1.0, 1.0, 1.0, ANGULAR, ANGULAR, ANGULAR]) / np.sqrt(
    [1e4, 1e4, 1e4, 4e3, 4e3, 0.04]
)
"""Scale of the slacks: linear and horizontal angular momentum far above everything else, L_z far below."""

POINTS = 6
"""Sole points of one foot."""

_FOOT = POINTS + 3  # unknowns of one foot

FORCES = 2 * _FOOT
"""Force unknowns of both feet."""

_SIZE = FORCES + 6
_ROWS = 6 + 12 + 2 * POINTS
_L_Z = 5
_NORMAL = np.concatenate([np.arange(POINTS), _FOOT + np.arange(POINTS)])
_COST = np.tile([NORMAL_COST, NORMAL_COST, NORMAL_COST, NORMAL_COST, TIP_COST, TIP_COST], 2)
_SOLES = 4  # first points of a foot, heel and ball: they share the planned load
_TANGENT = np.array([6, 7, 8, 15, 16, 17])
_SKEWS = ANGULAR * np.array(  # arm @ _SKEWS: rows of the matrix that turns a force at the arm into a moment
    [[0, 0, 0, 0, 0, -1, 0, 1, 0], [0, 0, 1, 0, 0, 0, -1, 0, 0], [0, -1, 0, 1, 0, 0, 0, 0, 0]], dtype=float
)


class ForceMap:
    """How the 18 force unknowns act; arrays are overwritten every tick.

    Point forces are ``f = D phi`` and the net wrench ``W = X D``, with X the points' lever arms. Only what
    depends on the tick is written again.

    Attributes:
        wrench: W, net force [m g] and moment about the COM times ANGULAR [m g m], shape (6, 18).
        foot_wrench: the same by foot, and the moment of the tips' forces about the toe axis [m g m],
            shape (2, 7, 9).
    """

    def __init__(self) -> None:
        self.wrench = np.zeros((6, FORCES))
        self.foot_wrench = np.zeros((2, 7, _FOOT))
        self._wrench_by_foot = self.wrench.reshape(6, 2, _FOOT).transpose(1, 0, 2)
        self._spread = np.zeros((2, POINTS, 3, _FOOT))  # D
        self._spread[:, np.arange(POINTS), 2, np.arange(POINTS)] = 1.0
        self._spread_rows = self._spread.reshape(2, 3 * POINTS, _FOOT)
        self._lever = np.zeros((2, 7, POINTS, 3))  # X, and a row for the toe
        self._lever[:, :3] = np.eye(3)[:, None, :]
        self._moment_rows = self._lever[:, 3:6].transpose(0, 2, 1, 3)
        self._lever_rows = self._lever.reshape(2, 7, 3 * POINTS)
        self._share = np.zeros((2, POINTS))
        self._opening: NDArray[np.float64] | None = None

    def update(
        self, arm: NDArray[np.float64], opening: NDArray[np.float64], toe_lever: NDArray[np.float64]
    ) -> None:
        """Fill in a tick.

        Args:
            arm: points about the COM, shape (2, 6, 3) [m].
            opening: of the points, shape (12,); the same array as before if nothing has changed in it.
            toe_lever: moment about the toe axis per force at the tips, shape (2, 2, 3) [m].
        """
        share, spread = self._share, self._spread
        if opening is not self._opening:
            self._opening = opening
            np.maximum(opening.reshape(2, POINTS), 1e-3, out=share)
            share /= np.add.reduce(share, axis=1, keepdims=True)
            spread[:, :, 0, 6] = spread[:, :, 1, 7] = share
        offset = arm[:, :, :2] - share[:, None, :] @ arm[:, :, :2]
        pull = share[:, :, None] * offset
        pull *= TWIST_ARM / np.add.reduce(pull * offset, axis=(1, 2), keepdims=True)
        spread[:, :, 1, 8] = pull[:, :, 0]
        np.negative(pull[:, :, 1], out=spread[:, :, 0, 8])
        self._moment_rows[:] = (arm @ _SKEWS).reshape(2, POINTS, 3, 3)
        self._lever[:, 6, 4:] = toe_lever
        np.matmul(self._lever_rows, self._spread_rows, out=self.foot_wrench)
        self._wrench_by_foot[:] = self.foot_wrench[:, :6]

    def foot_wrenches(self, phi: NDArray[np.float64]) -> NDArray[np.float64]:
        """Wrench of each foot in the units of ``wrench``, and its toe moment [m g m], shape (2, 7)."""
        return (self.foot_wrench @ phi.reshape(2, _FOOT, 1))[:, :, 0]

    def point_forces(self, phi: NDArray[np.float64]) -> NDArray[np.float64]:
        """Forces at the points for the unknowns phi, shape (2, 6, 3) [m g]."""
        return (self._spread_rows @ phi.reshape(2, _FOOT, 1)).reshape(2, POINTS, 3)


def without_closed(phi: NDArray[np.float64], opening: NDArray[np.float64]) -> NDArray[np.float64]:
    """Forces of an earlier tick, less those at points that have closed since.

    Tangential forces and twist of a foot shrink with its normal force, so that they stay within the friction.

    Args:
        phi: force unknowns, shape (18,) [m g].
        opening: of the points now, shape (12,).
    """
    kept = phi.reshape(2, _FOOT).copy()
    before = kept[:, :POINTS].sum(axis=1)
    kept[:, :POINTS] *= opening.reshape(2, POINTS) > 0.0
    after = kept[:, :POINTS].sum(axis=1)
    kept[:, POINTS:] *= np.divide(after, before, out=np.zeros(2), where=before > 0.0)[:, None]
    return kept.reshape(-1)


class CondensedForm:
    """The QP in 24 unknowns: builds its matrices, and hands them to a backend.

    Args:
        backend: name of the solver.
        settings: of the ADMM solver.
        friction: coefficient that the forces may use [1].
    """

    def __init__(self, backend: str, settings: QPSettings, friction: float) -> None:
        self.P = np.zeros((_SIZE, _SIZE))
        self.q = np.zeros(_SIZE)
        self.A = np.zeros((_ROWS, _SIZE))
        self.lower, self.upper = np.full(_ROWS, -np.inf), np.zeros(_ROWS)
        self._base = np.zeros(_SIZE)
        self._base[_NORMAL], self._base[_TANGENT], self._base[FORCES:] = _COST, TANGENT_COST, 1.0
        self.P[np.arange(_SIZE), np.arange(_SIZE)] = self._base
        self.P[_FOOT : _FOOT + POINTS, _FOOT : _FOOT + POINTS] += LOAD_COST
        self._tangent = np.ix_(_TANGENT, _TANGENT)
        self._tangent_block = (_SIZE * _TANGENT[:, None] + _TANGENT).ravel()  # in the flat P
        self._tangent_cost = TANGENT_COST * np.eye(_TANGENT.size)
        self._flat_P = self.P.reshape(-1)
        self._right = slice(_FOOT, _FOOT + POINTS)
        self.A[np.arange(6), FORCES + np.arange(6)] = -MOMENTUM_SLACK
        row = 6
        for foot in (0, 1):
            for k, limit in enumerate((friction, friction, TWIST_FRICTION)):
                for sign in (1.0, -1.0):
                    self.A[row, _FOOT * foot : _FOOT * foot + POINTS] = -limit
                    self.A[row, _FOOT * foot + POINTS + k] = sign
                    row += 1
        self.A[row + np.arange(2 * POINTS), _NORMAL] = 1.0
        self._normal_rows = slice(row, row + 2 * POINTS)
        self.lower[self._normal_rows] = 0.0
        self._loads = np.zeros((2, _SOLES))
        self._opening: NDArray[np.float64] | None = None
        self._landing: NDArray[np.float64] | None = None
        self._least, self._largest = self.lower[self._normal_rows], self.upper[self._normal_rows]
        self._backend: QPBackend = make_backend(backend, self.P_mask(), self.A_mask(), settings)

    def P_mask(self) -> NDArray[np.bool_]:
        """Where the cost matrix may ever be other than zero, shape (24, 24)."""
        mask = np.eye(_SIZE, dtype=bool)
        mask[self._tangent] = True
        mask[self._right, self._right] = True
        return mask

    def A_mask(self) -> NDArray[np.bool_]:
        """Where the constraint matrix may ever be other than zero, shape (30, 24)."""
        mask = self.A != 0.0
        for foot in (0, 1):
            c = _FOOT * foot
            mask[2:5, c : c + POINTS] = True
            for column, rows in ((6, (0, 4, 5)), (7, (1, 3, 5)), (8, (3, 4, 5))):
                mask[rows, c + column] = True
        return mask

    def build(
        self,
        wrench: NDArray[np.float64],
        wanted: Sequence[float] | NDArray[np.float64],
        opening: NDArray[np.float64],
        landing: NDArray[np.float64],
        right_load: float,
        yaw_curvature: float,
        yaw_gradient: float,
    ) -> None:
        """Fill the matrices.

        Args:
            wrench: W of the :class:`ForceMap`, shape (6, 18).
            wanted: momentum rate plus weight, [m g] and ANGULAR [m g m], six numbers.
            opening: share of the force limit per point, shape (12,); like ``landing`` the same array as
                before if nothing has changed in it.
            landing: force that landing points carry already, shape (12,) [m g].
            right_load: planned share of the right foot [1].
            yaw_curvature: of the posture's cost over the vertical moment.
            yaw_gradient: of the same at no moment.
        """
        row = wrench[_L_Z].take(_TANGENT)
        block = row[:, None] * (YAW_COST * yaw_curvature * row)
        block += self._tangent_cost
        self._flat_P[self._tangent_block] = block.reshape(-1)
        q, rest = self.q, -LOAD_COST * right_load
        q[_TANGENT] = YAW_COST * yaw_gradient * row
        if opening is not self._opening:
            loads = np.maximum(opening.reshape(2, POINTS)[:, :_SOLES], 1e-3)
            self._loads = -NORMAL_COST * loads / np.add.reduce(loads, axis=1, keepdims=True)
        q[:_SOLES] = (1.0 - right_load) * self._loads[0]
        q[self._right] = rest
        q[_FOOT : _FOOT + _SOLES] += right_load * self._loads[1]
        self.A[:6, :FORCES] = wrench
        self.lower[:6] = self.upper[:6] = wanted
        if opening is not self._opening or landing is not self._landing:
            np.maximum(LEAST_NORMAL * opening, landing, out=self._least)
            np.maximum(LARGEST_NORMAL * opening, self._least, out=self._largest)
            self._opening, self._landing = opening, landing

    def solve(self) -> QPSolution:
        """Solve what :meth:`build` filled in; the first 18 unknowns are phi."""
        return self._backend.solve(self.P, self.q, self.A, self.lower, self.upper)


class LimitedForm:
    """The whole problem, torque and joint limits as constraints: 40 accelerations, 18 forces, 20 slacks.

    Args:
        backend: name of the solver.
        settings: of the ADMM solver.
        nv: number of velocities.
        weights: posture weights, shape (nv,).
        condensed: supplies the force part of cost and constraints.
    """

    TASK_COST = 1e-3
    """Cost of leaving posture, feet and toes; the momentum's is one, so it comes first here too."""

    def __init__(
        self,
        backend: str,
        settings: QPSettings,
        nv: int,
        weights: NDArray[np.float64],
        condensed: CondensedForm,
    ) -> None:
        self.nv, self.nu = nv, nv - 6
        self._weights = self.TASK_COST * weights
        self._condensed = condensed
        self._soft = TASK_ROWS - 6
        n = nv + FORCES + 6 + self._soft
        self._phi = slice(nv, nv + FORCES)
        self._force_unknowns = slice(nv, nv + _SIZE)
        m = 6 + _ROWS + self._soft + 2 * self.nu
        self.P, self.q = np.zeros((n, n)), np.zeros(n)
        self.A, self.lower, self.upper = np.zeros((m, n)), np.zeros(m), np.zeros(m)
        self.P[np.arange(nv), np.arange(nv)] = self._weights
        self.P[-self._soft :, -self._soft :] = self.TASK_COST * np.eye(self._soft)
        self._dynamics, self._force_rows = slice(0, 6), slice(6, 6 + _ROWS)
        self._task_rows = slice(6 + _ROWS, 6 + _ROWS + self._soft)
        start = 6 + _ROWS + self._soft
        self._torque_rows, self._joint_rows = slice(start, start + self.nu), slice(start + self.nu, m)
        self.A[self._joint_rows, 6:nv] = np.eye(self.nu)
        self._backend = make_backend(backend, self._P_mask(n), self._A_mask(m, n), settings)

    def _P_mask(self, n: int) -> NDArray[np.bool_]:
        mask = np.eye(n, dtype=bool)
        mask[self._force_unknowns, self._force_unknowns] = self._condensed.P_mask()
        return mask

    def _A_mask(self, m: int, n: int) -> NDArray[np.bool_]:
        mask = self.A != 0.0
        mask[self._dynamics, : self.nv] = True
        mask[self._dynamics, self._phi] = self._condensed.A_mask()[:6, :FORCES]
        mask[self._force_rows, self._force_unknowns] = self._condensed.A_mask()
        mask[self._task_rows, : self.nv] = True
        mask[self._task_rows, -self._soft :] = np.eye(self._soft, dtype=bool)
        mask[self._torque_rows, : self.nv + FORCES] = True
        return mask

    def solve(
        self,
        rows: NDArray[np.float64],
        offset: NDArray[np.float64],
        wrench: NDArray[np.float64],
        softness: NDArray[np.float64],
        posture: NDArray[np.float64],
        torque_map: NDArray[np.float64],
        torque_bias: NDArray[np.float64],
        joint_lower: NDArray[np.float64],
        joint_upper: NDArray[np.float64],
    ) -> QPSolution:
        """Solve with the condensed form's current forces, costs and wanted momentum.

        Args:
            rows: B, shape (20, nv).
            offset: right-hand side of the 20 rows: the first six without forces, shape (20,).
            wrench: W, shape (6, 18).
            softness: of the 14 foot and toe rows, shape (14,).
            posture: wanted accelerations, shape (nv,) [g].
            torque_map: torques over the limit per unit of (alpha, phi), shape (nu, nv + 18).
            torque_bias: torques over the limit at zero, shape (nu,).
            joint_lower: least accelerations of the hinges, shape (nu,) [g].
            joint_upper: largest ones, shape (nu,) [g].

        Returns:
            Unknowns alpha, phi, slacks.
        """
        c, nv = self._condensed, self.nv
        self.P[self._force_unknowns, self._force_unknowns] = c.P
        self.q[:nv] = -self._weights * posture
        self.q[self._force_unknowns] = c.q
        A, lower, upper = self.A, self.lower, self.upper
        A[self._dynamics, :nv], A[self._dynamics, self._phi] = rows[:6], -wrench
        A[self._force_rows, self._force_unknowns] = c.A
        A[self._task_rows, :nv] = rows[6:]
        np.fill_diagonal(A[self._task_rows, -self._soft :], np.sqrt(softness))
        A[self._torque_rows, : nv + FORCES] = torque_map
        lower[self._dynamics] = upper[self._dynamics] = offset[:6]
        lower[self._force_rows], upper[self._force_rows] = c.lower, c.upper
        lower[self._task_rows] = upper[self._task_rows] = offset[6:]
        lower[self._torque_rows] = -1.0 - torque_bias
        upper[self._torque_rows] = 1.0 - torque_bias
        lower[self._joint_rows], upper[self._joint_rows] = joint_lower, joint_upper
        return self._backend.solve(self.P, self.q, A, lower, upper)
