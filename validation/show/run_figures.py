"""Plots of a saved run. Every function takes what the run folder holds and returns a matplotlib figure, drawn
within :func:`validation.show.style.style`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ampm.planner.contacts import footprint
from ampm.planner.support import StepPlan
from validation.judge.compare import PARTS as CAUSES
from validation.show.style import (
    BAD,
    COMMAND,
    FAINT,
    GOOD,
    INK,
    LEFT,
    MEASURED,
    PARTS,
    PLAN,
    RIGHT,
    SHADE,
    WIDTH,
    decimate,
    legend,
    new_figure,
)  # fmt: skip
from validation.store.saved import SavedRun
from validation.store.signals import Signals

Array = NDArray[np.float64]

# ---------------------------------------------------------------------------------------- preparation


@dataclass(frozen=True)
class Window:
    """A piece of the run, by rows of the signals: ``rows = slice(first, last)``."""

    first: int
    last: int

    @property
    def rows(self) -> slice:
        """The rows."""
        return slice(self.first, self.last)


def strides(signals: Signals) -> list[Window]:
    """Complete strides (two steps), each from the start of a left stance, the first step left out."""
    starts = signals.switches()
    phase, stance = signals["phase"], signals["stance"]
    left = [
        int(row) for row in starts if phase[row] == "single_support" and stance[row] == "left" and row > 0
    ]
    return [Window(a, b) for a, b in pairwise(left)]


def middle(signals: Signals) -> Window:
    """A stride from the middle of the run; the whole run if it has none."""
    all_strides = strides(signals)
    return all_strides[len(all_strides) // 2] if all_strides else Window(0, len(signals))


def shade_double_support(axis: Axes, signals: Signals, window: Window, *, origin: float = 0.0) -> None:
    """Shade the planned double supports."""
    starts = [int(s) for s in signals.switches()] + [len(signals)]
    step = _step(signals)
    for a, b in pairwise(starts):
        a, b = max(a, window.first), min(b, window.last)
        if a < b and signals["phase"][a] == "double_support":
            begin = float(signals.time[a]) - origin
            axis.axvspan(begin, begin + (b - a) * step, color=SHADE, linewidth=0, zorder=0)


def _step(signals: Signals) -> float:
    return float(signals.time[1] - signals.time[0]) if len(signals) > 1 else 0.0


def spread(signals: Signals, error: Array, window: Window) -> tuple[Array, Array]:
    """Smallest and largest ``error`` over all strides at the same instant of the stride.

    Returns:
        Two arrays as long as ``window``.
    """
    length = window.last - window.first
    folded = [error[s.first : s.first + length] for s in strides(signals)]
    folded = [part for part in folded if len(part) == length]
    if not folded:
        return error[window.rows], error[window.rows]
    stack = np.stack(folded)
    # Instants without contact have no ZMP in any stride.
    stack = np.where(np.isnan(stack).all(axis=0), 0.0, stack)
    return np.nanmin(stack, axis=0), np.nanmax(stack, axis=0)


# --------------------------------------------------------------------------------------------- curves


@dataclass(frozen=True)
class Curve:
    """A quantity that is planned, commanded and measured.

    Attributes:
        name: column without its prefix, e.g. ``zmp_x``.
        title: what it is.
        unit: unit in which it is drawn.
        scale: drawn value per SI value.
        about: column that is subtracted from the values, so that metres walked do not flatten the curve.
        residual_unit, residual_scale: of the error, where they differ.
    """

    name: str
    title: str
    unit: str
    scale: float = 1.0
    about: str | None = None
    residual_unit: str | None = None
    residual_scale: float | None = None


def tracking(
    signals: Signals,
    curve: Curve,
    *,
    tolerance_rmse: float | None = None,
    tolerance_maximum: float | None = None,
    extra: Callable[[Axes, Window], None] | None = None,
    reference: str = "plan",
) -> Figure:
    """Plan, command and measurement over one stride, and the error over the whole run.

    Args:
        signals: the run.
        curve: the quantity.
        tolerance_rmse: drawn as a band about zero, in ``residual_unit``.
        tolerance_maximum: drawn as two lines, in ``residual_unit``.
        extra: draws further curves into the upper axes.
        reference: what the measurement is compared with: prefix of its column.
    """
    figure, (upper, lower) = new_figure(3.9, 2, ratios=[3, 2])
    window = middle(signals)
    planned = signals[f"{reference}_{curve.name}"]
    error = signals[f"measured_{curve.name}"] - planned
    about = signals[curve.about] if curve.about is not None else np.zeros(len(signals))
    time = signals.time
    part = window.rows
    shade_double_support(upper, signals, window)
    if len(signals):
        low, high = spread(signals, error, window)
        base = (planned - about)[part]
        upper.fill_between(
            time[part], curve.scale * (base + low), curve.scale * (base + high),
            color=MEASURED, alpha=0.25, linewidth=0,
        )  # fmt: skip
    if extra is not None:
        extra(upper, window)
    for kind, color, width in (
        (reference, PLAN, 2.4),
        ("command", COMMAND, 1.1),
        ("measured", MEASURED, 1.1),
    ):
        column = f"{kind}_{curve.name}"
        if column in signals and np.isfinite(signals[column]).any():
            values = curve.scale * (signals[column] - about)
            upper.plot(time[part], values[part], color=color, linewidth=width, label=kind)
    upper.set_ylabel(f"[{curve.unit}]")
    upper.set_title(curve.title)
    legend(upper)

    scale = curve.scale if curve.residual_scale is None else curve.residual_scale
    unit = curve.unit if curve.residual_unit is None else curve.residual_unit
    lower.plot(*decimate(time, scale * error), color=MEASURED, linewidth=0.8)
    _band(lower, tolerance_rmse, tolerance_maximum)
    lower.set_ylabel(f"error [{unit}]")
    _over_time(signals, upper, lower)
    return figure


def _band(axis: Axes, rmse: float | None, maximum: float | None) -> None:
    """Draw tolerances about zero, without letting a wide one flatten the error."""
    axis.axhline(0.0, color=FAINT, linewidth=0.7)
    reach = 1.15 * max(abs(limit) for limit in axis.get_ylim())
    if rmse is not None:
        axis.axhspan(-rmse, rmse, color=GOOD, alpha=0.22, linewidth=0)
        reach = max(reach, 1.6 * rmse)
    if maximum is not None:
        if 0.4 * maximum < reach:
            reach = max(reach, 1.1 * maximum)
        for sign in (-1, 1):
            axis.axhline(sign * maximum, color=BAD, linewidth=0.9, linestyle=(0, (4, 3)))
    axis.set_ylim(-reach, reach)


def _over_time(signals: Signals, *axes: Axes) -> None:
    """Label the last axes, and mark in it where the first step, which is judged apart, ends."""
    for axis in axes:
        axis.margins(x=0)
    axes[-1].set_xlabel("time [s]")
    end = signals.first_step()
    if 0 < end < len(signals):
        axes[-1].axvline(float(signals.time[end]), color=FAINT, linewidth=0.8, linestyle=":")


def residuals(signals: Signals, columns: Mapping[str, Array], unit: str, title: str) -> Figure:
    """Several errors over the whole run in one axes.

    Args:
        signals: the run.
        columns: label to values (N,), in ``unit``.
        unit: of the values.
        title: of the axes.
    """
    figure, (axis,) = new_figure(2.3)
    axis.axhline(0.0, color=FAINT, linewidth=0.7)
    for (label, values), color in zip(columns.items(), PARTS, strict=False):
        axis.plot(*decimate(signals.time, values), color=color, linewidth=0.9, label=label)
    axis.set_ylabel(f"[{unit}]")
    axis.set_title(title)
    _over_time(signals, axis)
    legend(axis)
    return figure


# ------------------------------------------------------------------------------------------- the floor


def top_view(saved: SavedRun, plan: StepPlan | None, steps: int = 4) -> Figure:
    """ZMP and COM over the footprints, some steps from the middle of the run, seen from above."""
    signals = saved.signals
    starts = signals.switches()[::2]
    bounds = [*(int(s) for s in starts), len(signals)]
    begin = max(0, min(len(bounds) // 2 - steps // 2, len(bounds) - 1 - steps))
    window = Window(bounds[begin], bounds[min(begin + steps, len(bounds) - 1)])
    part = window.rows
    com = signals.vector("plan_com", "xy")[part]
    ahead, behind, side = 0.35, 0.35, 0.17
    low, high = (com[0, 0] - behind, com[-1, 0] + ahead) if len(com) else (-behind, ahead)
    width, left, top = 2 * WIDTH, 0.62, 0.24
    # As high as equal scales make it, plus legend and labels.
    inner = (width - left - 0.12) * 2 * side / (high - low)
    figure, (axis,) = new_figure(inner + top + 0.42, width=width, left=left, top=top)
    if plan is not None and len(com):
        for step in plan.contacts.footsteps:
            if com[0, 0] - 0.5 < step.position[0] < com[-1, 0] + 0.5:
                foot = footprint(plan.feet.sole, step)
                axis.fill(*foot.T, color=SHADE, linewidth=0)
                axis.plot(*foot.T, color=LEFT if step.foot == "left" else RIGHT, linewidth=0.9)
    for kind, color, width in (("plan", PLAN, 2.4), ("command", COMMAND, 1.0), ("measured", MEASURED, 1.0)):
        axis.plot(
            *signals.vector(f"{kind}_zmp", "xy")[part].T, color=color, linewidth=width, label=f"ZMP, {kind}"
        )
    for kind, color in (("plan", PLAN), ("measured", MEASURED)):
        xy = signals.vector(f"{kind}_com", "xy")[part]
        axis.plot(*xy.T, color=color, linewidth=1.0, linestyle=(0, (4, 2)), label=f"COM, {kind}")
    axis.set_aspect("equal")
    axis.set_xlim(low, high)
    axis.set_ylim(-side, side)
    axis.set_xlabel("x, forward [m]")
    axis.set_ylabel("y, left [m]")
    legend(axis)
    return figure


def contact_timeline(saved: SavedRun, plan: StepPlan | None) -> Figure:
    """Which part of which sole is on the floor: planned (line) and measured (bar), over one stride."""
    signals, record = saved.signals, saved.record
    window = middle(signals)
    part = window.rows
    time = signals.time[part]
    figure, (axis,) = new_figure(2.6, left=0.85, top=0.28)
    shade_double_support(axis, signals, window)
    planned = None
    if plan is not None and len(time):
        planned = [sample.contact for sample in plan.feet.sample(np.minimum(time, plan.duration))]
    ticks: list[tuple[float, str]] = []
    for foot, (name, color) in enumerate((("left", LEFT), ("right", RIGHT))):
        for group, region in enumerate(("heel", "ball", "tip")):
            row = -(3.5 * foot + group)
            points = (record.point_foot == foot) & (record.point_group == group)
            loaded = record.point_force[part][:, points, 2].max(axis=1, initial=0.0) > 1.0
            _bars(axis, time, loaded, row, 0.62, color=color, alpha=0.85)
            if planned is not None:
                _bars(axis, time, planned[foot][:, group], row, 0.14, color=INK, alpha=1.0)
            ticks.append((row, f"{name} {region}"))
    axis.set_yticks([t[0] for t in ticks], [t[1] for t in ticks])
    axis.grid(False, axis="y")
    axis.set_xlabel("time [s]")
    axis.margins(x=0)
    axis.set_title("Measured contact (bars) and planned contact (thin lines)")
    return figure


def _bars(axis: Axes, time: Array, on: NDArray[np.bool_], row: float, height: float, **style: Any) -> None:
    """Horizontal bars where ``on`` holds."""
    if not len(time):
        return
    edges = np.flatnonzero(np.diff(np.r_[False, on, False].astype(int)))
    step = float(time[1] - time[0]) if len(time) > 1 else 0.0
    spans = [(float(time[a]), float(time[b - 1]) - float(time[a]) + step) for a, b in edges.reshape(-1, 2)]
    axis.broken_barh(spans, (row - height / 2, height), linewidth=0, **style)


# ------------------------------------------------------------------------------------------------ cost


def torque_use(saved: SavedRun, count: int = 16) -> Figure:
    """Largest and RMS torque of the busiest motors, as shares of their limits."""
    record = saved.record
    figure, (axis,) = new_figure(3.9, left=1.45)
    share = 100.0 * np.abs(record.torque) / record.torque_limit
    if len(share):
        peak, rms = share.max(axis=0), np.sqrt((share**2).mean(axis=0))
        order = np.argsort(peak)[::-1][:count]
        rows = np.arange(len(order))
        axis.barh(rows, peak[order], height=0.7, color=PLAN, alpha=0.45, linewidth=0, label="largest")
        axis.barh(rows, rms[order], height=0.32, color=PLAN, linewidth=0, label="RMS")
        axis.set_yticks(rows, [record.joint_names[index] for index in order])
        axis.invert_yaxis()
        axis.set_xlim(0, max(100.0, 1.05 * float(peak.max())))
    axis.axvline(100.0, color=BAD, linewidth=0.9, linestyle=(0, (4, 3)))
    axis.grid(False, axis="y")
    axis.set_xlabel("torque [% of the motor's limit]")
    axis.set_title("The busiest motors")
    legend(axis)
    return figure


def qp_statistics(saved: SavedRun) -> Figure:
    """Wall-clock time of the controller's QP, and its residual at every tick."""
    record = saved.record
    figure, (upper, lower) = new_figure(3.9, 2, gap=0.6)
    micro = 1e6 * record.qp_time[np.isfinite(record.qp_time)]  # a controller of one's own may solve none
    if micro.size:
        # A few ticks are interrupted by other processes: they are counted in the last bar.
        top = max(min(float(micro.max()), 5.0 * float(np.median(micro))), 1e-3)
        upper.hist(np.minimum(micro, top), bins=60, range=(0.0, top), color=PLAN, linewidth=0)
        marks = {name: float(np.percentile(micro, share)) for share, name in ((50, "median"), (99, "99 %"))}
        for at in marks.values():
            if at <= top:
                upper.axvline(at, color=INK, linewidth=0.9, linestyle=":")
        shown = ", ".join(f"{name} {at:.0f} µs" for name, at in marks.items())
        upper.set_title(f"The controller's QP: {shown}")
        finite = np.where(record.qp_residual > 0, record.qp_residual, np.nan)
        if np.isfinite(finite).any():
            lower.plot(*decimate(record.tick_time, finite), color=PLAN, linewidth=0.7)
            lower.set_yscale("log")
        for status, color, label in ((1, COMMAND, "limits active"), (2, BAD, "unsolved")):
            rows = record.qp_status == status
            if rows.any():
                lower.plot(
                    record.tick_time[rows], np.full(rows.sum(), 0.04), ".", color=color, markersize=4,
                    transform=lower.get_xaxis_transform(), label=label,
                )  # fmt: skip
    upper.set_xlabel("time of a solve [µs]")
    upper.set_ylabel("ticks")
    lower.set_xlabel("time [s]")
    lower.set_ylabel("residual [1]")
    lower.margins(x=0)
    legend(lower)
    return figure


