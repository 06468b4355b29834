"""Pass, fail or not measured: a comparison held against a tolerance profile, and the summary of a run."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any

import numpy as np

from validation.judge.compare import Comparison, statistics_table
from validation.judge.metrics import BODY_WEIGHT, METRICS, display_unit
from validation.judge.profiles import Profile, Tolerance
from validation.store.json import json_ready

if TYPE_CHECKING:
    from validation.judge.metrics import MetricValue
    from validation.judge.uncertainty import Uncertainty


class VerdictName(StrEnum):
    """Result of a verdict."""

    PASS = "pass"
    FAIL = "fail"
    UNDECIDED = "undecided"
    NOT_MEASURED = "not_measured"


@dataclass(frozen=True)
class MetricResult:
    """One metric, judged or only reported.

    Attributes:
        name: metric.
        of: its value, in SI units, NaN if there is none.
        tolerance: largest value that passes, in SI units; None if the profile has none.
        passed: None where nothing is judged, or nothing can be said.
        margin: share of the tolerance that is left, 1 - value / tolerance; negative if failed, None where
            ``passed`` is. Where the tolerance is zero, 1 if met and -infinity if not.
        reason: of the tolerance, empty if there is none.
        factor: from SI to ``display_unit``.
        display_unit: what tables show: mm, % of body weight, N m s.
        uncertainty: numerical uncertainty of the value in SI units, infinite if it has no bound; None if none
            was given.
        undecided: whether the value is closer to the tolerance than its uncertainty, or a study that belongs
            to it was not made.
        not_studied: studies without which the uncertainty is not known; ``uncertainty`` is then what the
            others leave, and the true one is no less.
    """

    name: str
    of: MetricValue
    tolerance: float | None
    passed: bool | None
    margin: float | None
    reason: str
    factor: float
    display_unit: str
    uncertainty: float | None
    undecided: bool
    not_studied: tuple[str, ...]

    @property
    def value(self) -> float:
        """Measured value, in SI units."""
        return self.of.value

    def displayed(self, number: float | None) -> float | None:
        """Value, tolerance or uncertainty in ``display_unit``."""
        return None if number is None else number * self.factor

    def __str__(self) -> str:
        """The value, its uncertainty if it is known, and its unit, if it has one."""
        known = self.displayed(self.uncertainty)
        spread = "" if known is None else f" ± {'≥ ' if self.not_studied else ''}{known:.2g}"
        if self.not_studied and known is None:
            spread = " ± not studied"
        return f"{self.displayed(self.value):.3g}{spread} {self.display_unit}".rstrip()

    def as_dict(self) -> dict[str, Any]:
        """For ``summary.json``."""
        display: dict[str, Any] = {
            "value": self.displayed(self.value),
            "unit": self.display_unit,
            "tolerance": self.displayed(self.tolerance),
        }
        entry: dict[str, Any] = {
            "value": self.value,
            "unit": self.of.unit,
            "tolerance": self.tolerance,
            "pass": self.passed,
            "margin": self.margin,
            "first_step": self.of.first_step,
            "normalised": dict(self.of.normalised),
            "display": display,
            "reason": self.reason or None,
        }
        if self.uncertainty is not None or self.not_studied:
            entry["undecided"] = self.undecided
            for place, known in ((entry, self.uncertainty), (display, self.displayed(self.uncertainty))):
                place["uncertainty"] = "inf" if known == math.inf else known  # JSON has no infinity
        if self.not_studied:  # what the other studies leave is no uncertainty of the value
            entry["not_studied"] = list(self.not_studied)
            for place in (entry, display):
                place["uncertainty_at_least"], place["uncertainty"] = place["uncertainty"], None
        return entry


@dataclass(frozen=True)
class Verdict:
    """Metrics of a run held against a profile.

    Attributes:
        name: pass only if every tolerance was judged and met; undecided if all that can be said are passes,
            but of some tolerance nothing can be said.
        profile: name of the profile.
        reason: one sentence.
        metrics: judged ones first, in the profile's order, then those only reported.
    """

    name: VerdictName
    profile: str
    reason: str
    metrics: tuple[MetricResult, ...]

    @property
    def passed(self) -> bool:
        """Whether every tolerance is met."""
        return self.name is VerdictName.PASS

    @property
    def judged(self) -> tuple[MetricResult, ...]:
        """Metrics that have a tolerance."""
        return tuple(item for item in self.metrics if item.tolerance is not None)

    @property
    def failed(self) -> tuple[MetricResult, ...]:
        """Metrics out of tolerance."""
        return tuple(item for item in self.metrics if item.passed is False)

    @property
    def undecided(self) -> tuple[MetricResult, ...]:
        """Metrics closer to their tolerance than their numerical uncertainty."""
        return tuple(item for item in self.metrics if item.undecided)


def judge(
    comparison: Comparison,
    metrics: Mapping[str, MetricValue],
    profile: Profile,
    uncertainty: Uncertainty | None = None,
) -> Verdict:
    """Hold the metrics of a walk against a profile.

    A walk that did not complete has no verdict on tolerances: its metrics would be of a walk that did not
    happen. They are reported all the same, unjudged.

    Args:
        comparison: of the walk with its plan.
        metrics: of that walk.
        profile: tolerances.
        uncertainty: numerical uncertainty of the metrics. A metric whose distance to its tolerance is below
            it is undecided: neither met nor missed. So is one that lacks a study, whatever its value. A
            metric that is not named is judged by its value.
    """
    outcome = comparison.record.outcome
    known: Mapping[str, float] = {} if uncertainty is None else uncertainty.values
    lacking: Mapping[str, tuple[str, ...]] = {} if uncertainty is None else uncertainty.incomplete
    limits = {item.metric: item for item in profile.tolerances}
    weight = comparison.scales["body_weight"]
    names = [name for name in limits if name in metrics]
    names += [
        name
        for name in metrics
        if name not in limits and not METRICS[name].section  # its section of the summary has it
    ]
    results = tuple(
        _result(
            name,
            metrics[name],
            limits.get(name),
            weight,
            known.get(name),
            lacking.get(name, ()),
            judged=outcome.completed,
        )
        for name in names
    )
    missing = [name for name in limits if name not in metrics]
    missing += [item.name for item in results if item.tolerance is not None and math.isnan(item.value)]
    failed = [item for item in results if item.passed is False]
    undecided = [item for item in results if item.undecided]
    if not outcome.completed:
        name = VerdictName.NOT_MEASURED
        reason = f"{outcome.name.sentence[:-1]}, at {outcome.time:.3f} s"
        reason += f": {outcome.cause.rstrip('.')}." if outcome.cause else "."
    elif failed:
        name = VerdictName.FAIL
        worst = min(failed, key=lambda item: item.margin or 0.0)
        reason = (
            f"{len(failed)} of {len(limits)} tolerances not met; the furthest is {worst.name}: "
            f"{worst}, limit {worst.displayed(worst.tolerance):.3g}."
        )
        if undecided:
            reason += f" {len(undecided)} undecided: {_why(undecided)}."
    elif missing:
        name = VerdictName.NOT_MEASURED
        reason = f"No figure for {', '.join(missing)}: a run must last longer than its first step."
    elif undecided:
        name = VerdictName.UNDECIDED
        least = max(undecided, key=lambda item: (item.uncertainty or 0.0) / (item.tolerance or math.inf))
        reason = f"{len(undecided)} of {len(limits)} tolerances undecided, {_why(undecided)}"
        if least.uncertainty is not None:
            reason += f"; the least certain is {least.name}: {least}"
            reason += f", limit {least.displayed(least.tolerance):.3g}"
        reason += "."
    else:
        name = VerdictName.PASS
        judged = [item for item in results if item.margin is not None and item.tolerance]
        tight = min(judged, key=lambda item: item.margin or 0.0)
        reason = (
            f"All {len(limits)} tolerances met; the tightest is {tight.name}: "
            f"{tight}, limit {tight.displayed(tight.tolerance):.3g}."
        )
    return Verdict(name, profile.name, reason, results)


def build_summary(
    comparison: Comparison,
    verdict: Verdict,
    *,
    timing: Mapping[str, Any] | None = None,
    environment: Mapping[str, Any] | None = None,
    extra: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Contents of ``summary.json``: plain JSON values in SI units, None for what is undefined.

    Args:
        comparison: of the walk with its plan.
        verdict: of a profile.
        timing: wall-clock times [s] and what follows from them.
        environment: versions and platform.
        extra: further top-level entries, such as the gait's name or the motion's residuals.
    """
    record, status = comparison.record, comparison.record.qp_status
    summary = {
        "outcome": str(record.outcome.name),
        "verdict": str(verdict.name),
        "steps_completed": record.outcome.steps_completed,
        "reason": verdict.reason,
        "profile": verdict.profile,
        "end": {"time": record.outcome.time, "cause": record.outcome.cause},
        "metrics": {item.name: item.as_dict() for item in verdict.metrics},
        "timing": dict(timing or {}),
        "statistics": statistics_table(comparison),
        "zmp_error_split": {
            "residual": comparison.zmp_split.residual,
            "rmse": {name: list(pair) for name, pair in comparison.zmp_split.rmse.items()},
            "share": {name: list(pair) for name, pair in comparison.zmp_split.share.items()},
            "unit": "m",
        },
        "effort": asdict(comparison.effort),
        "effort_first_step": asdict(comparison.effort_first_step),
        "margins": asdict(comparison.margins),
        "energy": asdict(comparison.energy),
        "self_checks": asdict(comparison.measured.self_checks),
        "solver": {
            "ticks": int(status.size),
            "solved": int(np.count_nonzero(status == 0)),
            "solved_with_limits": int(np.count_nonzero(status == 1)),
            "unsolved": int(np.count_nonzero(status == 2)),
            "residual_maximum": _maximum(record.qp_residual),
            "iterations_median": _quantile(record.qp_iterations, 0.5),
            "iterations_maximum": _maximum(record.qp_iterations),
            "time_median": _quantile(record.qp_time, 0.5),
            "time_p99": _quantile(record.qp_time, 0.99),
        },
        "scales": dict(comparison.scales),
        "environment": dict(environment or {}),
        **(extra or {}),
    }
    return dict(json_ready(summary, infinity=None))


