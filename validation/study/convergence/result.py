"""What the studies say together: order, extrapolated value and uncertainty of every metric."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from validation.judge.metrics import display_unit
from validation.judge.profiles import Profile
from validation.judge.verdict import VerdictName, is_undecided
from validation.store.environment import describe_environment
from validation.store.identity import parameter_values, run_key
from validation.study.convergence.execute import OWN, Level, level
from validation.study.convergence.order import Estimate, estimate, input_uncertainty
from validation.study.convergence.studies import (
    COUNTS,
    EXTREME,
    INSTRUMENT,
    Figures,
    Study,
    as_plain,
    inside,
    not_studied,
)

if TYPE_CHECKING:
    from validation.trial.plan import Request

TIME_STEP = "time_step"
"""The study whose order and extrapolated value stand for a metric."""


@dataclass(frozen=True)
class MetricStudy:
    """One figure in all studies.

    Attributes:
        name: metric, integral or extreme.
        value: at the run's own parameters, in ``unit``.
        unit: SI unit.
        levels: study to the figure's value at every level.
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
        walks: every level's figures.
        metrics: by name; those with a tolerance first.
        verdict: pass only where every metric is further from its limit than its uncertainty.
        verdict_reason: one sentence.
        notes: what a reader has to know of single levels.
    """

    request: Request
    profile: Profile
    studies: tuple[Study, ...]
    walks: Mapping[Level, Figures]
    metrics: Mapping[str, MetricStudy]
    verdict: VerdictName
    verdict_reason: str
    notes: tuple[str, ...]

    @property
    def completed(self) -> bool:
        """Whether every walk of the numerical studies came to its end."""
        needed = {
            level(study, index)
            for study in self.studies
            if study.topic.kind == "numerical"
            for index in range(len(study.values))
        }
        return all(self.walks[key].completed for key in needed | {OWN})

    @property
    def inside(self) -> tuple[str, ...]:
        """Studies that the numerical uncertainty is the sum of."""
        made = {study.topic.name for study in self.studies}
        return tuple(name for name in inside("", self.request.run.solver.qp) if name in made)

    @property
    def not_studied(self) -> tuple[str, ...]:
        """Studies that it lacks."""
        return not_studied("", self.inside, self.request.run.solver.qp)

    def as_dict(self) -> dict[str, Any]:
        """Contents of ``convergence.json``."""
        run = self.request.run
        levels = {}
        for study in self.studies:
            walks = [self.walks[level(study, index)] for index in range(len(study.values))]
            levels[study.topic.name] = {
                **as_plain(study),
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
    request: Request, profile: Profile, found: Sequence[Study], walks: Mapping[Level, Figures]
) -> Convergence:
    """Estimates of every figure from the walks of all levels.

    The errors of time step, grids and tolerances are not random and may have one sign: their bounds are
    added, not their squares. Contact parameters are independent inputs: there the squares are.
    """
    own = walks[OWN]
    names = [name for name in own.limits if name in own.values]
    names += [name for name in own.values if name not in own.limits]
    qp = request.run.solver.qp
    metrics = {name: _metric(name, own, found, walks, qp) for name in names}
    made = [study.topic.name for study in found]
    verdict, reason = _verdict(own, metrics, [name for name in inside("", qp) if name in made])
    return Convergence(
        request, profile, tuple(found), dict(walks), metrics, verdict, reason, _notes(found, walks)
    )


def _metric(
    name: str, own: Figures, found: Sequence[Study], walks: Mapping[Level, Figures], qp: str
) -> MetricStudy:
    levels: dict[str, tuple[float, ...]] = {}
    estimates: dict[str, Estimate] = {}
    inputs: dict[str, float] = {}
    extreme = any(name.endswith(part) or name.startswith(part) for part in EXTREME)
    for study in found:
        topic = study.topic
        values = tuple(_value(walks[level(study, index)], name) for index in range(len(study.values)))
        levels[topic.name] = values
        if topic.kind == "input":
            inputs[topic.name] = input_uncertainty(values, study.own)
        else:
            forbidden = "an extreme, never extrapolated" if extreme else study.caution
            forbidden = "a count" if name in COUNTS else forbidden
            estimates[topic.name] = estimate(values, topic.ratio, forbidden=forbidden)
    value = own.values[name]
    head = estimates.get(TIME_STEP) or next(iter(estimates.values()), None)
    reason = head.reason if head else "no numerical study"
    counted = dict(estimates)
    if name in COUNTS:
        counted, reason = {}, "counted in the very run that it judges: exact"
    elif name in INSTRUMENT and TIME_STEP in counted:
        del counted[TIME_STEP]
        reason += "; a self-check whose exact value is zero: the time step is what it measures, and no "
        reason += "uncertainty of it"
    missing = not_studied(name, estimates, qp)
    at_least = math.fsum(item.uncertainty for item in counted.values())
    if math.isnan(value) or (missing and not counted):
        at_least = math.nan
    uncertainty = math.nan if missing else at_least
    limit = own.limits.get(name)
    judged = limit is not None and own.completed and not math.isnan(value)
    undecided = limit is not None and judged and (bool(missing) or is_undecided(value, limit, uncertainty))
    factor, unit = display_unit(own.units[name], own.weight)
    return MetricStudy(
        name=name,
        value=value,
        unit=own.units[name],
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
    )


def _value(walk: Figures, name: str) -> float:
    """A figure of a level; NaN unless its walk came to the end: another way of walking is no level."""
    return walk.values.get(name, math.nan) if walk.completed else math.nan


def _verdict(
    own: Figures, metrics: Mapping[str, MetricStudy], made: Sequence[str]
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
        return VerdictName.NOT_MEASURED, f"No figure for {', '.join(missing)}."
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


def _notes(found: Sequence[Study], walks: Mapping[Level, Figures]) -> tuple[str, ...]:
    notes = []
    for study in found:
        if study.caution:
            notes.append(f"{study.topic.name}: {study.caution}.")
        for index, value in enumerate(study.values):
            walk = walks[level(study, index)]
            where = f"{study.topic.name}, {study.shown(value)}"
            if not walk.completed:
                notes.append(f"{where}: {walk.outcome}, {walk.cause.rstrip('.') or 'no cause given'}.")
            elif walk.values.get("failed_qp"):
                notes.append(f"{where}: {walk.values['failed_qp']:.0f} of the controller's QPs unsolved.")
    return tuple(dict.fromkeys(notes))
