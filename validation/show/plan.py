"""Pictures of a plan."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from ampm.description import SoleGeometry
from ampm.planner.centroidal import CentroidalPlan, PlanSample
from ampm.planner.contacts import footprint
from ampm.planner.support import StepPlan
from validation.show.style import into_file, legend

_SHOWN_STEPS = 4  # a periodic gait repeats itself every two
_POINTS = 1200
_ROUNDING = 1e-9
_COLORS = {
    "COM": "#1f77b4",
    "DCM": "#5b6270",
    "ZMP": "#2ca02c",
    "x": "#1f77b4",
    "y": "#d62728",
    "z": "#5b6270",
}


@into_file
def plot_plan(plan: CentroidalPlan, *, title: str, sole: SoleGeometry | None = None) -> Figure:
    """Draw a plan: COM, ZMP, ground force, moment and angular momentum over time, and the top view.

    Args:
        plan: without a sole only its first steps are drawn, as the others repeat them.
        title: heading, usually the gait's name.
        sole: outline of the soles, of a walk over footsteps: all of it is drawn.
    """
    shown = _SHOWN_STEPS * plan.constants.step_duration if sole is None else plan.duration
    duration = min(plan.duration, shown)
    times = np.linspace(0.0, duration, _POINTS)
    sample = plan.sample(times)
    paths = {"COM": sample.com, "DCM": sample.dcm, "ZMP": sample.zmp}
    force = 100 * sample.force / (plan.mass * plan.gravity)
    curves = {
        "x [m]": {name: values[:, 0] for name, values in paths.items()},
        "y [m]": {name: values[:, 1] for name, values in paths.items()},
        "COM velocity [m/s]": dict(zip("xy", sample.com_velocity.T, strict=False)),
        "COM acceleration [m/s²]": dict(zip("xy", sample.com_acceleration.T, strict=False)),
        "ground force\n[% of body weight]": dict(zip("xyz", force.T, strict=True)),
        "moment about the\nCOM [N m]": dict(zip("xyz", sample.moment.T, strict=False)),
        "angular momentum about\nthe COM [N m s]": dict(zip("xyz", sample.angular_momentum.T, strict=False)),
    }
    if sole is None:
        curves["planned ZMP margin to\nthe planned support [mm]"] = {}
    else:
        curves["mean heading of\nboth feet [rad]"] = {"z": sample.heading}
    # Made without pyplot: no global state, no display, safe in any thread.
    figure = Figure(figsize=(14, 13), dpi=110, layout="constrained")
    figure.suptitle(title)
    grid = figure.add_gridspec(5, 2, height_ratios=[1, 1, 1, 1, 1.3])
    for cell, (label, lines) in enumerate(curves.items()):
        axis = figure.add_subplot(grid[cell // 2, cell % 2])
        for name, values in lines.items():
            axis.plot(times, values, color=_COLORS[name], label=name)
        if lines and max(np.abs(values).max() for values in lines.values()) < _ROUNDING:
            axis.set_ylim(-1.0, 1.0)
        if isinstance(plan, StepPlan) and not lines:
            axis.plot(times, 1000 * plan.zmp_margin(times), color=_COLORS["ZMP"])
            axis.axhline(0, color="k", lw=0.8)
        elif not lines:
            axis.text(0.5, 0.5, "no body, no soles", transform=axis.transAxes, ha="center", va="center")
        for phase in plan.contacts.phases:
            if phase.kind == "double_support" and phase.start < duration:
                end = min(phase.start + phase.duration, duration)
                axis.axvspan(phase.start, end, color="0.92", zorder=0, lw=0)
        axis.set(xlabel="time [s]", ylabel=label, xlim=(0, duration))
        legend(axis)
    _draw_top(figure.add_subplot(grid[4, :]), plan, sample, sole)
    return figure


def _draw_top(axis: Axes, plan: CentroidalPlan, sample: PlanSample, sole: SoleGeometry | None) -> None:
    """Footprints, support polygons, COM and ZMP seen from above."""
    reach = sample.com[-1, 0] + plan.contacts.step_length
    for footstep in plan.contacts.footsteps:
        position = footstep.position[:2]
        if sole is not None:
            axis.plot(*footprint(sole, footstep).T, color="0.6", lw=0.8)
        elif position[0] <= reach:
            axis.plot(*position, marker="+", color="k", ms=8)
            axis.annotate(footstep.foot[0].upper(), position, xytext=(4, 4), textcoords="offset points")
    if isinstance(plan, StepPlan):
        drawn: set[tuple[float, ...]] = set()
        for time in sample.time[:: max(1, _POINTS // 150)]:
            corners = plan.support_polygon(float(time))
            key = tuple(np.round(corners, 6).ravel())
            if len(corners) >= 3 and key not in drawn:
                drawn.add(key)
                axis.add_patch(Polygon(corners, closed=True, fc="#ffbf00", ec="0.4", alpha=0.12, lw=0.6))
    for name, values in (("COM", sample.com), ("ZMP", sample.zmp)):
        axis.plot(values[:, 0], values[:, 1], color=_COLORS[name], label=name)
    axis.set_aspect("equal", adjustable="datalim")
    axis.set(xlabel="x, forward [m]", ylabel="y, left [m]")
    marks = f"footprints{' (+)' if sole is None else ''}, support polygons (shaded)"
    axis.set_title(f"from above: {marks}")
    legend(axis)
