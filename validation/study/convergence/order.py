"""Observed order of accuracy and numerical uncertainty of one metric on a sequence of levels.

A level is a step of a grid or a tolerance; from one to the next it shrinks by a constant ratio.
``docs/uncertainty.md`` has the formulas and their sources.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

CONFIRMED, UNCONFIRMED = 1.25, 3.0
"""Roache's factors of safety: with the order observed twice, and without, where it is taken to be 1."""
ORDERS = (0.5, 2.5)
"""Range of orders observed with a method of first or second order; others are accidental."""
AGREEMENT = 0.25
"""Largest difference of the orders of two triplets that confirm each other."""
_ROUNDING = 1e-12  # relative; smaller differences are rounding errors


@dataclass(frozen=True)
class Estimate:
    """Order and uncertainty of one metric by a sequence of levels, in the metric's unit."""

    # asymptotic; no asymptotic range; constant, where the levels differ by rounding alone; unknown, where a
    # level has no value
    kind: str
    # observed order of every triplet of neighbouring levels, coarse to fine; NaN where the values do not
    # converge monotonically
    orders: tuple[float, ...]
    # expanded numerical uncertainty of the first level's value, about 95 %: the limit of vanishing steps is
    # taken to be within value ± uncertainty; infinite if a level has no value, NaN if the first one has none
    uncertainty: float
    finest: float  # uncertainty of the last level's value
    order: float | None = None  # that of the finest triplet, None outside the asymptotic range
    extrapolated: float | None = None  # value at step zero, None outside the asymptotic range


def observed_orders(values: Sequence[float], ratio: float) -> tuple[float, ...]:
    """Order of every triplet of neighbouring values, coarse to fine, at a ratio of their steps above 1.

    It is NaN unless a triplet is monotone, and negative where the differences grow.
    """
    orders = []
    for coarse, middle, fine in zip(values, values[1:], values[2:], strict=False):
        first, second = middle - coarse, fine - middle
        monotone = first * second > 0.0  # false for NaN, too
        orders.append(math.log(first / second) / math.log(ratio) if monotone else math.nan)
    return tuple(orders)


def estimate(levels: Iterable[float], ratio: float, *, forbidden: bool = False) -> Estimate:
    """Classify a sequence and bound the error of its first value.

    The levels are three or more values of one metric, coarse to fine, NaN for a level without any; the ratio
    is that of neighbouring steps, above 1. A metric may be ``forbidden`` to be extrapolated.
    """
    values = [float(value) for value in levels]
    orders = observed_orders(values, ratio)
    if not all(map(math.isfinite, values)):
        unknown = math.nan if math.isnan(values[0]) else math.inf
        return Estimate("unknown", orders, unknown, unknown)
    spread = max(values) - min(values)
    if spread <= _ROUNDING * max(abs(value) for value in values):
        return Estimate("constant", orders, spread, spread)
    last, pair = abs(values[-1] - values[-2]), orders[-2:]
    in_range = all(ORDERS[0] <= order <= ORDERS[1] for order in pair)  # false for NaN
    if forbidden or len(pair) < 2 or not in_range or abs(pair[0] - pair[1]) > AGREEMENT:
        # The larger of the last two changes, at first order: the last one may be accidentally small.
        beyond = UNCONFIRMED * max(last, abs(values[-2] - values[-3]) / ratio) / (ratio - 1.0)
        return Estimate("no asymptotic range", orders, spread + beyond, beyond)
    order = orders[-1]
    beyond = last / (ratio ** min(order, 1.0) - 1.0)  # Roache: a higher order does not reduce it
    return Estimate(
        kind="asymptotic",
        orders=orders,
        uncertainty=CONFIRMED * (abs(values[0] - values[-1]) + beyond),
        finest=CONFIRMED * beyond,
        order=order,
        extrapolated=values[-1] + (values[-1] - values[-2]) / (ratio**order - 1.0),
    )
