"""A record on disk, lossless: arrays of a record as columns of Parquet files.

One column per scalar, so that any tool can read them: ``joints.parquet`` (state, torque, and what a restart
needs), ``contacts.parquet`` (every contact force), ``states.parquet`` (body quantities, sensors, the
controller's commands), ``ticks.parquet`` (the solver), and ``external.parquet`` (forces of disturbances) if
there were any. Nothing is pickled or rounded: a record is read back bit for bit.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from ampm.exceptions import InputError
from validation.store.json import json_ready
from validation.trial.outcome import Outcome
from validation.trial.record import FEET, INTEGERS, SHAPES, SimulationRecord, shape_of

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

_FIELDS = {
    JOINTS_FILE: "time q qd torque warmstart",
    CONTACTS_FILE: "time point_force point_position point_penetration point_velocity command_point_force",
    STATES_FILE: "time com angular_momentum foot_position foot_rotation command_com command_zmp "
    "command_force command_angular_momentum sensors",
    TICKS_FILE: "tick_time qp_status qp_residual qp_iterations qp_time",
    EXTERNAL_FILE: "time external_force external_moment external_position",
}
"""Fields of a :class:`SimulationRecord` in each file. All others are in the header, a text in every file."""
_WORDS = {"foot_position": "foot", "foot_rotation": "foot", "command_point_force": "command_force"}
"""Words in the names of columns that differ from the field's name."""
_BEGINNINGS = ("point_", "external_", "tick_")
_FORMAT = 2
_METADATA_KEY = b"ampm_record"
_ROOT_Q = ("root_x", "root_y", "root_z", "root_qw", "root_qx", "root_qy", "root_qz")
_ROOT_V = ("root_x", "root_y", "root_z", "root_wx", "root_wy", "root_wz")


class _Block(NamedTuple):
    """A field and the columns of its scalars on disk."""

    field: str
    file: str
    shape: tuple[int, ...]
    columns: tuple[str, ...]


def _blocks(header: Mapping[str, Any]) -> list[_Block]:
    """Every array of a record whose header this is; one of each sensor, ``sensors:`` before its name."""
    steps, joints = header["steps"], header["joint_names"]
    owners = {"P": header["point_names"], "S": header["external_segments"], "F": FEET}
    parts = {
        "2": "xy", "3": "xyz", "4": ("qw", "qx", "qy", "qz"), "nu": joints,
        "nq": _coordinate_names(header["nq"], _ROOT_Q, joints),
        "nv": _coordinate_names(header["nv"], _ROOT_V, joints),
    }  # fmt: skip
    sizes = {name: len(names) for name, names in (owners | parts).items()}
    sizes |= {"K": steps, "K+1": steps + 1, "T": header["ticks"]}
    found = []
    for file, names in _FIELDS.items():
        for name in names.split():
            if name == "sensors":
                for sensor, width in header["sensors"].items():
                    columns = tuple(f"sensor_{sensor}_{index}" for index in range(width))
                    found.append(_Block(f"sensors:{sensor}", file, (steps + 1, width), columns))
                continue
            word = _WORDS.get(name, name)
            for beginning in _BEGINNINGS:
                word = word.removeprefix(beginning)
            symbols = SHAPES[name].split()[1:]
            owned = next((owners[symbol] for symbol in symbols if symbol in owners), ("",))
            split = next((parts[symbol] for symbol in symbols if symbol in parts), ("",))
            columns = tuple("_".join(filter(None, (a, word, b))) for a in owned for b in split)
            found.append(_Block(name, file, shape_of(name, sizes), columns))
    return [block for block in found if owners["S"] or block.file != EXTERNAL_FILE]


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
        table = pa.Table.from_arrays(arrays, names=list(columns))
        write_table(table.replace_schema_metadata({_METADATA_KEY: header.encode()}), directory / name)


def record_columns(record: SimulationRecord) -> dict[str, dict[str, NDArray[Any]]]:
    """All numbers of a record as named columns, grouped by the file that holds them.

    Columns of one file may differ by one in length: what belongs to a step has no entry at the last instant.
    """
    files: dict[str, dict[str, NDArray[Any]]] = {}
    for block in _blocks(_header(record)):
        name, _, sensor = block.field.partition(":")
        array = record.sensors[sensor] if sensor else getattr(record, name)
        flat = array.reshape(len(array), len(block.columns))
        file = files.setdefault(block.file, {})
        file.update((name, flat[:, index]) for index, name in enumerate(block.columns))
    return files


def write_table(table: pa.Table, path: str | Path) -> None:
    """Write a table of floats with zstd over split bytes and without dictionary, which suits them best."""
    split = [item.name for item in table.schema if pa.types.is_floating(item.type)]
    other = [item.name for item in table.schema if not pa.types.is_floating(item.type)]
    pq.write_table(
        table, Path(path), compression="zstd", use_byte_stream_split=split, use_dictionary=other or False
    )


