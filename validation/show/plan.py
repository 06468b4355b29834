"""Pictures of a plan."""

import math
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from ampm.planner.centroidal import CentroidalPlan, PlanSample
from ampm.planner.contacts import footprint
from ampm.planner.support import StepPlan
from validation.show.style import save_figure, style

_SHOWN_STEPS = 4  # a periodic gait repeats itself every two
_POINTS = 1200
_ABOVE: Any = {"loc": "lower left", "bbox_to_anchor": (-0.01, 1.0), "ncols": 5}
"""Place of a legend: above the axes, because curves fill them."""
_ROUNDING = 1e-9
_BEYOND = 0.7  # of the path of the COM, in which footsteps are drawn [m]
_COLORS = {"COM": "#1f77b4", "DCM": "#5b6270", "ZMP": "#2ca02c"}
_COLORS |= {"x": "#1f77b4", "y": "#d62728", "z": "#5b6270"}


@style()
def plot_plan(plan: CentroidalPlan, path: Path, *, title: str) -> None:
    """Draw a plan: COM, ZMP, ground force, moment and angular momentum over time, and the top view.

    Of a periodic gait the first steps are drawn, as the others repeat them; of footsteps all. The suffix of
    the path chooses the format.
    """
    is_whole = plan.contacts.phases[0].kind == "double_support"  # it begins at rest
    duration = min(plan.duration, math.inf if is_whole else _SHOWN_STEPS * plan.constants.step_duration)
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
    if is_whole:
        curves["mean heading of\nboth feet [rad]"] = {"z": sample.heading}
    elif isinstance(plan, StepPlan):
        curves["planned ZMP margin to\nthe planned support [mm]"] = {"ZMP": 1000 * plan.zmp_margin(times)}
    # Made without pyplot: no global state, no display, safe in any thread.
    figure = Figure(figsize=(14, 13), dpi=110, layout="constrained")
    figure.suptitle(title)
    grid = figure.add_gridspec(5, 2, height_ratios=[1, 1, 1, 1, 1.3])
    for cell, (label, lines) in enumerate(curves.items()):
        axis = figure.add_subplot(grid[cell // 2, cell % 2])
        for name, values in lines.items():
            axis.plot(times, values, color=_COLORS[name], label=name)
        if max(np.abs(values).max() for values in lines.values()) < _ROUNDING:
            axis.set_ylim(-1.0, 1.0)
        for phase in plan.contacts.phases:
            if phase.kind == "double_support" and phase.start < duration:
                end = min(phase.start + phase.duration, duration)
                axis.axvspan(phase.start, end, color="0.92", zorder=0, lw=0)
        axis.set(xlabel="time [s]", ylabel=label, xlim=(0, duration))
        axis.legend(**_ABOVE)
    _draw_top(figure.add_subplot(grid[4, :]), plan, sample)
    save_figure(figure, path)


def _draw_top(axis: Axes, plan: CentroidalPlan, sample: PlanSample) -> None:
    """Footprints, support polygons, COM and ZMP seen from above."""
    low, high = sample.com[:, :2].min(axis=0) - _BEYOND, sample.com[:, :2].max(axis=0) + _BEYOND
    for footstep in plan.contacts.footsteps:
        position = footstep.position[:2]
        if (position < low).any() or (position > high).any():
            continue
        axis.annotate(footstep.foot[0].upper(), position)
        if isinstance(plan, StepPlan):
            axis.plot(*footprint(plan.feet.sole, footstep).T, color="0.6", lw=0.8)
    if isinstance(plan, StepPlan):
        for time in sample.time[:: _POINTS // 150]:
            corners = plan.support_polygon(float(time))
            if len(corners) >= 3:
                axis.add_patch(Polygon(corners, closed=True, fc="#ffbf00", ec="none", alpha=0.02))
    for name, values in (("COM", sample.com), ("ZMP", sample.zmp)):
        axis.plot(values[:, 0], values[:, 1], color=_COLORS[name], label=name)
    axis.set_aspect("equal", adjustable="datalim")
    axis.set(xlabel="x, forward [m]", ylabel="y, left [m]")
    axis.set_title("from above: footprints, support polygons (shaded)", pad=19)
    axis.legend(**_ABOVE)
