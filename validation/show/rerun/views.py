"""Views of a recording: colours, panels, and the layout that shows at once whether a walk passes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import rerun as rr
import rerun.blueprint as rrb

if TYPE_CHECKING:
    from validation.store.saved import SavedRun

Color = tuple[int, int, int, int]

TIMELINE = "sim_time"

PLAN: Color = (86, 180, 233, 255)
COMMAND: Color = (46, 200, 140, 255)
MEASURED: Color = (255, 138, 61, 255)
LEFT: Color = (240, 98, 146, 255)
RIGHT: Color = (255, 213, 79, 255)
FAINT: Color = (130, 140, 155, 90)
GROUND: Color = (24, 27, 33, 255)


def verdict_markdown(saved: SavedRun) -> str:
    """The verdict and its figures as Markdown, for the recording's first panel."""
    summary = saved.summary
    verdict = str(summary.get("verdict", "not measured"))
    lines = [f"# {verdict} ({saved.record.outcome.name})", ""]
    if summary.get("reason"):
        lines += [str(summary["reason"]), ""]
    lines += ["| | value | tolerance | |", "|---|---|---|---|"]
    for name, metric in summary.get("metrics", {}).items():
        shown = metric.get("display") or metric
        if shown.get("tolerance") is None:
            continue
        value = "not measured" if shown["value"] is None else f"{shown['value']:.3g} {shown['unit']}"
        passed = {True: "pass", False: "**FAIL**", None: ""}[metric.get("pass")]
        lines.append(f"| {name.replace('_', ' ')} | {value} | {shown['tolerance']:.3g} | {passed} |")
    step = f"{1e3 * saved.record.time_step:g} ms"
    lines += [
        "",
        "Curves: one sample every 2 ms at most, and both sides of every switch of phase or contact.",
        f"Every time step ({step}) is in `signals.parquet`.",
    ]
    return plain_text("\n".join(lines) + "\n")


def plain_text(text: str) -> str:
    """Keep what the viewer's one font surely has: some versions end at the first glyph that it lacks."""
    return text.encode("latin-1", errors="replace").decode("latin-1")


def near(seconds: float = 1.5) -> rrb.TimeAxis:
    """Time axis that follows the cursor."""
    window = rr.TimeRange(
        start=rrb.TimeRangeBoundary.cursor_relative(seconds=-seconds),
        end=rrb.TimeRangeBoundary.cursor_relative(seconds=seconds / 3.0),
    )
    return rrb.TimeAxis(view_range=window)


TITLES = {
    "signals/zmp_x": "ZMP x about the planned COM [mm]",
    "signals/zmp_y": "ZMP y [mm]",
    **{f"signals/force_{axis}": f"F{axis} [N]" for axis in "xyz"},
    "signals/foot_force_z": "Load of each foot [N]",
    **{f"signals/angular_momentum_{axis}": f"L{axis} about the COM [N m s]" for axis in "xyz"},
    "signals/com_x": "COM x about the plan [m]",
    "signals/com_y": "COM y [m]",
    "signals/com_z": "COM z [m]",
    "residual/zmp": "ZMP error, measured - plan [mm]",
    "residual/force": "Force error [% of body weight]",
    "residual/angular_momentum": "Momentum error [N m s]",
    "residual/com": "COM error [mm]",
    "feedback/zmp": "Feedback: commanded - planned ZMP [mm]",
    "effort/torque": "Torque of the busiest motor [% of its limit]",
    "selfcheck/zmp": "Self-check: ZMP by momentum - by contact [mm]",
}
"""Entities that are curves. Signals are shown about the cursor, the others over the whole run."""


def plot(entity: str, prefixes: Sequence[str] = ("",), title: str = "") -> rrb.TimeSeriesView:
    """Curves of one entity of :data:`TITLES`, of one or several runs."""
    origins = [f"{prefix}/{entity}" for prefix in prefixes]
    options: dict[str, Any] = {"axis_x": near()} if entity.startswith("signals/") else {}
    where: dict[str, Any] = {"origin": origins[0]} if len(origins) == 1 else {"contents": origins}
    return rrb.TimeSeriesView(name=title or TITLES[entity], **where, **options)


