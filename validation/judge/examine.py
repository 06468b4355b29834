"""From a record to a verdict: measurement, comparison, metrics."""

from __future__ import annotations

from collections.abc import Mapping
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

if TYPE_CHECKING:
    from validation.judge.uncertainty import Uncertainty
    from validation.trial.plan import PlannedWalk


@dataclass(frozen=True)
class Evaluation:
    """Evaluation of a walk.

    Attributes:
        comparison: measurement and plan.
        metrics: values of all registered metrics that the walk has.
        verdict: of the profile.
    """

    comparison: Comparison
    metrics: Mapping[str, MetricValue]
    verdict: Verdict


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
