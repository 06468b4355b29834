"""Which parameter drives which error, from the runs that a sweep happens to have.

Two numbers per parameter and figure, both defined for any sample (grid, Latin hypercube, list), no special
design needed:

- Spearman's rank correlation rho, -1 ... 1: does the figure grow or fall with the parameter, evenly or not
  at all? Its interval comes from a bootstrap over the runs.
- The first-order Sobol index S1 = Var(E[Y | X]) / Var(Y), 0 ... 1: the share of the figure's variance that
  this parameter explains alone, in any shape, also a parabola that rho does not see. It is estimated from
  given data by equally filled classes of the parameter (Plischke, Borgonovo and Smith, European Journal of
  Operational Research 226 (2013) 536-550), corrected for the bias of finite classes (Kelley's epsilon
  squared), which allows for more and finer ones. What all S1 leave of 1 is interaction, and what varies
  within a class.

Chance gives numbers, too. The figure's values are shuffled over the runs many times, and the largest S1 and
rho over *all* parameters are kept; a parameter counts only above the 99 % quantile of these.

SALib's given-data estimators were tried and left: they reseed numpy's global generator and change the
interpreter's warning filters, and PAWN drops a grid's highest level.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata

Array = NDArray[np.float64]
Labels = NDArray[np.int64]

LEAST_RUNS = 30
"""Runs below which nothing is said: of 30, chance makes a rank correlation of 0.46 once in a hundred."""
LEAST_EVENTS = 5
"""Runs that must differ from the most frequent value: of fewer falls, any parameter seems to be the cause."""
MOST_RUNS = 2000
"""Runs from which all is computed; of more, a random draw: intervals are then a few hundredths wide."""
LEVELS = 12
"""Distinct values up to which a parameter's values are its classes."""
PER_CLASS = 12
"""Runs to a class of a parameter with more values than that: enough for a mean, fine enough for a wave."""
MOST_CLASSES = 40
RESAMPLES = 300
SHUFFLES = 400
CONFIDENCE = 1.959964
"""Standard deviations of a two-sided interval of 95 %."""
SIGNIFICANCE = 0.99


@dataclass(frozen=True)
class Influence:
    """What one parameter does to one figure.

    Attributes:
        parameter: its key.
        rho: Spearman's rank correlation [1]; NaN for a parameter that has no order, or does not vary.
        rho_interval: 95 % interval of it.
        share: first-order Sobol index S1 [1]; NaN if the parameter does not vary among these runs.
        share_interval: 95 % interval of it.
        clear_rho: whether the rank correlation is beyond what chance gives.
        clear_share: the same of the Sobol index.
    """

    parameter: str
    rho: float
    rho_interval: tuple[float, float]
    share: float
    share_interval: tuple[float, float]
    clear_rho: bool
    clear_share: bool

    @property
    def clear(self) -> bool:
        """Whether either is beyond what chance gives."""
        return self.clear_rho or self.clear_share


@dataclass(frozen=True)
class Sensitivity:
    """What drives one figure.

    Attributes:
        target: name of the figure.
        runs: from how many runs.
        drawn_from: how many there were; more than ``runs`` if a random draw was taken.
        influences: one per parameter, in the order given; empty if nothing can be said.
        noise: S1 that chance alone exceeds once in a hundred, over all parameters together [1].
        silent: why nothing is said, empty otherwise.
    """

    target: str
    runs: int
    drawn_from: int
    influences: tuple[Influence, ...]
    noise: float
    silent: str = ""

    @property
    def drivers(self) -> tuple[Influence, ...]:
        """The parameters beyond chance, strongest first."""
        clear = [item for item in self.influences if item.clear]
        return tuple(sorted(clear, key=lambda item: -strength(item)))


def strength(item: Influence) -> float:
    """What parameters are ordered by: the larger of S1 and rho squared [1]; both are shares of variance."""
    known = [value for value in (item.share, item.rho**2) if not math.isnan(value)]
    return max(known, default=0.0)


