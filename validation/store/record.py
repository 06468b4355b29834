"""A record on disk: what the physics of a walk depends on, as columns of Parquet files.

``ticks.parquet`` has torques, commands and solver of every control tick, ``joints.parquet`` a state every
10 ms, from which the physics can be started again, and ``external.parquet`` the forces of disturbances, if
there were any. Everything else is stepped again when it is used, see :mod:`validation.trial.restart`: contact
forces and states of every step would take twenty times the space. Nothing is pickled or rounded.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import fields
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from ampm.exceptions import InputError
from ampm.geometry import Array
from validation.store.json import json_ready
from validation.trial.outcome import Outcome
from validation.trial.record import INTEGERS, SHAPES, SimulationRecord, restart_steps
from validation.trial.restart import Restart
from validation.trial.spill import blocks

JOINTS_FILE = "joints.parquet"
TICKS_FILE = "ticks.parquet"
RECORD_FILES = (JOINTS_FILE, TICKS_FILE)
EXTERNAL_FILE = "external.parquet"
"""Beside the others if the walk was disturbed."""
MODEL_FILE = "model.xml"
"""The model that was simulated."""

_COMMANDS = "command_com command_zmp command_force command_angular_momentum"
_FIELDS = {
    JOINTS_FILE: "q qd warmstart",
    TICKS_FILE: f"torque torque_rate {_COMMANDS} qp_status qp_residual qp_iterations qp_time",
    EXTERNAL_FILE: "external_force external_moment external_position",
}
"""Fields of a :class:`SimulationRecord` in each file. Those that are in none and are no result of the physics
are in the header, a text in every file."""
_STEPPED = (
    "time point_force point_position point_penetration point_velocity com angular_momentum foot_position "
    "foot_rotation sensors tick_time"
)
"""Fields that follow from the others."""
_FORMAT = 3
_GROUP = 65_536  # rows written at a time, to bound the memory
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
    """Every array on disk of a record whose header this is."""
    joints, segments = header["joint_names"], header["external_segments"]
    parts = {
        "2": "xy", "3": "xyz", "nu": joints,
        "nq": _coordinate_names(header["nq"], _ROOT_Q, joints),
        "nv": _coordinate_names(header["nv"], _ROOT_V, joints),
    }  # fmt: skip
    sizes = {name: len(names) for name, names in parts.items()} | {"S": len(segments)}
    rows = {JOINTS_FILE: header["restarts"] + 1, TICKS_FILE: header["ticks"], EXTERNAL_FILE: header["steps"]}
    found = []
    for file, names in _FIELDS.items():
        for name in names.split():
            symbols = SHAPES[name].split()[1:]
            owned = segments if "S" in symbols else ("",)
            split = parts[symbols[-1]] if symbols else ("",)
            word = name.removeprefix("external_")
            columns = tuple("_".join(filter(None, (a, word, b))) for a in owned for b in split)
            count = rows[file] - (name == "warmstart")
            found.append(
                _Block(name, file, (count, *(sizes[s] if s in sizes else int(s) for s in symbols)), columns)
            )
    return [block for block in found if segments or block.file != EXTERNAL_FILE]


def _coordinate_names(count: int, root: tuple[str, ...], joints: Sequence[str]) -> list[str]:
    """Names of coordinates: a free root and the hinges, or plain numbers for any other body."""
    if count == len(root) + len(joints):
        return [*root, *joints]
    return [str(index) for index in range(count)]


def state_names(record: SimulationRecord | StoredRecord) -> list[str]:
    """Names of the columns of q and qd."""
    q, qd = (array.shape[1] for array in (record.q, record.qd))
    places = (f"q_{name}" for name in _coordinate_names(q, _ROOT_Q, record.joint_names))
    return [*places, *(f"qd_{name}" for name in _coordinate_names(qd, _ROOT_V, record.joint_names))]


# -------------------------------------------------------------------------------------------------- writing


def save_record(record: SimulationRecord, directory: str | Path) -> None:
    """Write ``record`` into ``directory`` (which is created): the files of :data:`RECORD_FILES`, and
    :data:`EXTERNAL_FILE` if anything but the floor pushed the body. To be read it needs the model beside it.
    """
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    described = _header(record)
    header = json.dumps(described, allow_nan=False)
    ticks = slice(None, None, described["substeps"])
    states = restart_rows(record.steps, record.time_step)
    times = {JOINTS_FILE: record.time[states], TICKS_FILE: record.tick_time, EXTERNAL_FILE: record.time[:-1]}
    files: dict[str, dict[str, NDArray[Any]]] = {}
    for block in _blocks(described):
        array = getattr(record, block.field)
        if block.field in ("q", "qd"):
            array = array[states]
        elif len(array) != block.shape[0]:
            array = array[ticks]
        flat = array.reshape(len(array), len(block.columns))
        file = files.setdefault(block.file, {"time": times[block.file]})
        file.update((name, flat[:, index]) for index, name in enumerate(block.columns))
    known, torque = np.empty(record.torque_rate.shape, dtype=bool), record.torque[ticks]
    for part in blocks(len(known)):
        before = slice(max(part.start - 1, 0), part.stop)  # a rate needs the tick before, too
        usual = _usual_rate(torque[before], record.tick_time)[part.start - before.start :]
        known[part] = record.torque_rate[part].view(np.int64) == usual.view(np.int64)
    nulls = {f"torque_rate_{name}": same for name, same in zip(record.joint_names, known.T, strict=True)}
    for name, columns in files.items():
        parts = blocks(len(times[name]), _GROUP) if len(times[name]) else [slice(0)]
        tables = (_table(columns, part, nulls, header) for part in parts)
        _write_tables(tables, directory / name)


def _table(
    columns: Mapping[str, NDArray[Any]], rows: slice, nulls: Mapping[str, NDArray[np.bool_]], header: str
) -> pa.Table:
    """Some rows of a file."""
    arrays = []
    for name, column in columns.items():
        values = column[rows]
        mask = nulls[name][rows] if name in nulls else None
        array = pa.array(np.ascontiguousarray(values), mask=mask)
        missing = len(columns["time"][rows]) - values.size
        arrays.append(pa.concat_arrays([array, pa.nulls(missing, array.type)]) if missing else array)
    table = pa.Table.from_arrays(arrays, names=list(columns))
    return table.replace_schema_metadata({_METADATA_KEY: header.encode()})


def _usual_rate(torque: Array, tick_time: Array) -> Array:
    """Difference of the torques of a tick and the last one over the period, shape (T, nu) [N m/s].

    A rate that is this one to the bit is null on disk.
    """
    frequency = 1.0 / tick_time[1] if len(tick_time) > 1 else 0.0
    return np.diff(torque, axis=0, prepend=torque[:1]) * frequency


def restart_rows(steps: int, time_step: float) -> NDArray[np.intp]:
    """Instants of the states on disk: those of the restarts, and the last one."""
    return np.append(np.arange(0, steps, restart_steps(time_step)), steps)


def write_table(table: pa.Table, path: str | Path) -> None:
    """Write a table of floats with zstd over split bytes and without dictionary, which suits them best."""
    _write_tables([table], Path(path))


def _write_tables(tables: Iterable[pa.Table], path: Path) -> None:
    """Write tables of the same columns, one below the other."""
    rest = iter(tables)
    first = next(rest)
    split = [item.name for item in first.schema if pa.types.is_floating(item.type)]
    other = [item.name for item in first.schema if not pa.types.is_floating(item.type)]
    how = {"compression": "zstd", "use_byte_stream_split": split, "use_dictionary": other or False}
    with pq.ParquetWriter(path, first.schema, **how) as file:
        for table in chain([first], rest):
            file.write_table(table)


def _header(record: SimulationRecord) -> dict[str, Any]:
    """Sizes, names and all fields that are no columns, as JSON, which keeps every bit of finite numbers."""
    ticks = record.tick_time
    header = {
        "format": _FORMAT,
        "steps": record.steps,
        "ticks": ticks.size,
        "restarts": len(record.warmstart),
        "substeps": record.substeps,
        "nq": record.q.shape[1],
        "nv": record.qd.shape[1],
        **{name: getattr(record, name) for name in _header_fields()},
    }
    return dict(json_ready(header))


def _header_fields() -> list[str]:
    """Fields of a record that are in its header."""
    elsewhere = " ".join([_STEPPED, *_FIELDS.values()]).split()
    return [item.name for item in fields(SimulationRecord) if item.name not in elsewhere]


# -------------------------------------------------------------------------------------------------- reading


class StoredRecord:
    """A record in a folder: its constants, its arrays on disk, each read when it is first used, and what the
    physics makes of them. The arrays are those of a :class:`validation.trial.record.SimulationRecord`, but

    - ``q`` and ``qd`` have a row for each of ``state_rows`` only, shape (C + 1, ...),
    - ``tick_torque`` and the commands have a row for each control tick, shape (T, ...).

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
    point_sites: tuple[str, ...]
    sole_sites: tuple[str, ...]
    external_segments: tuple[str, ...]
    metadata: Mapping[str, str]

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        header = _read_header(directory / JOINTS_FILE)
        try:
            self._blocks = {
                "tick_torque" if block.field == "torque" else block.field: block for block in _blocks(header)
            }
            self._constants = _constants(header)
            self.steps, self.substeps = int(header["steps"]), int(header["substeps"])
            self.ticks, self.coordinates = int(header["ticks"]), (int(header["nq"]), int(header["nv"]))
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise InputError(
                f"{directory / JOINTS_FILE} is damaged: its description is ({error}); walk the gait again."
            ) from error
        vars(self).update(self._constants)
        self.every = restart_steps(self.time_step)
        self.state_rows = restart_rows(self.steps, self.time_step)

    def __repr__(self) -> str:
        """Outcome and time, without the arrays."""
        return f"StoredRecord({self.outcome.summary} at {self.outcome.time:g} s)"

    def __getattr__(self, name: str) -> NDArray[Any]:
        """Read an array; it is kept until :meth:`forget`.

        Raises:
            InputError: its file or one of its columns is missing.
        """
        block = vars(self).get("_blocks", {}).get(name)
        if block is None:
            raise AttributeError(f"a record has no field {name!r}")
        array = _array(block, self.directory / block.file)
        if name == "torque_rate":
            usual = _usual_rate(self.tick_torque, self.tick_time)
            array = np.where(_nulls(block, self.directory / block.file), usual, array)
        array.setflags(write=False)
        vars(self)[name] = array
        return array

    @property
    def tick_time(self) -> Array:
        """Time of each control tick, shape (T,) [s]."""
        return np.arange(self.ticks, dtype=np.float64) * (self.substeps * self.time_step)

    @property
    def torque(self) -> Array:
        """Torque of every step, shape (K, nu) [N m]."""
        return self.torque_at(range(self.steps))

    def torque_at(self, rows: Sequence[int] | NDArray[np.intp]) -> Array:
        """Torques of some steps, shape (n, nu) [N m]."""
        tick, since = np.divmod(np.minimum(np.asarray(rows, dtype=np.intp), self.steps - 1), self.substeps)
        torque = self.tick_torque[tick]
        if since.any():  # as carry_on of validation.trial.restart does it
            rate, limit = self.torque_rate[tick], self.torque_limit
            moved = np.clip(torque + (since * self.time_step)[:, None] * rate, -limit, limit)
            torque = np.where(np.isnan(rate) | (since == 0)[:, None], torque, moved)
        return torque

    def contacts_at(self, rows: NDArray[np.intp]) -> tuple[Array, Array]:
        """Force of the floor at every sole point, and where it acts, in some steps in ascending order.

        Returns:
            Shape (n, P, 3) each [N], [m].
        """
        restart = Restart(self.model(), self)
        kept = restart.log(rows).close(len(rows), restart.data)
        return kept["point_force"], kept["point_position"]

    def model(self) -> mujoco.MjModel:
        """The model that was simulated.

        Raises:
            InputError: its file is missing or damaged, or of another body.
        """
        path = self.directory / MODEL_FILE
        try:
            model = mujoco.MjModel.from_xml_string(path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise InputError(f"{path} cannot be read ({error}); give the folder of a run.") from error
        shape, recorded = (model.nq, model.nv, model.nu), (*self.coordinates, len(self.joint_names))
        if shape != recorded:
            raise InputError(
                f"{path} has (nq, nv, nu) = {shape}, the record {recorded}; "
                "the files are of two runs, give the folder of one."
            )
        return model

    def forget(self) -> None:
        """Free the memory of all arrays; they are read again when used."""
        for name in self._blocks:
            vars(self).pop(name, None)

    def load(self) -> SimulationRecord:
        """Read everything, and step the physics again for the rest.

        Raises:
            InputError: a file or one of its columns is missing or damaged.
        """
        restart = Restart(self.model(), self)
        values = restart.log(np.arange(self.steps)).close(self.steps, restart.data)
        for name in self._blocks:
            if name.startswith("command_"):
                values[name] = np.repeat(getattr(self, name), self.substeps, axis=0)[: self.steps]
            elif name not in ("q", "qd", "tick_torque"):
                values[name] = getattr(self, name)
        sensors = dict(values["sensors"])
        body = {name: sensors.pop(name) for name in ("com", "angular_momentum")}
        time = np.arange(self.steps + 1, dtype=np.float64) * self.time_step
        return SimulationRecord(
            **{**values, **body, "sensors": sensors},
            time=time, tick_time=self.tick_time, **self._constants
        )  # fmt: skip


def load_record(directory: str | Path) -> SimulationRecord:
    """Read back what :func:`save_record` wrote, bit for bit.

    Raises:
        InputError: a file is missing, damaged, or of another format.
    """
    return StoredRecord(Path(directory)).load()


def _array(block: _Block, path: Path) -> NDArray[Any]:
    """One array, from its file, which is read a group of rows at a time."""
    array: NDArray[Any] = np.empty(0)
    row, rows = 0, block.shape[0]
    try:
        for table in _groups(path, block.columns):
            columns = [table.column(name).slice(0, rows - row).to_numpy() for name in block.columns]
            if not row:
                array = np.empty((rows, len(columns)), np.result_type(*columns))
            for to, column in zip(array.T, columns, strict=True):
                to[row : row + len(column)] = column
            row += len(columns[0])
        if array.dtype.kind not in "fiu" or row < rows:
            raise ValueError(f"{block.columns[0]} holds {'no numbers' if row == rows else 'too few rows'}")
    except (KeyError, ValueError) as error:
        raise InputError(f"{path} is damaged ({error.args[0]}); walk the gait again.") from None
    return array.reshape(block.shape)


def _nulls(block: _Block, path: Path) -> NDArray[np.bool_]:
    """Where an array has no value."""
    table = read_table(path, block.columns)
    return np.stack([table.column(name).is_null().to_numpy() for name in block.columns], axis=-1)


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
    found: dict[str, Any] = {}
    for name in _header_fields():
        value = header[name]
        if name in SHAPES:
            found[name] = np.array(value, dtype=INTEGERS.get(name, np.float64))
            found[name].setflags(write=False)
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


def _groups(path: Path, columns: Sequence[str]) -> Iterator[pa.Table]:
    """Some columns of a file, a group of rows at a time; see :func:`read_table`."""
    with _readable(path, pq.ParquetFile) as file:
        for group in range(file.num_row_groups):
            yield _readable(path, partial(_group, file, group, columns))


def _group(file: pq.ParquetFile, group: int, columns: Sequence[str], _: Path) -> pa.Table:
    return file.read_row_group(group, columns=list(columns))


def _readable(path: Path, read: Callable[[Path], Any]) -> Any:
    try:
        return read(path)
    except FileNotFoundError:
        raise InputError(f"{path} is missing; give the folder of a recorded run.") from None
    except (pa.ArrowException, OSError) as error:
        raise InputError(f"{path} cannot be read ({error}); walk the gait again.") from error
