"""Result of a convergence study: order, extrapolated value and uncertainty of every metric; verdict."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ampm.brief import Brief
from validation.judge.metrics import METRICS, MetricValue
from validation.judge.profiles import Profile
from validation.judge.uncertainty import Uncertainty
from validation.judge.verdict import MetricResult, Verdict, judge
from validation.store.environment import describe_environment
from validation.store.identity import parameter_values, run_key
from validation.study.convergence.levels import OWN, STUDIES, Study
from validation.study.convergence.order import Estimate, estimate, spread
from validation.study.row_file import Row
from validation.table import Table, Tabled, format_number, short_unit
from validation.trial.plan import Request

_NEVER = {"count": "a count", "extreme": "an extreme, never extrapolated"}
_ALSO = ("energy_positive_work", "energy_negative_work", "energy_cost_of_transport")
"""Integrals that the short table has beside what is judged."""
_NOTES = (
    "u_num is the sum over the studies of time step, grid and tolerance; ≥ where one was not made.",
    "spread: largest change by another contact law or engine.",
    "A value closer to its limit than u_num or the spread is undecided.",
)


@dataclass(frozen=True)
class StudiedMetric:
    """One metric in all studies.

    Attributes:
        levels: study to the value at every level [SI unit], NaN where the walk did not complete.
        estimates: numerical study to its estimate, that of the time step first.
        spreads: study of the contact law to the largest change within it.
    """

    levels: Mapping[str, tuple[float, ...]]
    estimates: Mapping[str, Estimate]
    spreads: Mapping[str, float]

    @property
    def spread(self) -> float | None:
        """The largest of ``spreads``; None without such a study."""
        return max(self.spreads.values(), default=None)


@dataclass(frozen=True)
class Convergence(Brief, Tabled):
    """All studies of one gait.

    Attributes:
        request: the gait, with the steps that were walked.
        studies: in order.
        walks: task of a level to its row, see :func:`validation.study.convergence.levels.walk_level`.
        uncertainty: numerical uncertainty by the studies.
        studied: metric to its levels and estimates.
        verdict: pass only where every metric is further from its limit than its uncertainty.
    """

    request: Request
    studies: tuple[Study, ...]
    walks: Mapping[str, Row]
    uncertainty: Uncertainty
    studied: Mapping[str, StudiedMetric]
    verdict: Verdict

    @property
    def metrics(self) -> dict[str, MetricResult]:
        """Metrics by name, judged with their uncertainty; those with a tolerance first."""
        return {item.name: item for item in self.verdict.metrics}

    @property
    def completed(self) -> bool:
        """Whether every walk of the numerical studies completed."""
        needed = {task for study in self.studies if study.numerical for task in study.tasks}
        return all(self.walks[task]["outcome"] == "completed" for task in needed | {OWN})

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
        known = self.uncertainty
        metrics = {
            name: {
                **item.as_dict(),
                "not_studied": item.not_studied,
                "uncertainty_at_least": item.uncertainty,
                **vars(self.studied[name]),
            }
            for name, item in self.metrics.items()
        }
        return {
            **known.as_dict(),
            "profile": self.verdict.profile,
            "verdict": self.verdict.name,
            "reason": self.verdict.reason,
            "notes": self.notes,
            "levels": {study.name: {**vars(study), "tasks": study.tasks} for study in self.studies},
            "metrics": metrics,
            "parameters": known.parameters,
            "environment": describe_environment(),
        }

    def tables(self) -> list[Table]:
        """The one table."""
        return [self.table()]

    def table(self, names: Sequence[str] = ()) -> Table:
        """Value, uncertainty, limit, order and extrapolated value.

        Args:
            names: of metrics; by default all that are judged, and the integrals.
        """
        judged = [name for name, item in self.metrics.items() if item.tolerance is not None or name in _ALSO]
        run, verdict = self.request.run, self.verdict
        finest = [study.shown[-1] for study in self.studies if study.numerical]
        columns = (
            "metric",
            ">value ± u_num",
            ">limit",
            "unit",
            "verdict",
            f">at {finest[0] if finest else 'last'}",
            "observed order",
            ">extrapolated",
            ">spread",
        )
        return Table(
            f"Convergence of {self.request.name}: value ± numerical uncertainty, {run.gait.steps} steps a "
            f"level, control at {run.controller.frequency:g} Hz, profile {verdict.profile}",
            columns,
            [self._cells(self.metrics[name]) for name in names or judged],
            [
                *_NOTES,
                *self.notes,
                f"{self.request.name}: {verdict.name.replace('_', ' ').upper()}  {verdict.reason}",
            ],
        )

    def _cells(self, item: MetricResult) -> tuple[str, ...]:
        """Row of a metric; order and limit are those of the first numerical study."""

        def shown(value: float | None, digits: int = 3) -> str:
            return "" if value is None else format_number(value * item.factor, digits).replace("inf", "∞")

        studied = self.studied[item.name]
        last = order = extrapolated = ""
        for study, first in list(studied.estimates.items())[:1]:
            last = shown(studied.levels[study][-1])
            order = str(first.kind) if first.order is None else f"{first.order:.2f}"
            if first.extrapolated is not None:  # a value below its own uncertainty has no significant digits
                is_small = abs(first.extrapolated) < first.finest
                extrapolated = "0" if is_small else shown(first.extrapolated)
        return (
            item.label,
            item.quoted,
            shown(item.tolerance),
            short_unit(item.display_unit),
            "undecided" if item.undecided else {True: "pass", False: "FAIL", None: ""}[item.passed],
            last,
            "exact" if METRICS[item.name].nature == "count" else order,
            extrapolated,
            shown(item.spread, 2),
        )


def combine(
    request: Request, profile: Profile, found: Sequence[Study], walks: Mapping[str, Row]
) -> Convergence:
    """Estimates of every metric from the walks of all levels, and the verdict.

    The errors of time step, grids and tolerances are not random and may have one sign, so their bounds are
    added. Of the contact laws the one counts that changes a metric most.
    """
    run, own = request.run, walks[OWN]
    own_values: Mapping[str, float] = own.get("values", {})
    every = [study.name for study in STUDIES if study.numerical and study.applies(run)]
    made = tuple(study.name for study in found if study.numerical)
    studied = {name: _study_metric(name, found, walks) for name in own_values}
    values: dict[str, float] = {}
    incomplete: dict[str, tuple[str, ...]] = {}
    for name, value in own_values.items():
        metric = METRICS[name]
        needed = [] if metric.nature == "count" else every
        if metric.is_self_check:  # its exact value is zero: it measures the error of the time step
            needed = [study for study in every if study != "time_step"]
        counted = [studied[name].estimates[study].uncertainty for study in needed if study in made]
        if len(counted) < len(needed):
            incomplete[name] = tuple(study for study in needed if study not in made)
        if counted or not needed:  # what has no value has no bound
            total = math.fsum(counted)
            values[name] = math.inf if math.isnan(value + total) else total
    spreads = {
        name: math.inf if math.isnan(metric.spread) else metric.spread
        for name, metric in studied.items()
        if metric.spread is not None and not METRICS[name].is_self_check
    }
    uncertainty = Uncertainty(
        gait=request.name,
        steps=run.gait.steps,
        run=run_key(parameter_values(run)),
        values=values,
        parameters=run.model_dump(),
        studies=made,
        not_studied=tuple(study for study in every if study not in made),
        incomplete=incomplete,
        spreads=spreads,
    )
    ended = ""
    if own["outcome"] != "completed":
        ended = f"The walk at the gait's own parameters {own['outcome']}: {own['cause']}"
    measured = {name: MetricValue(value, METRICS[name].unit) for name, value in own_values.items()}
    verdict = judge(measured, profile, own.get("scales", {}), uncertainty, ended=ended)
    return Convergence(request, tuple(found), walks, uncertainty, studied, verdict)


def _study_metric(name: str, found: Sequence[Study], walks: Mapping[str, Row]) -> StudiedMetric:
    """Levels and estimates of one metric."""
    levels: dict[str, tuple[float, ...]] = {}
    estimates: dict[str, Estimate] = {}
    spreads: dict[str, float] = {}
    for study in found:
        rows = [walks[task] for task in study.tasks]
        whole = [row["values"] if row["outcome"] == "completed" else {} for row in rows]
        values = levels[study.name] = tuple(level.get(name, math.nan) for level in whole)
        if study.numerical:
            forbidden = _NEVER.get(METRICS[name].nature, "")
            estimates[study.name] = estimate(values, study.ratio, forbidden=forbidden)
        else:
            spreads[study.name] = spread(values, study.own)
    return StudiedMetric(levels, estimates, spreads)