def zmp_error_split(signals: Signals, axis: str) -> Figure:
    """Causes of the ZMP error over one stride, stacked, with the error itself as a line."""
    figure, (axes,) = new_figure(2.7, top=0.6)
    window = middle(signals)
    rows = np.arange(window.first, window.last, max(1, (window.last - window.first) // 280))
    shade_double_support(axes, signals, window)
    if len(rows):
        parts = 1e3 * np.column_stack([signals[f"zmp_error_{part}_{axis}"][rows] for part in CAUSES])
        time = signals.time[rows]
        up, down = np.zeros(len(rows)), np.zeros(len(rows))
        for part, name, color in zip(np.nan_to_num(parts).T, CAUSES.values(), (*PARTS, FAINT), strict=True):
            rise, fall = np.maximum(part, 0.0), np.minimum(part, 0.0)
            axes.fill_between(time, up, up + rise, color=color, alpha=0.75, linewidth=0, label=name)
            axes.fill_between(time, down, down + fall, color=color, alpha=0.75, linewidth=0)
            up, down = up + rise, down + fall
        axes.plot(time, parts.sum(axis=1), color=INK, linewidth=1.1, label="error")
    axes.set_title(f"Causes of the ZMP error in {axis}")
    axes.set_ylabel("[mm]")
    axes.set_xlabel("time [s]")
    axes.margins(x=0)
    legend(axes, 3)
    return figure


def opening(signals: Signals, axis: str) -> Figure:
    """ZMP of the first step and the two after it, with its error."""
    figure, (upper, lower) = new_figure(3.3, 2, ratios=[3, 2])
    starts = signals.switches()
    window = Window(0, int(starts[6]) if len(starts) > 6 else len(signals))
    part = window.rows
    time = signals.time[part]
    about = signals["plan_com_x"][part] if axis == "x" else 0.0
    for panel in (upper, lower):
        shade_double_support(panel, signals, window)
    for kind, color, width in (("plan", PLAN, 2.4), ("command", COMMAND, 1.1), ("measured", MEASURED, 1.1)):
        values = 1e3 * (signals[f"{kind}_zmp_{axis}"][part] - about)
        upper.plot(time, values, color=color, linewidth=width, label=kind)
    error = 1e3 * (signals[f"measured_zmp_{axis}"] - signals[f"plan_zmp_{axis}"])[part]
    lower.axhline(0.0, color=FAINT, linewidth=0.7)
    lower.plot(time, error, color=MEASURED, linewidth=0.9)
    upper.set_ylabel("[mm]")
    upper.set_title("ZMP x about the planned COM" if axis == "x" else "ZMP y")
    lower.set_ylabel("error [mm]")
    _over_time(signals, upper, lower)
    legend(upper)
    return figure
