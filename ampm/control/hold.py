"""Hold of the torque between two control ticks.

A constant torque lags by half a period: where the plan's ZMP moves by 7 mm in a tick, that is an error of
2 mm (RMS). The first-order hold extrapolates it with the slope of the last tick.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.control.contact_gate import Contact

    Array = NDArray[np.float64]

LARGEST_CHANGE = 0.03
"""Largest change of a torque in one tick that is extrapolated, as share of the motor's limit [1]. A larger
one is the response to an event, such as a landing, and is not repeated in the next tick."""


class FirstOrderHold:
    """Rates of the torques from tick to tick.

    The rate is the last difference over the period, with three exceptions. It is limited by
    :data:`LARGEST_CHANGE`. Where the contact has changed, the difference is the response to it, and the
    earlier rate is kept. Where the plan jumps, it is zero, and the reference is that of the middle of the
    hold.

    Args:
        torque_limit: shape (nu,) [N m].
        period: of the ticks [s].
    """

    def __init__(self, torque_limit: Array, period: float) -> None:
        self._largest = LARGEST_CHANGE * torque_limit
        self._period = period
        self._torque: Array | None = None
        self._contact: object = None
        self._rate = np.zeros_like(torque_limit)

    def rate(self, torque: Array, contact: Contact, jumps: bool) -> Array:
        """Rate for the time until the next tick, shape (nu,) [N m/s].

        Args:
            torque: of this tick, shape (nu,) [N m].
            contact: of this tick.
            jumps: the plan jumps in this tick or has jumped in the last one.
        """
        last, self._torque = self._torque, torque
        before, self._contact = self._contact, _kind(contact)
        if last is None or jumps:
            self._rate = np.zeros_like(torque)
        elif self._contact == before:
            change = np.minimum(np.maximum(torque - last, -self._largest), self._largest)
            self._rate = change / self._period
        return self._rate


def _kind(contact: Contact) -> tuple[list[list[bool]], list[list[bool]]]:
    """Contact state that determines the slope of the torque: planned lines, and those that are opening."""
    opening = [
        [touches and 0.0 < share < 1.0 for touches, share in zip(*foot, strict=True)]
        for foot in zip(contact.touching, contact.opening, strict=True)
    ]
    return contact.planned, opening
