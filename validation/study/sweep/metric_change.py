"""One metric of two sweeps compared run by run: what is noise, what grew, whether all runs shifted.

Two runs of one revision on one machine have the same bits, so there is no scatter to estimate. What remains
between two revisions or machines that compute the same thing is rounding: perturbing the body's mass by 1e-15
to 1e-12 of itself moves every metric of `normal` and `momentum` that is not rounding itself by less than 1e-9
of its value. The default noise floor is a thousand times that. A convergence study gives a wider one: the
numerical uncertainty of every metric, below which a difference says more of the time step than of the gait.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import wilcoxon

from validation.study.sweep.table import METRIC, SweepTable

Array = NDArray[np.float64]
Rows = NDArray[np.int64]
Mask = NDArray[np.bool_]

Runs = tuple[SweepTable, Rows]
"""A sweep, and rows of it, shape (N,)."""

RELATIVE_FLOOR = 1e-6
"""Share of a metric's value below which a difference is rounding [1]."""
ABSOLUTE_FLOOR: Mapping[str, float] = {"m": 1e-11, "N": 1e-8, "N m s": 1e-10, "1": 1e-12}
"""The same in a metric's unit, for values near zero: ten times what rounding did to any metric."""
SIGNIFICANCE = 0.05
LEAST_PAIRS = 8
"""Pairs below which no shift over all runs is claimed: of 8, chance alone moves all one way in 1 of 128."""


@dataclass(frozen=True)
class MetricChange:
    """One metric of the N runs that both sweeps have; every array of shape (N,).

    Attributes:
        name: of the metric.
        unit: SI unit of all values.
        before, after: values in the first and in the second sweep.
        completed: whether the run completed in both, with a finite value in the first sweep.
        noise: what a difference must exceed to be one; infinite if the study has no bound.
        noise_from: ``floating point`` or ``convergence study``.
        allowed: growth that is no regression; NaN without a limit.
        over_a, over_b: whether it is over its limit.
    """

    name: str
    unit: str
    before: Array
    after: Array
    completed: Mask
    noise: Array
    noise_from: str
    allowed: Array
    over_a: Mask
    over_b: Mask

    @property
    def both(self) -> Mask:
        """Runs with a finite value in both sweeps."""
        return self.completed & np.isfinite(self.after)

    @property
    def growth(self) -> Array:
        """Second minus first; zero where there is no value in both, infinite where the second lacks one."""
        lost = np.where(self.completed, np.inf, 0.0)
        return np.where(self.both, self.after - self.before, lost)

    @property
    def worse(self) -> Mask:
        """Runs that grew by more than the noise, or lost their value."""
        return self.growth > np.where(self.both, self.noise, 0.0)

    @property
    def better(self) -> Mask:
        """Runs that fell by more than the noise."""
        return -self.growth > self.noise

    @property
    def regressed(self) -> Mask:
        """Runs that got worse by more than the tolerance, too, or lost their value."""
        return self.worse & (self.growth > np.where(self.both, np.nan_to_num(self.allowed, nan=np.inf), 0.0))

    def median(self, values: Array) -> float:
        """Median over the runs with a value in both sweeps."""
        return float(np.median(values[self.both])) if self.both.any() else math.nan

    @property
    def p_value(self) -> float:
        """Probability of the differences by chance (Wilcoxon's signed-rank test); NaN with too few runs.

        Differences within the noise count as none.
        """
        growth = np.where(self.worse | self.better, self.growth, 0.0)[self.both]
        if len(growth) < LEAST_PAIRS:
            return math.nan
        return float(wilcoxon(growth, zero_method="zsplit").pvalue) if growth.any() else 1.0

    def verdict(self, p: float) -> str:
        """Judgement of the shift over all runs: ``better``, ``worse``, ``same``, or ``too few`` runs.

        Args:
            p: of :attr:`p_value`, corrected for the number of metrics.
        """
        shift = self.median(self.growth)
        if p < SIGNIFICANCE and abs(shift) > self.median(self.noise):
            return "worse" if shift > 0.0 else "better"
        return "too few" if math.isnan(p) else "same"

    @classmethod
    def of(cls, name: str, a: Runs, b: Runs, share: float, bound: float | None) -> MetricChange:
        """Compare a metric.

        Args:
            name: of the metric.
            a: first sweep and the rows to compare.
            b: second sweep, likewise.
            share: of its limit by which it may grow.
            bound: numerical uncertainty, None without a study of it.
        """
        (first, rows_a), (second, rows_b) = a, b
        unit = first.unit(METRIC + name)
        before, after = first.numbers(METRIC + name)[rows_a], second.numbers(METRIC + name)[rows_b]
        rounding = RELATIVE_FLOOR * np.fmax(np.abs(before), np.abs(after))
        limit = second.limit_values(name)[rows_b]
        limit = np.where(np.isnan(limit), first.limit_values(name)[rows_a], limit)
        over_a, over_b = (np.nan_to_num(sweep.used(name)[rows]) > 1.0 for sweep, rows in (a, b))
        return cls(
            name=name,
            unit=unit,
            before=before,
            after=after,
            completed=first.measured[rows_a] & second.measured[rows_b] & np.isfinite(before),
            noise=np.maximum(np.maximum(rounding, ABSOLUTE_FLOOR.get(unit, 0.0)), bound or 0.0),
            noise_from="floating point" if bound is None else "convergence study",
            allowed=share * limit,
            over_a=over_a,
            over_b=over_b,
        )
