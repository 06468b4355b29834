"""Comparison of a run with its plan: what the verdict is spoken on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import TYPE_CHECKING

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
from validation.judge.metrics import Evidence, evaluate

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.description import BodyDescription
    from ampm.planner.support import StepPlan
    from validation.judge.errors import SignalComparison, ZmpErrorSplit
    from validation.judge.margins import Energy, FeedbackEffort, Margins
    from validation.judge.metrics import MetricValue
    from validation.measure.measure import MeasuredGait, StandingCheck
    from validation.trial.record import SimulationRecord

    Array = NDArray[np.float64]
    Rows = NDArray[np.bool_]


@dataclass(frozen=True)
class Comparison:
    """All that is said about a run, apart from whether it is good enough.

    Attributes:
        time: instants compared, shape (K,) [s].
        rows: window name to rows, shape (K,), bool.
        signals: name to comparison.
        zmp_split: causes of the ZMP error.
        effort: command minus plan, over the run without the first step.
        effort_first_step: the same for the first step.
        margins: distance to limits.
        energy: work of the motors.
        metrics: value of every registered metric that the run has.
        scales: body weight [N], foot length [m] and the like, used for normalising.
    """

    time: Array
    rows: Mapping[str, Rows]
    signals: Mapping[str, SignalComparison]
    zmp_split: ZmpErrorSplit
    effort: FeedbackEffort
    effort_first_step: FeedbackEffort
    margins: Margins
    energy: Energy
    metrics: Mapping[str, MetricValue]
    scales: Mapping[str, float]


def compare(
    plan: StepPlan,
    record: SimulationRecord,
    measured: MeasuredGait,
    *,
    description: BodyDescription | None = None,
    motion_angular_momentum_z: Array | None = None,
    standing: StandingCheck | None = None,
) -> Comparison:
    """Compare a run with its plan.

    Args:
        plan: the plan that was walked, with the constant of L_y of the motion.
        record: the run; a run that ended early is compared as far as it went.
        measured: its measurement.
        description: names the knees and gives the foot's length.
        motion_angular_momentum_z: L_z of the periodic whole-body motion at t_k, shape (K,) [N m s]; the plan
            has none.
        standing: the same body weighed with the same instrument while it stands still.

    Raises:
        InputError: the run is longer than the plan, or the measurement is of another run.
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
    rows = find_windows(plan, sample, measured)
    scales = reference_scales(plan, measured, description)
    evidence = Evidence(
        plan=plan,
        sample=sample,
        record=record,
        measured=measured,
        standing=standing,
        signals=MappingProxyType(
            compare_signals(plan, sample, measured, rows, scales, motion_angular_momentum_z)
        ),
        margins=margins(plan, sample, record, measured, description),
        effort=feedback_effort(record, sample, rows[RUN]),
        energy=energy(record, rows[RUN]),
        rows=MappingProxyType(rows),
        scales=MappingProxyType(scales),
    )
    return Comparison(
        time=time,
        rows=evidence.rows,
        signals=evidence.signals,
        zmp_split=split_zmp_error(sample, measured, rows[RUN]),
        effort=evidence.effort,
        effort_first_step=feedback_effort(record, sample, rows[FIRST_STEP]),
        margins=evidence.margins,
        energy=evidence.energy,
        metrics=MappingProxyType(evaluate(evidence)),
        scales=evidence.scales,
    )


def statistics_table(comparison: Comparison) -> dict[str, dict[str, dict[str, float | int | str | None]]]:
    """Signal to window to statistics, with normalised values, as plain data for JSON and reports.

    Normalised values are named after what they are divided by: ``rmse_per_foot_length``.
    """
    table: dict[str, dict[str, dict[str, float | int | str | None]]] = {}
    for name, signal in comparison.signals.items():
        table[name] = {}
        for window, statistics in signal.windows.items():
            entry: dict[str, float | int | str | None] = {
                item.name: getattr(statistics, item.name) for item in fields(statistics)
            }
            entry["unit"] = signal.unit
            entry["reference"] = signal.reference
            for scale, value in signal.scales.items():
                for statistic in ("rmse", "maximum", "bias"):
                    entry[f"{statistic}_per_{scale}"] = getattr(statistics, statistic) / value
            table[name][window] = entry
    return table
