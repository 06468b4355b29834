"""Several recordings in one: side by side, or overlaid, on a timeline that counts steps instead of seconds.

A viewer's panel shows entities of one recording only, so the recordings are put into one file, each under a
name of its own (``a/world/...``). What they hold is taken as it is: recordings of two revisions need to agree
in nothing but the names of their entities.

The timeline ``gait_phase`` counts walking steps: 3.4 is within the fourth. A single support takes the first
:data:`SINGLE_SUPPORT` of a step and a double support the rest, whatever their durations, so that touch-downs
and lift-offs of different gaits coincide. On this timeline a second is a step: Rerun has none without a unit.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray
from rerun.chunk import Chunk, RrdReader

from ampm.exceptions import InputError
from validation.show.rerun.views import TIMELINE, Color

Array = NDArray[np.float64]

PHASE = "gait_phase"
SINGLE_SUPPORT = 0.8
"""Share of a step on the timeline that a single support takes; about that of a walk."""

_STANCE = "/phase/planned_stance"
_FOOTPRINTS = "/world/plan/footprints"
_BOTH = "both feet"
_INDEX = b"rerun:index_name"


@dataclass(frozen=True)
class Part:
    """A recording on its way into another.

    Attributes:
        prefix: first part of all its entities' names, without slashes.
        label: name for people.
        path: of its file.
        chunks: what it holds.
        starts: times at which its planned phases begin, shape (n,) [s].
        phases: their place on the timeline ``gait_phase``, shape (n,).
        footprints: outlines of the planned footsteps as numbers; empty if there are none.
    """

    prefix: str
    label: str
    path: Path
    chunks: tuple[Chunk, ...]
    starts: Array
    phases: Array
    footprints: Array

    def phase(self, seconds: Array) -> Array:
        """Place of times on ``gait_phase``; the last phase goes on at its own pace."""
        return np.interp(seconds, self.starts, self.phases)

    @property
    def entities(self) -> frozenset[str]:
        """Names of all entities, without the prefix."""
        return frozenset(chunk.entity_path for chunk in self.chunks)

    @property
    def coloured(self) -> list[tuple[str, str]]:
        """Entity and archetype of everything in the scene that has a colour of its own."""
        found = []
        for chunk in self.chunks:
            if chunk.is_static and chunk.entity_path.startswith("/world/"):
                names = chunk.to_record_batch().schema.names
                found += [(chunk.entity_path, n.partition(":")[0]) for n in names if n.endswith(":colors")]
        return found


def read_part(path: Path, prefix: str, label: str) -> Part:
    """Read one recording.

    Raises:
        InputError: the file is no recording of a walk.
    """
    try:
        chunks = tuple(RrdReader(path).stream())
    except Exception as error:  # the reader's errors have no type of their own
        first = str(error).partition("\n")[0]
        raise InputError(f"{path} cannot be read as a recording ({first}); draw it again.") from error
    starts, phases = _gait_phase(chunks, path)
    return Part(prefix, label, path, chunks, starts, phases, _footprints(chunks))


def same_gait(parts: Sequence[Part]) -> bool:
    """Whether all recordings are of one plan: the same footsteps at the same times."""
    first = parts[0]

    def agrees(part: Part) -> bool:
        # A walk that ended early has fewer phases, and its last ends where it did.
        count = min(len(first.starts), len(part.starts)) - 1
        prints = min(len(first.footprints), len(part.footprints))
        return bool(
            np.allclose(first.footprints[:prints], part.footprints[:prints], atol=1e-4)
            and np.allclose(first.starts[:count], part.starts[:count], atol=1e-4)
        )

    return all(agrees(part) for part in parts[1:])


def write_merged(
    parts: Sequence[Part],
    path: Path,
    blueprint: Any,
    paint: Callable[[rr.RecordingStream], None] | None = None,
) -> None:
    """Write recordings into one file.

    Args:
        parts: what to put in, each under its prefix.
        path: of the file; an existing one is replaced.
        blueprint: the file's own layout.
        paint: sends what is to replace colours and names of the parts.
    """
    logging.getLogger("rerun").setLevel(logging.ERROR)
    stream = rr.RecordingStream("ampm-beside", recording_id="ampm-beside", send_properties=False)
    stream.save(str(path), default_blueprint=blueprint)
    try:
        for part in parts:
            stream.send_chunks(_moved(chunk, part) for chunk in part.chunks)
        if paint is not None:
            paint(stream)
    finally:
        # Without the footer that this writes the file does not verify.
        stream.flush()
        stream.disconnect()


def tint(stream: rr.RecordingStream, part: Part, color: Color, *, clear: int = 80) -> None:
    """Give everything in a part's scene one colour; the body is let through by ``clear`` of 255."""
    for entity, archetype in part.coloured:
        body = entity.startswith("/world/body/")
        own = (*color[:3], clear if body else 255)
        stream.log(f"/{part.prefix}{entity}", getattr(rr, archetype).from_fields(colors=[own]), static=True)


