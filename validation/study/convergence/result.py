"""What the studies say together: order, extrapolated value and uncertainty of every metric."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from validation.judge.metrics import BODY_WEIGHT, display_unit
from validation.judge.profiles import Profile
from validation.judge.verdict import VerdictName, is_undecided
from validation.store.environment import describe_environment
from validation.store.identity import parameter_values, run_key
from validation.study.convergence.order import Estimate, estimate, input_uncertainty
from validation.study.convergence.studies import OWN, Level, Study, numerical_studies
from validation.study.convergence.walks import Followed, LevelResult, followed

if TYPE_CHECKING:
    from validation.trial.plan import Request

TIME_STEP = "time_step"
"""The study whose order and extrapolated value stand for a metric."""


@dataclass(frozen=True)
class MetricStudy:
    """One metric, integral or extreme in all studies.

    Attributes:
        name: of the metric.
        value: at the run's own parameters, in ``unit``.
        unit: SI unit.
        levels: study to the metric's value at every level.
        estimates: numerical study to what it says.
        inputs: input study to the largest deviation within it.
        uncertainty: numerical uncertainty: the sum of those of the numerical studies that count; NaN if one
            of them was not made.
        at_least: the sum of those that were made, NaN if none was.
        not_studied: numerical studies that count and were not made; nothing is decided without them.
        input_uncertainty: root of the sum of squares of ``inputs``; None without such a study.
        reason: of the uncertainty, in words.
        tolerance: of the profile in ``unit``, None if it has none.
        passed: None where nothing is judged, or nothing can be said.
        undecided: whether the value is closer to the tolerance than its uncertainty, or that is not known.
        factor, display_unit: what people are shown: value times factor.
        exact: whether it is a count, which has no uncertainty.
    """

    name: str
    value: float
    unit: str
    levels: Mapping[str, tuple[float, ...]]
    estimates: Mapping[str, Estimate]
    inputs: Mapping[str, float]
    uncertainty: float
    at_least: float
    not_studied: tuple[str, ...]
    input_uncertainty: float | None
    reason: str
    tolerance: float | None
    passed: bool | None
    undecided: bool
    factor: float
    display_unit: str
    exact: bool

    @property
    def headline(self) -> Estimate | None:
        """The time step's estimate, or of what was studied instead."""
        if TIME_STEP in self.estimates:
            return self.estimates[TIME_STEP]
        return next(iter(self.estimates.values()), None)

    def as_dict(self) -> dict[str, Any]:
        """For ``convergence.json``."""
        head = self.headline
        by_study: dict[str, Any] = {}
        for study, values in self.levels.items():
            entry: dict[str, Any] = {"values": list(values)}
            if study in self.estimates:
                entry |= {**asdict(self.estimates[study]), "asymptotic": self.estimates[study].asymptotic}
            else:
                entry["input_uncertainty"] = self.inputs[study]
            by_study[study] = entry
        return {
            "value": self.value,
            "unit": self.unit,
            "order": head.order if head else None,
            "extrapolated": head.extrapolated if head else None,
            "uncertainty": self.uncertainty,
            "uncertainty_at_least": self.at_least,
            "not_studied": list(self.not_studied),
            "input_uncertainty": self.input_uncertainty,
            "asymptotic": bool(head and head.asymptotic),
            "reason": self.reason,
            "tolerance": self.tolerance,
            "pass": self.passed,
            "undecided": self.undecided,
            "display": {"factor": self.factor, "unit": self.display_unit},
            "by_study": by_study,
        }


@dataclass(frozen=True)
class Convergence:
    """All studies of one gait.

    Attributes:
        request: the gait, with the steps that were walked.
        profile: of the tolerances.
        studies: in order.
        walks: result of every level.
        metrics: by name; those with a tolerance first.
        verdict: pass only where every metric is further from its limit than its uncertainty.
        verdict_reason: one sentence.
        notes: what a reader has to know of single levels.
    """

    request: Request
    profile: Profile
    studies: tuple[Study, ...]
    walks: Mapping[Level, LevelResult]
    metrics: Mapping[str, MetricStudy]
    verdict: VerdictName
    verdict_reason: str
    notes: tuple[str, ...]

    @property
    def completed(self) -> bool:
        """Whether every walk of the numerical studies came to its end."""
        needed = {level for study in self.studies if study.numerical for level in study.levels}
        return all(self.walks[key].completed for key in needed | {OWN})

    @property
    def inside(self) -> tuple[str, ...]:
        """Studies that the numerical uncertainty is the sum of."""
        return tuple(study.name for study in self.studies if study.numerical)

    @property
    def not_studied(self) -> tuple[str, ...]:
        """Studies that it lacks."""
        return tuple(
            name for name in numerical_studies(self.request.run.solver.qp) if name not in self.inside
        )

    def as_dict(self) -> dict[str, Any]:
        """Contents of ``convergence.json``."""
        run = self.request.run
        levels = {}
        for study in self.studies:
            walks = [self.walks[level] for level in study.levels]
            levels[study.name] = {
                **study.as_dict(),
                "outcomes": [walk.outcome for walk in walks],
                "causes": [walk.cause or None for walk in walks],
                "seconds": [walk.seconds for walk in walks],
                "memory_peak": [walk.memory for walk in walks],
            }
        return {
            "gait": self.request.name,
            "run": run_key(parameter_values(run)),
            "steps": run.gait.steps,
            "profile": self.profile.name,
            "verdict": str(self.verdict),
            "reason": self.verdict_reason,
            "notes": list(self.notes),
            "uncertainty_of": list(self.inside),
            "not_studied": list(self.not_studied),
            "levels": levels,
            "metrics": {name: metric.as_dict() for name, metric in self.metrics.items()},
            "parameters": run.model_dump(),
            "environment": describe_environment(),
        }


