"""Influence of parameters on metrics, by rank statistics for grids, random samples and lists.

- Spearman's rho, -1 ... 1: whether the metric grows or falls with the parameter.
- Kruskal and Wallis' epsilon squared, 0 ... 1: share of the variance of the ranks that classes of the
  parameter explain, of any shape, for example a parabola, for which rho is zero. The rest to 1 is
  interaction, and scatter within a class.

The p-values of a sweep are corrected together for their number (Benjamini and Hochberg); an influence counts
at 1 %. SALib is not used: it reseeds numpy's global generator and changes the warning filters.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import false_discovery_control, kruskal, spearmanr

from ampm.geometry import Array

Parameters = Mapping[str, NDArray[Any]]
"""Values by key, each of shape (N,): numbers, or words (a parameter without order)."""

LEAST_RUNS = 30
"""Runs below which no influence is computed."""
LEAST_EVENTS = 5
"""Least number of runs that differ from the most frequent value: with fewer falls, any parameter may seem to
be the cause."""
MOST_RUNS = 5000
"""Largest number of runs that are used; of more, a random sample."""
LEVELS = 12
"""Distinct values up to which a parameter's values are its classes."""
PER_CLASS, MOST_CLASSES = 12, 20
"""Runs to a class of a parameter with more values than that, and most classes."""
SIGNIFICANCE = 0.01
ENTANGLED = 0.5
"""Magnitude of the rank correlation of two parameters above which they vary together [1]."""
_SEED = 1


@dataclass(frozen=True)
class Influence:
    """Influence of one parameter on one metric.

    Attributes:
        parameter: its key.
        rho: Spearman's rank correlation [1]; NaN for a parameter that has no order, or does not vary.
        share: epsilon squared [1]; NaN if the parameter does not vary among these runs.
        p_rho, p_share: p-values, corrected for all pairs of the sweep.
    """

    parameter: str
    rho: float = math.nan
    share: float = math.nan
    p_rho: float = math.nan
    p_share: float = math.nan

    @property
    def clear(self) -> bool:
        """Whether either is significant."""
        return self.p_rho < SIGNIFICANCE or self.p_share < SIGNIFICANCE

    @property
    def strength(self) -> float:
        """Larger of the shares of variance, epsilon squared and rho squared [1]."""
        return max((v for v in (self.share, self.rho**2) if not math.isnan(v)), default=0.0)


@dataclass(frozen=True)
class Target:
    """Influences on one metric.

    Attributes:
        name: of the metric.
        runs: number of runs.
        influences: one per parameter, in the order given; empty if none can be computed.
        reason: why there are none, empty otherwise.
    """

    name: str
    runs: int
    influences: tuple[Influence, ...] = ()
    reason: str = ""

    @property
    def drivers(self) -> tuple[Influence, ...]:
        """Parameters with a significant influence, strongest first."""
        return tuple(sorted((i for i in self.influences if i.clear), key=lambda item: -item.strength))


def analyse(parameters: Parameters, targets: Mapping[str, Array]) -> list[Target]:
    """Influences on each of several metrics.

    Args:
        parameters: of N runs.
        targets: values by name of the metric, each of shape (N,); NaN where the run has none.
    """
    found = [_target(parameters, name, values) for name, values in targets.items()]
    p = np.array([value for item in found for i in item.influences for value in (i.p_rho, i.p_share)])
    known = ~np.isnan(p)
    if known.any():
        p[known] = false_discovery_control(p[known])
    corrected = iter(p.tolist())

    def correct(item: Influence) -> Influence:
        return replace(item, p_rho=next(corrected), p_share=next(corrected))

    return [replace(item, influences=tuple(map(correct, item.influences))) for item in found]


def _target(parameters: Parameters, name: str, values: Array) -> Target:
    rows = np.flatnonzero(np.isfinite(values))
    if len(rows) < LEAST_RUNS:
        return Target(name, len(rows), reason=f"{len(rows)} runs are too few; {LEAST_RUNS} needed")
    if len(rows) > MOST_RUNS:
        rows = np.sort(np.random.default_rng(_SEED).choice(rows, MOST_RUNS, replace=False))
    y = values[rows]
    others = len(y) - int(np.unique(y, return_counts=True)[1].max())
    reason = f"all but {others} of {len(y)} runs agree, too few to say why" if others < LEAST_EVENTS else ""
    if np.ptp(y) <= 1e-12 * np.abs(y).max():
        reason = "it does not vary"
    influences = () if reason else tuple(_influence(key, x[rows], y) for key, x in parameters.items())
    return Target(name, len(y), influences, reason)


def _influence(key: str, values: NDArray[Any], y: Array) -> Influence:
    ordered, x = _numbers(values)
    label = classes(x)
    groups = [y[label == number] for number in range(label.max() + 1)]
    if len(groups) == 1:
        return Influence(key)
    statistic, p_share = kruskal(*groups)
    share = np.clip((statistic - len(groups) + 1) / (len(y) - len(groups)), 0.0, 1.0)
    rho, p_rho = spearmanr(x, y) if ordered else (math.nan, math.nan)
    return Influence(key, float(rho), float(share), float(p_rho), float(p_share))


def correlated(parameters: Parameters) -> list[tuple[str, str, float]]:
    """Pairs of parameters that vary together, whose effects a sweep therefore cannot separate.

    Returns:
        Both keys and their rank correlation, strongest first.
    """
    columns = {name: _numbers(values) for name, values in parameters.items()}
    numbers = {name: x for name, (ordered, x) in columns.items() if ordered and len(np.unique(x)) > 1}
    pairs = [
        (a, b, float(spearmanr(numbers[a], numbers[b]).statistic))
        for a, b in itertools.combinations(numbers, 2)
    ]
    return sorted((pair for pair in pairs if abs(pair[2]) > ENTANGLED), key=lambda pair: -abs(pair[2]))


def classes(column: Array) -> NDArray[np.int64]:
    """Class of every run by a parameter, shape (N,), from 0: its values if few, else intervals.

    The intervals are equally filled; equal values are kept together.
    """
    distinct, label = np.unique(column, return_inverse=True)
    if len(distinct) <= LEVELS:
        return label
    number = min(max(len(column) // PER_CLASS, 3), MOST_CLASSES)
    edges = np.quantile(column, np.linspace(0.0, 1.0, number + 1)[1:-1])
    return np.unique(np.searchsorted(edges, column, side="right"), return_inverse=True)[1]


def _numbers(values: NDArray[Any]) -> tuple[bool, Array]:
    """Whether the values have an order, and numbers that stand for them."""
    if values.dtype.kind in "biuf":
        column = values.astype(float)
        return True, np.where(np.isnan(column), -np.inf, column)  # an absent value is a class of its own
    return False, np.unique(values.astype(str), return_inverse=True)[1].astype(float)
