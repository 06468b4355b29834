"""Which sole points may carry force: planned *and* sensed, opened and closed over a short time.

On the plan's clock alone the controller would load points that are still tenths of a millimetre above the floor,
or already off it, and the ZMP would jump by centimetres.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.robot import Robot


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
            self._open = planned[self._foot, self._group].astype(np.float64)
        loaded = due[self._foot, self._group] & sensed
        np.clip(self._open + np.where(loaded, self._rate, -self._rate), 0.0, 1.0, out=self._open)
        closing = np.minimum(until_lift[self._foot, self._group] / self._ramp, 1.0)
        return np.where(loaded, np.minimum(self._open, closing), 0.0)
