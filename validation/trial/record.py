"""What a simulation leaves behind: one frozen :class:`SimulationRecord`, and its lossless form on disk.

Four Parquet files hold every number of a record, one column per scalar, so that any tool can read them:
``joints.parquet`` (state, torque, and what a restart needs), ``contacts.parquet`` (every contact force),
``states.parquet`` (body quantities, sensors, the controller's commands) and ``ticks.parquet`` (the solver).
Nothing is pickled, nothing is rounded: what is read back has the bits of what was saved.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from ampm.description import SOLE_POINT_GROUPS
from ampm.exceptions import InputError
from validation.store.record_layout import FEET as FEET
from validation.store.record_layout import JOINTS_FILE as JOINTS_FILE
from validation.store.record_layout import RECORD_FILES as RECORD_FILES
from validation.store.record_layout import STATES_FILE as STATES_FILE
from validation.store.record_layout import TICKS_FILE as TICKS_FILE
from validation.store.record_layout import RecordBlock, record_blocks
from validation.trial.outcome import Outcome as Outcome
from validation.trial.outcome import OutcomeName as OutcomeName

if TYPE_CHECKING:
    from numpy.typing import NDArray

_FORMAT = 1
_METADATA_KEY = b"ampm_record"
NOT_REPRODUCIBLE = frozenset({"qp_time"})
"""Columns that hold wall-clock time: the only ones that two identical runs need not share."""


@dataclass(frozen=True)
class Difference:
    """The first place where two records differ.

    Attributes:
        signal: column name, as in the Parquet files.
        time: simulated time of the first differing row [s].
        first: the first record's value there, as text.
        second: the second record's value there, as text.
    """

    signal: str
    time: float
    first: str
    second: str

    def __str__(self) -> str:
        return f"{self.signal} differs at {self.time:.6g} s: {self.first} and {self.second}"


@dataclass(frozen=True, eq=False)
class SimulationRecord:
    """Everything one simulation produced: K steps of ``time_step``, P sole points, T control ticks.

    Rows that belong to an instant have K + 1 entries (t_0 ... t_K); rows that belong to a step have K, row
    k acts over [t_k, t_(k+1)]. Vectors are in the world frame (x forward, y left, z up, floor at z = 0). All
    arrays are read-only; floats are float64. What is given is copied, unless it and all that it is a view of
    are read-only already: then it is taken over, and a long walk does not need its memory twice.

    Attributes:
        time: t_k, shape (K + 1,) [s].
        q: MuJoCo ``qpos``, root position [m], root quaternion wxyz, hinges [rad], shape (K + 1, nq).
        qd: MuJoCo ``qvel``, root velocity in world [m/s], root angular velocity in the root [rad/s], hinges
            [rad/s], shape (K + 1, nv).
        torque: applied joint torque, actuator order, shape (K, nu) [N m].
        warmstart: ``qacc_warmstart`` before the step, which a restart needs, shape (K, nv) [rad/s^2, m/s^2].
        point_force: force of the floor on the body at each sole point, shape (K, P, 3) [N].
        point_position: where it acts, shape (K, P, 3) [m].
        point_penetration: depth under the floor, >= 0, shape (K, P) [m].
        point_velocity: velocity of the sole point, shape (K, P, 3) [m/s].
        point_foot: foot of each point, 0 left, 1 right, shape (P,).
        point_group: 0 heel, 1 ball, 2 tip, shape (P,).
        com: COM as the simulator reports it, shape (K + 1, 3) [m].
        angular_momentum: about the COM, as the simulator reports it, shape (K + 1, 3) [N m s].
        foot_position: reference points of both soles, left first, shape (K + 1, 2, 3) [m].
        foot_rotation: their orientation, wxyz, shape (K + 1, 2, 4).
        sensors: sensor name to readings, shape (K + 1, d).
        command_com: the controller's COM reference, held over the tick, shape (K, 3) [m].
        command_zmp: ZMP that it asked for, shape (K, 2) [m].
        command_force: net ground force that it asked for, shape (K, 3) [N].
        command_angular_momentum: angular momentum about the COM that it asked for, shape (K, 3) [N m s].
        command_point_force: its QP's force at each sole point, shape (K, P, 3) [N].
        tick_time: time of each control tick, shape (T,) [s].
        qp_status: 0 solved, 1 solved in the form with limits, 2 unsolved, shape (T,).
        qp_residual: largest constraint or stationarity residual of the tick's QP, shape (T,).
        qp_iterations: iterations, shape (T,).
        qp_time: wall-clock time of the solve, shape (T,) [s]; the one column that equal runs differ in.
        outcome: how the run ended.
        mass: total mass [kg].
        gravity: g, positive [m/s^2].
        time_step: dt [s].
        friction: friction coefficient between sole and floor [1], NaN if unknown.
        torque_limit: largest torque per actuator, shape (nu,) [N m].
        joint_range: lower and upper limit per hinge, shape (nu, 2) [rad].
        joint_names: the hinges in actuator order, nu names.
        metadata: whatever else identifies the run, text to text.
    """

    time: NDArray[np.float64]
    q: NDArray[np.float64]
    qd: NDArray[np.float64]
    torque: NDArray[np.float64]
    warmstart: NDArray[np.float64]
    point_force: NDArray[np.float64]
    point_position: NDArray[np.float64]
    point_penetration: NDArray[np.float64]
    point_velocity: NDArray[np.float64]
    point_foot: NDArray[np.int8]
    point_group: NDArray[np.int8]
    com: NDArray[np.float64]
    angular_momentum: NDArray[np.float64]
    foot_position: NDArray[np.float64]
    foot_rotation: NDArray[np.float64]
    sensors: Mapping[str, NDArray[np.float64]]
    command_com: NDArray[np.float64]
    command_zmp: NDArray[np.float64]
    command_force: NDArray[np.float64]
    command_angular_momentum: NDArray[np.float64]
    command_point_force: NDArray[np.float64]
    tick_time: NDArray[np.float64]
    qp_status: NDArray[np.int8]
    qp_residual: NDArray[np.float64]
    qp_iterations: NDArray[np.int32]
    qp_time: NDArray[np.float64]
    outcome: Outcome
    mass: float
    gravity: float
    time_step: float
    torque_limit: NDArray[np.float64]
    joint_range: NDArray[np.float64]
    joint_names: tuple[str, ...]
    friction: float = math.nan
    metadata: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        integers = {
            "point_foot": np.int8, "point_group": np.int8, "qp_status": np.int8, "qp_iterations": np.int32
        }  # fmt: skip
        not_arrays = {
            "sensors", "outcome", "mass", "gravity", "time_step", "friction", "joint_names", "metadata"
        }  # fmt: skip
        for item in fields(self):
            if item.name not in not_arrays:
                value = _frozen(getattr(self, item.name), integers.get(item.name, np.float64))
                object.__setattr__(self, item.name, value)
        sensors = {name: _frozen(value, np.float64) for name, value in self.sensors.items()}
        sensors = {
            name: value.reshape(-1, 1) if value.ndim == 1 else value for name, value in sensors.items()
        }
        object.__setattr__(self, "sensors", MappingProxyType(sensors))
        object.__setattr__(self, "metadata", MappingProxyType(dict(self.metadata)))
        object.__setattr__(self, "joint_names", tuple(self.joint_names))
        for name in ("mass", "gravity", "time_step", "friction"):
            object.__setattr__(self, name, float(getattr(self, name)))
        self._check_shapes()

    def _check_shapes(self) -> None:
        if self.time.ndim != 1 or self.time.size == 0:
            raise InputError("a record needs at least the instant at which it starts: time has no entry")
        if self.q.ndim != 2 or self.qd.ndim != 2:
            raise InputError("q and qd must be two-dimensional: one row per instant")
        k, p, t, nu = self.steps, self.point_foot.size, self.tick_time.size, len(self.joint_names)
        nq, nv = self.q.shape[1], self.qd.shape[1]
        expected: dict[str, tuple[int, ...]] = {
            "q": (k + 1, nq), "qd": (k + 1, nv), "torque": (k, nu), "warmstart": (k, nv),
            "point_force": (k, p, 3), "point_position": (k, p, 3), "point_penetration": (k, p),
            "point_velocity": (k, p, 3), "point_foot": (p,), "point_group": (p,),
            "com": (k + 1, 3), "angular_momentum": (k + 1, 3), "foot_position": (k + 1, 2, 3),
            "foot_rotation": (k + 1, 2, 4), "command_com": (k, 3), "command_zmp": (k, 2),
            "command_force": (k, 3), "command_angular_momentum": (k, 3), "command_point_force": (k, p, 3),
            "tick_time": (t,), "qp_status": (t,), "qp_residual": (t,), "qp_iterations": (t,), "qp_time": (t,),
            "torque_limit": (nu,), "joint_range": (nu, 2),
        }  # fmt: skip
        for name, shape in expected.items():
            if getattr(self, name).shape != shape:
                raise InputError(
                    f"record: {name} has shape {getattr(self, name).shape}, expected {shape} "
                    f"for {k} steps, {p} sole points, {nu} actuators and {t} ticks"
                )
        for name, value in self.sensors.items():
            if value.ndim != 2 or value.shape[0] != k + 1:
                raise InputError(f"record: sensor '{name}' has shape {value.shape}, expected ({k + 1}, d)")

    @property
    def steps(self) -> int:
        """Number K of simulation steps."""
        return self.time.size - 1

    @property
    def q_start(self) -> NDArray[np.float64]:
        """``qpos`` at the start, shape (nq,) [m, rad]."""
        return self.q[0]

    @property
    def qd_start(self) -> NDArray[np.float64]:
        """``qvel`` at the start, shape (nv,) [m/s, rad/s]."""
        return self.qd[0]

    @property
    def hinge_q(self) -> NDArray[np.float64]:
        """Hinge angles in actuator order, shape (K + 1, nu) [rad]: the last columns of ``q``."""
        return self.q[:, self.q.shape[1] - len(self.joint_names) :]

    @property
    def hinge_qd(self) -> NDArray[np.float64]:
        """Hinge rates in actuator order, shape (K + 1, nu) [rad/s]."""
        return self.qd[:, self.qd.shape[1] - len(self.joint_names) :]

    @property
    def point_names(self) -> tuple[str, ...]:
        """Name of every sole point: foot, group, running number within the group."""
        count: dict[tuple[int, int], int] = {}
        names = []
        for foot, group in zip(self.point_foot.tolist(), self.point_group.tolist(), strict=True):
            index = count.get((foot, group), 0)
            count[foot, group] = index + 1
            names.append(f"{FEET[foot]}_{SOLE_POINT_GROUPS[group]}_{index}")
        return tuple(names)


def save_record(record: SimulationRecord, directory: str | Path) -> None:
    """Write ``record`` into ``directory`` (which is created): the four files of :data:`RECORD_FILES`."""
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    header = json.dumps(_header(record), allow_nan=False)
    for name, columns in record_columns(record).items():
        rows = max((column.size for column in columns.values()), default=0)
        arrays = [_padded(column, rows) for column in columns.values()]
        schema = pa.schema(
            [pa.field(key, array.type) for key, array in zip(columns, arrays, strict=True)],
            metadata={_METADATA_KEY: header.encode()},
        )
        write_table(pa.Table.from_arrays(arrays, schema=schema), directory / name)


def load_record(directory: str | Path) -> SimulationRecord:
    """Read back what :func:`save_record` wrote, bit for bit.

    Raises:
        InputError: a file is missing, damaged, or of another format.
    """
    directory = Path(directory)
    header = read_header(directory)
    tables = {name: read_record_table(directory / name) for name in RECORD_FILES}
    values: dict[str, Any] = {}
    sensors: dict[str, NDArray[np.float64]] = {}
    for block in record_blocks(header):
        array = block_array(block, tables[block.file], directory)
        array.setflags(write=False)
        if block.field.startswith("sensor:"):
            sensors[block.field.removeprefix("sensor:")] = array
        else:
            values[block.field] = array
    return SimulationRecord(**values, sensors=sensors, **header_fields(header))


def read_header(directory: Path) -> dict[str, Any]:
    """What a recorded run says of itself.

    Raises:
        InputError: there is no record, or one of another format.
    """
    schema = _readable(directory / JOINTS_FILE, pq.read_schema)
    raw = (schema.metadata or {}).get(_METADATA_KEY)
    if raw is None:
        raise InputError(
            f"{directory / JOINTS_FILE} is no recorded run: it carries no description of the run"
        )
    header: dict[str, Any] = json.loads(raw)
    if header["format"] != _FORMAT:
        raise InputError(
            f"{directory} has record format {header['format']}, this version reads {_FORMAT}; "
            "simulate the run again or use the version that wrote it"
        )
    return header


def header_fields(header: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of a :class:`SimulationRecord` that are in its header."""
    return {
        "point_foot": np.array(header["point_foot"], dtype=np.int8),
        "point_group": np.array(header["point_group"], dtype=np.int8),
        "outcome": Outcome(
            name=header["outcome"]["name"],
            time=float(header["outcome"]["time"]),
            cause=header["outcome"]["cause"],
            steps_completed=header["outcome"]["steps_completed"],
        ),
        "mass": float(header["mass"]),
        "gravity": float(header["gravity"]),
        "time_step": float(header["time_step"]),
        "friction": float(header["friction"]),
        "torque_limit": np.array([float(value) for value in header["torque_limit"]]),
        "joint_range": np.array([float(value) for value in header["joint_range"]]).reshape(-1, 2),
        "joint_names": tuple(header["joint_names"]),
        "metadata": header["metadata"],
    }


