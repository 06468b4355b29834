"""Views of recordings: colours, panels and layouts.

A layout is of one run, of several beside each other, or of several revisions of one gait over each other.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ampm.geometry import Array

Color = tuple[int, int, int, int]
Labels = Mapping[str, str]
"""Prefix of the names of a run's entities, such as ``/a``, to its displayed name."""
Ranges = Mapping[str, tuple[float, float]]
"""Entity of :data:`TITLES` to the ends of its vertical axis."""

TIMELINE, PHASE = "sim_time", "gait_phase"

PLAN: Color = (86, 180, 233, 255)
COMMAND: Color = (46, 200, 140, 255)
MEASURED: Color = (255, 138, 61, 255)
LEFT: Color = (240, 98, 146, 255)
RIGHT: Color = (255, 213, 79, 255)
ALERT: Color = (255, 40, 40, 255)
FAINT: Color = (130, 140, 155, 90)
GROUND: Color = (24, 27, 33, 255)

LEGEND: Mapping[str, Color] = {
    "plan": PLAN,
    "command": COMMAND,
    "measured": MEASURED,
    "left foot": LEFT,
    "right foot": RIGHT,
    "limit": ALERT,
    "footsteps": (*FAINT[:3], 255),
}
"""What the colours of a recording mean."""

RUN_COLORS: Mapping[str, Color] = {
    "blue": (86, 180, 233, 255),
    "orange": (255, 138, 61, 255),
    "green": (120, 220, 120, 255),
    "violet": (230, 140, 255, 255),
    "yellow": (255, 213, 79, 255),
    "pink": (240, 98, 146, 255),
}
"""Colours of overlaid runs."""

TITLES = {
    "signals/zmp_x": "ZMP along x, from the planned COM [mm]",
    "signals/zmp_y": "ZMP along y [mm]",
    **{f"signals/force_{axis}": f"Ground force along {axis} [N]" for axis in "xyz"},
    "signals/foot_force_z": "Load of each foot [N]",
    **{f"signals/angular_momentum_{axis}": f"Angular momentum about {axis} [N m s]" for axis in "xyz"},
    "signals/com_x": "COM along x, from the plan [m]",
    "signals/com_y": "COM along y [m]",
    "signals/com_z": "COM along z [m]",
    "residual/zmp": "ZMP error, measured - plan [mm]",
    "residual/force": "Ground force error [% of body weight]",
    "residual/angular_momentum": "Angular momentum error [N m s]",
    "residual/com": "COM error [mm]",
    "feedback/zmp": "Feedback: commanded - planned ZMP [mm]",
    "effort/torque": "Torque of the busiest motor [% of its limit]",
    "selfcheck/zmp": "Self-check: ZMP by momentum - by contact [mm]",
    "margin/clearance": "Least distance of two parts [mm]",
}
"""Entities that are curves. Signals are shown about the cursor, the others over the whole run."""
_TWO, _THREE = ("x red, y green", "y darker"), ("x red, y green, z blue", "y darker, z paler")
_COLORS = {
    "residual/zmp": _TWO,
    "residual/force": _THREE,
    "residual/angular_momentum": _TWO,
    "residual/com": _THREE,
    "feedback/zmp": _TWO,
    "selfcheck/zmp": _TWO,
    "signals/foot_force_z": ("left pink, right yellow, plan blue", ""),
    "margin/clearance": ("limit red", "limit red"),
}
"""Colours of an entity's curves in one run, and in several over each other; a legend would cover curves."""
_LEGEND_STEP = 130.0
"""Distance of two dots of the legend, about in pixels."""
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
    """Of one run: body and ZMP from above on the left; verdict and curves on the right."""
    left = rrb.Vertical(
        _body_view("Body and ground force", "/world/follow", _body_contents("")),
        _legend_view("/legend"),
        _above_view("From above: ZMP, COM, soles and planned support", "/world/follow", _above_contents("")),
        row_shares=[27, 6, 17],
    )
    curves = _tabs(
        {
            "ZMP": [_of_axes("zmp", "xy"), ["residual/zmp"]],
            "Force": [_of_axes("force", "xyz"), ["signals/foot_force_z", "residual/force"]],
            "Momentum": [_of_axes("angular_momentum", "xyz"), ["residual/angular_momentum"]],
            "COM": [_of_axes("com", "xyz"), ["residual/com"]],
            "Cost": [["feedback/zmp", "selfcheck/zmp"], ["effort/torque", "margin/clearance"]],
        },
        [""],
        ranges,
    )
    words = rrb.TextDocumentView(name="Verdict", origin="/verdict")
    right = rrb.Vertical(
        rrb.Horizontal(words, _events_view("", TIMELINE), column_shares=[3, 2]),
        curves,
        rrb.StateTimelineView(name="Phase and contact", origin="/phase", time_view=_near()),
        row_shares=[6, 17, 4],
    )
    return _laid_out(rrb.Horizontal(left, right, column_shares=[1, 1]), TIMELINE)


