"""Several recordings in one: beside each other, or over each other, aligned on the gait's phase.

A viewer's panel shows entities of one recording only, so the recordings are put into one file, each under a
prefix (``a/world/...``). Their contents stay unchanged: recordings of two revisions need the same names of
entities, nothing else.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import rerun as rr
from rerun.chunk import Chunk, RrdReader

from ampm.exceptions import InputError
from ampm.geometry import Array
from validation.show.rerun.record import SERIES, open_stream
from validation.show.rerun.views import (
    ALERT,
    PHASE,
    RUN_COLORS,
    TIMELINE,
    TITLES,
    Color,
    axis_range,
    beside_blueprint,
    legend,
    overlay_blueprint,
)

_STANCE, _FOOTPRINTS = "/phase/planned_stance", "/world/plan/footprints"
_GREY: Color = (150, 158, 172, 255)
"""Colour of the plan that overlaid runs share."""
_CLEAR = 80
"""Alpha of the first of overlaid bodies, of 255."""
_BODY = ("Capsules3D", "Cylinders3D", "Boxes3D", "Ellipsoids3D")
_WIRES = {"fill_mode": rr.components.FillMode.MajorWireframe}
"""Style of the bodies after the first: colours of surfaces that nearly coincide would mix."""


class Part(NamedTuple):
    """A recording to be merged.

    Attributes:
        at: prefix of the names of all its entities, with a slash before it.
        label: displayed name.
        chunks: its contents.
    """

    at: str
    label: str
    chunks: tuple[Chunk, ...]

    def numbers(self, entity: str, column: str) -> Array:
        """All numbers in a column of an entity; empty if it has none."""
        found = [np.zeros(0)]
        for chunk in self.chunks:
            batch = chunk.to_record_batch()
            if chunk.entity_path == entity and column in batch.schema.names:
                values: Any = batch.column(column)
                while pa.types.is_nested(values.type):
                    values = values.flatten()
                found.append(np.asarray(values.to_numpy(zero_copy_only=False), dtype=np.float64))
        return np.concatenate(found)


def read_part(path: Path, prefix: str, label: str) -> Part:
    """Read one recording.

    Raises:
        InputError: the file is no recording of a walk.
    """
    try:
        chunks = tuple(RrdReader(path).stream())
    except Exception as error:  # the reader's errors have no type of their own
        first = str(error).partition("\n")[0]
        raise InputError(f"{path} cannot be read as a recording ({first}); walk the gait again.") from error
    if not any(chunk.entity_path == _STANCE and PHASE in chunk.timeline_names for chunk in chunks):
        raise InputError(
            f"{path} has no {_STANCE} over {PHASE}; give the recording of a walk, or walk the gait again."
        )
    return Part(f"/{prefix}", label, chunks)


def same_gait(parts: Sequence[Part]) -> bool:
    """Whether all recordings are of one plan: the same footsteps at the same times."""

    def agree(a: Array, b: Array) -> bool:
        count = min(len(a), len(b))  # a walk that ended early has fewer phases
        return bool(np.allclose(a[:count], b[:count], atol=1e-4))

    first = parts[0]
    return all(
        agree(1e-9 * first.numbers(_STANCE, TIMELINE), 1e-9 * part.numbers(_STANCE, TIMELINE))
        and agree(*(one.numbers(_FOOTPRINTS, "LineStrips3D:strips") for one in (first, part)))
        for part in parts[1:]
    )


def merge(sources: Sequence[tuple[str, str, Path]], path: Path, *, overlay: bool | None = None) -> bool:
    """Put recordings into one file with a layout of its own.

    Args:
        sources: prefix, displayed name and file of each recording; two or more.
        path: of the file; an existing one is replaced.
        overlay: over each other or beside each other; by default over each other if they are of one gait.

    Returns:
        Whether they are overlaid.

    Raises:
        InputError: too many, or one that is no recording of a walk.
    """
    if len(sources) > len(RUN_COLORS):
        raise InputError(
            f"{len(sources)} recordings are too many for one view; give {len(RUN_COLORS)} at most."
        )
    parts = [read_part(file, prefix, label) for prefix, label, file in sources]
    over = same_gait(parts) if overlay is None else overlay
    runs = {part.at: part.label for part in parts}
    scalars = "Scalars:scalars"
    ranges = {
        entity: axis_range(np.concatenate([part.numbers(f"/{entity}", scalars) for part in parts]))
        for entity in TITLES
    }
    blueprint = overlay_blueprint(runs, ranges) if over else beside_blueprint(runs, ranges)
    with open_stream("ampm-beside", "ampm-beside", path, blueprint) as stream:
        for part in parts:
            stream.send_chunks(
                chunk.with_entity_path(f"{part.at}{chunk.entity_path}".rstrip("/")) for chunk in part.chunks
            )
        if over:
            colors = {part.label: color for part, color in zip(parts, RUN_COLORS.values(), strict=False)}
            stream.log("/legend", legend({**colors, "plan": _GREY}), static=True)
            for part, color in zip(parts, RUN_COLORS.values(), strict=False):
                _paint(stream, part, color, first=part is parts[0])
    return over


def _paint(stream: rr.RecordingStream, part: Part, color: Color, *, first: bool) -> None:
    """The colour of a run instead of those of plan and measurement; the plan of the first one is grey."""

    def mixed(share: float, base: float = 0.0) -> Color:
        r, g, b = (round(share * value + base) for value in color[:3])
        return (r, g, b, 255)

    shades, who = [color, mixed(0.55), mixed(0.5, 127.0)], part.label
    for chunk in part.chunks:
        if not chunk.is_static:
            continue
        batch, entity = chunk.to_record_batch(), chunk.entity_path
        if "SeriesLines:names" in batch.schema.names:
            names = batch.column("SeriesLines:names")[0].as_py()
            colors, visible = shades[: len(names)], None
            if names[:3] == list(SERIES):  # plan of the first run, command of none, measurement of all
                moved = names[3:]  # the first plan, of a plan that moved
                names, visible = ["plan", "command", who, *moved], [first, False, True, *[False] * len(moved)]
                colors = [_GREY, shades[1], color, *[_GREY] * len(moved)]
            elif names == list("xyz")[: len(names)]:
                names = [f"{who} {axis}" for axis in names]
            elif names[1:] in ([], ["limit"]):
                names, colors = [who, *names[1:]], [color, ALERT][: len(names)]
            else:
                continue
            widths = [1.5] * len(names)
            lines = rr.SeriesLines(names=names, colors=colors, widths=widths, visible_series=visible)
            stream.log(part.at + entity, lines, static=True)
        elif entity.startswith("/world/"):
            own = (*color[:3], _CLEAR) if first and entity.startswith("/world/body/") else color
            if first and entity.startswith(("/world/plan/", "/world/floor/zmp/plan")):
                own = _GREY
            for name in batch.schema.names:
                kind, _, component = name.partition(":")
                if component == "colors":
                    options = {} if first or kind not in _BODY else _WIRES
                    shape = getattr(rr, kind).from_fields(colors=[own], **options)
                    stream.log(part.at + entity, shape, static=True)