def combine(
    request: Request, profile: Profile, found: Sequence[Study], walks: Mapping[Level, LevelResult]
) -> Convergence:
    """Estimates of every metric from the walks of all levels.

    The errors of time step, grids and tolerances are not random and may have one sign: their bounds are
    added, not their squares. Contact parameters are independent inputs: there the squares are.
    """
    own, known = walks[OWN], followed()
    limits = {
        item.metric: item.limit * (own.weight if item.unit == BODY_WEIGHT else 1.0)
        for item in profile.tolerances
        if item.metric in own.values
    }
    metrics = {
        name: _metric(name, known[name], limits.get(name), request.run.solver.qp, found, walks)
        for name in [*limits, *(name for name in own.values if name not in limits)]
    }
    made = [study.name for study in found if study.numerical]
    verdict, reason = _verdict(own, metrics, made)
    return Convergence(
        request, profile, tuple(found), dict(walks), metrics, verdict, reason, _notes(found, walks)
    )


def _metric(
    name: str,
    known: Followed,
    limit: float | None,
    qp: str,
    found: Sequence[Study],
    walks: Mapping[Level, LevelResult],
) -> MetricStudy:
    own = walks[OWN]
    value = own.values[name]
    levels: dict[str, tuple[float, ...]] = {}
    estimates: dict[str, Estimate] = {}
    inputs: dict[str, float] = {}
    never = {"count": "a count", "extreme": "an extreme, never extrapolated"}.get(known.nature, "")
    for study in found:
        values = tuple(_value(walks[level], name) for level in study.levels)
        levels[study.name] = values
        if study.numerical:
            estimates[study.name] = estimate(values, study.topic.ratio, forbidden=never)
        else:
            inputs[study.name] = input_uncertainty(values, study.own)
    head = estimates.get(TIME_STEP) or next(iter(estimates.values()), None)
    reason = head.reason if head else "no numerical study"
    needed = set(numerical_studies(qp))
    if known.nature == "count":
        needed, reason = set(), "counted in the very run that it judges: exact"
    elif known.self_check:
        needed -= {TIME_STEP}
        if TIME_STEP in estimates:
            reason += "; a self-check whose exact value is zero: the time step is what it measures, and no "
            reason += "uncertainty of it"
    counted = [item for study, item in estimates.items() if study in needed]
    missing = tuple(study for study in numerical_studies(qp) if study in needed - estimates.keys())
    at_least = math.fsum(item.uncertainty for item in counted)
    if math.isnan(value) or (missing and not counted):
        at_least = math.nan
    uncertainty = math.nan if missing else at_least
    judged = limit is not None and own.completed and not math.isnan(value)
    undecided = limit is not None and judged and (bool(missing) or is_undecided(value, limit, uncertainty))
    factor, unit = display_unit(known.unit, own.weight)
    return MetricStudy(
        name=name,
        value=value,
        unit=known.unit,
        levels=levels,
        estimates=estimates,
        inputs=inputs,
        uncertainty=uncertainty,
        at_least=at_least,
        not_studied=missing,
        input_uncertainty=math.hypot(*inputs.values()) if inputs else None,
        reason=reason,
        tolerance=limit,
        passed=value <= limit if limit is not None and judged and not undecided else None,
        undecided=undecided,
        factor=factor,
        display_unit=unit,
        exact=known.nature == "count",
    )


def _value(walk: LevelResult, name: str) -> float:
    """A metric of a level; NaN unless its walk came to the end: another way of walking is no level."""
    return walk.values.get(name, math.nan) if walk.completed else math.nan


def _verdict(
    own: LevelResult, metrics: Mapping[str, MetricStudy], made: Sequence[str]
) -> tuple[VerdictName, str]:
    judged = [item for item in metrics.values() if item.tolerance is not None]
    if not own.completed:
        return VerdictName.NOT_MEASURED, f"The walk at the gait's own parameters {own.outcome}: {own.cause}"
    spread = f"the numerical uncertainty ({' + '.join(made) or 'of no study'})"
    lacking = tuple(dict.fromkeys(study for item in judged for study in item.not_studied))
    failed = [item.name for item in judged if item.passed is False]
    undecided = [item.name for item in judged if item.undecided]
    missing = [item.name for item in judged if item.passed is None and not item.undecided]
    if failed:
        return (
            VerdictName.FAIL,
            f"Over the limit by more than {spread}: {', '.join(failed)}.",
        )
    if missing:
        return VerdictName.NOT_MEASURED, f"No value of {', '.join(missing)}."
    if lacking:
        return (
            VerdictName.UNDECIDED,
            f"Not studied: {', '.join(lacking)}; without that nobody knows the numerical uncertainty, and of "
            f"{len(undecided)} of {len(judged)} tolerances it cannot be said whether they are met by more.",
        )
    if undecided:
        return (
            VerdictName.UNDECIDED,
            f"Closer to the limit than {spread}: {', '.join(undecided)}.",
        )
    return VerdictName.PASS, f"All {len(judged)} tolerances are met by more than {spread}."


def _notes(found: Sequence[Study], walks: Mapping[Level, LevelResult]) -> tuple[str, ...]:
    notes = []
    for study in found:
        for level, value in zip(study.levels, study.values, strict=True):
            walk, where = walks[level], f"{study.name}, {study.shown(value)}"
            if not walk.completed:
                notes.append(f"{where}: {walk.outcome}, {walk.cause.rstrip('.') or 'no cause given'}.")
            elif walk.values.get("failed_qp"):
                notes.append(f"{where}: {walk.values['failed_qp']:.0f} of the controller's QPs unsolved.")
    return tuple(dict.fromkeys(notes))
