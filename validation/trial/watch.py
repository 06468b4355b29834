"""Detects the end of a walk: a fall, divergence of the simulation, or failure of the QP; and its first sign.

A falling body needs wrenches that no contact force can give, so its QP fails before it is on the floor; and a
failing QP makes the body fall. The order decides: a QP that stays unsolved while the body follows the plan is
``infeasible``; a body that had left the plan before is given time to fall.
"""

import math
from typing import NamedTuple

import numpy as np

from ampm.compiled import bound, compiled, refer
from ampm.geometry import Array
from ampm.vectors import dot, minus, vector
from ampm.walk import LIMITED, SOLVED, UNSOLVED
from validation.trial.outcome import Outcome, OutcomeName

FALL_SHARE = 0.25
"""The body has fallen when the height of its COM over the lower sole differs from the planned one by more
than this share [1]. The plan's floor is not needed: the real one may be elsewhere."""
FALL_DISTANCE = 0.7
"""A body of 1.70 m has fallen when its COM is horizontally farther than this from both soles [m]: as far as a
leg reaches when a quarter of the height is lost. A body that stands beside the plan has not fallen."""
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


class Stance(NamedTuple):
    """Quantities that decide whether a body stands: measured and planned."""

    com: Array  # shape (3,) [m]
    trunk: Array  # its long axis in world, unit vector, shape (3,)
    soles: Array  # reference points of both, shape (2, 3) [m]
    planned_com: Array  # shape (3,) [m]
    planned_trunk: Array  # of the planned motion, shape (3,)
    planned_soles: Array  # shape (2, 3) [m]

    def fallen(self, scale: float) -> str:
        """How the body has fallen, in words; empty if it stands. ``scale`` is its stature over 1.70 m."""
        # One layout, however the sites of the soles lie in memory.
        height, apart, upright = posture(self._replace(soles=np.ascontiguousarray(self.soles)))
        if abs(height - 1.0) > FALL_SHARE:
            over = height * (self.planned_com[2] - self.planned_soles[:, 2].min())
            return f"the COM {'sank' if height < 1.0 else 'rose'} to {over:.2f} m over the soles"
        if apart > scale * FALL_DISTANCE:
            return f"the COM was {apart:.2f} m from both soles"
        lean = math.acos(min(max(upright, -1.0), 1.0))
        if lean > FALL_TILT:
            return f"the trunk leaned {math.degrees(lean):.0f} degrees off the reference"
        return ""


@compiled
def posture(stance: Stance) -> tuple[float, float, float]:
    """COM's height over the lower sole, as a share of the planned one [1]; its horizontal distance from the
    nearer sole [m]; cosine of the trunk's lean from the planned one [1].
    """
    com, soles, planned, planned_soles = stance.com, stance.soles, stance.planned_com, stance.planned_soles
    height = com[2] - min(soles[0, 2], soles[1, 2])
    planned_height = planned[2] - min(planned_soles[0, 2], planned_soles[1, 2])
    apart = np.inf
    for i in range(2):
        apart = min(apart, math.sqrt((com[0] - soles[i, 0]) ** 2 + (com[1] - soles[i, 1]) ** 2))
    return height / planned_height, apart, dot(vector(stance.trunk), vector(stance.planned_trunk))


@compiled
def stands(stance: Stance, scale: float) -> bool:
    """Whether a body has not fallen; ``scale`` is its stature over 1.70 m."""
    height, apart, upright = posture(stance)
    # NaN counts as fallen.
    return abs(height - 1.0) <= FALL_SHARE and apart <= scale * FALL_DISTANCE and upright >= _FALL_COSINE


@compiled
def look(stance: Stance, last: Array, off: float, scale: float) -> tuple[float, bool]:
    """Distance of the COM from the last one, which it replaces [m]; whether there is no sign of a failure."""
    here, axis = vector(stance.com), vector(stance.planned_trunk)
    way, error = minus(here, vector(last)), minus(here, vector(stance.planned_com))
    last[:] = stance.com
    close = dot(error, error) <= off * off and dot(vector(stance.trunk), axis) >= _UPRIGHT
    return math.sqrt(dot(way, way)), close and stands(stance, scale)


