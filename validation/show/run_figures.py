"""All pictures of a run's report, from its files."""

from collections.abc import Mapping
from itertools import count, pairwise
from typing import Any

import mujoco
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ampm.body.limits import CLEARANCE
from ampm.description import SOLE_POINT_GROUPS
from ampm.geometry import Array
from ampm.planner.contacts import footprint
from ampm.planner.support import StepPlan
from validation.judge.compare import PARTS as CAUSES
from validation.judge.compare import SIGNALS
from validation.judge.margins import clearance_over_time
from validation.show import style
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
    Picture,
    decimate,
    legend,
    new_figure,
)
from validation.store.saved import SavedRun
from validation.store.signals import Signals
from validation.trial.record import state_steps
from validation.trial.shapes import REACH, Shapes

_DASHED = (0, (4, 3))
_FEET = {"left": LEFT, "right": RIGHT}
_KINDS = (("plan", PLAN, 2.4), ("command", COMMAND, 1.1), ("measured", MEASURED, 1.1))
"""Kind, colour and width of a curve; the plan is a broad line below the others."""


def strides(signals: Signals) -> list[slice]:
    """Rows of complete strides (two steps), each from the start of a left stance, the first step left out."""
    phase, stance = signals["phase"], signals["stance"]
    left = [row for row in signals.switches()[1:] if (phase[row], stance[row]) == ("single_support", "left")]
    return [slice(int(a), int(b)) for a, b in pairwise(left)]


