"""Layouts of several recordings in one: beside each other, or one gait of several revisions overlaid."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from ampm.exceptions import InputError
from validation.show.rerun.merge import PHASE, Part, read_part, same_gait, tint, write_merged
from validation.show.rerun.views import (
    TITLES,
    Color,
    above_contents,
    above_view,
    body_contents,
    body_view,
    events_view,
    laid_out,
    near,
    of_axes,
    plot,
    tabs,
)

MOST = 6
"""Recordings that a screen has room for."""

COLORS: tuple[Color, ...] = (
    (86, 180, 233, 255), (255, 138, 61, 255), (120, 220, 120, 255),
    (230, 140, 255, 255), (255, 213, 79, 255), (240, 98, 146, 255),
)  # fmt: skip
NAMES = ("blue", "orange", "green", "violet", "yellow", "pink")
_FADED = 0.55
"""How much of a run's colour its second curve keeps."""

_PLAN: Color = (150, 158, 172, 255)


def merge(sources: Sequence[tuple[str, str, Path]], path: Path, *, overlay: bool | None = None) -> bool:
    """Put recordings into one file with a layout of its own.

    Args:
        sources: of each recording its prefix, its name for people, and its file; two or more.
        path: of the file; an existing one is replaced.
        overlay: over each other or beside each other; by default over each other if they are of one gait.

    Returns:
        Whether they are overlaid.

    Raises:
        InputError: too many, or one that is no recording of a walk.
    """
    if len(sources) > MOST:
        raise InputError(f"{len(sources)} recordings are more than a screen shows; give {MOST} at most.")
    parts = [read_part(file, prefix, label) for prefix, label, file in sources]
    over = same_gait(parts) if overlay is None else overlay
    if over:
        write_merged(parts, path, _over(parts), lambda stream: _paint(stream, parts))
    else:
        write_merged(parts, path, _beside(parts))
    return over


def _beside(parts: Sequence[Part]) -> rrb.Blueprint:
    """One column per run, all at the same phase of the gait."""
    columns = []
    for part in parts:
        at, follow = _at(part), f"{_at(part)}/world/follow"
        more = [
            plot(entity, [at])
            for entity in ("signals/zmp_x", "residual/force", "residual/angular_momentum", "effort/torque")
        ]
        verdict = rrb.TextDocumentView(name="Verdict", origin=f"{at}/verdict")
        views: list[rrb.Container | rrb.View] = [
            body_view(f"{part.label}: plan (blue), measured (orange)", follow, body_contents(at)),
            above_view(f"{part.label} from above", follow, above_contents(at)),
            plot("residual/zmp", [at], f"{part.label}: {TITLES['residual/zmp']}"),
            rrb.Tabs(*more, verdict, events_view(f"{at}/events", PHASE), active_tab=len(more)),
        ]
        columns.append(rrb.Vertical(*views, row_shares=[5, 3, 2, 3]))
    stances = [f"{_at(part)}/phase/planned_stance" for part in parts]
    lanes = _lanes("Planned stance", stances)
    return laid_out(rrb.Vertical(rrb.Horizontal(*columns), lanes, row_shares=[13, 2]), PHASE)


def _lanes(name: str, contents: Sequence[str]) -> rrb.StateTimelineView:
    title = f"{name}; a second on this timeline is a step"
    return rrb.StateTimelineView(name=title, contents=contents, time_view=near())