def _header(record: SimulationRecord) -> dict[str, Any]:
    """Sizes, names and all fields that are no columns, as JSON, which keeps every bit of finite numbers."""
    stored = " ".join(_FIELDS.values()).split()
    constants = {item.name: getattr(record, item.name) for item in fields(record) if item.name not in stored}
    header = {
        "format": _FORMAT,
        "steps": record.steps,
        "ticks": record.tick_time.size,
        "nq": record.q.shape[1],
        "nv": record.qd.shape[1],
        "point_names": record.point_names,
        "sensors": {name: value.shape[1] for name, value in record.sensors.items()},
        **constants,
    }
    return dict(json_ready(header))


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
        header = _read_header(directory / JOINTS_FILE)
        try:
            self._blocks = {block.field: block for block in _blocks(header)}
            self._constants = _constants(header)
            self.steps = int(header["steps"])
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise InputError(
                f"{directory / JOINTS_FILE} is damaged: its description is ({error}); walk the gait again."
            ) from error
        vars(self).update(self._constants)

    def __getattr__(self, name: str) -> NDArray[Any]:
        """Read a field; it is kept until :meth:`forget`.

        Raises:
            InputError: its file or one of its columns is missing.
        """
        block = vars(self).get("_blocks", {}).get(name)
        if block is None:
            raise AttributeError(f"a record has no field {name!r}")
        array = _array(block, self.directory / block.file)
        vars(self)[name] = array
        return array

    def forget(self) -> None:
        """Free the memory of all arrays; they are read again when used."""
        for name in self._blocks:
            vars(self).pop(name, None)

    def load(self) -> SimulationRecord:
        """Read everything.

        Raises:
            InputError: a file or one of its columns is missing or damaged.
        """
        files = dict.fromkeys(block.file for block in self._blocks.values())
        tables = {file: read_table(self.directory / file) for file in files}
        values: dict[str, Any] = {"sensors": {}}
        for block in self._blocks.values():
            name, _, sensor = block.field.partition(":")
            array = _array(block, self.directory / block.file, tables[block.file])
            if sensor:
                values["sensors"][sensor] = array
            else:
                values[name] = array
        return SimulationRecord(**values, **self._constants)


def load_record(directory: str | Path) -> SimulationRecord:
    """Read back what :func:`save_record` wrote, bit for bit.

    Raises:
        InputError: a file is missing, damaged, or of another format.
    """
    return StoredRecord(Path(directory)).load()


def _array(block: _Block, path: Path, table: pa.Table | None = None) -> NDArray[Any]:
    """One array, from its file or from the table of it."""
    table = read_table(path, block.columns) if table is None else table
    try:
        columns = [table.column(name).slice(0, block.shape[0]).to_numpy() for name in block.columns]
        array = np.stack(columns, axis=-1).reshape(block.shape)
        if array.dtype.kind not in "fiu":
            raise ValueError(f"{block.columns[0]} holds no numbers")
    except (KeyError, ValueError) as error:
        raise InputError(f"{path} is damaged ({error.args[0]}); walk the gait again.") from None
    array.setflags(write=False)
    return array


def _read_header(path: Path) -> dict[str, Any]:
    """The description of a recorded run."""
    raw = (_readable(path, pq.read_schema).metadata or {}).get(_METADATA_KEY)
    try:
        header: dict[str, Any] = json.loads(raw or "")
        written = header["format"]
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path} is no recorded run: it carries no description of the run.") from error
    if written != _FORMAT:
        raise InputError(
            f"{path} has record format {written}, this version reads {_FORMAT}; "
            "simulate the run again or use the version that wrote it"
        )
    return header


def _constants(header: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of a :class:`SimulationRecord` that are in its header."""
    stored = " ".join(_FIELDS.values()).split()
    found: dict[str, Any] = {}
    for name in (item.name for item in fields(SimulationRecord) if item.name not in stored):
        value = header[name]
        if name in SHAPES:
            found[name] = np.array(value, dtype=INTEGERS.get(name, np.float64))
        elif name in ("mass", "gravity", "time_step", "friction"):
            found[name] = math.nan if value is None else float(value)
        else:
            found[name] = tuple(value) if isinstance(value, list) else value
    return found | {"outcome": Outcome(**header["outcome"])}


def read_table(path: Path, columns: Sequence[str] | None = None) -> pa.Table:
    """Read a file of a run, or some of its columns; those that are absent are left out.

    Raises:
        InputError: it is missing or cannot be read.
    """

    def read(path: Path) -> pa.Table:
        with pq.ParquetFile(path) as file:
            return file.read(columns=None if columns is None else list(columns))

    return _readable(path, read)


def _readable(path: Path, read: Callable[[Path], Any]) -> Any:
    try:
        return read(path)
    except FileNotFoundError:
        raise InputError(f"{path} is missing; give the folder of a recorded run.") from None
    except (pa.ArrowException, OSError) as error:
        raise InputError(f"{path} cannot be read ({error}); walk the gait again.") from error