def middle(signals: Signals) -> slice:
    """Rows of a stride from the middle of the run; the whole run if it has none."""
    found = strides(signals)
    return found[len(found) // 2] if found else slice(0, len(signals))


def shade_double_support(axis: Axes, signals: Signals, window: slice, *, from_zero: bool = False) -> None:
    """Shade the planned double supports, on the clock of the walk or from 0 on."""
    first = float(signals.time[window.start]) if from_zero else 0.0
    step = float(signals.time[1] - signals.time[0]) if len(signals) > 1 else 0.0
    for a, b in pairwise([*signals.switches().tolist(), len(signals)]):
        a, b = max(a, window.start), min(b, window.stop)
        if a < b and signals["phase"][a] == "double_support":
            begin = float(signals.time[a]) - first
            axis.axvspan(begin, begin + (b - a) * step, color=SHADE, linewidth=0, zorder=0)


class RunFigures:
    """Draws the pictures of one run; colours are those of :mod:`validation.show.style`.

    Attributes:
        saved: the run.
        plan: evaluated again, None if that cannot be done.
        signals: of the run.
        window: rows of the stride that is shown.
        from_rest: whether the walk begins with standing; its steps may differ.
    """

    def __init__(self, saved: SavedRun, plan: StepPlan | None) -> None:
        self.saved, self.plan, self.signals = saved, plan, saved.signals
        self.window = middle(self.signals)
        self.from_rest = saved.from_rest
        self._count = count()

    def sections(self) -> dict[str, list[Picture]]:
        """All pictures, by section of the page."""
        weight = self.saved.record.mass * self.saved.record.gravity
        momentum = "Angular momentum {} about the COM"
        measured = {  # a log may lack some
            name.removeprefix("measured_"): np.isfinite(values).any()
            for name, values in self.signals.columns.items()
            if name.startswith("measured_")
        }
        found = {
            "zmp": [
                self.tracking(
                    "zmp_x",
                    *self._about("x"),
                    caption="Green band: plus and minus the tolerance of the RMSE. Dashed, where the axis "
                    "reaches so far: the largest error allowed.",
                ),
                self.tracking("zmp_y", *self._about("y")),
            ]
            if measured["zmp_x"]
            else [],
            "split": [] if self.saved.is_log else [self.causes(axis) for axis in "xy"],
            "above": [self.top_view()],
            "force": [
                self.tracking(f"force_{axis}", f"Ground force {axis}", "N", error=("% BW", 100.0 / weight))
                for axis in "xyz"
            ],
            "contact": [] if self.saved.is_log else [self.contact_timeline()],
            "momentum": [
                self.tracking(f"angular_momentum_{axis}", momentum.format(axis), "N m s")
                for axis in "xy"
                if measured[f"angular_momentum_{axis}"]
            ],
            "com": [
                self.difference("measured_com", "plan_com", "xyz", "COM error", "COM error in x, y and z")
            ]
            if measured["com_x"]
            else [],
            "check": [
                self.difference(
                    "measured_zmp_momentum",
                    "measured_zmp",
                    "xy",
                    "ZMP by momentum − ZMP by contact",
                    "Difference of the two measured ZMPs",
                )
            ]
            if measured["zmp_momentum_x"]
            else [],
            "cost": [] if self.saved.is_log else [self.torque_use(), self.clearance()],
        }
        if np.isfinite(self.signals["motion_angular_momentum_z"]).any() and measured["angular_momentum_z"]:
            caption = "AMPM does not plan it; the reference is the whole-body motion."
            found["momentum"].append(
                self.tracking(
                    "angular_momentum_z", momentum.format("z"), "N m s", reference="motion", caption=caption
                )
            )
        if np.isfinite(self.signals["command_zmp_x"]).any():  # a user's controller may report no command
            title, label = "Feedback: commanded − planned ZMP", "Commanded minus planned ZMP"
            found["cost"].append(self.difference("command_zmp", "plan_zmp", "xy", title, label))
        return found

    def tracking(
        self,
        name: str,
        title: str,
        unit: str,
        scale: float = 1.0,
        about: str = "",
        *,
        error: tuple[str, float] | None = None,
        reference: str = "plan",
        caption: str = "",
    ) -> Picture:
        """Error over one stride, large; below it plan and measurement, and the error over the whole run.

        Args:
            name: column without its prefix, e.g. ``zmp_x``.
            title: what it is.
            unit: in which it is drawn.
            scale: drawn value per SI value.
            about: column that is subtracted from the values, because the travel would flatten the curve.
            error: unit and scale of the error, where they differ.
            reference: what the measurement is compared with: prefix of its column.
            caption: explanation.
        """
        figure, (large, lower, whole) = new_figure(6.2, 3, top=0.28, gap=0.76, ratios=[5, 2.5, 2])
        signals, rows = self.signals, self.window
        planned = signals[f"{reference}_{name}"]
        gap = signals[f"measured_{name}"] - planned
        base = signals[about] if about else np.zeros(len(signals))
        time = signals.time[rows]
        unit_of_error, scale_of_error = error or (unit, scale)
        low, high = self._spread(scale_of_error * gap)
        large.fill_between(time, low, high, color=MEASURED, alpha=0.25, linewidth=0)
        large.plot(time, scale_of_error * gap[rows], color=MEASURED)
        whole.plot(*decimate(signals.time, scale_of_error * gap), color=MEASURED, linewidth=0.8)
        for axis in (large, whole):
            _draw_tolerances(axis, self._tolerance(f"{name}_rmse"), self._tolerance(f"{name}_maximum"))
        for axis in (large, lower):
            shade_double_support(axis, signals, rows)
        for foot, color in _FEET.items():
            if f"{foot}_{name}" in signals:
                values = scale * signals[f"{foot}_{name}"][rows]
                lower.plot(time, values, color=color, linewidth=0.9, label=f"{foot} foot")
        first = (f"first_{reference}", FAINT, 1.1)  # of a plan that moved
        for kind, color, width in ((reference, *_KINDS[0][1:]), first, *_KINDS[1:]):
            column = f"{kind}_{name}"
            if column in signals and np.isfinite(signals[column]).any():
                values = scale * (signals[column] - base)
                label = kind.replace("_", " ")
                lower.plot(time, values[rows], color=color, linewidth=width, label=label)
        error_title = f"Error of {SIGNALS[name].label}"
        _finish(large, f"{error_title}, two steps", f"[{unit_of_error}]")
        _finish(lower, title, f"[{unit}]")
        self._finish_run(whole, f"{error_title}, whole run", f"[{unit_of_error}]")
        label = f"{title}: error over two steps, plan and measurement, error over the whole run"
        return self._picture(figure, label, caption)

    def _about(self, axis: str) -> tuple[str, str, float, str]:
        """Title, unit, scale of the ZMP along an axis; the column it is drawn about where it travels."""
        if axis == "x" or self.from_rest:
            return f"ZMP {axis} about the planned COM", "mm", 1e3, f"plan_com_{axis}"
        return f"ZMP {axis}", "mm", 1e3, ""

    def difference(self, measured: str, planned: str, axes: str, title: str, label: str) -> Picture:
        """Difference of two vectors in millimetres, over the whole run."""
        figure, (axis,) = new_figure(2.3)
        axis.axhline(0.0, color=FAINT, linewidth=0.7)
        error = 1e3 * (self.signals.vector(measured, axes) - self.signals.vector(planned, axes))
        for name, values, color in zip(axes, error.T, PARTS, strict=False):
            axis.plot(*decimate(self.signals.time, values), color=color, linewidth=0.9, label=name)
        self._finish_run(axis, title, "[mm]")
        return self._picture(figure, label)

    def causes(self, axis: str) -> Picture:
        """Causes of the ZMP error over one stride, stacked, with the error itself as a line."""
        figure, (axes,) = new_figure(2.7, top=0.6)
        begin, end = self.window.start, self.window.stop
        rows = np.arange(begin, end, max(1, (end - begin) // 280))
        shade_double_support(axes, self.signals, self.window)
        parts = 1e3 * np.column_stack([self.signals[f"zmp_error_{part}_{axis}"][rows] for part in CAUSES])
        time = self.signals.time[rows]
        up, down = np.zeros(len(rows)), np.zeros(len(rows))
        for part, name, color in zip(np.nan_to_num(parts).T, CAUSES.values(), (*PARTS, FAINT), strict=True):
            rise, fall = np.maximum(part, 0.0), np.minimum(part, 0.0)
            axes.fill_between(time, up, up + rise, color=color, alpha=0.75, linewidth=0, label=name)
            axes.fill_between(time, down, down + fall, color=color, alpha=0.75, linewidth=0)
            up, down = up + rise, down + fall
        axes.plot(time, parts.sum(axis=1), color=INK, linewidth=1.1, label="error")
        _finish(axes, f"Causes of the ZMP error in {axis}", "[mm]", columns=3)
        return self._picture(figure, f"Causes of the ZMP error in {axis}, stacked")

    def top_view(self, steps: int = 4) -> Picture:
        """ZMP and COM over the footprints, seen from above: some steps from the middle, or all from rest."""
        whole = self.from_rest
        bounds = [*self.signals.switches()[::2].tolist(), len(self.signals)]
        begin = max(0, min(len(bounds) // 2 - steps // 2, len(bounds) - 1 - steps))
        part = slice(bounds[begin], bounds[min(begin + steps, len(bounds) - 1)])
        part = slice(None) if whole else part

        def points(name: str) -> Array:
            return self.signals.vector(name, "xy")[part]

        com, middle, side = points("plan_com"), 0.0, 0.17
        low, high = com[0, 0] - 0.35, com[-1, 0] + 0.35
        if whole:  # in any direction; at most half as high as wide
            (low, bottom), (high, top_) = com.min(axis=0) - 0.35, com.max(axis=0) + 0.35
            middle, side = 0.5 * (bottom + top_), 0.5 * (top_ - bottom)
            wider = max(0.0, 2.0 * side - 0.5 * (high - low))
            low, high = low - wider, high + wider
        width, left, top = 2 * WIDTH, 0.62, 0.24
        # As high as equal scales make it, plus legend and labels.
        inner = (width - left - 0.12) * 2 * side / (high - low)
        figure, (axis,) = new_figure(inner + top + 0.42, width=width, left=left, top=top)
        if self.plan is not None:
            for step in self.plan.contacts.footsteps:
                if low - 0.15 < step.position[0] < high + 0.15:
                    foot = footprint(self.plan.feet.sole, step)
                    axis.fill(*foot.T, color=SHADE, linewidth=0)
                    axis.plot(*foot.T, color=_FEET[step.foot], linewidth=0.9)
        for kind, color, thick in _KINDS:
            axis.plot(*points(f"{kind}_zmp").T, color=color, linewidth=thick, label=f"ZMP, {kind}")
        for kind, color in (("plan", PLAN), ("measured", MEASURED)):
            x, y = points(f"{kind}_com").T
            axis.plot(x, y, color=color, linewidth=1.0, linestyle=(0, (4, 2)), label=f"COM, {kind}")
        axis.set(aspect="equal", xlim=(low, high), ylim=(middle - side, middle + side))
        axis.set(xlabel="x, forward [m]", ylabel="y, left [m]")
        legend(axis)
        label = "ZMP and COM over the footprints, seen from above"
        caption = "The whole walk." if whole else "Four steps from the middle of the run."
        return self._picture(figure, label, caption, wide=True)

    def contact_timeline(self) -> Picture:
        """Contact of the parts of both soles over one stride, every 10 ms: planned (line), measured (bar)."""
        record, shown = self.saved.record, self.signals.time[self.window]
        stored = record.state_rows[:-1] * record.time_step
        rows = np.flatnonzero((stored >= shown.min(initial=np.inf)) & (stored <= shown.max(initial=-np.inf)))
        time, apart = stored[rows], state_steps(record.time_step) * record.time_step
        figure, (axis,) = new_figure(2.6, left=0.85, top=0.28)
        shade_double_support(axis, self.signals, self.window)

        def bars(on: NDArray[np.bool_], at: float, height: float, color: str, alpha: float) -> None:
            edges = np.flatnonzero(np.diff(np.r_[False, on, False].astype(int))).reshape(-1, 2)
            spans = [(float(time[a]), float((b - a) * apart)) for a, b in edges]
            axis.broken_barh(spans, (at - height / 2, height), linewidth=0, color=color, alpha=alpha)

        planned = None
        if self.plan is not None:
            planned = self.plan.feet.sample(np.minimum(time, self.plan.duration))
        ticks: dict[str, float] = {}
        force = record.point_force[rows]
        for foot, (name, color) in enumerate(_FEET.items()):
            for group, region in enumerate(SOLE_POINT_GROUPS):
                points = (record.point_foot == foot) & (record.point_group == group)
                if not points.any():
                    continue
                at = ticks[f"{name} {region}"] = -(3.5 * foot + group)
                loaded = force[:, points, 2].max(axis=1, initial=0.0) > 1.0
                bars(loaded, at, 0.62, color, 0.85)
                if planned is not None:
                    bars(planned[foot].contact[:, group], at, 0.14, INK, 1.0)
        axis.set_yticks(list(ticks.values()), list(ticks))
        axis.grid(False, axis="y")
        _finish(axis, "Measured contact (bars) and planned contact (thin lines)", "")
        return self._picture(figure, "Contact of heel, ball and tip of both feet")

    def torque_use(self, most: int = 16) -> Picture:
        """Largest and RMS torque of the busiest motors, as shares of their limits."""
        record = self.saved.record
        figure, (axis,) = new_figure(3.9, left=1.45)
        peak, rms = np.empty((2, len(record.joint_names)))
        for joint, limit in enumerate(record.torque_limit):
            share = 100.0 * np.abs(record.tick_torque[:, joint]) / limit
            peak[joint], rms[joint] = share.max(), np.sqrt((share**2).mean())
        order = np.argsort(peak)[::-1][:most]
        rows = np.arange(len(order))
        axis.barh(rows, peak[order], height=0.7, color=PLAN, alpha=0.45, linewidth=0, label="largest")
        axis.barh(rows, rms[order], height=0.32, color=PLAN, linewidth=0, label="RMS")
        axis.set_yticks(rows, [record.joint_names[index] for index in order])
        axis.invert_yaxis()
        axis.set_xlim(0, max(100.0, 1.05 * float(peak.max())))
        axis.axvline(100.0, color=BAD, linewidth=0.9, linestyle=_DASHED)
        axis.grid(False, axis="y")
        axis.set(xlabel="torque [% of the motor's limit]", title="The busiest motors")
        legend(axis)
        return self._picture(figure, "Torque of the busiest motors")

    def clearance(self) -> Picture:
        """Least distance of two parts of the body over the whole run, with its limit."""
        figure, (axis,) = new_figure(2.3)
        shapes = Shapes(mujoco.MjModel.from_xml_string(self.saved.model_xml))
        time, gaps = clearance_over_time(self.saved.record, shapes)
        axis.plot(*decimate(time, 1e3 * gaps.distance), color=MEASURED, linewidth=0.9)
        limit = 1e3 * CLEARANCE
        axis.axhline(limit, color=BAD, linewidth=0.9, linestyle=_DASHED, label=f"limit, {limit:g} mm")
        axis.set_ylim(bottom=min(0.0, 1.1e3 * float(gaps.distance.min())))
        self._finish_run(axis, "Least distance of two parts of the body", "[mm]")
        closest = gaps.parts[int(gaps.distance.argmin())]
        caption = f"Arms, legs and trunk; {1e3 * REACH:g} mm where nothing is nearer."
        label = "Least distance of two parts of the body over the run, and its limit"
        return self._picture(figure, label, f"{caption} Closest: {closest}." if closest else caption)

    def _picture(self, figure: Figure, label: str, caption: str = "", *, wide: bool = False) -> Picture:
        return style.picture(figure, f"f{next(self._count)}", label, caption, wide=wide)

    def _tolerance(self, metric: str) -> float | None:
        """Tolerance of a metric in the unit of reports."""
        entry: Mapping[str, Any] = self.saved.summary.get("metrics", {}).get(metric, {})
        return (entry.get("display") or entry).get("tolerance")

    def _spread(self, error: Array) -> tuple[Array, Array]:
        """Smallest and largest ``error`` over all strides at the same instant of the stride shown."""
        length = self.window.stop - self.window.start
        alike = [] if self.from_rest else strides(self.signals)
        folded = [error[rows.start : rows.start + length] for rows in alike]
        folded = [part for part in folded if len(part) == length] or [error[self.window]]
        stack = np.stack(folded)
        # Instants without contact have no ZMP in any stride.
        stack = np.where(np.isnan(stack).all(axis=0), 0.0, stack)
        return np.nanmin(stack, axis=0), np.nanmax(stack, axis=0)

    def _finish_run(self, axis: Axes, title: str, ylabel: str) -> None:
        """Labels; a dotted line at the end of the first step, which is judged separately."""
        end = 0 if self.from_rest else self.signals.first_step()
        if 0 < end < len(self.signals):
            axis.axvline(float(self.signals.time[end]), color=FAINT, linewidth=0.8, linestyle=":")
        _finish(axis, title, ylabel)


def _finish(axis: Axes, title: str, ylabel: str, *, xlabel: str = "time [s]", columns: int = 5) -> None:
    """Labels and legend of curves over time."""
    axis.set(title=title, xlabel=xlabel, ylabel=ylabel)
    axis.margins(x=0)
    legend(axis, columns)


def _draw_tolerances(axis: Axes, rmse: float | None, maximum: float | None) -> None:
    """Tolerances about zero; a wide one does not scale the axis."""
    axis.axhline(0.0, color=FAINT, linewidth=0.7)
    reach = 1.15 * max(abs(limit) for limit in axis.get_ylim())
    if rmse is not None:
        axis.axhspan(-rmse, rmse, color=GOOD, alpha=0.22, linewidth=0)
        reach = max(reach, 1.6 * rmse)
    if maximum is not None:
        if 0.4 * maximum < reach:
            reach = max(reach, 1.1 * maximum)
        for sign in (-1, 1):
            axis.axhline(sign * maximum, color=BAD, linewidth=0.9, linestyle=_DASHED)
    axis.set_ylim(-reach, reach)
