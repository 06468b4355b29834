"""A record on disk, lossless: which array is which columns of which Parquet file.

One column per scalar, so that any tool can read them: ``joints.parquet`` (state, torque, and what a restart
needs), ``contacts.parquet`` (every contact force), ``states.parquet`` (body quantities, sensors, the
controller's commands), ``ticks.parquet`` (the solver), and ``external.parquet`` (forces of disturbances) if
there were any. Nothing is pickled or rounded: what is read back has the bits of what was saved.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from ampm.exceptions import InputError
from validation.trial.outcome import Outcome
from validation.trial.record import FEET, SimulationRecord

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

JOINTS_FILE = "joints.parquet"
CONTACTS_FILE = "contacts.parquet"
STATES_FILE = "states.parquet"
TICKS_FILE = "ticks.parquet"
RECORD_FILES = (JOINTS_FILE, CONTACTS_FILE, STATES_FILE, TICKS_FILE)
EXTERNAL_FILE = "external.parquet"
"""Beside the others if the walk was disturbed."""

XYZ = ("x", "y", "z")
_FORMAT = 1
_METADATA_KEY = b"ampm_record"
_ROOT_Q = ("root_x", "root_y", "root_z", "root_qw", "root_qx", "root_qy", "root_qz")
_ROOT_V = ("root_x", "root_y", "root_z", "root_wx", "root_wy", "root_wz")


@dataclass(frozen=True)
class RecordBlock:
    """One array of the record and where its scalars lie on disk."""

    field: str
    file: str
    rows: int
    tail: tuple[int, ...]
    columns: tuple[str, ...]


def record_blocks(header: Mapping[str, Any]) -> Iterator[RecordBlock]:
    """Every array of a record whose header this is."""
    k, ticks, nq, nv = header["steps"], header["ticks"], header["nq"], header["nv"]
    joints, points = header["joint_names"], header["point_names"]
    segments = header.get("external_segments", ())
    q_names = _coordinate_names(nq, _ROOT_Q, joints)
    v_names = _coordinate_names(nv, _ROOT_V, joints)

    def vector(prefix: str, names: Sequence[str]) -> tuple[str, ...]:
        return tuple(f"{prefix}_{name}" for name in names)

    def each(owners: Sequence[str], names: Sequence[str]) -> tuple[str, ...]:
        return tuple(f"{owner}_{name}" for owner in owners for name in names)

    def block(field: str, file: str, rows: int, *tail: int, columns: tuple[str, ...]) -> RecordBlock:
        return RecordBlock(field, file, rows, tail, columns)

    def times(file: str) -> RecordBlock:
        return block("time", file, k + 1, columns=("time",))

    yield times(JOINTS_FILE)
    yield block("q", JOINTS_FILE, k + 1, nq, columns=vector("q", q_names))
    yield block("qd", JOINTS_FILE, k + 1, nv, columns=vector("qd", v_names))
    yield block("torque", JOINTS_FILE, k, len(joints), columns=vector("torque", joints))
    yield block("warmstart", JOINTS_FILE, k, nv, columns=vector("warmstart", v_names))

    count = len(points)
    yield times(CONTACTS_FILE)
    for name, part in (("point_force", "force"), ("point_position", "position")):
        yield block(name, CONTACTS_FILE, k, count, 3, columns=each(points, vector(part, XYZ)))
    yield block("point_penetration", CONTACTS_FILE, k, count, columns=each(points, ("penetration",)))
    for name, part in (("point_velocity", "velocity"), ("command_point_force", "command_force")):
        yield block(name, CONTACTS_FILE, k, count, 3, columns=each(points, vector(part, XYZ)))

    yield times(STATES_FILE)
    for name in ("com", "angular_momentum"):
        yield block(name, STATES_FILE, k + 1, 3, columns=vector(name, XYZ))
    turned = ("qw", "qx", "qy", "qz")
    yield block("foot_position", STATES_FILE, k + 1, 2, 3, columns=each(FEET, vector("foot", XYZ)))
    yield block("foot_rotation", STATES_FILE, k + 1, 2, 4, columns=each(FEET, vector("foot", turned)))
    for name, size in (("com", 3), ("zmp", 2), ("force", 3), ("angular_momentum", 3)):
        name = f"command_{name}"
        yield block(name, STATES_FILE, k, size, columns=vector(name, XYZ[:size]))
    for name, width in header["sensors"].items():
        columns = vector(f"sensor_{name}", [str(index) for index in range(width)])
        yield block(f"sensor:{name}", STATES_FILE, k + 1, width, columns=columns)

    yield block("tick_time", TICKS_FILE, ticks, columns=("time",))
    for name in ("qp_status", "qp_residual", "qp_iterations", "qp_time"):
        yield block(name, TICKS_FILE, ticks, columns=(name,))

    if segments:
        yield times(EXTERNAL_FILE)
    for part in ("force", "moment", "position"):
        columns = each(segments, vector(part, XYZ))
        yield block(f"external_{part}", EXTERNAL_FILE, k, len(segments), 3, columns=columns)


def _coordinate_names(count: int, root: tuple[str, ...], joints: Sequence[str]) -> list[str]:
    """Names of coordinates: a free root and the hinges, or plain numbers for any other body."""
    if count == len(root) + len(joints):
        return [*root, *joints]
    return [str(index) for index in range(count)]


# -------------------------------------------------------------------------------------------------- writing


def save_record(record: SimulationRecord, directory: str | Path) -> None:
    """Write ``record`` into ``directory`` (which is created): the files of :data:`RECORD_FILES`, and
    :data:`EXTERNAL_FILE` if anything but the floor pushed the body.
    """
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    header = json.dumps(_header(record), allow_nan=False)
    for name, columns in record_columns(record).items():
        rows = max(column.size for column in columns.values())
        arrays = [_padded(column, rows) for column in columns.values()]
        schema = pa.schema(
            [pa.field(key, array.type) for key, array in zip(columns, arrays, strict=True)],
            metadata={_METADATA_KEY: header.encode()},
        )
        write_table(pa.Table.from_arrays(arrays, schema=schema), directory / name)


def record_columns(record: SimulationRecord) -> dict[str, dict[str, NDArray[Any]]]:
    """All numbers of a record as named columns, grouped by the file that holds them.

    Columns of one file may differ by one in length: what belongs to a step has no entry at the last instant.
    """
    files: dict[str, dict[str, NDArray[Any]]] = {}
    for block in record_blocks(_header(record)):
        if not block.columns:
            continue
        if block.field.startswith("sensor:"):
            array = record.sensors[block.field.removeprefix("sensor:")]
        else:
            array = getattr(record, block.field)
        flat = array.reshape(array.shape[0], len(block.columns))
        file = files.setdefault(block.file, {})
        file.update((name, flat[:, index]) for index, name in enumerate(block.columns))
    return files


def write_table(table: pa.Table, path: str | Path) -> None:
    """Write a table of floats the way that suits them: zstd over split bytes, no dictionary."""
    split = [item.name for item in table.schema if pa.types.is_floating(item.type)]
    other = [item.name for item in table.schema if not pa.types.is_floating(item.type)]
    pq.write_table(
        table, Path(path), compression="zstd", use_byte_stream_split=split, use_dictionary=other or False
    )


def _header(record: SimulationRecord) -> dict[str, Any]:
    header = {
        "format": _FORMAT,
        "steps": record.steps,
        "ticks": record.tick_time.size,
        "nq": record.q.shape[1],
        "nv": record.qd.shape[1],
        "point_foot": record.point_foot.tolist(),
        "point_group": record.point_group.tolist(),
        "point_names": list(record.point_names),
        "sensors": {name: value.shape[1] for name, value in record.sensors.items()},
        "outcome": {
            "name": str(record.outcome.name),
            "time": _exact(record.outcome.time),
            "cause": record.outcome.cause,
            "steps_completed": int(record.outcome.steps_completed),
        },
        "mass": _exact(record.mass),
        "gravity": _exact(record.gravity),
        "time_step": _exact(record.time_step),
        "friction": _exact(record.friction),
        "torque_limit": [_exact(value) for value in record.torque_limit.tolist()],
        "joint_range": [_exact(value) for value in record.joint_range.ravel().tolist()],
        "joint_names": list(record.joint_names),
        "metadata": dict(record.metadata),
    }
    if record.external_segments:
        header["external_segments"] = list(record.external_segments)
    return header


def _exact(value: float) -> float | str:
    """JSON has no infinity and no NaN: those become text; every other float survives JSON exactly."""
    return float(value) if math.isfinite(value) else repr(float(value))


def _padded(column: NDArray[Any], rows: int) -> pa.Array:
    array = pa.array(np.ascontiguousarray(column))
    if column.size < rows:
        array = pa.concat_arrays([array, pa.nulls(rows - column.size, array.type)])
    return array


# -------------------------------------------------------------------------------------------------- reading


class StoredRecord:
    """The fields of a :class:`validation.trial.record.SimulationRecord`, each read when it is first used: a
    run has more numbers than pictures need.

    Args:
        directory: folder of a recorded run.

    Raises:
        InputError: there is no record, or one of another format.
    """

    outcome: Outcome
    mass: float
    gravity: float
    time_step: float
    friction: float
    torque_limit: Array
    joint_range: Array
    joint_names: tuple[str, ...]
    point_foot: NDArray[np.int8]
    point_group: NDArray[np.int8]

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        header = read_header(directory)
        blocks: dict[str, RecordBlock] = {}
        try:
            self._fields = _header_fields(header)
            self.steps = int(header["steps"])
            for block in record_blocks(header):
                blocks.setdefault(block.field, block)
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise InputError(
                f"{directory / JOINTS_FILE} is damaged: its description is ({error}); walk the gait again."
            ) from error
        vars(self).update(self._fields)
        self._blocks = blocks

    def __getattr__(self, name: str) -> NDArray[Any]:
        """Read a field; it is kept until :meth:`forget`.

        Raises:
            InputError: its file or one of its columns is missing.
        """
        block = vars(self).get("_blocks", {}).get(name)
        if block is None:
            raise AttributeError(f"a record has no field {name!r}")
        array = self._read(block)
        vars(self)[name] = array
        return array

    def _read(self, block: RecordBlock, table: pa.Table | None = None) -> NDArray[Any]:
        """One array, from its file or from the table of it."""
        if not block.columns:
            return np.zeros((block.rows, *block.tail))
        path = self.directory / block.file
        table = _read_table(path, block.columns) if table is None else table
        try:
            columns = [table.column(name).slice(0, block.rows).to_numpy() for name in block.columns]
            array = np.stack(columns, axis=-1).reshape(block.rows, *block.tail)
        except KeyError as error:
            raise InputError(f"{path} lacks a column: {error.args[0]}") from None
        except ValueError:
            raise InputError(f"{path} is damaged: it lacks rows; walk the gait again.") from None
        if array.dtype.kind not in "fiu":
            raise InputError(f"{path} is damaged: {block.columns[0]} holds no numbers; walk the gait again.")
        array.setflags(write=False)
        return array

    def forget(self) -> None:
        """Give the memory of all arrays back; they are read again if they are used again."""
        for name in self._blocks:
            vars(self).pop(name, None)

    def load(self) -> SimulationRecord:
        """Read everything.

        Raises:
            InputError: a file or one of its columns is missing or damaged.
        """
        files = {block.file for block in self._blocks.values() if block.columns}
        tables = {file: _read_table(self.directory / file) for file in files}
        values: dict[str, Any] = {
            name: self._read(block, tables.get(block.file)) for name, block in self._blocks.items()
        }
        sensors = {
            name.removeprefix("sensor:"): values.pop(name)
            for name in list(values)
            if name.startswith("sensor:")
        }
        return SimulationRecord(**values, sensors=sensors, **self._fields)


def load_record(directory: str | Path) -> SimulationRecord:
    """Read back what :func:`save_record` wrote, bit for bit.

    Raises:
        InputError: a file is missing, damaged, or of another format.
    """
    return StoredRecord(Path(directory)).load()


def read_header(directory: Path) -> dict[str, Any]:
    """The description of a recorded run.

    Raises:
        InputError: there is no record, or one of another format.
    """
    schema = _readable(directory / JOINTS_FILE, pq.read_schema)
    raw = (schema.metadata or {}).get(_METADATA_KEY)
    if raw is None:
        raise InputError(
            f"{directory / JOINTS_FILE} is no recorded run: it carries no description of the run"
        )
    try:
        header: dict[str, Any] = json.loads(raw)
        written = header["format"]
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{directory / JOINTS_FILE} is damaged: its description cannot be read; walk the gait again."
        ) from error
    if written != _FORMAT:
        raise InputError(
            f"{directory} has record format {written}, this version reads {_FORMAT}; "
            "simulate the run again or use the version that wrote it"
        )
    return header


def _header_fields(header: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of a :class:`SimulationRecord` that are in its header."""
    end = header["outcome"]
    return {
        "point_foot": np.array(header["point_foot"], dtype=np.int8),
        "point_group": np.array(header["point_group"], dtype=np.int8),
        "outcome": Outcome(end["name"], float(end["time"]), end["cause"], end["steps_completed"]),
        **{name: float(header[name]) for name in ("mass", "gravity", "time_step", "friction")},
        "torque_limit": np.array([float(value) for value in header["torque_limit"]]),
        "joint_range": np.array([float(value) for value in header["joint_range"]]).reshape(-1, 2),
        "joint_names": tuple(header["joint_names"]),
        "external_segments": tuple(header.get("external_segments", ())),
        "metadata": header["metadata"],
    }


def _read_table(path: Path, columns: Sequence[str] | None = None) -> pa.Table:
    """Read one file of a record, or some of its columns.

    Raises:
        InputError: it is missing or cannot be read.
    """

    def read(path: Path) -> pa.Table:
        with pq.ParquetFile(path) as file:  # columns that are absent are left out
            return file.read(columns=None if columns is None else list(columns))

    return _readable(path, read)


def _readable(path: Path, read: Callable[[Path], Any]) -> Any:
    try:
        return read(path)
    except FileNotFoundError:
        raise InputError(f"{path} is missing; give the folder of a recorded run") from None
    except (pa.ArrowException, OSError) as error:
        raise InputError(f"{path} cannot be read ({error}); simulate the run again") from error
