"""Detects the end of a walk: a fall, divergence of the simulation, or failure of the QP; and its first sign.
A falling body needs wrenches that no contact force can give, so its QP fails before it is on the floor; and a
failing QP makes the body fall. The order decides: a QP that stays unsolved while the body follows the plan is
``infeasible``; a body that had left the plan before is given time to fall.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ampm.compiled import compiled
from ampm.walk import LIMITED, SOLVED, UNSOLVED
from validation.trial.outcome import OutcomeName

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

FALL_SHARE = 0.75
"""The body has fallen when its COM is lower than this share of the planned height [1]."""

FALL_DISTANCE = 0.3
"""A body of 1.70 m has fallen when its COM is farther than this from the plan [m]: more than half a foot's
length outside any support that the plan could offer."""

FALL_TILT = math.radians(60.0)
"""The body has fallen when its trunk leans farther than this from the planned motion's [rad]."""

_FALL_COSINE = math.cos(FALL_TILT)
_UPRIGHT = math.cos(0.9 * math.radians(10.0))  # well above the lean of the first sign

BLOW_UP = 20.0
"""Speed of the COM [m/s] that only a diverged simulation reaches: a fall from standing height ends at 4
m/s."""

FIRST_SIGN = 0.02
"""COM error of a body of 1.70 m that is reported as the first sign of a failure [m]: a hundred times that of
a good walk."""

FIRST_TILT = math.radians(10.0)
"""Lean of the trunk from the motion's that is reported as the first sign of a failure [rad]."""

CALM = 1.0
"""If no warning sign recurs for this long, the earlier one is discarded as a cause [s]."""

FALL_TIME = 1.0
"""Time that a body off the plan is given to fall while its QP stays unsolved [s]."""


@compiled
def near(
    com: Array, trunk: Array, planned: Array, planned_trunk: Array, distance: float, cosine: float
) -> bool:
    """Whether the body is so near to the plan: its COM [m], and its trunk by the cosine of the angle."""
    x, y, z = com[0] - planned[0], com[1] - planned[1], com[2] - planned[2]
    upright = trunk[0] * planned_trunk[0] + trunk[1] * planned_trunk[1] + trunk[2] * planned_trunk[2]
    return math.sqrt(x * x + y * y + z * z) <= distance and upright >= cosine


@compiled
def look(
    com: Array, trunk: Array, planned: Array, planned_trunk: Array, last: Array, off: float
) -> tuple[float, bool]:
    """Distance of the COM from the last one, which it replaces [m]; whether there is no sign of a failure."""
    x, y, z = com[0] - last[0], com[1] - last[1], com[2] - last[2]
    last[:] = com
    return math.sqrt(x * x + y * y + z * z), near(com, trunk, planned, planned_trunk, off, _UPRIGHT)


class End(NamedTuple):
    """Early end of a walk: its kind, and one sentence on it and its first sign."""

    name: OutcomeName
    cause: str


