"""Views of recordings: colours, panels and layouts, of one run and of several."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ampm.geometry import Array
from validation.show.curves import CURVES, DIFFERENCES, VELOCITIES

Color = tuple[int, int, int, int]
Labels = Mapping[str, str]
"""Prefix of the names of a run's entities, such as ``/a``, to its displayed name."""
Ranges = Mapping[str, tuple[float, float]]
"""Entity that is a curve to the ends of its vertical axis."""

TIMELINE, PHASE = "sim_time", "gait_phase"

PLAN: Color = (86, 180, 233, 255)
COMMAND: Color = (46, 200, 140, 255)
MEASURED: Color = (255, 138, 61, 255)
LEFT: Color = (240, 98, 146, 255)
RIGHT: Color = (255, 213, 79, 255)
FAINT: Color = (130, 140, 155, 90)
GROUND: Color = (24, 27, 33, 255)
RUN_COLORS: Sequence[Color] = (PLAN, MEASURED, (120, 220, 120, 255), (230, 140, 255, 255), RIGHT, LEFT)
"""Colours of the curves of several runs."""

_TITLES = {
    **{f"signals/{column}": f"{curve.title} [{curve.unit}]" for column, curve in CURVES.items()},
    **{f"signals/{column}": f"{title} [{unit}]" for column, (title, unit) in VELOCITIES.items()},
    "signals/foot_force_z": "Load of each foot [N]",
    **{entity: f"{gap.title} [{gap.unit}]" for entity, gap in DIFFERENCES.items()},
    "effort/torque": "Torque of the busiest motor [% of its limit]",
}
"""Entities that are curves."""

_TABS = {
    "Velocity": [[f"signals/{column}"] for column in VELOCITIES],
    "ZMP": [[f"signals/zmp_{axis}" for axis in "xy"], ["residual/zmp"]],
    "Force": [[f"signals/force_{axis}" for axis in "xyz"], ["signals/foot_force_z", "residual/force"]],
    "Momentum": [[f"signals/angular_momentum_{axis}" for axis in "xyz"], ["residual/angular_momentum"]],
    "COM": [[f"signals/com_{axis}" for axis in "xyz"], ["residual/com"]],
    "Cost": [["feedback/zmp", "selfcheck/zmp"], ["effort/torque"]],
}
"""Tabs of curves: name to rows of entities."""
_LABELS = 7
"""Most intervals between two labels of a vertical axis: the viewer leaves out those less than 20 px apart."""


def axis_range(values: Array) -> tuple[float, float]:
    """Ends of a vertical axis that has labels: multiples of a power of ten, as the viewer labels no others.

    The values are all that is drawn, NaN where nothing is.
    """
    known = values[np.isfinite(values)]
    if not known.size:
        return -1.0, 1.0
    low, high = float(known.min()), float(known.max())
    step = 10.0 ** math.ceil(math.log10(max(high - low, 1e-6) / _LABELS) - 1e-9)
    low, high = step * math.floor(low / step), step * math.ceil(high / step)
    if high - low < 1.5 * step:  # of two labels one reads no scale
        low, high = low - step, high + step
    margin = 0.03 * (high - low)
    return low - margin, high + margin


def run_blueprint(ranges: Ranges) -> rrb.Blueprint:
    """Of one run: body and ZMP from above on the left; verdict and curves on the right."""
    colors = "command green, measured orange, left foot pink, right foot yellow"
    colors = colors.capitalize() if _is_free(ranges) else f"Plan blue, {colors}"
    left = _scenes("", colors, "From above: ZMP, COM and soles")
    right = rrb.Vertical(
        rrb.Horizontal(_verdict_view("Verdict", ""), _events_view("Events", ""), column_shares=[3, 2]),
        _tabs([""], ranges),
        rrb.StateTimelineView(name="Phase and contact", origin="/phase", time_view=_near()),
        row_shares=[6, 16, 5],
    )
    return _laid_out(rrb.Horizontal(left, right), TIMELINE)


