"""Several recordings in one, aligned on the gait's phase: bodies side by side, curves over each other.

A viewer's panel shows entities of one recording only, so the recordings are put into one file, each under a
prefix (``a/world/...``). Their contents stay unchanged, but for the colours of the curves.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun as rr
from rerun.chunk import Chunk, RrdReader

from ampm.exceptions import InputError
from ampm.geometry import Array
from validation.show.rerun.record import open_stream
from validation.show.rerun.views import PHASE, RUN_COLORS, Color, Ranges, axis_range, several_blueprint

_STANCES = "/phase/planned_stance", "/phase/measured_stance"
_HIDDEN = ("command", "first_plan")
"""Curves of a run that are not shown beside other runs."""
_SHARES = {"plan": 0.5, "motion": 0.5, "y": 0.65, "z": 0.4}
"""Brightness of curves in the colour of their run; of others it is 1."""


def read_chunks(path: Path) -> list[Chunk]:
    """Read one recording.

    Raises:
        InputError: the file is not a recording of a walk.
    """
    try:
        chunks = list(RrdReader(path).stream())
    except Exception as error:  # the reader's errors have no type of their own
        first = str(error).partition("\n")[0]
        raise InputError(f"{path} cannot be read as a recording ({first}); walk the gait again.") from error
    if not any(chunk.entity_path in _STANCES and PHASE in chunk.timeline_names for chunk in chunks):
        raise InputError(
            f"{path} has no {_STANCES[0]} over {PHASE}; give the recording of a walk, or walk the gait again."
        )
    return chunks


def merge(sources: Sequence[tuple[str, str, Path]], path: Path) -> None:
    """Put recordings into one file with a layout of its own.

    Args:
        sources: prefix, displayed name and file of each recording; two or more.
        path: of the file; an existing one is replaced.

    Raises:
        InputError: too many, or one that is not a recording of a walk.
    """
    if len(sources) > len(RUN_COLORS):
        raise InputError(
            f"{len(sources)} recordings are too many for one view; give {len(RUN_COLORS)} at most."
        )
    recordings = [read_chunks(file) for _, _, file in sources]
    runs = {f"/{prefix}": label for prefix, label, _ in sources}
    blueprint = several_blueprint(runs, _ranges([chunk for chunks in recordings for chunk in chunks]))
    with open_stream("ampm-beside", "ampm-beside", path, blueprint) as stream:
        for (prefix, label, _), chunks, color in zip(sources, recordings, RUN_COLORS, strict=False):
            moved = [chunk.with_entity_path(f"/{prefix}{chunk.entity_path}".rstrip("/")) for chunk in chunks]
            stream.send_chunks(moved)
            for chunk in moved:
                _paint(stream, chunk, label, color)


def _ranges(chunks: Sequence[Chunk]) -> Ranges:
    """Ends of the vertical axes of all curves, together for all recordings."""
    values: dict[str, list[Array]] = {}
    for chunk in chunks:
        batch = chunk.to_record_batch()
        if "Scalars:scalars" in batch.schema.names:
            drawn = batch.column("Scalars:scalars").flatten().to_numpy()
            values.setdefault(chunk.entity_path.removeprefix("/"), []).append(drawn)
    return {entity: axis_range(np.concatenate(parts)) for entity, parts in values.items()}


def _paint(stream: rr.RecordingStream, chunk: Chunk, label: str, color: Color) -> None:
    """Give curves the colour and the name of their run."""
    batch = chunk.to_record_batch()
    if not chunk.is_static or "SeriesLines:names" not in batch.schema.names:
        return
    names = batch.column("SeriesLines:names")[0].as_py()
    shares = [_SHARES.get(name, 1.0) for name in names]
    lines = rr.SeriesLines(
        names=[f"{label} {name}" for name in names],
        colors=[(*(round(share * part) for part in color[:3]), 255) for share in shares],
        widths=[1.5] * len(names),
        visible_series=[name not in _HIDDEN for name in names],
    )
    stream.log(chunk.entity_path, lines, static=True)
