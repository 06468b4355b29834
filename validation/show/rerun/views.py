"""Views of recordings: colours, panels and layout."""

import math
from collections.abc import Mapping

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ampm.geometry import Array
from validation.show.curves import CURVES, DIFFERENCES, VELOCITIES

Color = tuple[int, int, int, int]
Ranges = Mapping[str, tuple[float, float]]
"""Entity that is a curve to the ends of its vertical axis."""

TIMELINE = "sim_time"

PLAN: Color = (86, 180, 233, 255)
COMMAND: Color = (46, 200, 140, 255)
MEASURED: Color = (255, 138, 61, 255)
LEFT: Color = (240, 98, 146, 255)
RIGHT: Color = (255, 213, 79, 255)
FAINT: Color = (130, 140, 155, 90)
GROUND: Color = (24, 27, 33, 255)

_TITLES = {
    **{f"signals/{column}": f"{curve.title} [{curve.unit}]" for column, curve in CURVES.items()},
    **{f"signals/{column}": f"{title} [{unit}]" for column, (title, unit) in VELOCITIES.items()},
    "signals/foot_force_z": "Load of each foot [N]",
    **{entity: f"{gap.title} [{gap.unit}]" for entity, gap in DIFFERENCES.items()},
    "effort/torque": "Torque of the busiest motor [% of its limit]",
}
"""Entities that are curves."""


def _signals(name: str, axes: str) -> list[str]:
    """Entities of a signal, one for each axis."""
    return [f"signals/{name}_{axis}" for axis in axes]


_TABS = {
    "Velocity": [[f"signals/{column}"] for column in VELOCITIES],
    "ZMP": [_signals("zmp", "xy"), ["residual/zmp"]],
    "Force": [_signals("force", "xyz"), ["signals/foot_force_z", "residual/force"]],
    "Momentum": [_signals("angular_momentum", "xyz"), ["residual/angular_momentum"]],
    "COM": [_signals("com", "xyz"), ["residual/com"]],
    "Cost": [["feedback/zmp", "selfcheck/zmp"], ["effort/torque"]],
}
"""Tabs of curves: name to rows of entities."""
_LABELS = 7
"""Most intervals between two labels of a vertical axis: the viewer leaves out those less than 20 px apart."""


def axis_range(values: Array) -> tuple[float, float]:
    """Ends of a vertical axis that has labels: multiples of a power of ten, as the viewer labels no others.

    Args:
        values: all that is drawn, NaN where nothing is.
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
    """Body and ZMP from above on the left; verdict, events, curves and phases on the right; it plays."""
    columns = rrb.TextLogColumns(timeline_columns=[TIMELINE], text_log_columns=["loglevel", "body"])
    right = rrb.Vertical(
        rrb.Horizontal(
            rrb.TextDocumentView(name="Verdict", origin="/verdict"),
            rrb.TextLogView(name="Events", origin="/events", columns=columns),
            column_shares=[3, 2],
        ),
        _tabs(ranges),
        rrb.StateTimelineView(name="Phase and contact", origin="/phase", time_view=_near()),
        row_shares=[6, 17, 4],
    )
    return rrb.Blueprint(
        rrb.Horizontal(_scenes(), right),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="playing", loop_mode="all"),
        auto_layout=False,
        auto_views=False,
    )


def _near() -> rrb.TimeAxis:
    """Time axis that follows the cursor."""
    boundary = rrb.TimeRangeBoundary.cursor_relative
    window = rr.TimeRange(start=boundary(seconds=-1.5), end=boundary(seconds=0.5))
    return rrb.TimeAxis(view_range=window)


def _plot(entity: str, ranges: Ranges) -> rrb.TimeSeriesView:
    """Curves of one entity: signals about the cursor, others over the whole run."""
    title = _TITLES[entity]
    if "signals/yaw_rate" in ranges:  # there is no plan
        title = title.replace(", from the planned COM", "").replace(", from the plan", "")
    return rrb.TimeSeriesView(
        name=title,
        contents=[f"/{entity}"],
        axis_x=_near() if entity.startswith("signals/") else None,
        axis_y=rrb.ScalarAxis(range=ranges[entity]) if entity in ranges else None,
        plot_legend=rrb.PlotLegend(visible=True),
    )


def _tabs(ranges: Ranges) -> rrb.Tabs:
    """All curves."""
    tabs = []
    for name, rows in _TABS.items():
        there = [[entity for entity in row if entity in ranges or not ranges] for row in rows]
        lines = [rrb.Horizontal(*(_plot(entity, ranges) for entity in row)) for row in there if row]
        tabs += [rrb.Vertical(*lines, name=name)] if lines else []
    return rrb.Tabs(*tabs, active_tab=0)


def _scenes() -> rrb.Vertical:
    """The body from the side, and soles and ZMP from above; the views move with it."""
    world, color = "/world", rrb.Background(color=GROUND[:3])
    body = rrb.Spatial3DView(
        name="Plan blue, command green, measured orange, left foot pink, right foot yellow",
        origin=f"{world}/follow",
        contents=[f"{world}/**", f"- {world}/floor/**", f"- {world}/feet/**", f"+ {world}/feet/+/contact"],
        background=color,
        line_grid=rrb.LineGrid3D(visible=True, spacing=0.2, color=(90, 98, 110, 120)),
        eye_controls=rrb.EyeControls3D(
            position=(1.0, -1.85, 1.15), look_target=(0.05, 0.0, 0.82), eye_up=(0, 0, 1)
        ),
    )
    soles = rrb.Spatial3DView(
        name="From above: ZMP, COM, soles and planned support",
        origin=f"{world}/follow",
        contents=[f"{world}/{part}" for part in ("follow", "feet/**", "floor/**", "plan/**")],
        background=color,
        line_grid=rrb.LineGrid3D(visible=False),
        eye_controls=rrb.EyeControls3D(position=(0, 0, 0.85), look_target=(0, 0, 0), eye_up=(0, 1, 0)),
    )
    return rrb.Vertical(body, soles, row_shares=[3, 2])
