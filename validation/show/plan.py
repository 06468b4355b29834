"""Pictures of a plan."""

import textwrap
from dataclasses import replace
from pathlib import Path

import numpy as np

from ampm.geometry import convex_hull
from ampm.planner.centroidal import CentroidalPlan, PlanSample
from ampm.planner.contacts import footprint
from ampm.planner.support import StepPlan
from validation.show.chart import WIDTH, Chart, Picture, new_charts
from validation.show.style import COMMAND, FAINT, INK, LEFT, MEASURED, PLAN, RIGHT, SHADE
from validation.store.folders import write_whole

_SHOWN_STEPS = 4  # a periodic gait repeats itself every two
_POINTS = 1200
_BEYOND = 0.7  # of the path of the COM, in which footsteps are drawn [m]
_COLORS = {"COM": PLAN, "DCM": FAINT, "ZMP": COMMAND, "x": PLAN, "y": MEASURED, "z": INK}


def plot_plan(plan: CentroidalPlan, path: Path, *, title: str) -> None:
    """Draw a plan: COM, ZMP, ground force, moment and angular momentum over time, and the top view.

    Of a periodic gait the first steps are drawn, as the others repeat them; of footsteps all. The suffix of
    the path chooses the format.
    """
    is_whole = plan.contacts.phases[0].kind == "double_support"  # it begins at rest
    steps = len(plan.contacts.footsteps) - 2
    shown = steps if is_whole else min(steps, _SHOWN_STEPS)
    duration = plan.duration if shown == steps else shown * plan.constants.step_duration
    times = np.linspace(0.0, duration, _POINTS)
    if isinstance(plan, StepPlan):  # the ZMP margin jumps where a contact changes
        changes = np.r_[plan.contacts.starts, plan.feet.left.start, plan.feet.right.start]
        times = np.unique(np.clip(np.r_[times, changes - 1e-9, changes + 1e-9], 0.0, duration))
    sample = plan.sample(times)
    paths = {"COM": sample.com, "DCM": sample.dcm, "ZMP": sample.zmp}
    force = 100 * sample.force.T / plan.weight
    along_x = f"{textwrap.shorten(title, 54, placeholder=' ...')}: along x"
    along_y = f"along y (steps 1 to {shown} of {steps}; grey: double support)"
    curves = {
        (along_x, "[m]"): {name: values[:, 0] for name, values in paths.items()},
        (along_y, "[m]"): {name: values[:, 1] for name, values in paths.items()},
        ("COM velocity", "[m/s]"): dict(zip("xy", sample.com_velocity.T, strict=False)),
        ("COM acceleration", "[m/s²]"): dict(zip("xy", sample.com_acceleration.T, strict=False)),
        ("ground force", "[% of body weight]"): dict(zip("xyz", force, strict=True)),
        ("moment about the COM", "[N m]"): dict(zip("xyz", sample.moment.T, strict=False)),
        ("angular momentum about the COM", "[N m s]"): dict(
            zip("xyz", sample.angular_momentum.T, strict=False)
        ),
    }
    if is_whole:
        curves["mean heading of both feet", "[rad]"] = {"z": sample.heading}
    elif isinstance(plan, StepPlan):
        margin = 1000 * plan.zmp_margin(times)
        curves["planned ZMP margin to the planned support", "[mm]"] = {"ZMP": margin}
    *rows, top = new_charts(12.0, (1.0, 1.0, 1.0, 1.0, 1.7))
    beside = 72.0 * WIDTH
    right = [replace(row, left=row.left + beside, label_at=row.label_at + beside, marks=[]) for row in rows]
    charts = [chart for pair in zip(rows, right, strict=True) for chart in pair][: len(curves)]
    for chart, ((what, unit), lines) in zip(charts, curves.items(), strict=True):
        for name, values in lines.items():
            chart.line(times, values, _COLORS[name], 1.3, label=name)
        if max(np.abs(values).max() for values in lines.values()) < 1e-9:  # rounding
            chart.ylim = (-1.0, 1.0)
        for phase in plan.contacts.phases:
            if phase.kind == "double_support" and phase.start < duration:
                chart.shade(phase.start, min(phase.start + phase.duration, duration), SHADE)
        chart.name(what, unit)
    top.width += beside
    _draw_top(top, plan, sample)
    write_whole(path, Picture([*charts, top], title).as_file(path.suffix[1:]))


def _draw_top(chart: Chart, plan: CentroidalPlan, sample: PlanSample) -> None:
    """Footprints, support polygons, COM and ZMP seen from above."""
    if isinstance(plan, StepPlan):
        chart.title = "footprints (left purple, right yellow), support (shaded)"
        for points, contact in zip(*plan.points_in_contact(sample.time[:: _POINTS // 150]), strict=True):
            corners = convex_hull(points[contact])
            if len(corners) >= 3:
                chart.area(corners[:, 0], corners[:, 1], FAINT, opacity=0.02)
        low, high = sample.com[:, :2].min(axis=0) - _BEYOND, sample.com[:, :2].max(axis=0) + _BEYOND
        for step in plan.contacts.footsteps:
            if (step.position[:2] >= low).all() and (step.position[:2] <= high).all():
                x, y = footprint(plan.feet.sole, step).T
                chart.line(x, y, LEFT if step.foot == "left" else RIGHT, 0.9)
    for name, values in (("COM", sample.com), ("ZMP", sample.zmp)):
        chart.line(values[:, 0], values[:, 1], _COLORS[name], 1.3, label=name)
    chart.equal = True
    chart.name(chart.title, "y, left [m]", "x, forward [m]")
