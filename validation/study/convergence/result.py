"""Combined result of the studies: order, extrapolated value and uncertainty of every metric."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ampm.brief import Brief
from validation.judge.metrics import MetricValue
from validation.judge.profiles import Profile
from validation.judge.uncertainty import Uncertainty
from validation.judge.verdict import MetricResult, Verdict, judge
from validation.store.environment import describe_environment
from validation.store.identity import parameter_values, run_key
from validation.study.convergence.order import Estimate, estimate, input_uncertainty
from validation.study.convergence.studies import Study, numerical_studies
from validation.study.convergence.walks import StudiedQuantity, Walks, studied_quantities
from validation.trial.plan import Request

TIME_STEP = "time_step"
"""The first of the studies, whose order and extrapolated value are shown for a metric."""
_NEVER = {"count": "a count", "extreme": "an extreme, never extrapolated"}


@dataclass(frozen=True)
class MetricStudy(MetricResult):
    """One metric in all studies, judged with the uncertainty that they give it.

    Attributes:
        levels: study to the metric's value at every level [SI unit].
        estimates: numerical study to its estimate.
        inputs: input study to the largest deviation within it.
        found: sources of its numerical uncertainty, as text.
        exact: whether it is a count, which has no uncertainty.
    """

    levels: Mapping[str, tuple[float, ...]]
    estimates: Mapping[str, Estimate]
    inputs: Mapping[str, float]
    found: str
    exact: bool

    @property
    def headline(self) -> Estimate | None:
        """The time step's estimate, or that of the first other study."""
        return next(iter(self.estimates.values()), None)

    @property
    def input_uncertainty(self) -> float | None:
        """Root of the sum of squares of ``inputs``; None without such a study."""
        return math.hypot(*self.inputs.values()) if self.inputs else None

    def as_dict(self) -> dict[str, Any]:
        """For ``convergence.json``."""
        head = self.headline
        by_study: dict[str, Any] = {study: {"values": values} for study, values in self.levels.items()}
        for study, one in self.estimates.items():
            by_study[study] |= {**vars(one), "asymptotic": one.asymptotic}
        for study, deviation in self.inputs.items():
            by_study[study]["input_uncertainty"] = deviation
        return {
            "value": self.value,
            "unit": self.of.unit,
            "order": head and head.order,
            "extrapolated": head and head.extrapolated,
            "uncertainty": None if self.not_studied else self.uncertainty,
            "uncertainty_at_least": self.uncertainty,
            "not_studied": self.not_studied,
            "input_uncertainty": self.input_uncertainty,
            "asymptotic": bool(head and head.asymptotic),
            "reason": self.found,
            "tolerance": self.tolerance,
            "pass": self.passed,
            "undecided": self.undecided,
            "display": {"factor": self.factor, "unit": self.display_unit},
            "by_study": by_study,
        }


@dataclass(frozen=True)
class Convergence(Brief):
    """All studies of one gait.

    Attributes:
        request: the gait, with the steps that were walked.
        studies: in order.
        walks: result of every level.
        uncertainty: numerical uncertainty by the studies.
        metrics: by name; those with a tolerance first.
        verdict: pass only where every metric is further from its limit than its uncertainty.
    """

    request: Request
    studies: tuple[Study, ...]
    walks: Walks
    uncertainty: Uncertainty
    metrics: Mapping[str, MetricStudy]
    verdict: Verdict

    @property
    def completed(self) -> bool:
        """Whether every walk of the numerical studies completed."""
        needed = {run for study in self.studies if study.numerical for run in study.runs}
        return all(self.walks[run].completed for run in needed | {self.request.run})

    @property
    def notes(self) -> list[str]:
        """Notes on single levels."""
        notes = []
        for study in self.studies:
            for run, value in zip(study.runs, study.values, strict=True):
                walk, where = self.walks[run], f"{study.name}, {study.shown(value)}"
                if not walk.completed:
                    notes.append(f"{where}: {walk.outcome}, {walk.cause.rstrip('.') or 'no cause given'}.")
                elif unsolved := walk.values.get("failed_qp"):
                    notes.append(f"{where}: {unsolved:.0f} of the controller's QPs unsolved.")
        return list(dict.fromkeys(notes))

    def as_dict(self) -> dict[str, Any]:
        """Contents of ``convergence.json``."""
        known, levels = self.uncertainty, {}
        for study in self.studies:
            walks = [self.walks[run] for run in study.runs]
            levels[study.name] = {
                "kind": "numerical" if study.numerical else "input",
                "title": study.title,
                "key": study.key,
                "unit": study.unit,
                "values": study.values,
                "own": study.own,
                "ratio": study.ratio or None,
                "outcomes": [walk.outcome for walk in walks],
                "causes": [walk.cause or None for walk in walks],
                "seconds": [walk.seconds for walk in walks],
                "memory_peak": [walk.memory for walk in walks],
            }
        return {
            "gait": known.gait,
            "run": known.run,
            "steps": known.steps,
            "profile": self.verdict.profile,
            "verdict": self.verdict.name,
            "reason": self.verdict.reason,
            "notes": self.notes,
            "uncertainty_of": known.studies,
            "not_studied": known.not_studied,
            "levels": levels,
            "metrics": {name: metric.as_dict() for name, metric in self.metrics.items()},
            "parameters": known.parameters,
            "environment": describe_environment(),
        }