def analyse(
    parameters: Mapping[str, Sequence[object] | NDArray[np.generic]],
    target: str,
    values: Array,
    *,
    seed: int = 1,
) -> Sensitivity:
    """Say what drives a figure.

    Args:
        parameters: values by key, each of length N: numbers, or words (a parameter without order).
        target: name of the figure.
        values: shape (N,); NaN where the run has none.
        seed: of draw, bootstrap and shuffles.
    """
    rows = np.flatnonzero(np.isfinite(values))
    found = len(rows)
    if found < LEAST_RUNS:
        return Sensitivity(
            target, found, found, (), math.nan, f"{found} runs are too few; {LEAST_RUNS} needed"
        )
    rng = np.random.default_rng(seed)
    if found > MOST_RUNS:
        rows = np.sort(rng.choice(rows, MOST_RUNS, replace=False))
    y = np.asarray(values, dtype=float)[rows]
    if np.ptp(y) <= 1e-12 * np.abs(y).max():
        return Sensitivity(target, len(rows), found, (), math.nan, "it does not vary")
    _, repeats = np.unique(y, return_counts=True)
    others = len(y) - int(repeats.max())
    if others < LEAST_EVENTS:
        text = f"all but {others} of {len(y)} runs agree, which is too few to say why"
        return Sensitivity(target, len(rows), found, (), math.nan, text)
    names = list(parameters)
    columns = [_column(parameters[name], rows) for name in names]
    counts = rng.multinomial(len(y), np.full(len(y), 1.0 / len(y)), RESAMPLES).astype(float)
    shuffled = np.stack([rng.permutation(len(y)) for _ in range(SHUFFLES)])
    y = (y - y.mean()) / y.std()
    y_rank = _standard(rankdata(y))
    shares, ranks = [], []
    chance_share = np.full(SHUFFLES, -np.inf)
    chance_rho = np.zeros(SHUFFLES)
    for ordered, column in columns:
        label = classes(column)
        if label.max() == 0:
            shares.append((math.nan, (math.nan, math.nan)))
            ranks.append((math.nan, (math.nan, math.nan)))
            continue
        share = float(_share(label, y, np.ones((1, len(y))))[0])
        error = CONFIDENCE * float(np.std(_share(label, y, counts)))
        shares.append((max(share, 0.0), (max(share - error, 0.0), min(share + error, 1.0))))
        chance_share = np.maximum(chance_share, _shuffled_share(label, y, shuffled))
        if not ordered:
            ranks.append((math.nan, (math.nan, math.nan)))
            continue
        x_rank = _standard(rankdata(column))
        rho = float(x_rank @ y_rank) / len(y)
        low, high = np.quantile(_weighted_correlation(x_rank, y_rank, counts), (0.025, 0.975))
        ranks.append((rho, (float(low), float(high))))
        chance_rho = np.maximum(chance_rho, np.abs(y_rank[shuffled] @ x_rank) / len(y))
    noise = max(float(np.quantile(chance_share, SIGNIFICANCE)), 0.0)
    noise_rho = float(np.quantile(chance_rho, SIGNIFICANCE))
    influences = tuple(
        Influence(
            name, rho, rho_interval, share, share_interval, bool(abs(rho) > noise_rho), bool(share > noise)
        )
        for name, (share, share_interval), (rho, rho_interval) in zip(names, shares, ranks, strict=True)
    )
    return Sensitivity(target, len(rows), found, influences, noise)


def entangled(
    parameters: Mapping[str, Sequence[object] | NDArray[np.generic]], limit: float = 0.5
) -> list[tuple[str, str, float]]:
    """Pairs of parameters that vary together, whose effects a sweep therefore cannot tell apart.

    Args:
        parameters: values by key, each of length N.
        limit: of the magnitude of the rank correlation [1].

    Returns:
        Both keys and their rank correlation, strongest first.
    """
    ranks = {}
    for name, values in parameters.items():
        ordered, column = _column(values, None)
        if ordered and len(np.unique(column)) > 1:
            ranks[name] = _standard(rankdata(column))
    names = list(ranks)
    pairs = [
        (a, b, float(ranks[a] @ ranks[b]) / len(ranks[a]))
        for i, a in enumerate(names)
        for b in names[i + 1 :]
    ]
    return sorted((pair for pair in pairs if abs(pair[2]) > limit), key=lambda pair: -abs(pair[2]))


