"""Verdict: metrics compared with a tolerance profile, and the summary of a run."""

import math
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np

from ampm.exceptions import InputError
from ampm.walk import LIMITED, SOLVED, UNSOLVED
from validation.judge.built_in import has_qp
from validation.judge.compare import SIGNALS, Comparison
from validation.judge.log import LogFacts
from validation.judge.metrics import METRICS, added_metrics, display_unit
from validation.judge.profiles import DEFAULT, Profile
from validation.judge.uncertainty import Uncertainty
from validation.store.json import json_ready
from validation.table import format_number, with_uncertainty
from validation.trial.record import SimulationRecord


class VerdictName(StrEnum):
    """Result of a verdict."""

    PASS = "pass"
    FAIL = "fail"
    UNDECIDED = "undecided"
    PARTIAL = "partial"
    NOT_MEASURED = "not_measured"


@dataclass(frozen=True)
class MetricResult:
    """One metric, judged or only reported."""

    name: str  # metric
    value: float  # measured, in SI units, NaN if there is none
    tolerance: float | None  # largest value that passes, in SI units; None if the profile has none
    reason: str  # of the tolerance, empty if there is none
    factor: float  # from SI to `display_unit`
    display_unit: str  # what tables show: mm, % of body weight, N m s
    # numerical uncertainty of the value in SI units, infinite if it has no bound; None if none is known
    uncertainty: float | None
    # largest change of the value by another contact law or engine, in SI units; None if none was studied
    spread: float | None
    judged: bool  # whether it has a tolerance and a value, of a walk that completed

    @property
    def label(self) -> str:
        """Readable name."""
        return METRICS[self.name].label

    @property
    def bound(self) -> float:
        """Largest of uncertainty and spread, in SI units; 0 if none is known."""
        return max(self.uncertainty or 0.0, self.spread or 0.0)

    @property
    def undecided(self) -> bool:
        """Whether the value is closer to the tolerance than its uncertainty or its spread."""
        return self.judged and self.bound > 0.0 and abs((self.tolerance or 0.0) - self.value) < self.bound

    @property
    def passed(self) -> bool | None:
        """Whether the tolerance is met; None where nothing is judged, or the result is undecided."""
        return self.value <= (self.tolerance or 0.0) if self.judged and not self.undecided else None

    @property
    def margin(self) -> float | None:
        """Share of the tolerance that is left; negative if failed, None where ``passed`` is.

        Of a tolerance of zero it is 1 if met and -infinity if not.
        """
        if self.passed is None:
            return None
        return 1.0 - self.value / self.tolerance if self.tolerance else 1.0 if self.passed else -math.inf

    def displayed(self, number: float | None) -> float | None:
        """Value, tolerance or uncertainty in ``display_unit``."""
        return None if number is None else number * self.factor

    @property
    def quoted(self) -> str:
        """The value, and its uncertainty if it is known, in ``display_unit``."""
        return with_uncertainty(self.displayed(self.value), self.displayed(self.uncertainty))

    def __str__(self) -> str:
        """The quoted value and its unit, if it has one."""
        return f"{self.quoted} {self.display_unit}".rstrip()

    @property
    def against(self) -> str:
        """The value and its limit, of a metric that has one; with more digits if both look the same."""
        value, limit = self.quoted, f"{self.displayed(self.tolerance):.3g}"
        if value == limit and self.value != self.tolerance:
            value, limit = (f"{self.displayed(number):.12g}" for number in (self.value, self.tolerance))
        return f"{value} {self.display_unit}".rstrip() + f", limit {limit}"

    def as_dict(self) -> dict[str, Any]:
        """For ``summary.json``."""
        value, limit = self.displayed(self.value), self.displayed(self.tolerance)
        display: dict[str, Any] = {"value": value, "unit": self.display_unit, "tolerance": limit}
        entry: dict[str, Any] = {
            "label": self.label,
            "kind": METRICS[self.name].kind,
            "value": self.value,
            "unit": METRICS[self.name].unit,
            "tolerance": self.tolerance,
            "pass": self.passed,
            "margin": self.margin,
            "display": display,
            "reason": self.reason or None,
        }
        if self.uncertainty is not None:
            entry |= {"undecided": self.undecided, "uncertainty": self.uncertainty, "spread": self.spread}
            display["uncertainty"] = self.displayed(self.uncertainty)
            display["spread"] = self.displayed(self.spread)
        return entry


@dataclass(frozen=True)
class Verdict:
    """Metrics of a run compared with a profile."""

    # pass only if every tolerance was judged and met; undecided if all decided tolerances pass, but some are
    # undecided; partial if all pass that a log has, but it lacks some, or much of its time
    name: VerdictName
    profile: str  # name of the profile
    reason: str  # one sentence
    metrics: tuple[MetricResult, ...] = field(repr=False)  # judged ones first, in the profile's order

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


