"""Pictures of a plan."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from ampm.planner.centroidal import CentroidalPlan
from ampm.planner.support import StepPlan
from validation.show.style import file_style, legend

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from ampm.planner.centroidal import PlanSample

_SHOWN_STEPS = 4  # a periodic gait repeats itself every two
_POINTS = 1200
_X, _Y, _Z, _ZMP = "#1f77b4", "#d62728", "#5b6270", "#2ca02c"


def plot_plan(plan: CentroidalPlan, path: Path, *, title: str) -> None:
    """Draw a plan: COM, ZMP, ground force, moment and angular momentum over time, and the top view.

    Args:
        plan: the plan; only its first steps are drawn, as the rest repeats them.
        path: image file; the suffix chooses the format.
        title: heading, usually the gait's name.

    Raises:
        OSError: the file cannot be written.
    """
    duration = min(plan.duration, _SHOWN_STEPS * plan.constants.step_duration)
    times = np.linspace(0.0, duration, _POINTS)
    sample = plan.sample(times)
    with file_style():
        # Made without pyplot: no global state, no display, safe in any thread.
        figure = Figure(figsize=(14, 13), layout="constrained")
        figure.suptitle(title)
        axes = figure.subplot_mosaic(
            [
                ["x", "y"],
                ["velocity", "acceleration"],
                ["force", "moment"],
                ["momentum", "margin"],
                ["top", "top"],
            ],
            height_ratios=[1, 1, 1, 1, 1.3],
        )
        _draw_times(axes, plan, sample)
        _draw_margin(axes["margin"], plan, times)
        for name, axis in axes.items():
            if name != "top":
                axis.set_xlabel("time [s]")
                axis.set_xlim(0, duration)
                _shade_double_support(axis, plan, duration)
        _draw_top(axes["top"], plan, sample, times)
        for axis in axes.values():
            legend(axis)
        figure.savefig(path, dpi=110)


def _draw_times(axes: dict[str, Axes], plan: CentroidalPlan, sample: PlanSample) -> None:
    time = sample.time
    for name, index in (("x", 0), ("y", 1)):
        for label, values, colour in (
            ("COM", sample.com, _X),
            ("DCM", sample.dcm, _Z),
            ("ZMP", sample.zmp, _ZMP),
        ):
            axes[name].plot(time, values[:, index], color=colour, label=label)
        axes[name].set_ylabel(f"{name} [m]")
    weight = plan.mass * plan.gravity
    pairs: tuple[tuple[str, NDArray[np.float64], str], ...] = (
        ("velocity", sample.com_velocity[:, :2], "COM velocity [m/s]"),
        ("acceleration", sample.com_acceleration[:, :2], "COM acceleration [m/s²]"),
        ("force", 100 * sample.force / weight, "ground force\n[% of body weight]"),
        ("moment", sample.moment, "moment about the\nCOM [N m]"),
        ("momentum", sample.angular_momentum, "angular momentum about\nthe COM [N m s]"),
    )
    for name, values, label in pairs:
        for column, letter, colour in zip(values.T, "xyz", (_X, _Y, _Z), strict=False):
            axes[name].plot(time, column, color=colour, label=letter)
        axes[name].set_ylabel(label)


def _draw_margin(axis: Axes, plan: CentroidalPlan, times: NDArray[np.float64]) -> None:
    axis.set_ylabel("ZMP margin to the\nsupport polygon [mm]")
    if not isinstance(plan, StepPlan):
        axis.text(0.5, 0.5, "no body, no soles", transform=axis.transAxes, ha="center", va="center")
        return
    axis.plot(times, 1000 * plan.zmp_margin(times), color=_ZMP)
    axis.axhline(0, color="k", lw=0.8)


def _draw_top(axis: Axes, plan: CentroidalPlan, sample: PlanSample, times: NDArray[np.float64]) -> None:
    """Footprints, support polygons, COM and ZMP seen from above."""
    reach = sample.com[-1, 0] + plan.contacts.step_length
    for footstep in plan.contacts.footsteps:
        position = footstep.position[:2]
        if position[0] > reach:
            continue
        axis.plot(*position, marker="+", color="k", ms=8)
        axis.annotate(footstep.foot[0].upper(), position, xytext=(4, 4), textcoords="offset points")
    if isinstance(plan, StepPlan):
        drawn: set[tuple[float, ...]] = set()
        for time in times[:: max(1, _POINTS // 150)]:
            corners = plan.support_polygon(float(time))
            key = tuple(np.round(corners, 6).ravel())
            if len(corners) >= 3 and key not in drawn:
                drawn.add(key)
                axis.add_patch(Polygon(corners, closed=True, fc="#ffbf00", ec="0.4", alpha=0.12, lw=0.6))
    axis.plot(sample.com[:, 0], sample.com[:, 1], color=_X, label="COM")
    axis.plot(sample.zmp[:, 0], sample.zmp[:, 1], color=_ZMP, label="ZMP")
    axis.set_aspect("equal", adjustable="datalim")
    axis.set_xlabel("x, forward [m]")
    axis.set_ylabel("y, left [m]")
    axis.set_title("from above: footprints (+), support polygons (shaded)")


def _shade_double_support(axis: Axes, plan: CentroidalPlan, duration: float) -> None:
    for phase in plan.contacts.phases:
        if phase.kind == "double_support" and phase.start < duration:
            axis.axvspan(
                phase.start, min(phase.start + phase.duration, duration), color="0.92", zorder=0, lw=0
            )