def block_array(block: RecordBlock, table: pa.Table, directory: Path) -> NDArray[Any]:
    """One array of a record from the table that holds its columns.

    Raises:
        InputError: a column is missing.
    """
    try:
        columns = [table.column(name).slice(0, block.rows).to_numpy() for name in block.columns]
    except KeyError as error:
        raise InputError(f"{directory / block.file} lacks a column: {error.args[0]}") from None
    array = np.stack(columns, axis=-1) if columns else np.zeros((block.rows, 0))
    return array.reshape(block.rows, *block.tail)


def record_columns(record: SimulationRecord) -> dict[str, dict[str, NDArray[Any]]]:
    """All numbers of a record as named columns, grouped by the file that holds them.

    Columns of one file may differ by one in length: what belongs to a step has no entry at the last instant.
    """
    files: dict[str, dict[str, NDArray[Any]]] = {name: {} for name in RECORD_FILES}
    for block in record_blocks(_header(record)):
        if block.field.startswith("sensor:"):
            array = record.sensors[block.field.removeprefix("sensor:")]
        else:
            array = getattr(record, block.field)
        flat = array.reshape(array.shape[0], len(block.columns))
        for index, name in enumerate(block.columns):
            files[block.file][name] = flat[:, index]
    return files


def first_difference(first: SimulationRecord, second: SimulationRecord) -> Difference | None:
    """Earliest bit in which two records differ, or None if there is none; wall-clock times are not compared.

    Among columns that differ at the same instant the state comes first, then torque, contacts, the rest.
    """
    found: Difference | None = None
    first_files, second_files = record_columns(first), record_columns(second)
    for name in RECORD_FILES:
        one, two = first_files[name], second_files[name]
        time = one["time"] if one["time"].size >= two["time"].size else two["time"]
        for column in dict.fromkeys([*one, *two]):
            if column in NOT_REPRODUCIBLE:
                continue
            difference = _column_difference(column, one.get(column), two.get(column), time)
            if difference is not None and (found is None or difference.time < found.time):
                found = difference
    if found is None and first.outcome != second.outcome:
        time_of_end = min(first.outcome.time, second.outcome.time)
        found = Difference("outcome", time_of_end, str(first.outcome), str(second.outcome))
    return found


