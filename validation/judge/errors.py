"""Measured minus planned at the same instant: error of each signal, and causes of the ZMP error.

Row k of the measurement is compared with the plan at t_k. Nothing is shifted, fitted or masked; the first
step, in which the controller meets the contact for the first time, is reported apart from the rest.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.planner.centroidal import PlanSample
    from ampm.walk import WalkPlan
    from validation.measure.measure import MeasuredGait

    Array = NDArray[np.float64]
    Rows = NDArray[np.bool_]

RUN = "run"
"""The window that is judged: the whole run without the first step."""
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


class Signal(NamedTuple):
    """One component of a measured vector, and its reference.

    Attributes:
        group: vector that it belongs to, such as ``zmp`` or ``left_foot``.
        axis: ``x``, ``y`` or ``z``.
        unit: SI unit.
        label: for tables and figures.
        meaning: of the error.
        scales: names of the reference quantities that its error is divided by.
        reference: ``plan``, or ``motion`` for what the plan does not have.
    """

    group: str
    axis: str
    unit: str
    label: str
    meaning: str
    scales: tuple[str, ...]
    reference: str = "plan"

    @property
    def name(self) -> str:
        """As in ``signals.parquet``."""
        return f"{self.group}_{self.axis}"


_MINUS = "measured minus planned"
_FOOT, _WEIGHT = ("foot_length",), ("body_weight",)
_MOMENTUM = ("mass_height_velocity", "mass_height_froude_velocity")
_YAW = "angular momentum about the vertical, measured minus that of the whole-body motion"
_VECTORS: tuple[tuple[str, str, str, str, str, tuple[str, ...]], ...] = (
    ("zmp", "xy", "m", "ZMP ", f"ZMP, {_MINUS}", _FOOT),
    ("force", "xyz", "N", "force F", f"net ground force, {_MINUS}", _WEIGHT),
    ("angular_momentum", "xy", "N m s", "momentum L", f"angular momentum about the COM, {_MINUS}", _MOMENTUM),
    ("angular_momentum", "z", "N m s", "momentum L", _YAW, _MOMENTUM),
    ("com", "xyz", "m", "COM ", f"COM, {_MINUS}", _FOOT),
    ("left_foot", "xyz", "m", "left foot ", f"left foot's reference point, {_MINUS}", _FOOT),
    ("right_foot", "xyz", "m", "right foot ", f"right foot's reference point, {_MINUS}", _FOOT),
)
SIGNALS = tuple(
    Signal(group, axis, unit, label + axis, meaning, scales, "motion" if meaning == _YAW else "plan")
    for group, axes, unit, label, meaning, scales in _VECTORS
    for axis in axes
)
"""All components that are compared."""


@dataclass(frozen=True)
class Statistics:
    """Error of one signal in one window, measured minus reference.

    Attributes:
        count: number of instants.
        unmeasured: instants among them that had no measurement; they are in no statistic.
        rmse: root mean square error [unit of the signal].
        maximum: largest absolute error.
        bias: mean error.
        r2: 1 - sum(error^2) / sum((reference - mean reference)^2); None where the reference does not vary.
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
        of: the signal.
        scales: name of a reference quantity to its value in the signal's unit; error over it is the
            normalised error.
        windows: window name to statistics.
    """

    of: Signal
    scales: Mapping[str, float]
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
        residual: largest deviation of the sum of parts from the error [m].
        rmse: part name to RMS over the run, x and y [m].
        share: part name to its share of the squared error over the run, x and y [1]; shares add up to 1 and
            may be negative, where a part makes up for others.
    """

    parts: Mapping[str, Array]
    residual: float
    rmse: Mapping[str, tuple[float, ...]]
    share: Mapping[str, tuple[float, ...]]


def find_windows(plan: WalkPlan, sample: PlanSample, measured: MeasuredGait) -> dict[str, Rows]:
    """Rows of every window of :data:`WINDOWS`, shape (K,) each."""
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