def combine(request: Request, profile: Profile, found: Sequence[Study], walks: Walks) -> Convergence:
    """Estimates of every metric from the walks of all levels, and the verdict.

    The errors of time step, grids and tolerances are not random and may have one sign, so their bounds are
    added. Contact parameters are independent inputs: their squares are added.
    """
    run, own, known = request.run, walks[request.run], studied_quantities()
    every, made = numerical_studies(run.solver.qp), tuple(study.name for study in found if study.numerical)
    studied = {name: _study(name, known[name], found, walks) for name in own.values}
    values: dict[str, float] = {}
    incomplete: dict[str, tuple[str, ...]] = {}
    for name, value in own.values.items():
        # The exact value of a self-check is zero: it measures the error of the time step.
        skipped = (TIME_STEP,) if known[name].is_self_check else every if studied[name]["exact"] else ()
        needed, estimates = [study for study in every if study not in skipped], studied[name]["estimates"]
        counted = [estimates[study].uncertainty for study in needed if study in estimates]
        if len(counted) < len(needed):
            incomplete[name] = tuple(study for study in needed if study not in estimates)
        if counted or not needed:  # what has no value has no bound
            total = math.fsum(counted)
            values[name] = math.inf if math.isnan(value + total) else total
    uncertainty = Uncertainty(
        gait=request.name,
        steps=run.gait.steps,
        run=run_key(parameter_values(run)),
        values=values,
        parameters=run.model_dump(),
        studies=made,
        not_studied=tuple(study for study in every if study not in made),
        incomplete=incomplete,
    )
    ended = "" if own.completed else f"The walk at the gait's own parameters {own.outcome}: {own.cause}"
    measured = {name: MetricValue(value, known[name].unit) for name, value in own.values.items()}
    verdict = judge(measured, profile, own.scales, uncertainty, ended=ended)
    metrics = {item.name: MetricStudy(**vars(item), **studied[item.name]) for item in verdict.metrics}
    return Convergence(request, tuple(found), walks, uncertainty, metrics, verdict)


def _study(name: str, known: StudiedQuantity, found: Sequence[Study], walks: Walks) -> dict[str, Any]:
    """Entries of :class:`MetricStudy` beyond the verdict."""
    levels: dict[str, tuple[float, ...]] = {}
    estimates: dict[str, Estimate] = {}
    inputs: dict[str, float] = {}
    for study in found:
        # NaN unless the walk completed
        ended = (walks[run].values if walks[run].completed else {} for run in study.runs)
        values = levels[study.name] = tuple(level.get(name, math.nan) for level in ended)
        if study.numerical:
            estimates[study.name] = estimate(values, study.ratio, forbidden=_NEVER.get(known.nature, ""))
        else:
            inputs[study.name] = input_uncertainty(values, study.own)
    exact, words = known.nature == "count", "counted in the very run that it judges: exact"
    if not exact:
        words = next((item.reason for item in estimates.values()), "no numerical study")
    if known.is_self_check and TIME_STEP in estimates:
        words += "; a self-check whose exact value is zero: the time step is what it measures, and no "
        words += "uncertainty of it"
    return {"levels": levels, "estimates": estimates, "inputs": inputs, "found": words, "exact": exact}
