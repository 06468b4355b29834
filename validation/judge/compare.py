"""Measured minus planned, at the same instant, with units: what the verdict is spoken on.

Row k of the measurement is compared with the plan at t_k. Nothing is shifted, fitted or masked; the first
step, in which the controller meets the contact for the first time, is reported apart from the rest.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from ampm.exceptions import InputError
from validation.judge.margins import Energy, FeedbackEffort, Margins, energy, feedback_effort, margins

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.description import BodyDescription
    from ampm.planner.gait import GaitPlan, PlanSample
    from validation.measure.measure import MeasuredGait, StandingCheck
    from validation.trial.record import SimulationRecord

    Array = NDArray[np.float64]
    Rows = NDArray[np.bool_]

RUN = "run"
"""The window of every headline figure: the whole run without the first step."""
FIRST_STEP = "first_step"
WINDOWS = (
    RUN,
    FIRST_STEP,
    "single_support",
    "double_support",
    "measured_single_support",
    "measured_double_support",
    "measured_flight",
)
"""Planned phases and measured contacts divide :data:`RUN`."""

PARTS = ("com_position", "com_acceleration", "momentum_rate", "vertical_force", "instrument")
"""Parts of the ZMP error, in the order of :attr:`ZmpErrorSplit.parts`."""

_CONSTANT = 1e-9


@dataclass(frozen=True)
class Statistics:
    """Error of one signal in one window, measured minus reference.

    Attributes:
        count: number of instants.
        unmeasured: instants among them that had no measurement; they are in no figure.
        rmse: root mean square error [unit of the signal].
        maximum: largest absolute error.
        bias: mean error.
        r2: 1 - sum(error^2) / sum((reference - mean reference)^2); None where that says nothing.
        r2_reason: why ``r2`` is None.
    """

    count: int
    unmeasured: int
    rmse: float
    maximum: float
    bias: float
    r2: float | None
    r2_reason: str | None = None


@dataclass(frozen=True)
class SignalComparison:
    """One signal against its reference.

    Attributes:
        name: as in ``signals.parquet``.
        unit: SI unit of error and statistics.
        reference: ``plan``, or ``motion`` for what the plan does not have.
        scales: name of a reference quantity to its value in ``unit``; error over it is the normalised error.
        error: measured minus reference, shape (K,).
        windows: window name to statistics.
    """

    name: str
    unit: str
    reference: str
    scales: Mapping[str, float]
    error: Array
    windows: Mapping[str, Statistics]

    @property
    def run(self) -> Statistics:
        """The whole run without the first step."""
        return self.windows[RUN]


@dataclass(frozen=True)
class ZmpErrorSplit:
    """The ZMP error as a sum of causes, exact at every instant.

    With ``u = 1/F_z`` and ``N = z F_x + M_y`` the ZMP of plan and of momentum is ``x - N u``. A difference of
    products splits without remainder when each factor's difference is weighted with the other's mean over
    plan and measurement:

    - ``com_position``: ``dx - mean(u) mean(F_x) dz``
    - ``com_acceleration``: ``-mean(u) mean(z) dF_x``, with F_x = m x''
    - ``momentum_rate``: ``-mean(u) dM_y``
    - ``vertical_force``: ``-mean(N) du``
    - ``instrument``: contact ZMP minus momentum ZMP, which belongs to the measurement and not to the walk

    Lateral: F_y for F_x and -M_x for M_y. The split is symmetric in plan and measurement: no order of causes
    has to be chosen, as it would for replacing one after the other.

    Attributes:
        parts: part name to shape (K, 2) [m].
        error: contact ZMP minus plan, shape (K, 2) [m].
        residual: largest deviation of the sum of parts from the error [m].
        rmse: part name to RMS over the run, x and y [m].
        share: part name to its share of the squared error over the run, x and y [1]; shares add up to 1 and
            may be negative, where a part makes up for others.
    """

    parts: Mapping[str, Array]
    error: Array
    residual: float
    rmse: Mapping[str, tuple[float, float]]
    share: Mapping[str, tuple[float, float]]


@dataclass(frozen=True)
class Metric:
    """One figure that a tolerance may be set on, over the run without the first step.

    Attributes:
        value: NaN if it could not be measured.
        unit: SI unit.
        normalised: name of a reference quantity to value over it [1].
    """

    value: float
    unit: str
    normalised: Mapping[str, float]


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
        metrics: every figure that a tolerance can be set on.
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
    metrics: Mapping[str, Metric]
    scales: Mapping[str, float]


def compare(
    plan: GaitPlan,
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
    rows = _windows(plan, sample, measured)
    scales = _scales(plan, measured, description)
    signals = _signals(plan, sample, measured, rows, scales, motion_angular_momentum_z)
    split = _split_zmp_error(sample, measured, rows[RUN])
    metrics = _metrics(signals, record, measured, rows[RUN], scales)
    if standing is not None:
        metrics["standing_weight_error"] = Metric(standing.relative_error, "1", MappingProxyType({}))
    return Comparison(
        time=time,
        rows=MappingProxyType(rows),
        signals=MappingProxyType(signals),
        zmp_split=split,
        effort=feedback_effort(record, sample, rows[RUN]),
        effort_first_step=feedback_effort(record, sample, rows[FIRST_STEP]),
        margins=margins(plan, sample, record, measured, description),
        energy=energy(record, rows[RUN]),
        metrics=MappingProxyType(metrics),
        scales=MappingProxyType(scales),
    )


def _windows(plan: GaitPlan, sample: PlanSample, measured: MeasuredGait) -> dict[str, Rows]:
    run = measured.time >= plan.constants.step_duration - 1e-9
    feet = measured.foot_contact.sum(axis=1)
    return {
        RUN: run,
        FIRST_STEP: ~run,
        "single_support": run & (sample.phase == 0),
        "double_support": run & (sample.phase == 1),
        "measured_single_support": run & (feet == 1),
        "measured_double_support": run & (feet == 2),
        "measured_flight": run & (feet == 0),
    }


def _scales(plan: GaitPlan, measured: MeasuredGait, description: BodyDescription | None) -> dict[str, float]:
    height, mass = plan.parameters.com_height, measured.mass
    scales = {
        "body_weight": measured.weight,
        "mass_height_velocity": mass * height * plan.constants.mean_velocity,
        "mass_height_froude_velocity": mass * height * float(np.sqrt(measured.gravity * height)),
    }
    sole = description.sole if description is not None else plan.feet.sole if plan.feet is not None else None
    if sole is not None:
        scales["foot_length"] = sole.length
    return scales


def _signals(
    plan: GaitPlan,
    sample: PlanSample,
    measured: MeasuredGait,
    rows: Mapping[str, Rows],
    scales: Mapping[str, float],
    motion_z: Array | None,
) -> dict[str, SignalComparison]:
    length = {name: scales[name] for name in ("foot_length",) if name in scales}
    weight = {"body_weight": scales["body_weight"]}
    momentum = {name: scales[name] for name in ("mass_height_velocity", "mass_height_froude_velocity")}
    result: dict[str, SignalComparison] = {}

    def add(
        name: str, unit: str, values: Array, reference: Array, norm: Mapping[str, float], source: str = "plan"
    ) -> None:
        for column, axis in enumerate("xyz"[: reference.shape[1]]):
            key = f"{name}_{axis}"
            error = values[:, column] - reference[:, column]
            error.setflags(write=False)
            small = _CONSTANT * max(norm.values(), default=1.0)
            result[key] = SignalComparison(
                name=key,
                unit=unit,
                reference=source,
                scales=MappingProxyType(dict(norm)),
                error=error,
                windows=MappingProxyType(
                    {
                        window: _statistics(error[used], reference[used, column], small, unit)
                        for window, used in rows.items()
                    }
                ),
            )

    add("zmp", "m", measured.zmp, sample.zmp, length)
    add("force", "N", measured.force, sample.force, weight)
    add("angular_momentum", "N m s", measured.angular_momentum, sample.angular_momentum, momentum)
    if motion_z is not None:
        yaw = np.asarray(motion_z, dtype=np.float64)
        if yaw.shape != measured.time.shape:
            raise InputError(f"L_z of the motion has shape {yaw.shape}, expected {measured.time.shape}")
        padded = np.column_stack([np.zeros((yaw.size, 2)), yaw])
        known = dict(result)
        add("angular_momentum", "N m s", measured.angular_momentum, padded, momentum, "motion")
        result.update(known)  # x and y stay the plan's
    add("com", "m", measured.com, sample.com, length)
    if plan.feet is not None and measured.time.size:
        for index, (foot, path) in enumerate(
            zip(("left_foot", "right_foot"), plan.feet.sample(sample.time), strict=True)
        ):
            add(foot, "m", measured.foot_position[:, index], path.position, length)
    return result


def _statistics(error: Array, reference: Array, small: float, unit: str) -> Statistics:
    """Statistics of one window; ``small`` is the spread below which a reference counts as constant."""
    known = np.isfinite(error)
    unmeasured = int(error.size - np.count_nonzero(known))
    if not known.any():
        nan = float("nan")
        reason = "no instant" if error.size == 0 else "not measured"
        return Statistics(error.size, unmeasured, nan, nan, nan, None, reason)
    error, reference = error[known], reference[known]
    squares = float(np.sum(error * error))
    r2, reason_r2 = None, None
    if float(np.ptp(reference)) <= small:
        reason_r2 = f"the reference does not vary: it is {reference[0]:.6g} {unit} throughout"
    else:
        r2 = 1.0 - squares / float(np.sum((reference - reference.mean()) ** 2))
    return Statistics(
        count=int(known.size),
        unmeasured=unmeasured,
        rmse=float(np.sqrt(squares / error.size)),
        maximum=float(np.abs(error).max()),
        bias=float(error.mean()),
        r2=r2,
        r2_reason=reason_r2,
    )


def _split_zmp_error(sample: PlanSample, measured: MeasuredGait, rows: Rows) -> ZmpErrorSplit:
    parts = {name: np.empty_like(measured.zmp) for name in PARTS}
    z_plan, z = sample.com[:, 2], measured.com_pin[:, 2]  # the COM that zmp_momentum was computed with
    u_plan, u = (
        1.0 / sample.force[:, 2],
        1.0 / np.where(np.isfinite(measured.zmp_momentum[:, 0]), measured.momentum_force[:, 2], np.nan),
    )
    mean_u, mean_z = 0.5 * (u_plan + u), 0.5 * (z_plan + z)
    moments = (
        (sample.moment[:, 1], measured.angular_momentum_rate[:, 1]),
        (-sample.moment[:, 0], -measured.angular_momentum_rate[:, 0]),
    )
    for axis, (moment_plan, moment) in enumerate(moments):
        force_plan, force = sample.force[:, axis], measured.momentum_force[:, axis]
        total_plan, total = z_plan * force_plan + moment_plan, z * force + moment
        mean_force = 0.5 * (force_plan + force)
        shift = measured.com_pin[:, axis] - sample.com[:, axis]
        parts["com_position"][:, axis] = shift - mean_u * mean_force * (z - z_plan)
        parts["com_acceleration"][:, axis] = -mean_u * mean_z * (force - force_plan)
        parts["momentum_rate"][:, axis] = -mean_u * (moment - moment_plan)
        parts["vertical_force"][:, axis] = -0.5 * (total_plan + total) * (u - u_plan)
    parts["instrument"][:] = measured.zmp - measured.zmp_momentum
    error = measured.zmp - sample.zmp
    for array in (*parts.values(), error):
        array.setflags(write=False)
    gap = np.abs(sum(parts.values()) - error)
    used = rows & np.isfinite(error).all(axis=1)
    squares = np.sum(error[used] ** 2, axis=0)
    rmse, share = {}, {}
    for name, part in parts.items():
        rmse[name] = _pair(np.sqrt(np.mean(part[used] ** 2, axis=0)) if used.any() else [np.nan] * 2)
        with np.errstate(invalid="ignore", divide="ignore"):
            share[name] = _pair(np.sum(part[used] * error[used], axis=0) / squares)
    return ZmpErrorSplit(
        parts=MappingProxyType(parts),
        error=error,
        residual=float(np.nanmax(gap)) if np.isfinite(gap).any() else float("nan"),
        rmse=MappingProxyType(rmse),
        share=MappingProxyType(share),
    )


def _metrics(
    signals: Mapping[str, SignalComparison],
    record: SimulationRecord,
    measured: MeasuredGait,
    run: Rows,
    scales: Mapping[str, float],
) -> dict[str, Metric]:
    metrics: dict[str, Metric] = {}

    def add(name: str, value: float, unit: str, norm: Mapping[str, float] | None = None) -> None:
        normalised = {key: value / scale for key, scale in (norm or {}).items()}
        metrics[name] = Metric(float(value), unit, MappingProxyType(normalised))

    for name, signal in signals.items():
        add(f"{name}_rmse", signal.run.rmse, signal.unit, signal.scales)
        add(f"{name}_maximum", signal.run.maximum, signal.unit, signal.scales)
    length = {name: scales[name] for name in ("foot_length",) if name in scales}
    weight = {"body_weight": scales["body_weight"]}
    gap = np.linalg.norm((measured.zmp - measured.zmp_momentum)[run], axis=1)
    force_gap = np.linalg.norm((measured.force - measured.momentum_force)[run], axis=1)
    add("zmp_agreement_rmse", _rms(gap), "m", length)
    add("zmp_agreement_maximum", float(np.nanmax(gap)) if np.isfinite(gap).any() else np.nan, "m", length)
    add("force_agreement_rmse", _rms(force_gap), "N", weight)
    add("com_agreement_maximum", measured.self_checks.com_agreement, "m", length)
    add("angular_momentum_agreement_maximum", measured.self_checks.angular_momentum_agreement, "N m s")
    add("impulse_residual", abs(measured.self_checks.impulse_residual), "1")
    add("failed_qp", float(np.count_nonzero(record.qp_status == 2)), "1")
    add("unsupported_instants", float(np.count_nonzero(~np.isfinite(measured.zmp[run]).all(axis=1))), "1")
    return metrics


def _rms(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known * known))) if known.size else float("nan")


def _pair(values: Array | list[float]) -> tuple[float, float]:
    return float(values[0]), float(values[1])


def statistics_table(comparison: Comparison) -> dict[str, dict[str, dict[str, float | int | str | None]]]:
    """Signal to window to statistics, with normalised figures, as plain data for JSON and reports.

    Normalised figures are named after what they are divided by: ``rmse_per_foot_length``.
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
                for figure in ("rmse", "maximum", "bias"):
                    entry[f"{figure}_per_{scale}"] = getattr(statistics, figure) / value
            table[name][window] = entry
    return table
