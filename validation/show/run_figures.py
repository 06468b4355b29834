"""All pictures of a run's report, from its files."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from ampm.geometry import Array
from ampm.planner.contacts import footprint
from ampm.planner.support import StepPlan
from validation.judge.compare import PARTS as CAUSES
from validation.judge.compare import SIGNALS
from validation.judge.metrics import display_unit
from validation.show.chart import DASHED, WIDTH, Chart, Picture, decimate, new_charts, numbered, text_width
from validation.show.curves import CURVES, DIFFERENCES, VELOCITIES, Curve
from validation.show.style import BAD, COMMAND, FAINT, GOOD, INK, LEFT, MEASURED, PARTS, PLAN, RIGHT, SHADE
from validation.show.walker import draw_walker
from validation.store.saved import SavedRun
from validation.store.signals import Signals
from validation.table import short_unit

_FEET = {"left": LEFT, "right": RIGHT}
_STEPS, _MOTORS = 4, 16  # steps seen from above, and motors whose torque is drawn
_KINDS = (("plan", PLAN, 2.4, ""), ("command", COMMAND, 1.1, DASHED), ("measured", MEASURED, 1.1, ""))
"""Kind, colour, width and dashes of a curve, told apart in grey, too; the plan is below the others."""
_DASHES = ("", DASHED, "1.5 1")  # dashes of the components of a vector


def strides(signals: Signals) -> list[slice]:
    """Rows of complete strides (two steps), each from the start of a left stance, the first step left out."""
    phase, stance = signals["phase"], signals["stance"]
    left = [row for row in signals.switches()[1:] if (phase[row], stance[row]) == ("single_support", "left")]
    return [slice(int(a), int(b)) for a, b in pairwise(left)]


def middle(saved: SavedRun) -> slice:
    """Rows of a stride from the middle of the run, or that nearest to the first push; else the whole run."""
    found, signals = strides(saved.signals), saved.signals
    if saved.pushes and found:
        pushed = min(begin for _, begin, *_ in saved.pushes)
        return min(found, key=lambda rows: abs(signals.time[rows].mean() - pushed))
    return found[len(found) // 2] if found else slice(0, len(signals))


def middle_name(signals: Signals) -> str:
    """What :func:`middle` is, for titles."""
    return "two steps" if strides(signals) else "whole run"


def shade_double_support(chart: Chart, signals: Signals, window: slice, *, from_zero: bool = False) -> None:
    """Shade the planned double supports, on the clock of the walk or from 0 on."""
    first = float(signals.time[window.start]) if from_zero else 0.0
    step = float(signals.time[1] - signals.time[0]) if len(signals) > 1 else 0.0
    for a, b in pairwise([*signals.switches().tolist(), len(signals)]):
        a, b = max(a, window.start), min(b, window.stop)
        if a < b and signals["phase"][a] == "double_support":
            begin = float(signals.time[a]) - first
            chart.shade(begin, begin + (b - a) * step, SHADE)


class RunFigures:
    """Draws the pictures of one run; what was not measured has none, what was not planned is not drawn."""

    def __init__(self, saved: SavedRun, plan: StepPlan | None) -> None:
        self.saved, self.plan, self.signals = saved, plan, saved.signals
        self.window = middle(saved)  # rows of the stride that is shown
        self.weight = saved.record.mass * saved.record.gravity  # [N]
        self.pushed = " Red: a push." * bool(saved.pushes)  # of captions

    def sections(self) -> dict[str, list[Picture]]:
        """All pictures with their numbers, by section, in the order of the page."""
        is_log, is_free = self.saved.is_log, self.saved.is_free
        poses = [] if is_log else draw_walker(self.saved, self.plan, self.window)
        moved = self.saved.summary.get("ahead", {}).get("judged")
        found = {
            "walker": [self.walker(poses)] if poses else [],
            "velocity": [self.velocity()] if is_free else [],
            "zmp": self.tracked("zmp", "xy") + ([self.ahead()] if moved else []),
            "above": [self.top_view()],
            "split": [] if is_log or is_free else [self.causes(axis) for axis in "xy"],
            "force": self.tracked("force", "xyz"),
            "momentum": self.tracked("angular_momentum", "xyz"),
            "com": self.differing("residual/com"),
            "check": self.differing("selfcheck/zmp"),
            "cost": ([] if is_log else [self.torque_use()]) + self.differing("feedback/zmp"),
        }
        every = iter(numbered(item for pictures in found.values() for item in pictures))
        return {section: [next(every) for _ in pictures] for section, pictures in found.items()}

    def _has(self, column: str) -> bool:
        """Whether a column has any value: a log may lack some, a user's controller may report no command."""
        return column in self.signals and bool(np.isfinite(self.signals[column]).any())

    def walker(self, poses: list[Chart]) -> Picture:
        """The body at a few instants."""
        kinds = "measured" if self.saved.is_free else "planned (blue) and measured (orange)"
        caption = f"Arrows: {kinds} ground force, from the ZMP. Black dot: COM. Purple: left; yellow: right."
        return Picture(poses, "The walking body from the side", caption, wide=True)

    def velocity(self) -> Picture:
        """Commanded and measured velocity over the whole run."""
        charts = new_charts(5.0, (1.0, 1.0, 1.0), width=2 * WIDTH)
        for chart, (column, (title, unit)) in zip(charts, VELOCITIES.items(), strict=True):
            for kind, color, width, dash in reversed(_KINDS[1:]):  # the command above the others
                values = self.signals[f"{kind}_{column}"]
                chart.line(*decimate(self.signals.time, values), color, width, dash=dash, label=kind)
            low, high = (float(ends[1]) for ends in chart.limits())
            chart.ylim = min(low, -0.1), max(high, 0.1)  # rounding is no velocity
            self._shade_pushes(chart, self.signals.time)
            chart.name(title, f"[{unit}]")
        return Picture(charts, "Commanded and measured velocity", self.pushed.strip(), wide=True)

    def tracked(self, name: str, axes: str) -> list[Picture]:
        """The components of a signal that were measured."""
        columns = [f"{name}_{axis}" for axis in axes]
        return [self.tracking(CURVES[column]) for column in columns if self._has(f"measured_{column}")]

    def tracking(self, curve: Curve) -> Picture:
        """Error over one stride, large; below it plan and measurement, and the error over a longer run.

        Without a plan the measurement alone.
        """
        if self.saved.is_free:
            title = curve.title.partition(",")[0]
            return Picture([self._signal(chart, curve, title) for chart in new_charts(2.6)], title)
        signals, rows, name = self.signals, self.window, curve.column
        is_all = rows == slice(0, len(signals))
        height, ratios = (5.0, (5.0, 2.5)) if is_all else (6.2, (5.0, 2.5, 2.0))
        large, lower, *more = charts = new_charts(height, ratios)
        whole = large if is_all else more[0]
        time = signals.time[rows]
        scale, unit = display_unit(SIGNALS[name].unit, self.weight)
        gap = scale * (signals[f"measured_{name}"] - signals[f"{curve.reference}_{name}"])
        large.band(time, *self._spread(gap), MEASURED, opacity=0.25)
        large.line(*decimate(time, gap[rows]), MEASURED, 1.3)
        if not is_all:
            whole.line(*decimate(signals.time, gap), MEASURED, 0.8)
        for chart in (large, *more):
            _draw_tolerances(chart, self._tolerance(f"{name}_rmse"), self._tolerance(f"{name}_maximum"))
            self._shade_pushes(chart, signals.time[[0, -1]] if chart is whole else time)
        self._signal(lower, curve, curve.title)
        shade_double_support(large, signals, rows)  # below the pushes
        title = f"Error of {SIGNALS[name].label}"
        large.name(f"{title}, {middle_name(signals)}", f"[{short_unit(unit)}]")
        self._finish_run(whole, f"{title}, whole run", f"[{short_unit(unit)}]")
        caption = f"Grey: double support.{self.pushed}"
        if self._tolerance(f"{name}_rmse") is not None:
            caption += " Green: tolerance of the RMS error."
        if curve.reference == "motion":
            caption += " The plan is that of the whole-body motion; the AMPM does not plan it."
        return Picture(charts, f"{curve.title}: error, plan and measurement", caption)

    def _signal(self, chart: Chart, curve: Curve, title: str) -> Chart:
        """Draw plan, command and measurement over one stride."""
        signals, rows, name = self.signals, self.window, curve.column
        time = signals.time[rows]
        for foot, color in _FEET.items():
            if self._has(f"{foot}_{name}"):
                values = curve.scale * signals[f"{foot}_{name}"][rows]
                chart.line(*decimate(time, values), color, 0.9, label=f"{foot} foot")
        plan, *others = _KINDS
        first_plan = ("first_plan", FAINT, 1.1, "1 2")  # of a plan that moved
        for kind, color, width, dash in ((curve.reference, *plan[1:]), first_plan, *others):
            if self._has(f"{kind}_{name}"):
                values, label = curve.values(signals, kind)[rows], kind.replace("_", " ")
                chart.line(*decimate(time, values), color, width, dash=dash, label=label)
        self._shade_pushes(chart, time)
        shade_double_support(chart, signals, rows)
        chart.name(title, f"[{curve.unit}]")
        return chart

    def ahead(self) -> Picture:
        """RMS errors of the ZMP by how long before each instant the plan stood."""
        (chart,) = charts = new_charts(2.3)
        ahead = self.saved.summary["ahead"]
        for name, color in zip(("zmp_x", "zmp_y"), PARTS, strict=False):
            values = 1e3 * np.array(ahead["rmse"][name], dtype=float)
            chart.line(ahead["lead"], values, color, 1.3, label=SIGNALS[name].direction)
            chart.dots(ahead["lead"], values, color, 5.0)
        chart.instant(ahead["judged"], FAINT, dash=DASHED)
        chart.xlim, chart.ylim = (-0.01, ahead["lead"][-1] + 0.01), (0.0, None)
        chart.name("ZMP, RMS error from the plan as it stood before", "[mm]", "age of the plan [s]")
        caption = "Dashed: the age by which this walk is judged."
        return Picture(charts, "RMS error of the ZMP by the age of the plan", caption)

    def differing(self, entity: str) -> list[Picture]:
        """Difference of two vectors, over the whole run; none where one was not measured."""
        gap = DIFFERENCES[entity]
        if not (self._has(f"{gap.minuend}_x") and self._has(f"{gap.subtrahend}_x")):
            return []
        (chart,) = charts = new_charts(2.3)
        chart.level(0.0, FAINT)
        values = gap.values(self.signals, self.weight)
        for name, part, color, dash in zip(gap.axes, values.T, PARTS, _DASHES, strict=False):
            chart.line(*decimate(self.signals.time, part), color, 0.9, dash=dash, label=name)
        self._finish_run(chart, gap.title, f"[{short_unit(gap.unit)}]")
        self._shade_pushes(chart, self.signals.time)
        return [Picture(charts, gap.title, self.pushed.strip())]

    def causes(self, axis: str) -> Picture:
        """Causes of the ZMP error over one stride, stacked, with the error itself as a line."""
        (chart,) = charts = new_charts(2.7)
        parts = np.stack([self.signals[f"zmp_error_{part}_{axis}"][self.window] for part in CAUSES])
        parts, time = 1e3 * np.nan_to_num(parts), self.signals.time[self.window]
        rows, error = decimate(np.arange(len(time)), parts.sum(axis=0), 140)
        parts, time = parts[:, rows], time[rows]
        for half, labels in ((np.maximum(parts, 0.0), [*CAUSES.values()]), (np.minimum(parts, 0.0), None)):
            tops = np.cumsum(half, axis=0)
            for k, color in enumerate((*PARTS, FAINT, BAD)):  # unlike the grey columns
                label = labels[k] if labels else ""
                chart.band(time, tops[k] - half[k], tops[k], color, opacity=1.0, label=label)
        chart.line(time, error, INK, 1.1, label="error")
        self._shade_pushes(chart, time)
        shade_double_support(chart, self.signals, self.window)
        chart.name("", f"error along {axis} [mm]")
        caption = f"Grey: double support.{self.pushed}"
        return Picture(charts, f"Causes of the ZMP error along {axis}, stacked", caption)

    def top_view(self) -> Picture:
        """ZMP and COM over the footprints, seen from above: steps around the stride, or all from rest."""
        is_whole = self.saved.from_rest
        bounds = [*self.signals.switches()[::2].tolist(), len(self.signals)]
        centre = int(np.searchsorted(bounds, (self.window.start + self.window.stop) // 2))
        begin = max(0, min(centre - _STEPS // 2, len(bounds) - 1 - _STEPS))
        end = min(begin + _STEPS, len(bounds) - 1)
        rows = slice(None) if is_whole else slice(bounds[begin], bounds[end])
        kind = "measured" if self.saved.is_free else "plan"
        com = self.signals.vector(f"{kind}_com", "xy")[rows]
        low, high = com.min(axis=0) - 0.35, com.max(axis=0) + 0.35
        (chart,) = charts = new_charts(4.8 if is_whole else 2.6, width=2 * WIDTH)
        prints = self.saved.footprints()
        whose = " over measured footprints" if prints else ""
        if self.plan is not None:
            sole, whose = self.plan.feet.sole, " over the footprints"
            prints = [(step.foot, footprint(sole, step)) for step in self.plan.contacts.footsteps]
        for foot, outline in prints:
            place = outline[:, :2].mean(axis=0)
            if (low - 0.15 < place).all() and (place < high + 0.15).all():
                x, y = outline[:, :2].T
                chart.area(x, y, SHADE)
                chart.line(x, y, _FEET[foot], 0.9)
        paths = [("ZMP", *item) for item in _KINDS]
        paths += [("COM", kind, color, 1.0, "1 2") for kind, color, *_ in (_KINDS[0], _KINDS[2])]
        for what, kind, color, width, dash in paths:
            if self._has(f"{kind}_zmp_x"):
                x, y = self.signals.vector(f"{kind}_{what.lower()}", "xy")[rows].T
                chart.line(x, y, color, width, dash=dash, label=f"{what}, {kind}")
        chart.equal = True
        fitted = [mark for mark in chart.marks if mark.label != "ZMP, command"]  # far off in a fall
        chart.xlim, chart.ylim = zip(*replace(chart, marks=fitted).limits(), strict=True)
        chart.name("", "y, left [m]", "x, forward [m]")
        caption = "The other figures' stride and a step on either side."
        if is_whole or len(bounds) - 1 <= _STEPS:
            caption = "The whole walk."
        return Picture(charts, f"ZMP and COM{whose}, seen from above", caption, wide=True)

    def torque_use(self) -> Picture:
        """Largest and RMS torque of the busiest motors, as shares of their limits."""
        record = self.saved.record
        share = 100.0 * np.abs(record.tick_torque) / record.torque_limit
        order = np.argsort(share.max(axis=0))[::-1][:_MOTORS]
        names = [name.removesuffix("_joint").replace("_", " ") for name in record.joint_names]
        left = max(text_width(names[index]) for index in order) / 72 + 0.13
        (chart,) = charts = new_charts(3.9, left=min(left, 2.0))
        peak, rms = share.max(axis=0)[order], np.sqrt((share**2).mean(axis=0))[order]
        for values, half, opacity, label in ((peak, 0.35, 0.45, "largest"), (rms, 0.16, 1.0, "RMS")):
            for row, value in enumerate(values):
                corners = [0.0, value, value, 0.0], [-row - half, -row - half, -row + half, -row + half]
                chart.area(*corners, PLAN, opacity=opacity, label=label if row == 0 else "")
        chart.yticks = {names[index]: -row for row, index in enumerate(order)}
        chart.xlim = (0.0, max(100.0, 1.05 * float(peak.max())))
        chart.instant(100.0, BAD, 0.9, dash=DASHED)
        chart.name("The busiest motors", "", "torque [% of its limit]")
        return Picture(charts, "Torque of the busiest motors")

    def _tolerance(self, metric: str) -> float | None:
        """Tolerance of a metric in the unit of reports."""
        entry: Mapping[str, Any] = self.saved.summary["metrics"].get(metric, {})
        return (entry.get("display") or entry).get("tolerance")

    def _spread(self, error: Array) -> tuple[Array, Array]:
        """Smallest and largest ``error`` over all strides at the same instant of the stride shown."""
        length = self.window.stop - self.window.start
        alike = [] if self.saved.from_rest else strides(self.signals)
        parts = [error[self.window], *(error[rows.start : rows.start + length] for rows in alike)]
        stack = np.stack([part for part in parts if len(part) == length])
        # Instants without contact may have no ZMP in any stride.
        return np.nan_to_num(np.fmin.reduce(stack)), np.nan_to_num(np.fmax.reduce(stack))

    def _shade_pushes(self, chart: Chart, time: Array) -> None:
        """Shade the pushes at some instants, shape (N,) [s]."""
        for _, begin, end, _ in self.saved.pushes:
            if begin < time[-1] and end > time[0]:
                chart.shade(max(begin, time[0]), min(end, time[-1]), f"{BAD}33")

    def _finish_run(self, chart: Chart, title: str, ylabel: str) -> None:
        """Labels; a dotted line at the end of the first step, which is judged separately."""
        end = 0 if self.saved.from_rest else self.signals.first_step()
        if 0 < end < len(self.signals):
            chart.instant(float(self.signals.time[end]), FAINT, 0.8, dash="1 2")
        chart.xlim = float(self.signals.time[0]), float(self.signals.time[-1])  # also of thinned curves
        chart.name(title, ylabel)


def _draw_tolerances(chart: Chart, rmse: float | None, maximum: float | None) -> None:
    """Tolerances about zero; a wide one does not scale the axis."""
    reach = 1.1 * max(abs(ends[1]) for ends in chart.limits())
    chart.level(0.0, FAINT)
    if rmse is not None:
        chart.area((-np.inf, np.inf, np.inf, -np.inf), (-rmse, -rmse, rmse, rmse), GOOD, opacity=0.22)
        chart.marks.insert(0, chart.marks.pop())  # below the error
        reach = max(reach, 1.6 * rmse)
    if maximum is not None:
        if 0.4 * maximum < reach:
            reach = max(reach, 1.1 * maximum)
        for sign in (-1, 1):
            chart.level(sign * maximum, BAD, 0.9, dash=DASHED)
    chart.ylim = (-reach, reach)