class Watch:
    """Checks every control tick, and reports when the walk is over.

    Args:
        unsolved_limit: time for which the QP may stay unsolved while the body follows the plan [s].
        scale: size of the body, of which 1.70 m is one [1].
    """

    def __init__(self, unsolved_limit: float, scale: float = 1.0) -> None:
        self._unsolved_limit = unsolved_limit
        self._fallen, self._off = scale * FALL_DISTANCE, scale * FIRST_SIGN
        self._unsolved: tuple[float, float] | None = None  # since when, and how long it may last
        self._last_com, self._last_time = np.zeros(3), math.inf  # there is none yet
        self._first_sign, self._last_sign = "", 0.0

    def check(
        self,
        time: float,
        com: Array,
        trunk: Array,
        planned: Array,
        planned_trunk: Array,
        status: int,
        *,
        residual: float = 0.0,
        limit: str = "",
    ) -> End | None:
        """One tick.

        Args:
            time: [s].
            com: shape (3,) [m].
            trunk: its long axis in world, unit vector, shape (3,).
            planned: COM of the plan, shape (3,) [m].
            planned_trunk: the same of the planned motion, shape (3,).
            status: of the controller's tick.
            residual: of its QP.
            limit: description of the torque or joint at its limit, if the status is ``LIMITED``.

        Returns:
            None while the walk goes on.
        """
        span, self._last_time = time - self._last_time, time
        way, close = look(com, trunk, planned, planned_trunk, self._last_com, self._off)
        speed = way / span if span > 0.0 else 0.0  # mean speed of the COM since the last tick [m/s]
        if close and status == SOLVED and not self._first_sign and speed <= BLOW_UP:
            self._unsolved = None
            return None
        return self._judge(
            time,
            com.tolist(),
            trunk.tolist(),
            planned.tolist(),
            planned_trunk.tolist(),
            status,
            residual,
            limit,
            speed,
        )

    def _judge(
        self,
        time: float,
        com: list[float],
        trunk: list[float],
        planned: list[float],
        planned_trunk: list[float],
        status: int,
        residual: float,
        limit: str,
        speed: float,
    ) -> End | None:
        """The end of the walk, or its signs noted; arguments as in :meth:`check`."""
        error = com[0] - planned[0], com[1] - planned[1], com[2] - planned[2]
        distance = math.hypot(*error)
        axis = "xyz"[max(range(3), key=lambda i: abs(error[i]))]
        lean = math.atan2(_cross_size(trunk, planned_trunk), _dot(trunk, planned_trunk))
        degrees, at = math.degrees(lean), f"at {time:.3f} s"
        signs = (
            (status == UNSOLVED, f"an unsolved QP {at} (residual {residual:.2g})"),
            (distance > self._off, f"a COM {distance * 1e3:.0f} mm off the plan, mostly along {axis}, {at}"),
            (lean > FIRST_TILT, f"a trunk {degrees:.0f} degrees off the motion's {at}"),
            (status == LIMITED, f"a torque or joint limit {at} ({limit})"),
        )
        ends = (
            (not math.isfinite(distance + lean), OutcomeName.DIVERGED, "the state was no longer finite"),
            (speed > BLOW_UP, OutcomeName.DIVERGED, f"the COM moved at {speed:.3g} m/s, which no body does,"),
            (com[2] < FALL_SHARE * planned[2], OutcomeName.FELL, f"the COM sank to {com[2]:.2f} m"),
            (distance > self._fallen, OutcomeName.FELL, f"the COM was {distance:.2f} m off the plan"),
            (lean > FALL_TILT, OutcomeName.FELL, f"the trunk leaned over by {degrees:.0f} degrees"),
        )
        self._note(time, next((text for seen, text in signs if seen), ""))
        for reached, name, what in ends:
            if reached:
                return self._end(name, f"{what} {at}")
        return self._check_unsolved(time, status, distance <= self._off and lean <= FIRST_TILT)

    def check_between_ticks(
        self,
        time: float,
        com: Array,
        trunk: Array,
        planned: Array,
        planned_trunk: Array,
    ) -> End | None:
        """Whether the body has fallen at a step without a tick; arguments as in :meth:`check`."""
        if com[2] >= FALL_SHARE * planned[2] and near(
            com, trunk, planned, planned_trunk, self._fallen, _FALL_COSINE
        ):
            return None
        return self.check(time, com, trunk, planned, planned_trunk, SOLVED)

    def blown_up(self, time: float) -> End:
        """The end of a walk whose accelerations the simulator refused to integrate."""
        return self._end(OutcomeName.DIVERGED, f"the accelerations left all bounds at {time:.3f} s")

    def _note(self, time: float, sign: str) -> None:
        """Store the first sign of a failure; discard it after a time without a sign."""
        if sign:
            self._first_sign = self._first_sign or sign
            self._last_sign = time
        elif time - self._last_sign > CALM:
            self._first_sign = ""

    def _check_unsolved(self, time: float, status: int, on_plan: bool) -> End | None:
        """The end by a QP that stayed unsolved too long; None otherwise."""
        if status != UNSOLVED:
            self._unsolved = None
            return None
        if self._unsolved is None:
            limit = self._unsolved_limit
            self._unsolved = time, limit if on_plan else max(limit, FALL_TIME)
        since, allowance = self._unsolved
        if time - since < allowance - 1e-9:
            return None
        return self._end(OutcomeName.INFEASIBLE, f"the QP stayed unsolved from {since:.3f} to {time:.3f} s")

    def _end(self, name: OutcomeName, what: str) -> End:
        return End(name, f"{what}; the first sign was {self._first_sign}" if self._first_sign else what)


def _cross_size(a: Sequence[float], b: Sequence[float]) -> float:
    return math.hypot(a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
