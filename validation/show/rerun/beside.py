"""Layouts of several recordings in one: beside each other, or one gait of several revisions overlaid."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from ampm.exceptions import InputError
from validation.show.rerun.merge import PHASE, Part, read_part, same_gait, tint, write_merged
from validation.show.rerun.views import (
    Color,
    above_contents,
    above_view,
    body_contents,
    body_view,
    events_view,
    laid_out,
    near,
    plot,
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
    columns = [
        rrb.Vertical(
            body_view(f"{part.label}: plan (blue), measured (orange)", f"{_at(part)}/world/follow",
                      body_contents(_at(part))),
            above_view(f"{part.label} from above", f"{_at(part)}/world/follow", above_contents(_at(part))),
            plot(f"{part.label}: ZMP error, measured - plan [mm]", f"{_at(part)}/residual/zmp", whole=True),
            rrb.Tabs(
                plot("ZMP x about the planned COM [mm]", f"{_at(part)}/signals/zmp_x"),
                plot("Force error [% of body weight]", f"{_at(part)}/residual/force", whole=True),
                plot("Momentum error [N m s]", f"{_at(part)}/residual/angular_momentum", whole=True),
                plot("Busiest motor [% of its limit]", f"{_at(part)}/effort/torque", whole=True),
                rrb.TextDocumentView(name="Verdict", origin=f"{_at(part)}/verdict"),
                events_view(f"{_at(part)}/events", PHASE),
                active_tab=4,
            ),
            row_shares=[5, 3, 2, 3],
        )
        for part in parts
    ]  # fmt: skip
    lanes = rrb.StateTimelineView(
        name="Planned stance; a second on this timeline is a step",
        contents=[f"{_at(part)}/phase/planned_stance" for part in parts],
        time_view=near(),
    )
    return laid_out(rrb.Vertical(rrb.Horizontal(*columns), lanes, row_shares=[13, 2]), PHASE)


def _over(parts: Sequence[Part]) -> rrb.Blueprint:
    """All runs in one scene and on the same axes, each in its colour."""
    bodies, floors = [], []
    for number, part in enumerate(parts):
        world = f"{_at(part)}/world"
        bodies += [f"{world}/body/**", f"{world}/force/measured", f"{world}/com/measured"]
        floors += [f"{world}/feet/**", f"{world}/floor/zmp/measured/**", f"{world}/floor/com/measured/**"]
        if number == 0:  # the plan is the same
            bodies += [f"{world}/follow", f"{world}/plan/footprints"]
            floors += [f"{world}/follow", f"{world}/plan/**", f"{world}/floor/zmp/plan/**"]
    colours = ", ".join(f"{part.label} ({name})" for part, name in zip(parts, NAMES, strict=False))
    origin = f"{_at(parts[0])}/world/follow"

    def each(entity: str) -> list[str]:
        return [f"{_at(part)}/{entity}" for part in parts]

    curves = rrb.Tabs(
        rrb.Vertical(
            plot("ZMP error x and y [mm]", *each("residual/zmp"), whole=True),
            plot("ZMP x about the planned COM [mm]", *each("signals/zmp_x")),
            plot("ZMP y [mm]", *each("signals/zmp_y")),
            name="ZMP",
        ),
        rrb.Vertical(
            plot("Force error [% of body weight]", *each("residual/force"), whole=True),
            *[plot(f"F{a} [N]", *each(f"signals/force_{a}")) for a in "xyz"],
            name="Force",
        ),
        rrb.Vertical(
            plot("Momentum error [N m s]", *each("residual/angular_momentum"), whole=True),
            *[plot(f"L{a} about the COM [N m s]", *each(f"signals/angular_momentum_{a}")) for a in "xy"],
            name="Momentum",
        ),
        rrb.Vertical(
            plot("Feedback: commanded - planned ZMP [mm]", *each("feedback/zmp"), whole=True),
            plot("Busiest motor [% of its limit]", *each("effort/torque"), whole=True),
            plot("COM error [mm]", *each("residual/com"), whole=True),
            name="Cost",
        ),
        active_tab=0,
    )
    words = [
        rrb.TextDocumentView(name=part.label, origin=f"{_at(part)}/verdict") for part in parts
    ] + [events_view(f"{_at(part)}/events", PHASE, f"Events of {part.label}") for part in parts]  # fmt: skip
    left = rrb.Vertical(
        body_view(colours, origin, bodies),
        above_view("From above: soles and measured ZMP; planned support and ZMP (grey)", origin, floors),
        row_shares=[3, 2],
    )
    verdicts = rrb.Horizontal(*words[: len(parts)]) if len(parts) <= 2 else rrb.Tabs(*words[: len(parts)])
    right = rrb.Vertical(
        verdicts,
        curves,
        rrb.Tabs(
            rrb.StateTimelineView(
                name="Feet on the floor; a second on this timeline is a step",
                contents=[f"{_at(part)}/phase/**" for part in parts],
                time_view=near(),
            ),
            *words[len(parts) :],
        ),
        row_shares=[7, 14, 5],
    )
    return laid_out(rrb.Horizontal(left, right), PHASE)


def _paint(stream: rr.RecordingStream, parts: Sequence[Part]) -> None:
    """Colours of runs instead of those of plan and measurement."""
    for number, part in enumerate(parts):
        color = COLORS[number]
        tint(stream, part, color)
        if number == 0:
            for entity in ("polygon", "footprints"):
                strips = rr.LineStrips3D.from_fields(colors=[_PLAN])
                stream.log(f"{_at(part)}/world/plan/{entity}", strips, static=True)
            _grey(stream, f"{_at(part)}/world/floor/zmp/plan")
        faded: Color = (*(round(_FADED * c) for c in color[:3]), 255)  # type: ignore[assignment]
        pale: Color = (*(round(0.5 * c + 127) for c in color[:3]), 255)  # type: ignore[assignment]
        who = part.label
        for entity in ("residual/zmp", "feedback/zmp", "residual/angular_momentum"):
            _lines(stream, part, entity, [f"{who} x", f"{who} y"], [color, faded])
        for entity in ("residual/force", "residual/com"):
            _lines(stream, part, entity, [f"{who} {axis}" for axis in "xyz"], [color, faded, pale])
        _lines(stream, part, "effort/torque", [who], [color])
        signals = ["zmp_x", "zmp_y", *(f"force_{a}" for a in "xyz"), *(f"angular_momentum_{a}" for a in "xy")]
        for signal in signals:
            # Plan of the first run, command of none, measurement of all.
            names, colors = ["plan", "command", who], [_PLAN, faded, color]
            shown = [number == 0, False, True]
            _lines(stream, part, f"signals/{signal}", names, colors, shown)


def _grey(stream: rr.RecordingStream, entity: str) -> None:
    stream.log(entity, rr.Points3D.from_fields(colors=[_PLAN]), static=True)
    stream.log(f"{entity}/trail", rr.LineStrips3D.from_fields(colors=[_PLAN]), static=True)


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
    style = rr.SeriesLines(
        names=list(names),
        colors=list(colors),
        widths=[1.5] * len(names),
        visible_series=None if shown is None else list(shown),
    )
    stream.log(f"{_at(part)}/{entity}", style, static=True)


def _at(part: Part) -> str:
    return f"/{part.prefix}"
