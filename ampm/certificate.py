"""What a refused search leaves behind: the limit that stayed broken, and the best that was reached."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from ampm.exceptions import BodilyRefusal
from ampm.gait_limits import LIMITS


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
        if self.limit not in LIMITS:
            told = self.what
        else:
            limit = LIMITS[self.limit]
            side = "at most" if limit.comfort < limit.bound else "at least"
            unit = "" if self.unit == "1" else f" {self.unit}"
            told = (
                f"{self.what} is {self.value:.4g}{unit} at best, {self.tried} choices tried, and must be "
                f"{side} {self.bound:.4g}{unit}"
            )
        beyond = f"; farther on, {self.beyond}" if self.beyond else ""
        return f"{self.where}, and there {told}{beyond}" if self.where else told + beyond


class Untunable(BodilyRefusal):
    """No choice was found.

    Attributes:
        certificate: which limit, and the best that was reached.
    """

    def __init__(self, message: str, certificate: Certificate, *, reason: str, way_out: str) -> None:
        super().__init__(
            message,
            reason=reason,
            value=certificate.value,
            limit=certificate.bound,
            unit=certificate.unit,
            way_out=way_out,
        )
        self.certificate = certificate


WAYS_OUT = {
    **dict.fromkeys(
        (name for name in LIMITS if name.endswith("_torque")),
        "lower gait.switching_velocity, or bring gait.c_s and gait.c_y nearer to 1",
    ),
    "trunk": "bring gait.c_s and gait.c_y nearer to 1",
    "arms": "bring gait.c_s and gait.c_y nearer to 1",
    "friction": "bring gait.c_s nearer to 1 or shorten gait.step_length",
    "mid_stance": "raise gait.switching_velocity, shorten gait.step_length or lower gait.c_s",
}
"""Limit to what would make the gait easier."""
