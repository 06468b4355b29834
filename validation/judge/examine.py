"""The trial of one planned gait, in memory: walk, measurement, comparison, verdict."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

from validation.judge.compare import Comparison, compare
from validation.judge.metrics import MetricValue, evaluate
from validation.judge.profiles import DEFAULT, Profile
from validation.judge.verdict import Verdict, judge
from validation.measure.measure import measure
from validation.measure.standing import weigh
from validation.trial.bridge import to_pinocchio
from validation.trial.record import SimulationRecord
from validation.trial.simulate import simulate

if TYPE_CHECKING:
    from collections.abc import Iterator

    from validation.judge.uncertainty import Uncertainty
    from validation.trial.plan import PlannedWalk


@dataclass(frozen=True)
class Evaluation:
    """What a walk is found to be.

    Attributes:
        comparison: measurement and plan.
        metrics: values of all registered metrics that the walk has.
        verdict: of the profile.
    """

    comparison: Comparison
    metrics: Mapping[str, MetricValue]
    verdict: Verdict


@dataclass(frozen=True)
class Walk:
    """A walked gait and its evaluation.

    Attributes:
        planned: plan and body.
        record: of the simulation.
        evaluation: measurement, comparison, metrics and verdict.
        seconds: wall-clock time of ``simulation`` and ``measurement`` [s].
    """

    planned: PlannedWalk
    record: SimulationRecord
    evaluation: Evaluation
    seconds: Mapping[str, float]


def examine(
    planned: PlannedWalk,
    record: SimulationRecord,
    profile: Profile = DEFAULT,
    uncertainty: Uncertainty | None = None,
) -> Evaluation:
    """Measure, weigh, compare and judge.

    Args:
        planned: plan and body.
        record: of its walk.
        profile: tolerances.
        uncertainty: numerical uncertainty of the metrics, see :func:`validation.judge.verdict.judge`.
    """
    body = planned.body
    measured = measure(record, body.robot.model, to_pinocchio)
    standing = weigh(planned.run, body.model, body.robot)
    comparison = compare(
        planned.plan, record, measured, description=body.model.description, standing=standing
    )
    metrics = MappingProxyType(evaluate(comparison))
    return Evaluation(comparison, metrics, judge(comparison, metrics, profile, uncertainty))


def walk(
    planned: PlannedWalk,
    profile: Profile = DEFAULT,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> Walk:
    """Walk a planned gait and examine it; nothing is written.

    Args:
        planned: see :func:`validation.trial.plan.plan_walk`.
        profile: tolerances.
        progress: called with steps done and steps in all.
    """
    run, body = planned.request.run, planned.body
    seconds: dict[str, float] = {}
    with _timed(seconds, "simulation"):
        record = simulate(planned.plan, run, body.model, steps=run.gait.steps, progress=progress)
    with _timed(seconds, "measurement"):
        evaluation = examine(planned, record, profile)
    return Walk(planned, record, evaluation, MappingProxyType(seconds))


@contextmanager
def _timed(seconds: dict[str, float], label: str) -> Iterator[None]:
    start = time.perf_counter()
    yield
    seconds[label] = time.perf_counter() - start
