"""Result of a convergence study: order, extrapolated value and uncertainty of every metric; verdict.

A level is a step of a grid or a tolerance; from one to the next it shrinks by a constant ratio.
``docs/uncertainty.md`` has the formulas and their sources.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from validation.judge.metrics import METRICS
from validation.judge.profiles import Profile
from validation.judge.uncertainty import Uncertainty
from validation.judge.verdict import MetricResult, Verdict, judge
from validation.store.environment import describe_environment, parameter_values
from validation.study.row_file import Row
from validation.table import Table, Tabled, format_number, short_unit
from validation.trial.plan import Request

CONFIRMED, UNCONFIRMED = 1.25, 3.0
"""Roache's factors of safety: with the order observed twice, and without, where it is taken to be 1."""
_ORDERS = (0.5, 2.5)  # range observed with a method of first or second order; others are accidental
AGREEMENT = 0.25
"""Largest difference of the orders of two triplets that confirm each other."""
_ROUNDING = 1e-12  # relative; smaller differences are rounding errors
OWN = "own"
"""Task of the walk at the gait's own values, which all studies share."""
_NEVER = ("count", "extreme")  # natures of metrics that are not extrapolated
_ALSO = ("energy_positive_work", "energy_negative_work", "energy_cost_of_transport")
"""Integrals that the table has beside what is judged."""
_NOTES = (
    "u_num is the sum over the studies of time step, grid and tolerance.",
    "Order and extrapolated value are those of the time step.",
    "spread: largest change by another contact law or engine.",
    "A value closer to its limit than u_num or the spread is undecided.",
)


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


def estimate(levels: Iterable[float], ratio: float, *, forbidden: bool = False) -> Estimate:
    """Classify a sequence and bound the error of its first value.

    The levels are three or more values of one metric, coarse to fine, NaN for a level without any; the ratio
    is that of neighbouring steps, above 1. A metric may be ``forbidden`` to be extrapolated.
    """
    values = [float(value) for value in levels]
    changes = [fine - coarse for coarse, fine in pairwise(values)]
    orders = tuple(  # negative where the changes grow, NaN unless a triplet is monotone
        math.log(first / second) / math.log(ratio) if first * second > 0.0 else math.nan
        for first, second in pairwise(changes)
    )
    if not all(map(math.isfinite, values)):
        unknown = math.nan if math.isnan(values[0]) else math.inf
        return Estimate("unknown", orders, unknown, unknown)
    spread = max(values) - min(values)
    if spread <= _ROUNDING * max(abs(value) for value in values):
        return Estimate("constant", orders, spread, spread)
    last, pair = abs(changes[-1]), orders[-2:]
    in_range = all(_ORDERS[0] <= order <= _ORDERS[1] for order in pair)  # false for NaN
    if forbidden or len(pair) < 2 or not in_range or abs(pair[0] - pair[1]) > AGREEMENT:
        # The larger of the last two changes, at first order: the last one may be accidentally small.
        beyond = UNCONFIRMED * max(last, abs(changes[-2]) / ratio) / (ratio - 1.0)
        return Estimate("no asymptotic range", orders, spread + beyond, beyond)
    order = orders[-1]
    beyond = last / (ratio ** min(order, 1.0) - 1.0)  # Roache: a higher order does not reduce it
    return Estimate(
        kind="asymptotic",
        orders=orders,
        uncertainty=CONFIRMED * (abs(values[0] - values[-1]) + beyond),
        finest=CONFIRMED * beyond,
        order=order,
        extrapolated=values[-1] + changes[-1] / (ratio**order - 1.0),
    )


@dataclass(frozen=True)
class Study:
    """Levels of one parameter."""

    name: str  # of the study
    key: str  # of the parameter
    # of the key in its unit, the gait's own one first; those of a numerical study fall
    values: tuple[Any, ...]
    ratio: float = 0.0  # of neighbouring levels of a numerical study, 0 of a contact law or the engine

    @property
    def tasks(self) -> tuple[str, ...]:
        """Task of each level."""
        return OWN, *(f"{self.key}={value}" for value in self.values[1:])


@dataclass(frozen=True)
class StudiedMetric:
    """One metric in all studies."""

    # study to the value at every level, the own one first [SI unit]; NaN where the walk did not complete
    levels: Mapping[str, tuple[float, ...]]
    estimates: Mapping[str, Estimate]  # numerical study to its estimate, that of the time step first
    # largest change by another contact law or engine, infinite if a walk with one did not complete
    spread: float


