"""What a refused search leaves behind: the limit that stayed broken, and the best that was reached."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ampm.exceptions import BodilyRefusal
from ampm.tune.free_choices import FREE_KEYS
from ampm.tune.gait_limits import LIMITS

if TYPE_CHECKING:
    from ampm.parameters import RunParameters


@dataclass(frozen=True)
class Certificate:
    """Why nothing was found: the limit that stayed broken, and the best that was reached.

    Attributes:
        limit: name in :data:`LIMITS`, or the reason of another refusal.
        what: what was measured.
        value: best value over all choices that were tried while the other limits were broken least.
        bound: what it should have met.
        unit: of both.
        tried: how many choices had been tried.
        choice: free choices of that best value, by namespaced key.
        where: clause about an easier gait at which the search ended, if it did not reach the one asked for;
            the value is then that gait's.
        beyond: clause about what was in the way farther on, if that is known.
    """

    limit: str
    what: str
    value: float
    bound: float
    unit: str
    tried: int
    choice: Mapping[str, float]
    where: str = ""
    beyond: str = ""

    @property
    def margin(self) -> float:
        """Normalised margin of the best value; minus infinity if it is of no limit or an easier gait."""
        known = self.limit in LIMITS and not self.where
        return LIMITS[self.limit].margin(self.value) if known else -math.inf

    def __str__(self) -> str:
        """One clause."""
        text = self.what
        if self.limit in LIMITS:
            limit = LIMITS[self.limit]
            best = limit.quantity(self.value, 4)
            text = f"{self.what} is {best} at best, {self.tried} choices tried, and must be {limit.rule}"
        text += f"; farther on, {self.beyond}" if self.beyond else ""
        return f"{self.where}, and there {text}" if self.where else text


class Untunable(BodilyRefusal):
    """No choice was found.

    Attributes:
        certificate: which limit, and the best that was reached.
    """

    def __init__(self, message: str, certificate: Certificate, *, reason: str, way_out: str) -> None:
        super().__init__(
            f"{message}: {certificate}",
            reason=reason,
            value=certificate.value,
            limit=certificate.bound,
            unit=certificate.unit,
            way_out=way_out,
        )
        self.certificate = certificate


def way_out(limit: str, run: RunParameters, fixed: Collection[str]) -> str:
    """What would make a refused gait easier, as far as it has not been done already.

    Args:
        limit: name in :data:`ampm.tune.gait_limits.LIMITS`, or another.
        run: the request.
        fixed: keys that might not be changed.
    """
    gait = run.gait
    turning = limit in ("twist", "turn", "handover")
    ways = []
    if limit == "mid_stance":
        ways += ["raise gait.switching_velocity", "shorten gait.step_length", "lower gait.c_s"]
    elif turning:
        ways += ["lower gait.switching_velocity or lengthen gait.step_length"]
    elif limit in ("knee_torque", "friction") and gait.c_s > 1.1:
        ways += ["change gait.switching_velocity (a faster step of this c_s may need less)"]
    elif limit.endswith("_torque"):
        ways += ["lower gait.switching_velocity"]
    leaning = [f"gait.{key}" for key in ("c_s", "c_y") if abs(getattr(gait, key) - 1.0) > 0.02]
    if leaning:
        ways += [f"bring {' and '.join(leaning)} nearer to 1"]
    if not turning and limit != "mid_stance":
        ways += ["shorten gait.step_length"]
    named = [key for key in FREE_KEYS if key in fixed]
    if named:
        others = f" and {len(named) - 3} more" if len(named) > 3 else ""
        ways += [f"leave free what was named ({', '.join(named[:3])}{others})"]
    return ways[0] if len(ways) == 1 else f"{', '.join(ways[:-1])}, or {ways[-1]}"