def beside_blueprint(runs: Labels, ranges: Ranges) -> rrb.Blueprint:
    """One column per run, all at the same phase of the gait."""
    columns = []
    for at, label in runs.items():
        follow = f"{at}/world/follow"
        more = [
            _plot(entity, [at], ranges)
            for entity in (
                "signals/zmp_x",
                "residual/force",
                "residual/angular_momentum",
                "effort/torque",
                "margin/clearance",
            )
        ]
        verdict = rrb.TextDocumentView(name="Verdict", origin=f"{at}/verdict")
        views: list[rrb.Container | rrb.View] = [
            _body_view(label, follow, _body_contents(at)),
            _above_view(f"{label} from above", follow, _above_contents(at)),
            _plot("residual/zmp", [at], ranges, f"{label}: "),
            rrb.Tabs(*more, verdict, _events_view(at, PHASE), active_tab=len(more)),
        ]
        columns.append(rrb.Vertical(*views, row_shares=[5, 3, 3, 3]))
    lanes = _lanes("Planned stance", [f"{at}/phase/planned_stance" for at in runs])
    colours = _legend_view(f"{next(iter(runs))}/legend")
    below = rrb.Horizontal(lanes, colours)
    return _laid_out(rrb.Vertical(rrb.Horizontal(*columns), below, row_shares=[13, 2]), PHASE)


def overlay_blueprint(runs: Labels, ranges: Ranges) -> rrb.Blueprint:
    """All runs in one scene and on the same axes, each in its colour of :data:`RUN_COLORS`."""
    first = f"{next(iter(runs))}/world"  # the plan is the same
    bodies = [f"{first}/follow", f"{first}/plan/footprints"]
    floors = [f"{first}/follow", f"{first}/plan/**", f"{first}/floor/zmp/plan/**"]
    for at in runs:
        bodies += [f"{at}/world/{what}" for what in ("body/**", "force/measured", "com/measured")]
        shown = ("feet/**", "floor/zmp/measured/**", "floor/com/measured/**")
        floors += [f"{at}/world/{what}" for what in shown]
    above = "From above: soles and measured ZMP; planned support and ZMP"
    left = rrb.Vertical(
        _body_view("Bodies and ground forces", f"{first}/follow", bodies),
        _legend_view("/legend"),
        _above_view(above, f"{first}/follow", floors),
        row_shares=[27, 6, 17],
    )
    curves = _tabs(
        {
            "ZMP": [["residual/zmp"], _of_axes("zmp", "xy")],
            "Force": [["residual/force"], _of_axes("force", "xyz")],
            "Momentum": [["residual/angular_momentum"], _of_axes("angular_momentum", "xy")],
            "Cost": [["feedback/zmp", "residual/com"], ["effort/torque", "margin/clearance"]],
        },
        list(runs),
        ranges,
    )
    words = [rrb.TextDocumentView(name=label, origin=f"{at}/verdict") for at, label in runs.items()]
    events = [_events_view(at, PHASE, f"Events of {label}") for at, label in runs.items()]
    right = rrb.Vertical(
        rrb.Horizontal(*words) if len(words) <= 2 else rrb.Tabs(*words),
        curves,
        rrb.Tabs(_lanes("Feet on the floor", [f"{at}/phase/**" for at in runs]), *events),
        row_shares=[6, 17, 4],
    )
    return _laid_out(rrb.Horizontal(left, right), PHASE)


def _of_axes(signal: str, axes: str) -> list[str]:
    """Entities of a signal, one per axis."""
    return [f"signals/{signal}_{axis}" for axis in axes]


def _near(seconds: float = 1.5) -> rrb.TimeAxis:
    """Time axis that follows the cursor."""
    boundary = rrb.TimeRangeBoundary.cursor_relative
    window = rr.TimeRange(start=boundary(seconds=-seconds), end=boundary(seconds=seconds / 3.0))
    return rrb.TimeAxis(view_range=window)