def _moved(chunk: Chunk, part: Part) -> Chunk:
    """A chunk under the part's prefix, with the timeline ``gait_phase`` beside that of seconds."""
    entity = f"/{part.prefix}{chunk.entity_path}".rstrip("/")
    batch = chunk.to_record_batch()
    if TIMELINE not in batch.schema.names or PHASE in batch.schema.names:
        return chunk.with_entity_path(entity)
    at = batch.schema.get_field_index(TIMELINE)
    field, times = batch.schema.field(at), batch.column(at)
    nanoseconds = times.cast(pa.int64()).to_numpy(zero_copy_only=False)
    phase = np.round(1e9 * part.phase(1e-9 * nanoseconds)).astype(np.int64)
    named = field.with_name(PHASE).with_metadata({**(field.metadata or {}), _INDEX: PHASE.encode()})
    batch = batch.add_column(at + 1, named, pa.array(phase).cast(field.type))
    (moved,) = Chunk.from_record_batch(batch)
    return moved.with_entity_path(entity)


def _gait_phase(chunks: Sequence[Chunk], path: Path) -> tuple[Array, Array]:
    """Where the planned phases begin, in seconds and in steps, with the end of the recording as the last."""
    times: list[Array] = []
    states: list[str] = []
    end = 0.0
    for chunk in chunks:
        if chunk.is_static or TIMELINE not in chunk.timeline_names:
            continue
        batch = chunk.to_record_batch()
        seconds = 1e-9 * batch.column(TIMELINE).cast(pa.int64()).to_numpy(zero_copy_only=False)
        end = max(end, float(seconds.max(initial=0.0)))
        if chunk.entity_path == _STANCE:
            times.append(seconds)
            states += [row[0] for row in batch.column("StateChange:state").to_pylist()]
    if not states:
        raise InputError(f"{path} has no {_STANCE}; give the recording of a walk.")
    starts = np.concatenate(times)
    both = np.array([state == _BOTH for state in states])
    steps = np.cumsum(~both) - 1.0  # a step begins with its single support
    phases = np.maximum(steps, 0.0) + np.where(both, SINGLE_SUPPORT, 0.0)
    # The last phase may have been cut short: it keeps the pace of its kind.
    share = np.where(both, 1.0 - SINGLE_SUPPORT, SINGLE_SUPPORT)
    length = np.diff(starts)
    like = length[both[:-1] == both[-1]]
    usual = float(np.median(like)) if len(like) else max(end - float(starts[-1]), 1e-9)
    last = phases[-1] + share[-1] * (end - starts[-1]) / usual
    if end > starts[-1]:
        return np.append(starts, end), np.append(phases, last)
    return starts, phases


def _footprints(chunks: Sequence[Chunk]) -> Array:
    for chunk in chunks:
        if chunk.entity_path == _FOOTPRINTS:
            column = chunk.to_record_batch().column("LineStrips3D:strips")
            while not pa.types.is_floating(column.type):
                column = column.flatten()
            return np.asarray(column.to_numpy(zero_copy_only=False), dtype=np.float64)
    return np.zeros(0)
