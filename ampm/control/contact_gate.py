"""Which sole points may carry force: planned, and sensed since; opened and closed over a short time.

On the plan's clock alone the controller would load points that are still tenths of a millimetre above the
floor, and the ZMP would jump by centimetres. A group (the two heel, ball or tip points) opens when either of
its points touches and stays open until its planned lift-off: a foot that stands on one point of a line is
turned back by the very force that the other point was meant to carry, and would be turned over if that force
were taken away.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.body.robot import Robot


_BALL, _TIP = 1, 2


class ContactGate:
    """Force limits of the sole points from planned and sensed contact.

    Args:
        robot: which point belongs to which foot and group.
        period: of a control tick [s].
        ramp: time in which a limit opens and closes [s].
    """

    def __init__(self, robot: Robot, period: float, ramp: float) -> None:
        self._rate, self._ramp = period / ramp, ramp
        self._slots = 3 * robot.point_foot + robot.point_group
        self._groups = self._slots.tolist()
        self._limits: list[float] = []
        self._limit = np.ones(len(self._groups))
        self.opening = [[1.0] * 3 for _ in range(2)]
        """How far each foot's groups have opened since their touch-down, 0 ... 1."""
        self.touching = [[True] * 3 for _ in range(2)]
        """Which groups of each foot touch at this tick."""
        self.touched = [[True] * 3 for _ in range(2)]
        """Which of them have touched down since their contact was due."""
        self._started = False
        self.landing = False
        """Whether any group touches that has not fully opened."""

    def update(
        self,
        planned: list[list[bool]],
        due: list[list[bool]],
        until_lift: list[list[float]],
        sensed: NDArray[np.bool_],
    ) -> NDArray[np.float64]:
        """Advance one tick, in plain numbers: six of them are too few for arrays to be worth their while.

        Args:
            planned: contact groups of each foot in contact.
            due: groups in contact now or shortly.
            until_lift: time to their planned lift-off [s].
            sensed: points in contact, shape (P,).

        Returns:
            Share of the full force limit of every point, 0 ... 1, shape (P,): the same array as long as it
            has not changed.
        """
        if not self._started:  # a run starts standing on whatever is planned
            self._started = True
            self.opening = [[float(group) for group in foot] for foot in planned]
            self.touched = [list(foot) for foot in planned]
        touches = [False] * 6
        for slot, sensed_now in zip(self._groups, sensed.tolist(), strict=True):
            if sensed_now:
                touches[slot] = True
        self.touching = [touches[:3], touches[3:]]
        self.landing = False
        limits = []
        for foot in (0, 1):
            opening, touched, touching = self.opening[foot], self.touched[foot], self.touching[foot]
            due_now, until = due[foot], until_lift[foot]
            for group in (0, 1, 2):
                held = due_now[group] and (touched[group] or touching[group])
                if group == _TIP:  # a loaded tip would keep the ball off the floor
                    held = held and touched[_BALL]
                touched[group] = held
                share = min(opening[group] + self._rate, 1.0) if held else 0.0
                opening[group] = share
                if share < 1.0 and touching[group]:
                    self.landing = True
                limits.append(min(share, until[group] / self._ramp))
        if limits != self._limits:
            self._limits = limits
            self._limit = np.array(limits)[self._slots]
        return self._limit