def _plot(entity: str, runs: Sequence[str], ranges: Ranges, before: str = "") -> rrb.TimeSeriesView:
    """Curves of one entity of :data:`TITLES`, of one or several runs."""
    origins = [f"{at}/{entity}" for at in runs]
    options: dict[str, Any] = {"axis_x": _near()} if entity.startswith("signals/") else {}
    if entity in ranges:
        options["axis_y"] = rrb.ScalarAxis(range=ranges[entity])
    where: dict[str, Any] = {"origin": origins[0]} if len(origins) == 1 else {"contents": origins}
    colors = _COLORS.get(entity, ("", ""))[len(runs) > 1]
    title = f"{before}{TITLES[entity]}{f', {colors}' if colors else ''}"
    return rrb.TimeSeriesView(name=title, plot_legend=rrb.PlotLegend(visible=False), **where, **options)


def _tabs(layout: Mapping[str, Sequence[Sequence[str]]], runs: Sequence[str], ranges: Ranges) -> rrb.Tabs:
    """Tabs of curves: name to rows of entities."""
    columns = [
        rrb.Vertical(
            *(rrb.Horizontal(*(_plot(entity, runs, ranges) for entity in row)) for row in rows), name=name
        )
        for name, rows in layout.items()
    ]
    return rrb.Tabs(*columns, active_tab=0)


def _body_view(name: str, origin: str, contents: Sequence[str]) -> rrb.Spatial3DView:
    """The body from the side; the view moves with it."""
    eye = rrb.EyeControls3D(position=(1.0, -1.85, 1.15), look_target=(0.05, 0.0, 0.82), eye_up=(0, 0, 1))
    grid = rrb.LineGrid3D(visible=True, spacing=0.2, color=(90, 98, 110, 120))
    return _scene(name, origin, contents, grid, eye)


def _legend_view(origin: str) -> rrb.Spatial2DView:
    """Meaning of the colours."""
    ground = rrb.Background(color=GROUND[:3])
    bounds = rrb.VisualBounds2D(x_range=(-70.0, 860.0), y_range=(-14.0, 30.0))
    return rrb.Spatial2DView(name="Colours", origin=origin, background=ground, visual_bounds=bounds)


def legend(colors: Mapping[str, Color]) -> rr.Points2D:
    """Dots in a row, each with its meaning below it."""
    places = [(_LEGEND_STEP * number, 0.0) for number in range(len(colors))]
    return rr.Points2D(places, colors=list(colors.values()), labels=list(colors), radii=6.0, show_labels=True)


def _above_view(name: str, origin: str, contents: Sequence[str]) -> rrb.Spatial3DView:
    """Soles and ZMP from above."""
    eye = rrb.EyeControls3D(position=(0, 0, 0.85), look_target=(0, 0, 0), eye_up=(0, 1, 0))
    return _scene(name, origin, contents, rrb.LineGrid3D(visible=False), eye)


def _scene(
    name: str, origin: str, contents: Sequence[str], grid: rrb.LineGrid3D, eye: rrb.EyeControls3D
) -> rrb.Spatial3DView:
    ground = rrb.Background(color=GROUND[:3])
    return rrb.Spatial3DView(
        name=name, origin=origin, contents=contents, background=ground, line_grid=grid, eye_controls=eye
    )


def _body_contents(at: str) -> list[str]:
    world = f"{at}/world"
    return [f"{world}/**", f"- {world}/floor/**", f"- {world}/feet/**", f"+ {world}/feet/+/contact"]


def _above_contents(at: str) -> list[str]:
    return [f"{at}/world/{part}" for part in ("follow", "feet/**", "floor/**", "plan/**")]


def _events_view(at: str, timeline: str, name: str = "Events") -> rrb.TextLogView:
    """List of events with their times."""
    columns = rrb.TextLogColumns(timeline_columns=[timeline], text_log_columns=["loglevel", "body"])
    return rrb.TextLogView(name=name, origin=f"{at}/events", columns=columns)


def _lanes(name: str, contents: Sequence[str]) -> rrb.StateTimelineView:
    title = f"{name}; a second on this timeline is a step"
    return rrb.StateTimelineView(name=title, contents=contents, time_view=_near())


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
