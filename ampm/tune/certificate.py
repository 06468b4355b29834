"""Result of a refused search: the limit that stayed broken, and the best value reached."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

from ampm.exceptions import BodilyRefusal
from ampm.tune.free_choices import FREE_KEYS
from ampm.tune.gait_limits import LIMITS

if TYPE_CHECKING:
    from ampm.body.inverse_kinematics import Unreachable
    from ampm.parameters import RunParameters
    from ampm.tune.search import Candidate, ChoiceSearch

_TIGHT = 0.3  # margin below which a limit is named as what ended a way


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
        where: clause about an easier gait at which the search ended, if it did not reach the requested one;
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
            text = f"{self.what} is {best} at best, {self.tried} choices tried, and must be {limit.rule()}"
        text += f"; farther on, {self.beyond}" if self.beyond else ""
        return f"{self.where}, and there {text}" if self.where else text


class NoFeasibleChoice(BodilyRefusal):
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


@dataclass
class Approach:
    """How far the continuation from an easy neighbour led.

    Attributes:
        share: of the way [1].
        search: at that place.
        candidate: the choice there.
        why: what was in the way farther on.
    """

    share: float
    search: ChoiceSearch
    candidate: Candidate
    why: Unreachable | None = None


def numbers(found: Mapping[str, float | str]) -> Mapping[str, float]:
    """Those of the free choices that are numbers."""
    return MappingProxyType({key: float(value) for key, value in found.items() if isinstance(value, float)})


def no_feasible_choice(
    search: ChoiceSearch, best: Candidate | None, farthest: Approach | None
) -> NoFeasibleChoice:
    """The limit that stayed broken in the best of all choices, or where the way to the gait ended."""
    space, tried = search.space, len(search.candidates)
    where = beyond = ""
    if best is None and farthest is not None:
        best, gait = farthest.candidate, farthest.search.space.run.gait
        tried += len(farthest.search.candidates)
        where = (
            f"the search came {farthest.share:.0%} of the way from an easy gait, to step "
            f"{gait.step_length:.3g} m, v0 {gait.switching_velocity:.3g} m/s, c_s {gait.c_s:.3g}, "
            f"c_y {gait.c_y:.3g}"
        )
        beyond = "" if farthest.why is None else str(farthest.why)
    name = reason = "no_periodic_motion"
    if best is not None and best.orbit is not None:
        margins = best.margins()
        tightest = min(margins, key=lambda key: margins[key])
        limit = LIMITS[tightest]
        what, value, bound, unit = limit.what, best.values[tightest], limit.bound, limit.unit
        if not where or margins[tightest] < _TIGHT:
            name, reason = tightest, limit.reason
        elif farthest is not None:
            what, value, bound, unit = "the last periodic step is found", farthest.share, 1.0, "1"
    else:
        failed = [candidate for candidate in search.candidates if candidate.why is not None]
        best = (failed or search.candidates)[-1]
        what, value, bound, unit = "the formula has no solution", 0.0, 0.0, "1"
        if best.why is not None:
            what, value, bound, unit = str(best.why), best.why.value, best.why.limit, best.why.unit
    choice = numbers(space.found(best.run) if best.plan is not None else {})
    certificate = Certificate(name, what, float(value), float(bound), unit, tried, choice, where, beyond)
    fault = "no choice of timing, heights and angles lets this body walk the gait"
    return NoFeasibleChoice(fault, certificate, reason=reason, way_out=way_out(name, space.run, space.fixed))


def way_out(limit: str, run: RunParameters, fixed: Collection[str]) -> str:
    """Changes that would make a refused gait easier and are not made yet.

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