def judge(
    metrics: Mapping[str, float],
    profile: Profile,
    scales: Mapping[str, float],
    uncertainty: Uncertainty | None = None,
    *,
    ended: str = "",
    log: LogFacts | None = None,
) -> Verdict:
    """Compare metrics with a profile; those of a walk that did not complete are reported, not judged.

    Args:
        metrics: name to value in SI units. A tolerance on a metric that is not among them does not apply.
        profile: tolerances.
        scales: ``body_weight`` [N] and ``foot_length`` [m], as :attr:`Comparison.scales` has them.
        uncertainty: a metric whose distance to its tolerance is below its numerical uncertainty, or its
            spread over contact laws, is undecided.
        ended: how the walk ended, see :attr:`validation.trial.outcome.Outcome.ending`; empty if it completed.
        log: given if another instrument measured, which may lack signals or what :attr:`LogFacts.lacks`
            names. It checks no measurement by another.

    Raises :class:`InputError` if a metric is not registered.
    """
    if unknown := [name for name in metrics if name not in METRICS]:
        way_out = "register them, or name them with --metric, or walk again if another version made the run"
        raise InputError(f"metrics not known here: {', '.join(unknown)}; {way_out}.")
    limits = {name: item for name, item in profile.tolerances.items() if name in metrics}
    known = uncertainty or Uncertainty("", 0, {})
    results = []
    for name in dict.fromkeys([*limits, *metrics]):
        value, limit = metrics[name], limits.get(name)
        factor, unit = display_unit(METRICS[name].unit, scales["body_weight"])
        results.append(
            MetricResult(
                name=name,
                value=value,
                tolerance=None if limit is None else float(limit.limit_for(scales)),
                reason="" if limit is None else limit.reason,
                factor=factor,
                display_unit=unit,
                uncertainty=known.values.get(name),
                spread=known.spreads.get(name),
                judged=limit is not None and not ended and not math.isnan(value),
            )
        )
    if why := ended or _misfit(profile, metrics.keys()):
        return Verdict(VerdictName.NOT_MEASURED, profile.name, why, tuple(results))
    missing = [name for name in limits if math.isnan(metrics[name])]
    lacking = [name for name in missing if log is None or METRICS[name].kind != "instrument"]
    own = {metric.name for metric in added_metrics()}
    verdict, reason = _conclude(results, lacking, len(limits) - len(missing), log)
    if verdict is VerdictName.NOT_MEASURED and log is None and not own.issuperset(lacking):
        reason += f" Walk longer {'after the push' if 'recovery_time' in lacking else 'than a step'}."
    if checks := len(missing) - len(lacking):
        reason += f" Checks of the measurement that were not made: {checks}."
    if profile.name != DEFAULT.name:
        reason += f" Profile: {profile.name}."
    return Verdict(verdict, profile.name, reason, tuple(results))


def _misfit(profile: Profile, metrics: Set[str]) -> str:
    """Why a profile cannot judge a walk that has some metrics; empty if it can."""
    limited = profile.tolerances.keys()
    if limited.isdisjoint(metrics):
        return f"The profile {profile.name} has no limits."
    if "recovery_time" in limited - metrics:
        return "Nothing pushed the body off a plan: judge it by another profile."
    if "velocity_x_error" in metrics - limited:
        return "The walk has no plan: judge it by the profile free."
    if "velocity_x_error" in limited - metrics:
        return "The walk has a plan and no commanded velocity: judge it by another profile."
    return ""


def _conclude(
    results: Sequence[MetricResult], missing: list[str], limits: int, log: LogFacts | None
) -> tuple[VerdictName, str]:
    """Verdict and its reason; ``limits`` is how many were measured, and a walk has no ``log``."""

    def against(item: MetricResult) -> str:
        return f"{item.label}: {item.against}"

    def by_contact(item: MetricResult) -> bool:
        return (item.spread or 0.0) > (item.uncertainty or 0.0)

    passed = [item for item in results if item.passed]
    failed = [item for item in results if item.passed is False]
    undecided = [item for item in results if item.undecided]
    laws = " or the spread of contact laws" if any(map(by_contact, undecided)) else ""
    why = f"the numerical uncertainty{laws} is larger than the distance to the limit"
    signals = dict.fromkeys(METRICS[name].label.partition(",")[0] for name in missing)
    unknown = f" Not measured: {', '.join(signals)}." if missing else ""
    if failed:
        relative = [item for item in failed if item.tolerance]  # nothing tells how far is from a limit of 0
        worst = min(relative or failed, key=lambda item: item.margin or 0.0)
        reason = f"{len(failed)} of {limits} tolerances not met; the furthest is {against(worst)}"
        if relative and (zero := [item for item in failed if not item.tolerance]):
            reason += f", and {against(zero[0])}"
        reason += "."
        reason += f" {len(undecided)} undecided: {why}." if undecided else ""
        return VerdictName.FAIL, reason + unknown
    were = "was" if len(signals) == 1 else "were"
    lacks = [f"{' and '.join(signals)} {were} not measured"] if missing else []
    lacks += [] if log is None else log.lacks
    if lacks and log is not None and passed and not undecided:
        lack = ", and ".join(lacks)
        return VerdictName.PARTIAL, f"Pass on {len(passed)} of {limits + len(missing)}; {lack}."
    if missing:
        return VerdictName.NOT_MEASURED, f"{len(passed)} of {limits} measured tolerances met.{unknown}"
    if undecided:
        least = max(undecided, key=lambda item: item.bound / (item.tolerance or math.inf))
        reason = (
            f"{len(undecided)} of {limits} tolerances undecided: {why}; the least certain is {against(least)}"
        )
        if by_contact(least):
            spread = format_number(least.displayed(least.spread), 2).replace("inf", "∞")
            reason += f", which contact laws change by up to {spread} {least.display_unit}".rstrip()
        return VerdictName.UNDECIDED, f"{reason}."
    tight = min(passed, key=lambda item: (not item.tolerance, item.margin or 0.0))
    return VerdictName.PASS, f"All {limits} tolerances met; the tightest is {against(tight)}."


