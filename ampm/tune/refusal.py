"""Refusal of a gait that no choice makes walkable: the limit that stayed broken, and the best value."""

from collections.abc import Mapping
from typing import Any

from ampm.body.limits import LIMITS
from ampm.exceptions import BodilyRefusal
from ampm.tune.search import ChoiceSearch


class NoFeasibleChoice(BodilyRefusal):
    """No choice was found; value and limit are those of the best that was tried.

    Attributes:
        tried: how many choices had been tried.
        values: of all limits for the best choice, by name in :data:`LIMITS`.
    """

    def __init__(self, why: str, *, tried: int, values: Mapping[str, float], **refusal: Any) -> None:
        super().__init__(why, **refusal)
        self.tried, self.values = tried, values


def broken_limit(name: str, values: Mapping[str, float], tried: int) -> NoFeasibleChoice:
    """The refusal by one limit.

    Args:
        name: in :data:`LIMITS`.
        values: of all known limits for the best choice.
        tried: number of choices; 1 where the best choice of all is known.
    """
    limit, value = LIMITS[name], values[name]
    reached, rule = limit.told(value)
    return NoFeasibleChoice(
        f"{_none(tried)}: {limit.what} is {reached} at best and must be {rule}",
        tried=tried,
        values=values,
        reason=limit.reason,
        value=value,
        limit=limit.bound,
        unit=limit.unit,
    )


def no_feasible_choice(search: ChoiceSearch, tried: int) -> NoFeasibleChoice:
    """The limit that stayed broken in the best of all choices, or why none has a periodic step."""
    best = search.best()
    if best.orbit is not None:
        margins = best.margins()
        return broken_limit(min(margins, key=lambda name: margins[name]), best.values, tried)
    why = next((candidate.why for candidate in search.candidates if candidate.why is not None), None)
    return NoFeasibleChoice(
        f"{_none(tried)}: {why or 'the formula has no solution'}",
        tried=tried,
        values=best.values,
        reason="no_periodic_motion",
        value=0.0 if why is None else why.value,
        limit=0.0 if why is None else why.limit,
        unit="1" if why is None else why.unit,
    )


def _none(tried: int) -> str:
    """What was found of so many choices that were tried, in words."""
    none = "no choice" if tried == 1 else f"none of {tried} choices"
    return f"{none} of timing, heights and angles lets this body walk the gait"