class Watch:
    """Checks at every control tick whether the walk is over.

    Args:
        stance: of the body, whose numbers change.
        unsolved: time for which the QP may stay unsolved while the body follows the plan [s].
        scale: stature of the body over 1.70 m [1].
        planned: whether the body is to be where the plan has it.
    """

    def __init__(self, stance: Stance, unsolved: float, scale: float = 1.0, planned: bool = True) -> None:
        self.stance, self._unsolved_limit = stance, unsolved
        self._scale, self._off = scale, scale * FIRST_SIGN if planned else math.inf
        self._unsolved: tuple[float, float] | None = None  # since when, and how long it may last
        self._last_com, self._last_time = np.zeros(3), math.inf  # there is none yet
        self._first_sign, self._last_sign = "", 0.0
        self._look = bound(look, (refer(stance), self._last_com, self._off, scale))

    def check(self, time: float, status: int, *, residual: float = 0.0, limit: str = "") -> Outcome | None:
        """The end of the walk at a tick [s], None while it goes on.

        The residual is that of its QP; ``limit`` describes the torque or joint at its limit, if there is one.
        """
        stance = self.stance
        span, self._last_time = time - self._last_time, time
        way, close = self._look()
        speed = way / span if span > 0.0 else 0.0  # mean speed of the COM since the last tick [m/s]
        if close and status == SOLVED and not self._first_sign and speed <= BLOW_UP:
            self._unsolved = None
            return None
        error = stance.com - stance.planned_com
        distance = float(np.linalg.norm(error))
        lean = float(np.arccos(np.clip(stance.trunk @ stance.planned_trunk, -1.0, 1.0)))
        at = f"at {time:.3f} s"
        sign = ""
        if status == UNSOLVED:
            sign = f"an unsolved QP {at} (residual {residual:.2g})"
        elif distance > self._off:
            axis = "xyz"[int(np.abs(error).argmax())]
            sign = f"a COM {distance * 1e3:.0f} mm off the plan, mostly along {axis}, {at}"
        elif lean > FIRST_TILT:
            sign = f"a trunk {math.degrees(lean):.0f} degrees off the reference {at}"
        elif status == LIMITED:
            sign = f"a torque or joint limit {at} ({limit.replace('_', ' ')})"
        if sign:
            self._first_sign, self._last_sign = self._first_sign or sign, time
        elif time - self._last_sign > CALM:
            self._first_sign = ""
        if not math.isfinite(distance + lean):
            return self.blown_up(time, "the state was no longer finite")
        if speed > BLOW_UP:
            return self.blown_up(time, f"the COM moved at {speed:.3g} m/s, which no body does,")
        if fallen := stance.fallen(self._scale):
            return self._end(time, OutcomeName.FELL, f"{fallen} {at}")
        if status != UNSOLVED:
            self._unsolved = None
            return None
        if self._unsolved is None:
            on_plan, allowed = distance <= self._off and lean <= FIRST_TILT, self._unsolved_limit
            self._unsolved = time, allowed if on_plan else max(allowed, FALL_TIME)
        since, allowance = self._unsolved
        if time - since < allowance - 1e-9:
            return None
        unsolved = f"the QP stayed unsolved from {since:.3f} to {time:.3f} s"
        return self._end(time, OutcomeName.INFEASIBLE, unsolved)

    def blown_up(self, time: float, what: str = "the accelerations left all bounds") -> Outcome:
        """The end of a walk whose accelerations the simulator refused to integrate, or of another failure."""
        return self._end(time, OutcomeName.DIVERGED, f"{what} at {time:.3f} s")

    def _end(self, time: float, name: OutcomeName, what: str) -> Outcome:
        """An end, with its first sign; the steps until then are not known here."""
        cause = f"{what}; the first sign was {self._first_sign}" if self._first_sign else what
        return Outcome(name, time, cause, 0)