def _over(parts: Sequence[Part]) -> rrb.Blueprint:
    """All runs in one scene and on the same axes, each in its colour."""
    prefixes = [_at(part) for part in parts]
    world = f"{prefixes[0]}/world"
    bodies, floors = [f"{world}/follow", f"{world}/plan/footprints"], [f"{world}/follow"]
    floors += [f"{world}/plan/**", f"{world}/floor/zmp/plan/**"]  # the plan is the same
    for at in prefixes:
        bodies += [f"{at}/world/{what}" for what in ("body/**", "force/measured", "com/measured")]
        shown = ("feet/**", "floor/zmp/measured/**", "floor/com/measured/**")
        floors += [f"{at}/world/{what}" for what in shown]
    colours = ", ".join(f"{part.label} ({name})" for part, name in zip(parts, NAMES, strict=False))
    left = rrb.Vertical(
        body_view(colours, f"{world}/follow", bodies),
        above_view(
            "From above: soles and measured ZMP; planned support and ZMP (grey)", f"{world}/follow", floors
        ),
        row_shares=[3, 2],
    )
    curves = tabs(
        {
            "ZMP": ["residual/zmp", *of_axes("zmp", "xy")],
            "Force": ["residual/force", *of_axes("force", "xyz")],
            "Momentum": ["residual/angular_momentum", *of_axes("angular_momentum", "xy")],
            "Cost": ["feedback/zmp", "effort/torque", "residual/com"],
        },
        prefixes,
    )
    words = [rrb.TextDocumentView(name=part.label, origin=f"{_at(part)}/verdict") for part in parts]
    events = [events_view(f"{_at(part)}/events", PHASE, f"Events of {part.label}") for part in parts]
    right = rrb.Vertical(
        rrb.Horizontal(*words) if len(words) <= 2 else rrb.Tabs(*words),
        curves,
        rrb.Tabs(_lanes("Feet on the floor", [f"{at}/phase/**" for at in prefixes]), *events),
        row_shares=[7, 14, 5],
    )
    return laid_out(rrb.Horizontal(left, right), PHASE)


def _paint(stream: rr.RecordingStream, parts: Sequence[Part]) -> None:
    """Colours of runs instead of those of plan and measurement."""
    for number, part in enumerate(parts):
        color = COLORS[number]
        tint(stream, part, color)
        if number == 0:
            floor = f"{_at(part)}/world/floor/zmp/plan"
            for entity, shape in (
                (f"{_at(part)}/world/plan/polygon", rr.LineStrips3D),
                (f"{_at(part)}/world/plan/footprints", rr.LineStrips3D),
                (floor, rr.Points3D),
                (f"{floor}/trail", rr.LineStrips3D),
            ):
                stream.log(entity, shape.from_fields(colors=[_PLAN]), static=True)
        faded: Color = (*(round(_FADED * c) for c in color[:3]), 255)  # type: ignore[assignment]
        pale: Color = (*(round(0.5 * c + 127) for c in color[:3]), 255)  # type: ignore[assignment]
        who = part.label
        for entity in ("residual/zmp", "feedback/zmp", "residual/angular_momentum"):
            _lines(stream, part, entity, [f"{who} x", f"{who} y"], [color, faded])
        for entity in ("residual/force", "residual/com"):
            _lines(stream, part, entity, [f"{who} {axis}" for axis in "xyz"], [color, faded, pale])
        _lines(stream, part, "effort/torque", [who], [color])
        # Plan of the first run, command of none, measurement of all.
        names, colors, shown = ["plan", "command", who], [_PLAN, faded, color], [number == 0, False, True]
        for axes, signal in (("xy", "zmp"), ("xyz", "force"), ("xy", "angular_momentum")):
            for entity in of_axes(signal, axes):
                _lines(stream, part, entity, names, colors, shown)


def _lines(
    stream: rr.RecordingStream,
    part: Part,
    entity: str,
    names: Sequence[str],
    colors: Sequence[Color],
    shown: Sequence[bool] | None = None,
) -> None:
    """Name and colour curves, if the recording has them."""
    if f"/{entity}" not in part.entities:
        return
    widths = [1.5] * len(names)
    style = rr.SeriesLines(names=names, colors=colors, widths=widths, visible_series=shown)
    stream.log(f"{_at(part)}/{entity}", style, static=True)


def _at(part: Part) -> str:
    return f"/{part.prefix}"