@dataclass(frozen=True)
class Convergence(Tabled):
    """All studies of one gait."""

    request: Request  # the gait, with the steps that were walked
    studies: tuple[Study, ...]  # in order
    walks: Mapping[str, Row]  # task of a level to its row, see `walk_level`
    uncertainty: Uncertainty  # numerical uncertainty by the studies
    studied: Mapping[str, StudiedMetric]  # metric to its levels and estimates
    verdict: Verdict  # pass only where every metric is further from its limit than its uncertainty

    @property
    def metrics(self) -> dict[str, MetricResult]:
        """Metrics by name, judged with their uncertainty; those with a tolerance first."""
        return {item.name: item for item in self.verdict.metrics}

    @property
    def completed(self) -> bool:
        """Whether every walk of the numerical studies completed."""
        tasks = [OWN, *(task for study in self.studies if study.ratio for task in study.tasks)]
        return all(self.walks[task]["outcome"] == "completed" for task in tasks)

    @property
    def notes(self) -> list[str]:
        """Walks that did not complete."""
        return [
            f"{task}: {row['outcome']}, {row['cause'].rstrip('.') or 'no cause given'}."
            for task, row in self.walks.items()
            if row["outcome"] != "completed"
        ]

    def as_dict(self) -> dict[str, Any]:
        """Contents of ``convergence.json``."""
        return {
            "profile": self.verdict.profile,
            "verdict": self.verdict.name,
            "reason": self.verdict.reason,
            "notes": self.notes,
            "uncertainty": self.uncertainty,
            "levels": {study.name: {"key": study.key, "values": study.values} for study in self.studies},
            "metrics": {
                name: {**item.as_dict(), **vars(self.studied[name])} for name, item in self.metrics.items()
            },
            "environment": describe_environment(),
        }

    def tables(self) -> list[Table]:
        """Value, uncertainty, limit, order and extrapolated value of what is judged, and of integrals."""
        run, verdict = self.request.run, self.verdict
        title = (
            f"Convergence of {self.request.name}: value ± numerical uncertainty, {run.gait.steps} steps a "
            f"level, control at {run.controller.frequency:g} Hz, profile {verdict.profile}"
        )
        numbers = (">value ± u_num", ">limit", "unit", "verdict", ">finest step", "observed order")
        columns = ("metric", *numbers, ">extrapolated", ">spread")
        rows = [
            self._row(item)
            for item in self.metrics.values()
            if item.tolerance is not None or item.name in _ALSO
        ]
        ended = f"{self.request.name}: {verdict.name.replace('_', ' ').upper()}  {verdict.reason}"
        return [Table(title, columns, rows, [*_NOTES, *self.notes, ended])]

    def _row(self, item: MetricResult) -> tuple[str, ...]:
        """Row of a metric."""

        def shown(value: float | None, digits: int = 3) -> str:
            return "" if value is None else format_number(value * item.factor, digits).replace("inf", "∞")

        studied = self.studied[item.name]
        step = studied.estimates["time_step"]
        order = step.kind if step.order is None else f"{step.order:.2f}"
        extrapolated = shown(step.extrapolated)
        if step.extrapolated is not None and abs(step.extrapolated) < step.finest:
            extrapolated = "0"  # a value below its own uncertainty has no significant digits
        return (
            item.label,
            item.quoted,
            shown(item.tolerance),
            short_unit(item.display_unit),
            "undecided" if item.undecided else {True: "pass", False: "FAIL", None: ""}[item.passed],
            shown(studied.levels["time_step"][-1]),
            "exact" if METRICS[item.name].nature == "count" else order,
            extrapolated,
            shown(studied.spread, 2),
        )


def combine(
    request: Request, profile: Profile, found: Sequence[Study], walks: Mapping[str, Row]
) -> Convergence:
    """Estimates of every metric from the rows of all levels, by task, and the verdict.

    The errors of time step, grids and tolerances are not random and may have one sign, so their bounds are
    added. Of the contact laws the one counts that changes a metric most.
    """
    own = walks[OWN]
    own_values = _values(own)
    studied = {name: _study_metric(name, found, walks) for name in own_values}
    known = Uncertainty(
        gait=request.name,
        steps=request.run.gait.steps,
        values={name: _sum_of(name, item.estimates) for name, item in studied.items()},
        spreads={name: item.spread for name, item in studied.items() if not METRICS[name].is_self_check},
        parameters=parameter_values(request.run),
    )
    ended = ""
    if own["outcome"] != "completed":
        ended = f"The walk at the gait's own parameters {own['outcome']}: {own['cause']}"
    verdict = judge(own_values, profile, own.get("scales", {}), known, ended=ended)
    return Convergence(request, tuple(found), walks, known, studied, verdict)


def _values(row: Row) -> dict[str, float]:
    """Metrics of a level, of which a stored row has infinity as a word, and NaN as null."""
    return {name: math.nan if v is None else float(v) for name, v in row.get("values", {}).items()}


def _sum_of(name: str, estimates: Mapping[str, Estimate]) -> float:
    """Numerical uncertainty of a metric in its SI unit: the sum over its studies, infinite without a bound.

    A count is exact. A self-check measures the error of the time step, and excludes that study.
    """
    metric = METRICS[name]
    if metric.nature == "count":
        return 0.0
    total = math.fsum(
        item.uncertainty
        for study, item in estimates.items()
        if not (metric.is_self_check and study == "time_step")
    )
    return math.inf if math.isnan(total) else total


def _study_metric(name: str, studies: Sequence[Study], walks: Mapping[str, Row]) -> StudiedMetric:
    """Levels and estimates of one metric."""
    levels: dict[str, tuple[float, ...]] = {}
    estimates: dict[str, Estimate] = {}
    changes = [0.0]
    for study in studies:
        rows = [walks[task] for task in study.tasks]
        known = [_values(row) if row["outcome"] == "completed" else {} for row in rows]
        levels[study.name] = values = tuple(found.get(name, math.nan) for found in known)
        if study.ratio:
            is_never = METRICS[name].nature in _NEVER
            estimates[study.name] = estimate(values, study.ratio, forbidden=is_never)
        else:
            changes.append(float(np.abs(np.subtract(values, values[0])).max()))
    spread = max(math.inf if math.isnan(change) else change for change in changes)
    return StudiedMetric(levels, estimates, spread)
