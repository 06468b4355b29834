"""Observed order of accuracy and numerical uncertainty of one metric on a sequence of levels.

A level is a step of a grid or a tolerance; from one to the next it shrinks by a constant ratio ``r``. With
the last three levels h3 > h2 > h1 = h3 / r^2 and a metric ``f = f_exact + C h^p``,

    p = ln[(f3 - f2) / (f2 - f1)] / ln r                  observed order of accuracy
    f_exact ~ f1 + (f1 - f2) / (r^p - 1)                  Richardson extrapolation

which is valid in the asymptotic range only, where every triplet of levels has the same p. This needs four
levels: two triplets, each of which converges monotonically, whose orders agree. Then the uncertainty is
Roache's grid convergence index with his factor of safety for a confirmed order, 1.25; otherwise nothing is
extrapolated, and the uncertainty is the spread over all levels, plus the possible error of formal order
beyond the last one times his factor for an unconfirmed order, 3.

Sources: P. J. Roache, Verification of codes and calculations, AIAA Journal 36 (1998); ASME V&V 20-2009,
section 2; L. Eca and M. Hoekstra, A procedure for the estimation of the numerical uncertainty of CFD
calculations based on grid refinement studies, Journal of Computational Physics 262 (2014): the spread of the
data where they do not follow a power of the step.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum

FORMAL_ORDER = 1.0
"""Order of the semi-implicit Euler step, and of a grid across a switch of contact."""
CONFIRMED, UNCONFIRMED = 1.25, 3.0
"""Roache's factors of safety: with the order observed twice, and without."""
ORDERS = (0.5, 2.5)
"""Range of orders observed with a method of first or second order; others are accidental."""
AGREEMENT = 0.25
"""Largest difference of the orders of two triplets that confirm each other."""
_ROUNDING = 1e-12  # relative; smaller differences are rounding errors


class Kind(StrEnum):
    """Behaviour of a sequence of values."""

    ASYMPTOTIC = "asymptotic"
    NO_RANGE = "no asymptotic range"
    CONSTANT = "constant"
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class Estimate:
    """Order and uncertainty of one metric by a sequence of levels, in the metric's unit."""

    # asymptotic; no asymptotic range; constant, where the levels differ by rounding alone; unknown, where a
    # level has no value
    kind: Kind
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
        return Estimate(Kind.UNKNOWN, orders, unknown, unknown)
    spread = max(values) - min(values)
    if spread <= _ROUNDING * max(abs(value) for value in values):
        return Estimate(Kind.CONSTANT, orders, spread, spread)
    last, pair = abs(values[-1] - values[-2]), orders[-2:]
    in_range = all(ORDERS[0] <= order <= ORDERS[1] for order in pair)  # false for NaN
    if forbidden or len(pair) < 2 or not in_range or abs(pair[0] - pair[1]) > AGREEMENT:
        # The larger of the last two changes, at formal order: the last one may be accidentally small.
        before = abs(values[-2] - values[-3]) / ratio**FORMAL_ORDER
        beyond = UNCONFIRMED * max(last, before) / (ratio**FORMAL_ORDER - 1.0)
        return Estimate(Kind.NO_RANGE, orders, spread + beyond, beyond)
    order = orders[-1]
    # Roache: an observed order above the formal one does not reduce the uncertainty.
    beyond = last / (ratio ** min(order, FORMAL_ORDER) - 1.0)
    return Estimate(
        kind=Kind.ASYMPTOTIC,
        orders=orders,
        uncertainty=CONFIRMED * (abs(values[0] - values[-1]) + beyond),
        finest=CONFIRMED * beyond,
        order=order,
        extrapolated=values[-1] + (values[-1] - values[-2]) / (ratio**order - 1.0),
    )