def several_blueprint(runs: Labels, ranges: Ranges) -> rrb.Blueprint:
    """Of several runs: bodies side by side, curves over each other, all at the same phase of the gait."""
    columns = [_scenes(at, label, f"{label} from above") for at, label in runs.items()]
    lanes = [f"{at}/phase/{kind}_stance" for at in runs for kind in ("planned", "measured")]
    title = "Stance; a second on this timeline is a step"
    below = rrb.Horizontal(
        _tabs(list(runs), ranges),
        rrb.Vertical(
            rrb.Tabs(*(_verdict_view(label, at) for at, label in runs.items())),
            rrb.Tabs(*(_events_view(f"Events of {label}", at) for at, label in runs.items())),
            rrb.StateTimelineView(name=title, contents=lanes, time_view=_near()),
        ),
        column_shares=[2, 1],
    )
    return _laid_out(rrb.Vertical(rrb.Horizontal(*columns), below, row_shares=[4, 3]), PHASE)


def _is_free(ranges: Ranges) -> bool:
    """Whether there is no plan, but a commanded velocity."""
    return "signals/yaw_rate" in ranges


def _near() -> rrb.TimeAxis:
    """Time axis that follows the cursor."""
    boundary = rrb.TimeRangeBoundary.cursor_relative
    return rrb.TimeAxis(view_range=rr.TimeRange(start=boundary(seconds=-1.5), end=boundary(seconds=0.5)))


def _plot(entity: str, runs: Sequence[str], ranges: Ranges) -> rrb.TimeSeriesView:
    """Curves of one entity of some runs: signals about the cursor, others over the whole run."""
    is_signal, title = entity.startswith("signals/"), _TITLES[entity].replace(" about", "")  # leaves the unit
    if _is_free(ranges):
        title = title.replace(", from the planned COM", "").replace(", from the plan", "")
    return rrb.TimeSeriesView(
        name=title,
        contents=[f"{at}/{entity}" for at in runs],
        axis_x=_near() if is_signal else None,
        axis_y=rrb.ScalarAxis(range=ranges[entity]) if entity in ranges else None,
        plot_legend=rrb.PlotLegend(visible=len(runs) == 1 or not is_signal),  # that of many would cover them
    )


def _tabs(runs: Sequence[str], ranges: Ranges) -> rrb.Tabs:
    """All curves of some runs."""
    tabs = []
    for name, rows in _TABS.items():
        there = [[entity for entity in row if entity in ranges or not ranges] for row in rows]
        lines = [rrb.Horizontal(*(_plot(entity, runs, ranges) for entity in row)) for row in there if row]
        tabs += [rrb.Vertical(*lines, name=name)] if lines else []
    return rrb.Tabs(*tabs, active_tab=0)


def _scenes(at: str, side: str, above: str) -> rrb.Vertical:
    """The body from the side, and soles and ZMP from above, under these names; the views move with it."""
    world, color = f"{at}/world", rrb.Background(color=GROUND[:3])
    body = rrb.Spatial3DView(
        name=side,
        origin=f"{world}/follow",
        contents=[f"{world}/**", f"- {world}/floor/**", f"- {world}/feet/**", f"+ {world}/feet/+/contact"],
        background=color,
        line_grid=rrb.LineGrid3D(visible=True, spacing=0.2, color=(90, 98, 110, 120)),
        eye_controls=rrb.EyeControls3D(
            position=(1.0, -1.85, 1.15), look_target=(0.05, 0.0, 0.82), eye_up=(0, 0, 1)
        ),
    )
    soles = rrb.Spatial3DView(
        name=above,
        origin=f"{world}/follow",
        contents=[f"{world}/{part}" for part in ("follow", "feet/**", "floor/**", "plan/**")],
        background=color,
        line_grid=rrb.LineGrid3D(visible=False),
        eye_controls=rrb.EyeControls3D(position=(0, 0, 0.85), look_target=(0, 0, 0), eye_up=(0, 1, 0)),
    )
    return rrb.Vertical(body, soles, row_shares=[3, 2])


def _verdict_view(name: str, at: str) -> rrb.TextDocumentView:
    return rrb.TextDocumentView(name=name, origin=f"{at}/verdict")


def _events_view(name: str, at: str) -> rrb.TextLogView:
    """List of events with their times."""
    columns = rrb.TextLogColumns(timeline_columns=[TIMELINE], text_log_columns=["loglevel", "body"])
    return rrb.TextLogView(name=name, origin=f"{at}/events", columns=columns)


def _laid_out(root: Any, timeline: str) -> rrb.Blueprint:
    """A blueprint that shows one container and plays."""
    return rrb.Blueprint(
        root,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=timeline, play_state="playing", loop_mode="all"),
        auto_layout=False,
        auto_views=False,
    )
