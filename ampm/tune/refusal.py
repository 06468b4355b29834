"""Refusal of a gait that no choice makes walkable: the limit that stayed broken, and the best value."""

from collections.abc import Collection, Mapping
from types import MappingProxyType
from typing import Any

from ampm.body.limits import LIMITS
from ampm.exceptions import BodilyRefusal
from ampm.parameters import OPEN_KEYS, RunParameters
from ampm.tune.free_choices import FreeChoices
from ampm.tune.search import ChoiceSearch

_NONE = "no choice of timing, heights and angles lets this body walk the gait"


class NoFeasibleChoice(BodilyRefusal):
    """No choice was found; value and limit are those of the best that was tried.

    Attributes:
        broken: limit that stayed broken, a name in :data:`LIMITS`, or the reason of another refusal.
        tried: how many choices had been tried.
        values: of all limits for the best choice, by name in :data:`LIMITS`.
    """

    def __init__(
        self,
        why: str,
        *,
        broken: str,
        tried: int,
        values: Mapping[str, float] = MappingProxyType({}),
        **refusal: Any,
    ) -> None:
        super().__init__(why, **refusal)
        self.broken, self.tried, self.values = broken, tried, values


def broken_limit(name: str, values: Mapping[str, float], space: FreeChoices, tried: int) -> NoFeasibleChoice:
    """The refusal by one limit.

    Args:
        name: in :data:`LIMITS`.
        values: of all known limits for the best choice.
        space: the free choices.
        tried: number of choices.
    """
    limit, value = LIMITS[name], values[name]
    return NoFeasibleChoice(
        f"{_NONE}: {limit.what} is {limit.quantity(value, 4)} at best, {tried} choices tried, and must be "
        f"{limit.rule()}",
        broken=name,
        tried=tried,
        values=values,
        reason=limit.reason,
        value=value,
        limit=limit.bound,
        unit=limit.unit,
        way_out=way_out(name, space.run, space.fixed),
    )


def no_feasible_choice(search: ChoiceSearch) -> NoFeasibleChoice:
    """The limit that stayed broken in the best of all choices, or why none has a periodic step."""
    space, tried, best = search.space, len(search.candidates), search.best()
    if best.orbit is not None:
        margins = best.margins()
        return broken_limit(min(margins, key=lambda name: margins[name]), best.values, space, tried)
    why = next((candidate.why for candidate in search.candidates if candidate.why is not None), None)
    return NoFeasibleChoice(
        f"{_NONE}: {why or 'the formula has no solution'}",
        broken="no_periodic_motion",
        tried=tried,
        values=best.values,
        reason="no_periodic_motion",
        value=0.0 if why is None else why.value,
        limit=0.0 if why is None else why.limit,
        unit="1" if why is None else why.unit,
        way_out=way_out("no_periodic_motion", space.run, space.fixed),
    )


def way_out(limit: str, run: RunParameters, fixed: Collection[str]) -> str:
    """Changes that would make a refused gait easier.

    Args:
        limit: name in :data:`ampm.body.limits.LIMITS`, or another.
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
        ways += [f"leave open what was set ({', '.join(named[:3])}{others})"]
    return ways[0] if len(ways) == 1 else f"{', '.join(ways[:-1])}, or {ways[-1]}"
