"""A record on disk: its arrays as columns of Parquet files, its constants in the header of one of them.

``joints.parquet`` has the state every 10 ms, ``contacts.parquet`` the contact forces at the same instants,
``ticks.parquet`` torques and solver of every control tick, and ``external.parquet`` the forces of
disturbances, if there were any. Start, torques and external forces are all that the physics of a walk depends
on beside the model, see :mod:`validation.run.replay`. Nothing is pickled or rounded.
"""

import json
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import chain, product
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
from validation.trial.record import (
    CONSTANTS,
    CONTACTS_FILE,
    EXTERNAL_FILE,
    INTEGERS,
    JOINTS_FILE,
    SHAPES,
    STORED,
    TICKS_FILE,
    SimulationRecord,
    stored_rows,
)
from validation.trial.spill import blocks

RECORD_FILES = (JOINTS_FILE, CONTACTS_FILE, TICKS_FILE)
MODEL_FILE = "model.xml"
"""The model that was simulated."""

_FORMAT = 6
_GROUP = 65_536  # rows written at a time
_HEADER = b"ampm_record"
_ROOT_Q = ("root_x", "root_y", "root_z", "root_qw", "root_qx", "root_qy", "root_qz")
_ROOT_V = ("root_x", "root_y", "root_z", "root_wx", "root_wy", "root_wz")


class _Field(NamedTuple):
    """An array on disk: the columns of its scalars, and its shape without the rows."""

    columns: list[str]
    shape: tuple[int, ...]


def _files(header: Mapping[str, Any]) -> dict[str, dict[str, _Field]]:
    """The fields in every file of the record that has this header."""
    joints = header["joint_names"]
    labels: dict[str, Sequence[Any]] = {
        "nq": _coordinate_names(header["nq"], _ROOT_Q, joints),
        "nv": _coordinate_names(header["nv"], _ROOT_V, joints),
        "nu": joints,
        "P": header["point_sites"] or range(len(header["point_foot"])),
        "S": header["external_segments"],
        "3": "xyz",
    }
    files: dict[str, dict[str, _Field]] = {}
    for name, file in STORED.items():
        if (file == EXTERNAL_FILE and not labels["S"]) or (name == "tick_plan" and not header["changes"]):
            continue
        word = re.sub("^(point|external|tick)_", "", name)
        parts = [labels[symbol] for symbol in SHAPES[name].split()[1:]]
        columns = ["_".join([word, *map(str, part)]) for part in product(*parts)]
        files.setdefault(file, {})[name] = _Field(columns, tuple(map(len, parts)))
    return files


def _coordinate_names(count: int, root: tuple[str, ...], joints: Sequence[str]) -> list[str]:
    """Names of coordinates: a free root and the hinges, or plain numbers for any other body."""
    if count == len(root) + len(joints):
        return [*root, *joints]
    return [str(index) for index in range(count)]


# -------------------------------------------------------------------------------------------------- writing


def save_record(record: SimulationRecord, directory: str | Path) -> None:
    """Write ``record`` into ``directory``, which is created.

    The files are those of :data:`RECORD_FILES`, and :data:`EXTERNAL_FILE` if anything but the floor pushed
    the body.
    """
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    header = json_ready(
        {
            "format": _FORMAT,
            "steps": record.steps,
            "substeps": record.substeps,
            "nq": record.q.shape[1],
            "nv": record.qd.shape[1],
            **{name: getattr(record, name) for name in CONSTANTS},
        }
    )
    rows = _rows(record.steps, record.time_step, record.substeps)
    for file, fields in _files(header).items():
        columns = {"time": record.time[rows[file]]}
        for name, field in fields.items():
            array = getattr(record, name)
            if not SHAPES[name].startswith("T"):
                array = array[rows[file]]
            columns.update(zip(field.columns, array.reshape(len(array), len(field.columns)).T, strict=True))
        _write_columns(columns, directory / file, json.dumps(header, allow_nan=False))


def _rows(steps: int, time_step: float, substeps: int) -> dict[str, slice | NDArray[np.intp]]:
    """Instants, or steps that begin there, of every file's rows."""
    states = stored_rows(steps, time_step)
    return {
        JOINTS_FILE: states,
        CONTACTS_FILE: states[:-1],
        TICKS_FILE: slice(0, steps, substeps),
        EXTERNAL_FILE: slice(0, steps),
    }


def _write_columns(columns: Mapping[str, NDArray[Any]], path: Path, header: str) -> None:
    """Write columns of numbers, some rows at a time, to bound the memory."""

    def table(part: slice) -> pa.Table:
        arrays = {name: pa.array(column[part]) for name, column in columns.items()}
        return pa.table(arrays).replace_schema_metadata({_HEADER: header.encode()})

    rows = len(columns["time"])
    write_tables(map(table, blocks(rows, _GROUP) if rows else [slice(0)]), path)


def write_tables(tables: Iterable[pa.Table], path: Path) -> None:
    """Write tables of the same columns, one below the other.

    Floats are written with zstd over split bytes and without a dictionary, which suits them best.
    """
    rest = iter(tables)
    first = next(rest)
    split = [item.name for item in first.schema if pa.types.is_floating(item.type)]
    other = [item.name for item in first.schema if not pa.types.is_floating(item.type)]
    how = {"compression": "zstd", "use_byte_stream_split": split, "use_dictionary": other or False}
    with pq.ParquetWriter(path, first.schema, **how) as file:
        for table in chain([first], rest):
            file.write_table(table)


# -------------------------------------------------------------------------------------------------- reading