def write_table(table: pa.Table, path: str | Path) -> None:
    """Write a table of floats the way that suits them: zstd over split bytes, no dictionary."""
    split = [item.name for item in table.schema if pa.types.is_floating(item.type)]
    other = [item.name for item in table.schema if not pa.types.is_floating(item.type)]
    pq.write_table(
        table, Path(path), compression="zstd", use_byte_stream_split=split, use_dictionary=other or False
    )


def _header(record: SimulationRecord) -> dict[str, Any]:
    return {
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


def _exact(value: float) -> float | str:
    """JSON has no infinity and no NaN: those become text; every other float survives JSON exactly."""
    return float(value) if math.isfinite(value) else repr(float(value))


def _frozen(value: Any, dtype: Any) -> NDArray[Any]:
    """Read-only: as it is if nobody can write to it any more, else a C-contiguous copy."""
    if isinstance(value, np.ndarray) and value.dtype == dtype:
        owner: Any = value
        while isinstance(owner, np.ndarray) and not owner.flags.writeable:
            owner = owner.base
        if owner is None:
            return value
    array: NDArray[Any] = np.array(value, dtype=dtype, order="C")
    array.setflags(write=False)
    return array


def _padded(column: NDArray[Any], rows: int) -> pa.Array:
    array = pa.array(np.ascontiguousarray(column))
    if column.size < rows:
        array = pa.concat_arrays([array, pa.nulls(rows - column.size, array.type)])
    return array


def read_record_table(path: Path, columns: Sequence[str] | None = None) -> pa.Table:
    """Read one file of a record, or some of its columns.

    Raises:
        InputError: it is missing or cannot be read.
    """

    def read(path: Path) -> pa.Table:
        with pq.ParquetFile(path) as file:  # one that is absent is left out, and told of later
            return file.read(columns=None if columns is None else list(columns))

    return _readable(path, read)


def _readable(path: Path, read: Callable[[Path], Any]) -> Any:
    try:
        return read(path)
    except FileNotFoundError:
        raise InputError(f"{path} is missing; give the folder of a recorded run") from None
    except (pa.ArrowException, OSError) as error:
        raise InputError(f"{path} cannot be read ({error}); simulate the run again") from error


def _column_difference(
    name: str, one: NDArray[Any] | None, two: NDArray[Any] | None, time: NDArray[np.float64]
) -> Difference | None:
    if one is None or two is None:
        start = float(time[0]) if time.size else 0.0
        present, absent = "present", "absent"
        pair = (present, absent) if two is None else (absent, present)
        return Difference(name, start, *pair)
    rows = min(one.size, two.size)
    unequal = np.flatnonzero(_bits(one[:rows]) != _bits(two[:rows]))
    if unequal.size:
        row = int(unequal[0])
        return Difference(name, float(time[row]), repr(one[row].item()), repr(two[row].item()))
    if one.size != two.size:
        at = float(time[rows]) if rows < time.size else float(time[-1])
        return Difference(name, at, f"{one.size} rows", f"{two.size} rows")
    return None


def _bits(array: NDArray[Any]) -> NDArray[Any]:
    """Bit patterns: tells -0 from 0, and one NaN equals itself."""
    array = np.ascontiguousarray(array)
    return array.view(np.int64) if array.dtype == np.float64 else array
