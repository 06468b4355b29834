"""Which sole points may carry force: planned, and sensed since; opened and closed over a short time.

On the plan's clock alone the controller would load points that are still tenths of a millimetre above the floor,
and the ZMP would jump by centimetres. A group (the two heel, ball or tip points) opens when either of its points
touches and stays open until its planned lift-off: a foot that stands on one point of a line is turned back by the
very force that the other point was meant to carry, and would be turned over if that force were taken away.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.robot import Robot


_BALL, _TIP = 1, 2


class ContactGate:
    """Force limits of the sole points from planned and sensed contact.

    Args:
        robot: which point belongs to which foot and group.
        period: of a control tick [s].
        ramp: time in which a limit opens and closes [s].
    """

    def __init__(self, robot: Robot, period: float, ramp: float) -> None:
        self._foot, self._group = robot.point_foot, robot.point_group
        self._rate = period / ramp
        self._ramp = ramp
        self._open: NDArray[np.float64] | None = None
        self._touched: NDArray[np.bool_] | None = None

    def update(
        self,
        planned: NDArray[np.bool_],
        due: NDArray[np.bool_],
        until_lift: NDArray[np.float64],
        sensed: NDArray[np.bool_],
    ) -> NDArray[np.float64]:
        """Advance one tick.

        Args:
            planned: contact groups in contact, shape (2, 3).
            due: groups in contact now or shortly, shape (2, 3).
            until_lift: time to their planned lift-off, shape (2, 3) [s].
            sensed: points in contact, shape (P,).

        Returns:
            Share of the full force limit of every point, 0 ... 1, shape (P,).
        """
        if self._open is None:  # a run starts standing on whatever is planned
            self._open = planned.astype(np.float64)
            self._touched = planned.copy()
        touching = sensed.reshape(2, 3, 2).any(axis=2)
        self._touched = due & (self._touched | touching)
        self._touched[:, _TIP] &= self._touched[:, _BALL]  # a loaded tip would keep the ball off the floor
        np.clip(self._open + np.where(self._touched, self._rate, -1.0), 0.0, 1.0, out=self._open)
        closing = np.minimum(until_lift / self._ramp, 1.0)
        return np.minimum(self._open, closing)[self._foot, self._group]

    @property
    def touched(self) -> NDArray[np.bool_]:
        """Groups that have touched down since their contact was due, shape (2, 3)."""
        if self._touched is None:
            return np.ones((2, 3), dtype=bool)
        return self._touched

    @property
    def opening(self) -> NDArray[np.float64]:
        """How far each group has opened since its touch-down, 0 ... 1, shape (2, 3)."""
        if self._open is None:
            return np.ones((2, 3))
        return self._open
