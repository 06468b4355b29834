"""The trial of one planned gait, in memory: walk, measurement, comparison, verdict."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

from validation.judge.compare import Comparison, compare
from validation.judge.profiles import DEFAULT, Profile
from validation.judge.verdict import Verdict, judge
from validation.measure.measure import MeasuredGait, measure
from validation.measure.standing import StandingCheck, weigh
from validation.trial.bridge import to_pinocchio
from validation.trial.record import SimulationRecord
from validation.trial.simulate import simulate

if TYPE_CHECKING:
    from collections.abc import Iterator

    import numpy as np
    from numpy.typing import NDArray

    from validation.trial.plan import PlannedWalk


@dataclass(frozen=True)
class Findings:
    """What a record says, beside its plan.

    Attributes:
        measured: blind to the plan.
        standing: the still body, weighed.
        comparison: with the plan.
        verdict: of the profile.
        motion_angular_momentum_z: of the whole-body motion at every row of forces, shape (K,) [N m s].
    """

    measured: MeasuredGait
    standing: StandingCheck
    comparison: Comparison
    verdict: Verdict
    motion_angular_momentum_z: NDArray[np.float64]


@dataclass(frozen=True)
class Walk:
    """A walked gait and what is found in it.

    Attributes:
        planned: plan and motion.
        record: of the simulation.
        findings: measurement, comparison and verdict.
        seconds: wall-clock time of ``simulation`` and ``measurement`` [s].
    """

    planned: PlannedWalk
    record: SimulationRecord
    findings: Findings
    seconds: Mapping[str, float]


def examine(
    planned: PlannedWalk,
    record: SimulationRecord,
    profile: Profile = DEFAULT,
    uncertainty: Mapping[str, float] | None = None,
    not_studied: Mapping[str, tuple[str, ...]] | None = None,
) -> Findings:
    """Measure, weigh, compare and judge.

    Args:
        planned: plan, body and motion.
        record: of its walk.
        profile: tolerances.
        uncertainty: numerical uncertainty of metrics in their SI units, see
        :func:`validation.judge.verdict.judge`.
        not_studied: metric to the studies that its uncertainty lacks.
    """
    run, body, posture = planned.run, planned.body, planned.plan.posture
    motion_z = posture.sample(record.time[:-1]).angular_momentum_z
    measured = measure(record, body.robot.model, to_pinocchio)
    standing = weigh(run, body.model, body.robot)
    comparison = compare(
        planned.plan,
        record,
        measured,
        description=body.model.description,
        motion_angular_momentum_z=motion_z,
        standing=standing,
    )
    verdict = judge(comparison, record.outcome, profile, uncertainty, not_studied)
    return Findings(measured, standing, comparison, verdict, motion_z)


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
        findings = examine(planned, record, profile)
    return Walk(planned, record, findings, MappingProxyType(seconds))


@contextmanager
def _timed(seconds: dict[str, float], label: str) -> Iterator[None]:
    start = time.perf_counter()
    yield
    seconds[label] = time.perf_counter() - start
