"""Refusal of a gait that no choice makes walkable: the limit that stayed broken, and the best value."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from ampm.exceptions import BodilyRefusal
from ampm.parameters import OPEN_KEYS
from ampm.tune.gait_limits import LIMITS

if TYPE_CHECKING:
    from ampm.parameters import RunParameters
    from ampm.tune.search import Approach, Candidate, ChoiceSearch

_TIGHT = 0.3  # margin below which a limit is named as the end of a continuation


class NoFeasibleChoice(BodilyRefusal):
    """No choice was found; value and limit are those of the best that was tried.

    Attributes:
        broken: limit that stayed broken, a name in :data:`LIMITS`, or the reason of another refusal.
        margin: its normalised margin; minus infinity if it is of no limit, or of an easier gait at which the
            search ended [1].
        tried: how many choices had been tried.
        choice: free choices of the best value, by namespaced key.
        values: of all limits for the best choice, by name in :data:`LIMITS`.
    """

    def __init__(
        self,
        why: str,
        *,
        broken: str,
        tried: int,
        choice: Mapping[str, float | str],
        margin: float = -math.inf,
        values: Mapping[str, float] = MappingProxyType({}),
        **refusal: Any,
    ) -> None:
        super().__init__(why, **refusal)
        self.broken, self.margin, self.tried, self.values = broken, margin, tried, values
        self.choice = {key: value for key, value in choice.items() if isinstance(value, float)}


def no_feasible_choice(
    search: ChoiceSearch, best: Candidate | None, farthest: Approach | None
) -> NoFeasibleChoice:
    """The limit that stayed broken in the best of all choices, or at the end of the continuation."""
    space, tried = search.space, len(search.candidates)
    where = beyond = ""
    if best is None and farthest is not None:
        best, gait = farthest.candidate, farthest.search.space.run.gait
        tried += len(farthest.search.candidates)
        where = (
            f"the search came {farthest.share:.0%} of the way from an easy gait, to step "
            f"{gait.step_length:.3g} m, v0 {gait.switching_velocity:.3g} m/s, c_s {gait.c_s:.3g}, "
            f"c_y {gait.c_y:.3g}, and there "
        )
        beyond = "" if farthest.why is None else f"; farther on, {farthest.why}"
    broken, reason, margin = "no_periodic_motion", "no_periodic_motion", -math.inf
    if best is not None and best.orbit is not None:
        margins = best.margins()
        tightest = min(margins, key=lambda key: margins[key])
        if where and margins[tightest] >= _TIGHT and farthest is not None:
            what, value, bound, unit = "the last periodic step is found", farthest.share, 1.0, "1"
        else:
            limit, value = LIMITS[tightest], best.values[tightest]
            broken, reason, bound, unit = tightest, limit.reason, limit.bound, limit.unit
            margin = -math.inf if where else margins[tightest]
            reached = f"{limit.quantity(value, 4)} at best, {tried} choices tried"
            what = f"{limit.what} is {reached}, and must be {limit.rule()}"
    else:
        failed = [candidate for candidate in search.candidates if candidate.why is not None]
        best = (failed or search.candidates)[-1]
        what, value, bound, unit = "the formula has no solution", 0.0, 0.0, "1"
        if best.why is not None:
            what, value, bound, unit = str(best.why), best.why.value, best.why.limit, best.why.unit
    return NoFeasibleChoice(
        f"no choice of timing, heights and angles lets this body walk the gait: {where}{what}{beyond}",
        broken=broken,
        margin=margin,
        tried=tried,
        values=best.values,
        choice=space.found(best.run) if best.plan is not None else {},
        reason=reason,
        value=float(value),
        limit=float(bound),
        unit=unit,
        way_out=way_out(broken, space.run, space.fixed),
    )


def way_out(limit: str, run: RunParameters, fixed: Collection[str]) -> str:
    """Changes that would make a refused gait easier.

    Args:
        limit: name in :data:`ampm.tune.gait_limits.LIMITS`, or another.
        run: the request.
        fixed: keys that might not be changed.
    """
    gait = run.gait
    turning = limit in ("twist", "turn", "handover", "pace", "hip_time")
    ways = []
    if limit == "mid_stance":
        ways += ["raise gait.switching_velocity", "shorten gait.step_length", "lower gait.c_s"]
    elif limit == "gap":
        ways += ["raise body.arm_abduction or gait.step_width"]
    elif turning:
        ways += ["lower gait.switching_velocity or lengthen gait.step_length"]
    elif limit in ("knee_torque", "friction") and gait.c_s > 1.1:
        ways += ["change gait.switching_velocity (a faster step of this c_s may need less)"]
    elif limit.endswith("_torque") or limit == "speed":
        ways += ["lower gait.switching_velocity"]
    leaning = [f"gait.{key}" for key in ("c_s", "c_y") if abs(getattr(gait, key) - 1.0) > 0.02]
    if leaning:
        ways += [f"bring {' and '.join(leaning)} nearer to 1"]
    if not turning and limit != "mid_stance":
        ways += ["shorten gait.step_length"]
    named = [key for key in OPEN_KEYS if key in fixed]
    if named:
        others = f" and {len(named) - 3} more" if len(named) > 3 else ""
        ways += [f"leave open what was given ({', '.join(named[:3])}{others})"]
    return ways[0] if len(ways) == 1 else f"{', '.join(ways[:-1])}, or {ways[-1]}"
