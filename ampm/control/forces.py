"""Contact forces in the controller's QP: nine unknowns per foot, and their effect on the body.

Units: forces in m g, moments in m g m times :data:`ANGULAR`, so that a metre of lever is as large as a third
of a weight. Per foot: the normal forces of its points, two tangential forces and a twist about the vertical.
Tangential forces are distributed over the points by their openings.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ampm.body.robot import POINTS, SOLES

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.body.robot import Kinematics

    Array = NDArray[np.float64]

ANGULAR = 3.0
"""Scale of the angular momentum rows [1/m]."""

TWIST_ARM = 0.1
"""Lever that turns a twisting moment into a force of the size of the others [m]."""

NORMAL_COST = 0.6
"""Regularisation of normal forces."""

LARGEST_NORMAL = 0.6
"""Largest normal force of one point [m g]."""

LEAST_NORMAL = 0.004
"""Least normal force of an open point [m g]: enough to keep it from chattering on a compliant floor."""

FOOT = POINTS + 3
"""Unknowns of one foot."""

FORCES = 2 * FOOT
"""Unknowns of both feet."""

NORMALS = np.concatenate([np.arange(POINTS), FOOT + np.arange(POINTS)])
"""Their normal forces, by point."""

_LEAST_OPENING = 1e-3  # a foot with all points closed has shares, too
_SKEWS = ANGULAR * np.array(  # arm @ _SKEWS: rows of the matrix that turns a force at the arm into a moment
    [[0, 0, 0, 0, 0, -1, 0, 1, 0], [0, 0, 1, 0, 0, 0, -1, 0, 0], [0, -1, 0, 1, 0, 0, 0, 0, 0]], dtype=float
)


class Openings(NamedTuple):
    """Openings of the sole points, and the limits and shares that follow.

    Attributes:
        limit: share of the full force limit, 0 ... 1, shape (P,).
        share: of each point in its foot's tangential forces, shape (2, 6).
        load_cost: gradient of the soles' normal forces per planned load of the foot, shape (2, 4).
        least, largest: normal forces, shape (P,) [m g].
    """

    limit: Array
    share: Array
    load_cost: Array
    least: Array
    largest: Array

    @classmethod
    def of(cls, limit: Array) -> Openings:
        """From the share of the force limit of every point, shape (P,)."""
        share = np.maximum(limit.reshape(2, POINTS), _LEAST_OPENING)
        loads = share[:, :SOLES]
        load_cost = -NORMAL_COST * loads / np.add.reduce(loads, axis=1, keepdims=True)
        share /= np.add.reduce(share, axis=1, keepdims=True)
        least = LEAST_NORMAL * limit
        return cls(
            limit=limit,
            share=share,
            load_cost=load_cost,
            least=least,
            largest=np.maximum(LARGEST_NORMAL * limit, least),
        )


class ForceMap:
    """Effect of the force unknowns; made once, its arrays are overwritten by every :meth:`update`.

    Point forces are ``f = D phi`` and the net wrench ``W = X D``, with X the points' lever arms. New arrays
    at every tick would cost more than the arithmetic.

    Attributes:
        wrench: W, net force and moment about the COM, shape (6, 18).
        foot_wrench: the same by foot, and the moment of the tips' forces about the toe axis [m g m],
            shape (2, 7, 9).
        twist_lever: distance of the points from the centre of their foot's tangential forces, (2, 6) [m].
    """

    def __init__(self) -> None:
        self.wrench = np.zeros((6, FORCES))
        self.foot_wrench = np.zeros((2, 7, FOOT))
        self.twist_lever = np.zeros((2, POINTS))
        self._wrench_by_foot = self.wrench.reshape(6, 2, FOOT).transpose(1, 0, 2)
        self._spread = np.zeros((2, POINTS, 3, FOOT))  # D
        self._spread[:, np.arange(POINTS), 2, np.arange(POINTS)] = 1.0
        self._shares = self._spread[:, :, 0, POINTS], self._spread[:, :, 1, POINTS + 1]
        self._twists = self._spread[:, :, 0, POINTS + 2], self._spread[:, :, 1, POINTS + 2]
        self._spread_rows = self._spread.reshape(2, 3 * POINTS, FOOT)
        self._lever = np.zeros((2, 7, POINTS, 3))  # X, and a row for the toe
        self._lever[:, :3] = np.eye(3)[:, None, :]
        self._moment_rows = self._lever[:, 3:6].transpose(0, 2, 1, 3)
        self._toe_row = self._lever[:, 6, SOLES:]
        self._lever_rows = self._lever.reshape(2, 7, 3 * POINTS)

    def update(self, body: Kinematics, openings: Openings) -> None:
        """Fill in a tick."""
        share, arm = openings.share, body.arm
        self._shares[0][:] = self._shares[1][:] = share
        offset = arm[:, :, :2] - share[:, None, :] @ arm[:, :, :2]
        np.hypot(offset[:, :, 0], offset[:, :, 1], out=self.twist_lever)
        pull = share[:, :, None] * offset
        pull *= TWIST_ARM / np.add.reduce(pull * offset, axis=(1, 2), keepdims=True)
        np.negative(pull[:, :, 1], out=self._twists[0])
        self._twists[1][:] = pull[:, :, 0]
        self._moment_rows[:] = (arm @ _SKEWS).reshape(2, POINTS, 3, 3)
        self._toe_row[:] = body.toe_lever
        np.matmul(self._lever_rows, self._spread_rows, out=self.foot_wrench)
        self._wrench_by_foot[:] = self.foot_wrench[:, :6]

    def foot_wrenches(self, phi: Array) -> Array:
        """Wrench of each foot in the units of ``wrench``, and its toe moment [m g m], shape (2, 7)."""
        return (self.foot_wrench @ phi.reshape(2, FOOT, 1))[:, :, 0]

    def point_forces(self, phi: Array) -> Array:
        """Forces at the points for the unknowns phi, shape (2, 6, 3) [m g]."""
        return (self._spread_rows @ phi.reshape(2, FOOT, 1)).reshape(2, POINTS, 3)


def without_closed(phi: Array, opening: Array) -> Array:
    """Forces of an earlier tick, less those at points that have closed since.

    Tangential forces and twist of a foot shrink with its normal force, so that they stay within the friction.

    Args:
        phi: force unknowns, shape (18,) [m g].
        opening: of the points now, shape (12,).
    """
    kept = phi.reshape(2, FOOT).copy()
    before = kept[:, :POINTS].sum(axis=1)
    kept[:, :POINTS] *= opening.reshape(2, POINTS) > 0.0
    after = kept[:, :POINTS].sum(axis=1)
    kept[:, POINTS:] *= np.divide(after, before, out=np.zeros(2), where=before > 0.0)[:, None]
    return kept.reshape(-1)
