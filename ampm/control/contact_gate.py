"""Which sole points may carry force: planned, and sensed since; opened and closed over a short time.

On the plan's clock alone the controller would load points that are still tenths of a millimetre above the
floor, and the ZMP would jump by centimetres. A group (the two heel, ball or tip points) opens when either of
its points touches and stays open until its planned lift-off: a foot that stands on one point of a line is
turned back by the planned force of the other point, and would be turned over without it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ampm.control.forces import Openings

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.body.robot import Robot
    from ampm.walk import ContactState

HEEL, BALL, TIP = 0, 1, 2
"""Groups of a foot's points."""

Groups = list[list[bool]]


class Contact(NamedTuple):
    """Contacts that may carry force at one tick; lists by foot and group.

    Attributes:
        planned: planned in contact.
        due: planned in contact now or shortly.
        touching: touches at this tick.
        touched: has touched down since its contact was due.
        opening: share opened since its touch-down, 0 ... 1.
        landing: whether any group touches or has opened that has not fully opened.
        openings: force limits of the points, which also close before lift-off.
    """

    planned: Groups
    due: Groups
    touching: Groups
    touched: Groups
    opening: list[list[float]]
    landing: bool
    openings: Openings


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
        self._last: Contact | None = None

    def update(self, reference: ContactState, sensed: NDArray[np.bool_]) -> Contact:
        """Advance one tick, in plain numbers: six of them are too few for arrays to be faster.

        Args:
            reference: planned contact.
            sensed: points in contact, shape (P,).
        """
        planned, due, until_lift = [part.tolist() for part in reference]
        last = self._last
        if last is None:  # a run starts standing on the planned points
            opening, touched = [[float(group) for group in foot] for foot in planned], planned
        else:
            opening, touched = last.opening, last.touched
        touches = [False] * 6
        for slot, sensed_now in zip(self._groups, sensed.tolist(), strict=True):
            if sensed_now:
                touches[slot] = True
        touching = [touches[:3], touches[3:]]
        landing, limits, rate, ramp = False, [], self._rate, self._ramp
        holding, opened = [[False] * 3, [False] * 3], [[0.0] * 3, [0.0] * 3]
        for foot in (0, 1):
            holds, shares, until = holding[foot], opened[foot], until_lift[foot]
            due_now, has_touched, touches_now = due[foot], touched[foot], touching[foot]
            before = opening[foot]
            for group in (HEEL, BALL, TIP):
                held = due_now[group] and (has_touched[group] or touches_now[group])
                if group == TIP:  # a loaded tip would keep the ball off the floor
                    held = held and holds[BALL]
                holds[group] = held
                share = shares[group] = min(before[group] + rate, 1.0) if held else 0.0
                if share < 1.0 and (touches_now[group] or share > 0.0):
                    landing = True
                limits.append(min(share, until[group] / ramp))
        if last is not None and limits == self._limits:
            openings = last.openings
        else:
            self._limits, openings = limits, Openings.of(np.array(limits)[self._slots])
        self._last = Contact(planned, due, touching, holding, opened, landing, openings)
        return self._last
