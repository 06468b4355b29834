"""Comparison of a walk with its plan: what metrics are computed from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from ampm.exceptions import InputError
from validation.judge.errors import (
    FIRST_STEP,
    RUN,
    compare_signals,
    find_windows,
    reference_scales,
    split_zmp_error,
)
from validation.judge.margins import energy, feedback_effort, margins

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.description import BodyDescription
    from ampm.planner.centroidal import PlanSample
    from ampm.walk import WalkPlan
    from validation.judge.errors import SignalComparison, ZmpErrorSplit
    from validation.judge.margins import Energy, FeedbackEffort, Margins
    from validation.measure.measure import MeasuredGait, StandingCheck
    from validation.trial.record import SimulationRecord

    Array = NDArray[np.float64]
    Rows = NDArray[np.bool_]


@dataclass(frozen=True)
class Comparison:
    """A walk beside its plan.

    Attributes:
        plan: that was walked.
        record: of the simulation.
        measured: what the record says, blind to the plan.
        standing: the same body weighed while it stands still; None if it was not.
        sample: the plan at the measured instants t_k, K of them.
        momentum_z: L_z of the planned posture at t_k, shape (K,) [N m s].
        rows: window name to rows, shape (K,), see :data:`validation.judge.errors.WINDOWS`.
        scales: reference quantities that errors are divided by, such as ``body_weight`` [N].
        signals: error of every compared signal, by name.
        zmp_split: causes of the ZMP error.
        effort: command minus plan, without the first step.
        effort_first_step: the same for the first step.
        margins: distances to the limits of body and floor, first step included.
        energy: work of the motors, without the first step.
        window: name of the window that a metric is wanted for.
    """

    plan: WalkPlan
    record: SimulationRecord
    measured: MeasuredGait
    standing: StandingCheck | None
    sample: PlanSample
    momentum_z: Array
    rows: Mapping[str, Rows]
    scales: Mapping[str, float]
    signals: Mapping[str, SignalComparison]
    zmp_split: ZmpErrorSplit
    effort: FeedbackEffort
    effort_first_step: FeedbackEffort
    margins: Margins
    energy: Energy
    window: str = RUN

    @property
    def time(self) -> Array:
        """Instants compared, shape (K,) [s]."""
        return self.measured.time

    @property
    def inside(self) -> Rows:
        """Rows of the window, shape (K,)."""
        return self.rows[self.window]


def compare(
    plan: WalkPlan,
    record: SimulationRecord,
    measured: MeasuredGait,
    *,
    description: BodyDescription | None = None,
    standing: StandingCheck | None = None,
) -> Comparison:
    """Compare a walk with its plan.

    Args:
        plan: the plan that was walked.
        record: the walk; one that ended early is compared as far as it went.
        measured: its measurement.
        description: names the knees.
        standing: the same body weighed with the same instrument while it stands still.

    Raises:
        InputError: the walk is longer than the plan, or the measurement is of another walk.
    """
    time = measured.time
    if time.size != record.steps:
        raise InputError(
            f"the measurement has {time.size} steps and the record {record.steps}; measure this very record"
        )
    if time.size and time[-1] > plan.duration + 1e-9:
        raise InputError(
            f"the record lasts until {time[-1]:.6g} s, the plan only {plan.duration:.6g} s; "
            "compare the run with the plan that was walked"
        )
    sample = plan.sample(np.minimum(time, plan.duration))
    momentum_z = plan.posture.sample(time).angular_momentum_z
    rows = find_windows(plan, sample, measured)
    scales = reference_scales(plan, measured)
    return Comparison(
        plan=plan,
        record=record,
        measured=measured,
        standing=standing,
        sample=sample,
        momentum_z=momentum_z,
        rows=MappingProxyType(rows),
        scales=MappingProxyType(scales),
        signals=MappingProxyType(compare_signals(plan, sample, measured, rows, scales, momentum_z)),
        zmp_split=split_zmp_error(sample, measured, rows[RUN]),
        effort=feedback_effort(record, sample, rows[RUN]),
        effort_first_step=feedback_effort(record, sample, rows[FIRST_STEP]),
        margins=margins(plan, sample, record, measured, description),
        energy=energy(record, rows[RUN]),
    )


def statistics_table(comparison: Comparison) -> dict[str, dict[str, dict[str, Any]]]:
    """Signal to window to statistics, with normalised values, as plain data for JSON and reports.

    Normalised values are named after what they are divided by: ``rmse_per_foot_length``.
    """
    return {
        name: {
            window: {
                **vars(statistics),
                "unit": signal.of.unit,
                "reference": signal.of.reference,
                **{
                    f"{statistic}_per_{scale}": getattr(statistics, statistic) / value
                    for scale, value in signal.scales.items()
                    for statistic in ("rmse", "maximum", "bias")
                },
            }
            for window, statistics in signal.windows.items()
        }
        for name, signal in comparison.signals.items()
    }