def classes(column: Array) -> Labels:
    """Class of every run by a parameter: its values if few, else equally filled intervals, equal values kept
    together.

    Args:
        column: shape (N,).

    Returns:
        Shape (N,), from 0 without gaps.
    """
    distinct, label = np.unique(column, return_inverse=True)
    if len(distinct) <= LEVELS:
        return label.astype(np.int64)
    number = min(max(len(column) // PER_CLASS, 3), MOST_CLASSES)
    edges = np.quantile(column, np.linspace(0.0, 1.0, number + 1)[1:-1])
    return np.unique(np.searchsorted(edges, column, side="right"), return_inverse=True)[1].astype(np.int64)


def _column(values: Sequence[object] | NDArray[np.generic], rows: Labels | None) -> tuple[bool, Array]:
    """Whether the values have an order, and numbers that stand for them."""
    array = np.asarray(values)
    if rows is not None:
        array = array[rows]
    if array.dtype.kind in "biuf":
        column = array.astype(float)
        return True, np.where(np.isnan(column), -np.inf, column)  # an absent value is a class of its own
    return False, np.unique(array.astype(str), return_inverse=True)[1].astype(float)


def _standard(values: Array) -> Array:
    spread = values.std()
    return (values - values.mean()) / (spread if spread > 0.0 else 1.0)


def _share(label: Labels, y: Array, counts: Array) -> Array:
    """Epsilon squared of the classes in every resample, shape (R,); ``counts`` has shape (R, N)."""
    member = np.zeros((len(y), int(label.max()) + 1))
    member[np.arange(len(y)), label] = 1.0
    kinds = member.shape[1]
    sums = counts @ np.column_stack([member, member * y[:, None], y * y])
    size, total, square = sums[:, :kinds], sums[:, kinds:-1], sums[:, -1]
    n = size.sum(axis=1)
    between = np.where(size > 0, total**2 / np.maximum(size, 1.0), 0.0).sum(axis=1)
    within = square - between
    spread = square - total.sum(axis=1) ** 2 / n
    used = (size > 0).sum(axis=1)
    varies = spread > 1e-9 * n  # a resample may happen to hold equal values only
    ratio = (within / np.maximum(n - used, 1.0)) / np.where(varies, spread / (n - 1.0), 1.0)
    return np.where(varies, 1.0 - ratio, 0.0)


def _shuffled_share(label: Labels, y: Array, shuffled: Labels) -> Array:
    """The same with ``y`` shuffled, shape (S,); ``shuffled`` has shape (S, N)."""
    member = np.zeros((len(y), int(label.max()) + 1))
    member[np.arange(len(y)), label] = 1.0
    n, used = len(y), member.shape[1]
    between = ((y[shuffled] @ member) ** 2 / member.sum(axis=0)).sum(axis=1)
    spread = float(y @ y) - float(y.sum()) ** 2 / n
    return 1.0 - ((float(y @ y) - between) / max(n - used, 1)) / (spread / (n - 1))


def _weighted_correlation(x: Array, y: Array, counts: Array) -> Array:
    """Correlation of ranks in every resample, shape (R,)."""
    sums = counts @ np.column_stack([np.ones_like(x), x, y, x * y, x * x, y * y])
    mean_x, mean_y, mean_xy, mean_xx, mean_yy = (sums[:, 1:] / sums[:, :1]).T
    covariance = mean_xy - mean_x * mean_y
    variance = (mean_xx - mean_x**2) * (mean_yy - mean_y**2)
    return covariance / np.sqrt(np.maximum(variance, 1e-300))