class StoredRecord(SimulationRecord):
    """A record in a folder. Its arrays are read when they are first used, at the rates of their files.

    - ``q`` and ``qd`` have a row for each of ``state_rows`` only, shape (R + 1, ...),
    - ``point_force`` and ``point_position`` one for each of these but the last, shape (R, P, 3),
    - ``tick_torque`` one for each control tick, shape (T, nu), from which ``torque`` is made.

    What the folder lacks is not an attribute.

    Raises:
        InputError: there is no record, or one of another format.
    """

    directory: Path
    coordinates: tuple[int, int]
    _files: dict[str, dict[str, _Field]]

    def __init__(self, directory: Path) -> None:
        header = _read_header(directory / JOINTS_FILE)
        own = vars(self)  # assignments are closed
        own["directory"] = directory
        try:
            own["_files"] = _files(header)
            own.update(_constants(header))
            own["coordinates"] = int(header["nq"]), int(header["nv"])
            steps, substeps = int(header["steps"]), int(header["substeps"])
            own["time"] = np.arange(steps + 1, dtype=np.float64) * self.time_step
            own["tick_time"] = np.arange(-(-steps // substeps), dtype=np.float64) * (
                substeps * self.time_step
            )
        except (ArithmeticError, AttributeError, KeyError, MemoryError, TypeError, ValueError) as error:
            raise InputError(
                f"{directory / JOINTS_FILE} is damaged: its description is ({error}); walk the gait again."
            ) from error
        for name in ("time", "tick_time"):
            own[name].setflags(write=False)

    @property
    def state_rows(self) -> NDArray[np.intp]:
        """Instants of the rows of ``q`` and ``qd``."""
        return stored_rows(self.steps, self.time_step)

    def __getattr__(self, name: str) -> NDArray[Any]:
        """Read an array and keep it.

        Raises:
            InputError: its file or one of its columns is missing or damaged.
        """
        of = "torque" if name == "tick_torque" else name
        for file, fields in vars(self).get("_files", {}).items():
            if of in fields:
                rows = len(np.arange(self.steps + 1)[_rows(self.steps, self.time_step, self.substeps)[file]])
                kind = np.dtype(INTEGERS.get(of, np.float64))
                array = _read_array(self.directory / file, fields[of], rows, kind)
                array.setflags(write=False)
                vars(self)[name] = array
                return array
        if name == "tick_plan":  # of a plan that did not move
            return np.zeros(len(self.tick_time), np.int32)
        raise AttributeError(f"a stored record has no field {name!r}")

    def columns(self, name: str) -> tuple[str, list[str]]:
        """File of an array, and the columns of its scalars."""
        return next((file, fields[name].columns) for file, fields in self._files.items() if name in fields)

    @property
    def torque(self) -> Array:
        """Torque of every step, shape (K, nu) [N m]."""
        return self.torque_at(range(self.steps))

    def torque_at(self, rows: Sequence[int] | NDArray[np.intp]) -> Array:
        """Torques of some steps, shape (n, nu) [N m]."""
        tick, since = np.divmod(np.minimum(np.asarray(rows, dtype=np.intp), self.steps - 1), self.substeps)
        torque = self.tick_torque[tick]
        if since.any():  # as end_step of validation.trial.step does it
            rate, limit = self.torque_rate[tick], self.torque_limit
            moved = np.clip(torque + (since * self.time_step)[:, None] * rate, -limit, limit)
            torque = np.where(np.isnan(rate) | (since == 0)[:, None], torque, moved)
        return torque

    def model(self) -> mujoco.MjModel:
        """The model that was simulated.

        Raises:
            InputError: its file is missing or damaged, or of another body, or the record is of a log.
        """
        if not self.joint_names:
            raise InputError(f"{self.directory} is of a log, which has no joints; give the folder of a walk.")
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


def _read_array(path: Path, field: _Field, rows: int, kind: np.dtype[Any]) -> NDArray[Any]:
    """One array from its file, shape (rows, *field.shape)."""
    table = read_table(path, field.columns)
    missing = sorted(set(field.columns) - set(table.column_names))
    if missing:
        raise InputError(f"{path} is damaged: it has no column {missing[0]!r}; walk the gait again.")
    columns = [table.column(name).to_numpy() for name in field.columns]
    if table.num_rows != rows or any(column.dtype != kind for column in columns):
        raise InputError(
            f"{path} is damaged: {field.columns[0]!r} has not {rows} numbers; walk the gait again."
        )
    if not columns:  # of a log
        return np.zeros((rows, *field.shape), kind)
    return np.column_stack(columns).reshape(rows, *field.shape)


def _read_header(path: Path) -> dict[str, Any]:
    """The description of a recorded run."""
    raw = (_readable(path, pq.read_schema).metadata or {}).get(_HEADER)
    try:
        header: dict[str, Any] = json.loads(raw or "")
        written = header["format"]
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path} is not a recorded run: it carries no description of the run.") from error
    if written != _FORMAT:
        raise InputError(
            f"{path} has record format {written}, this version reads {_FORMAT}; "
            "walk the gait again, or use the version that wrote it."
        )
    return header


def _constants(header: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of a :class:`SimulationRecord` that are in its header."""
    found: dict[str, Any] = {}
    for name in CONSTANTS:
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


def _readable(path: Path, read: Callable[[Path], Any]) -> Any:
    if not path.is_file():  # to open a pipe would wait for its writer
        what = "is not a regular file" if path.exists() else "is missing"
        raise InputError(f"{path} {what}; give the folder of a recorded run.")
    try:
        return read(path)
    except (pa.ArrowException, OSError) as error:
        raise InputError(f"{path} cannot be read ({error}); walk the gait again.") from error