def is_undecided(value: float, tolerance: float, uncertainty: float | None) -> bool:
    """Whether the value is closer to its tolerance than its uncertainty; all in one unit."""
    return uncertainty is not None and abs(tolerance - value) < uncertainty


def _result(
    name: str,
    metric: MetricValue,
    tolerance: Tolerance | None,
    weight: float,
    uncertainty: float | None,
    not_studied: tuple[str, ...],
    *,
    judged: bool,
) -> MetricResult:
    factor, unit = display_unit(metric.unit, weight)
    if uncertainty is not None and math.isnan(uncertainty):
        uncertainty = None
    limit: float | None = None
    if tolerance is not None:
        limit = tolerance.limit * (weight if tolerance.unit == BODY_WEIGHT else 1.0)
    passed: bool | None = None
    margin: float | None = None
    comparable = limit is not None and judged and not math.isnan(metric.value)
    undecided = comparable and (
        bool(not_studied) or (limit is not None and is_undecided(metric.value, limit, uncertainty))
    )
    if limit is not None and comparable and not undecided:
        passed = metric.value <= limit
        if limit > 0.0:
            margin = 1.0 - metric.value / limit
        else:
            margin = 1.0 if passed else -math.inf
    reason = tolerance.reason if tolerance is not None else ""
    return MetricResult(
        name, metric, limit, passed, margin, reason, factor, unit, uncertainty, undecided, not_studied
    )


def _why(undecided: Sequence[MetricResult]) -> str:
    """Why nothing can be said of these."""
    lacking = dict.fromkeys(name for item in undecided for name in item.not_studied)
    if lacking:
        return f"their numerical uncertainty is not known (not studied: {', '.join(lacking)})"
    return "closer to the limit than the numerical uncertainty"


def _maximum(values: Any) -> float:
    return float(values.max()) if values.size else math.nan


def _quantile(values: Any, share: float) -> float:
    return float(np.quantile(values, share)) if values.size else math.nan