def tabs(layout: Mapping[str, Sequence[str]], prefixes: Sequence[str] = ("",)) -> rrb.Tabs:
    """Tabs of curves: name to entities, see :func:`plot`."""
    columns = [
        rrb.Vertical(*(plot(entity, prefixes) for entity in entities), name=name)
        for name, entities in layout.items()
    ]
    return rrb.Tabs(*columns, active_tab=0)


def of_axes(signal: str, axes: str) -> list[str]:
    """Entities of a signal, one an axis."""
    return [f"signals/{signal}_{axis}" for axis in axes]


def body_view(name: str, origin: str, contents: Sequence[str]) -> rrb.Spatial3DView:
    """The body from the side; it walks on the spot and the floor passes by."""
    eye = rrb.EyeControls3D(position=(1.0, -1.85, 1.15), look_target=(0.05, 0.0, 0.82), eye_up=(0, 0, 1))
    grid = rrb.LineGrid3D(visible=True, spacing=0.2, color=(90, 98, 110, 120))
    return _scene(name, origin, contents, grid, eye)


def above_view(name: str, origin: str, contents: Sequence[str]) -> rrb.Spatial3DView:
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


def body_contents(prefix: str = "") -> list[str]:
    """Contents of the body's view for one run."""
    world = f"{prefix}/world"
    return [f"{world}/**", f"- {world}/floor/**", f"- {world}/feet/**", f"+ {world}/feet/+/contact"]


def above_contents(prefix: str = "") -> list[str]:
    """Contents of the view from above for one run."""
    return [f"{prefix}/world/{part}" for part in ("follow", "feet/**", "floor/**", "plan/**")]


def events_view(origin: str, timeline: str, name: str = "Events") -> rrb.TextLogView:
    """List of events with their times."""
    columns = rrb.TextLogColumns(timeline_columns=[timeline], text_log_columns=["loglevel", "body"])
    return rrb.TextLogView(name=name, origin=origin, columns=columns)


def laid_out(root: Any, timeline: str) -> rrb.Blueprint:
    """A blueprint that shows one thing and plays."""
    return rrb.Blueprint(
        root,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=timeline, play_state="playing", loop_mode="all"),
        auto_layout=False,
        auto_views=False,
    )


def run_blueprint() -> rrb.Blueprint:
    """Of one run: body and ZMP from above on the left; verdict and curves on the right."""
    body = body_view(
        "Body, with planned (blue) and measured (orange) ground force", "/world/follow", body_contents()
    )
    above = above_view(
        "From above: planned (blue), commanded (green), measured (orange) ZMP; planned support (blue)",
        "/world/follow",
        above_contents(),
    )
    curves = tabs(
        {
            "ZMP": [*of_axes("zmp", "xy"), "residual/zmp"],
            "Force": [*of_axes("force", "xyz"), "signals/foot_force_z", "residual/force"],
            "Momentum": [*of_axes("angular_momentum", "xyz"), "residual/angular_momentum"],
            "COM": [*of_axes("com", "xyz"), "residual/com"],
            "Cost": ["feedback/zmp", "effort/torque", "selfcheck/zmp"],
        }
    )
    right = rrb.Vertical(
        rrb.Horizontal(
            rrb.TextDocumentView(name="Verdict", origin="/verdict"),
            events_view("/events", TIMELINE),
            column_shares=[3, 2],
        ),
        curves,
        rrb.StateTimelineView(name="Phase and contact", origin="/phase", time_view=near()),
        row_shares=[8, 14, 5],
    )
    left = rrb.Vertical(body, above, row_shares=[3, 2])
    return laid_out(rrb.Horizontal(left, right, column_shares=[1, 1]), TIMELINE)