def build_summary(comparison: Comparison, verdict: Verdict, **entries: Any) -> dict[str, Any]:
    """Contents of ``summary.json``: plain JSON values in SI units, None if undefined.

    Further top-level entries are for example ``timing`` [s], ``environment`` or the gait's name.
    """
    outcome, zmp = comparison.record.outcome, comparison.zmp_split
    planned = [name for name, signal in SIGNALS.items() if signal.reference == "plan"]
    ahead = {name: [found[name] for found in comparison.ahead.values()] for name in planned}
    summary = {
        "outcome": outcome.name,
        "steps_completed": outcome.steps_completed,
        "end": {"time": outcome.time, "cause": outcome.cause},
        **_entries(verdict),
        "timing": {},
        "statistics": {
            name: {
                window: {**vars(found), "unit": SIGNALS[name].unit, "reference": SIGNALS[name].reference}
                for window, found in windows.items()
            }
            for name, windows in comparison.signals.items()
        },
        "zmp_error_split": {"residual": zmp.residual, "rmse": zmp.rmse, "share": zmp.share, "unit": "m"},
        "ahead": {"judged": comparison.followed.lead, "lead": list(comparison.ahead), "rmse": ahead},
        **comparison.costs,
        "self_checks": comparison.measured.self_checks,
        "solver": _solver(comparison.record),
        "scales": comparison.scales,
        "environment": {},
        **entries,
    }
    return dict(json_ready(summary))


def _entries(verdict: Verdict) -> dict[str, Any]:
    """What a summary says of a verdict."""
    return {
        "verdict": verdict.name,
        "reason": verdict.reason,
        "profile": verdict.profile,
        # Others are in their sections.
        "metrics": {item.name: item.as_dict() for item in verdict.metrics if not METRICS[item.name].section},
    }


def judge_summary(summary: Mapping[str, Any], profile: Profile, ended: str = "") -> dict[str, Any]:
    """A run's summary, its metrics judged again by a profile; raises as :func:`judge`."""
    entries = summary["metrics"]

    def of(key: str) -> dict[str, float]:
        """Numbers of the summary, in which infinity is a word."""
        return {name: float(item[key]) for name, item in entries.items() if item.get(key) is not None}

    metrics, known = {**dict.fromkeys(entries, math.nan), **of("value")}, None
    log = LogFacts.of(summary["log"]) if "log" in summary else None
    if study := summary.get("uncertainty"):
        known = Uncertainty(study["gait"], study["steps"], of("uncertainty"), of("spread"))
    verdict = judge(metrics, profile, summary["scales"], known, ended=ended, log=log)
    return dict(json_ready({**summary, **_entries(verdict)}))


def _solver(record: SimulationRecord) -> dict[str, Any]:
    """How the controller's QPs were solved, NaN without a tick; nothing is counted without a QP."""

    def quantile(values: Any, share: float) -> float:
        return float(np.quantile(values, share)) if values.size else math.nan

    status = record.qp_status
    states = {"solved": SOLVED, "solved_with_limits": LIMITED, "unsolved": UNSOLVED}
    known = has_qp(record)
    return {
        "ticks": status.size,
        **{name: np.count_nonzero(status == code) if known else None for name, code in states.items()},
        "residual_maximum": quantile(record.qp_residual, 1.0),
        "iterations_median": quantile(record.qp_iterations, 0.5),
        "iterations_maximum": quantile(record.qp_iterations, 1.0),
        "time_median": quantile(record.qp_time, 0.5),
        "time_p99": quantile(record.qp_time, 0.99),
    }