def reference_scales(plan: WalkPlan, measured: MeasuredGait) -> dict[str, float]:
    """Reference quantities that errors are divided by."""
    height, mass = plan.centroidal.com_height, measured.mass
    return {
        "body_weight": measured.weight,
        "mass_height_velocity": mass * height * plan.constants.mean_velocity,
        "mass_height_froude_velocity": mass * height * float(np.sqrt(measured.gravity * height)),
        "foot_length": plan.feet.sole.length,
    }


def compare_signals(
    plan: WalkPlan,
    sample: PlanSample,
    measured: MeasuredGait,
    rows: Mapping[str, Rows],
    scales: Mapping[str, float],
    momentum_z: Array,
) -> dict[str, SignalComparison]:
    """Errors of every component of :data:`SIGNALS`, by name; ``momentum_z`` is the posture's L_z."""
    planned_momentum = np.column_stack([sample.angular_momentum, momentum_z])
    left, right = plan.feet.sample(sample.time)
    pairs = {
        "zmp": (measured.zmp, sample.zmp),
        "force": (measured.force, sample.force),
        "angular_momentum": (measured.angular_momentum, planned_momentum),
        "com": (measured.com, sample.com),
        "left_foot": (measured.foot_position[:, 0], left.position),
        "right_foot": (measured.foot_position[:, 1], right.position),
    }
    found: dict[str, SignalComparison] = {}
    for signal in SIGNALS:
        column = "xyz".index(signal.axis)
        value, reference = (values[:, column] for values in pairs[signal.group])
        norm = {name: scales[name] for name in signal.scales}
        windows = {
            window: _statistics((value - reference)[used], reference[used], norm, signal.unit)
            for window, used in rows.items()
        }
        found[signal.name] = SignalComparison(signal, MappingProxyType(norm), MappingProxyType(windows))
    return found


def _statistics(error: Array, reference: Array, scales: Mapping[str, float], unit: str) -> Statistics:
    """Statistics of one window; a reference whose spread is tiny on its scale counts as constant."""
    known = np.isfinite(error)
    unmeasured = int(error.size - np.count_nonzero(known))
    if not known.any():
        reason = "no instant" if error.size == 0 else "not measured"
        return Statistics(error.size, unmeasured, math.nan, math.nan, math.nan, None, reason)
    error, reference = error[known], reference[known]
    squares = float(np.sum(error * error))
    r2, why = None, None
    if float(np.ptp(reference)) <= _CONSTANT * max(scales.values()):
        why = f"the reference does not vary: it is {reference[0]:.6g} {unit} throughout"
    else:
        r2 = 1.0 - squares / float(np.sum((reference - reference.mean()) ** 2))
    return Statistics(
        count=int(known.size),
        unmeasured=unmeasured,
        rmse=float(np.sqrt(squares / error.size)),
        maximum=float(np.abs(error).max()),
        bias=float(error.mean()),
        r2=r2,
        r2_reason=why,
    )


def split_zmp_error(sample: PlanSample, measured: MeasuredGait, rows: Rows) -> ZmpErrorSplit:
    """Split the ZMP error into its causes; RMS and shares over ``rows``, shape (K,)."""
    parts = {name: np.empty_like(measured.zmp) for name in PARTS}
    z_plan, z = sample.com[:, 2], measured.com_pin[:, 2]  # the COM that zmp_momentum was computed with
    supported = np.isfinite(measured.zmp_momentum[:, 0])
    u_plan, u = 1.0 / sample.force[:, 2], 1.0 / np.where(supported, measured.momentum_force[:, 2], np.nan)
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
    for array in parts.values():
        array.setflags(write=False)
    gap = np.abs(sum(parts.values()) - error)
    used = rows & np.isfinite(error).all(axis=1)
    squares = np.sum(error[used] ** 2, axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        rmse = {name: np.sqrt(np.sum(part[used] ** 2, axis=0) / used.sum()) for name, part in parts.items()}
        share = {name: np.sum(part[used] * error[used], axis=0) / squares for name, part in parts.items()}
    return ZmpErrorSplit(
        parts=MappingProxyType(parts),
        residual=float(np.nanmax(gap)) if np.isfinite(gap).any() else math.nan,
        rmse=MappingProxyType({name: tuple(pair.tolist()) for name, pair in rmse.items()}),
        share=MappingProxyType({name: tuple(pair.tolist()) for name, pair in share.items()}),
    )
