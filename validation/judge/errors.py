"""Measured minus planned at the same instant: error of each signal, and causes of the ZMP error.

Row k of the measurement is compared with the plan at t_k. Nothing is shifted, fitted or masked; the first
step, in which the controller meets the contact for the first time, is reported apart from the rest.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

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


@dataclass(frozen=True)
class Signal:
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
    scales: tuple[str, ...] = ("foot_length",)
    reference: str = "plan"

    @property
    def name(self) -> str:
        """As in ``signals.parquet``."""
        return f"{self.group}_{self.axis}"


_MOMENTUM = ("mass_height_velocity", "mass_height_froude_velocity")
_ABOUT_COM = "angular momentum about the COM, measured minus planned"
_YAW = "angular momentum about the vertical, measured minus that of the whole-body motion"
SIGNALS = (
    *(Signal("zmp", axis, "m", f"ZMP {axis}", "ZMP, measured minus planned") for axis in "xy"),
    *(
        Signal(
            "force", axis, "N", f"force F{axis}", "net ground force, measured minus planned", ("body_weight",)
        )
        for axis in "xyz"
    ),
    *(Signal("angular_momentum", axis, "N m s", f"momentum L{axis}", _ABOUT_COM, _MOMENTUM) for axis in "xy"),
    Signal("angular_momentum", "z", "N m s", "momentum Lz", _YAW, _MOMENTUM, "motion"),
    *(Signal("com", axis, "m", f"COM {axis}", "COM, measured minus planned") for axis in "xyz"),
    *(
        Signal(
            f"{side}_foot",
            axis,
            "m",
            f"{side} foot {axis}",
            f"{side} foot's reference point, measured minus planned",
        )
        for side in ("left", "right")
        for axis in "xyz"
    ),
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
    pairs = {
        "zmp": (measured.zmp, sample.zmp),
        "force": (measured.force, sample.force),
        "angular_momentum": (
            measured.angular_momentum,
            np.column_stack([sample.angular_momentum, momentum_z]),
        ),
        "com": (measured.com, sample.com),
    }
    for foot, name, path in zip(
        (0, 1), ("left_foot", "right_foot"), plan.feet.sample(sample.time), strict=True
    ):
        pairs[name] = (measured.foot_position[:, foot], path.position)
    found: dict[str, SignalComparison] = {}
    for signal in SIGNALS:
        values, references = pairs[signal.group]
        column = "xyz".index(signal.axis)
        error = values[:, column] - references[:, column]
        error.setflags(write=False)
        norm = {name: scales[name] for name in signal.scales}
        small = _CONSTANT * max(norm.values(), default=1.0)
        found[signal.name] = SignalComparison(
            name=signal.name,
            unit=signal.unit,
            reference=signal.reference,
            scales=MappingProxyType(norm),
            error=error,
            windows=MappingProxyType(
                {
                    window: _statistics(error[used], references[used, column], small, signal.unit)
                    for window, used in rows.items()
                }
            ),
        )
    return found


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


def split_zmp_error(sample: PlanSample, measured: MeasuredGait, rows: Rows) -> ZmpErrorSplit:
    """Split the ZMP error into its causes; RMS and shares over ``rows``, shape (K,)."""
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


def _pair(values: Array | list[float]) -> tuple[float, float]:
    return float(values[0]), float(values[1])
