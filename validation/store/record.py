"""A record on disk: its arrays as columns of Parquet files, its constants in the header of each.

``joints.parquet`` has the state every 10 ms, ``contacts.parquet`` the contact forces at the same instants,
``ticks.parquet`` torques and solver of every control tick, and ``external.parquet`` the forces of
disturbances, if there were any. Start, torques and external forces are all that the physics of a walk depends
on beside the model, see :mod:`validation.run.replay`. Nothing is pickled or rounded.
"""

import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from ampm.exceptions import InputError
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

RECORD_FILES = (JOINTS_FILE, CONTACTS_FILE, TICKS_FILE)
MODEL_FILE = "model.xml"
"""The model that was simulated."""

_FORMAT = 6
_HEADER = b"ampm_record"
_ROOT_Q = ("root_x", "root_y", "root_z", "root_qw", "root_qx", "root_qy", "root_qz")
_ROOT_V = ("root_x", "root_y", "root_z", "root_wx", "root_wy", "root_wz")


def stored_columns(about: Mapping[str, Any]) -> dict[str, tuple[list[str], tuple[int, ...]]]:
    """Columns of the scalars of every array on disk, and its shape without the rows.

    Args:
        about: constants of the record, by name.
    """
    joints = about["joint_names"]
    labels: dict[str, Sequence[Any]] = {
        "nq": [*_ROOT_Q, *joints] if joints else (),  # a log has no coordinates
        "nv": [*_ROOT_V, *joints] if joints else (),
        "nu": joints,
        "P": about["point_sites"] or range(len(about["point_foot"])),
        "S": about["external_segments"],
        "3": "xyz",
    }
    found = {}
    for name, file in STORED.items():
        if (file == EXTERNAL_FILE and not labels["S"]) or (name == "tick_plan" and not about["changes"]):
            continue
        word = re.sub("^(point|external|tick)_", "", name)
        parts = [labels[symbol] for symbol in SHAPES[name].split()[1:]]
        columns = ["_".join([word, *map(str, part)]) for part in product(*parts)]
        found[name] = columns, tuple(map(len, parts))
    return found


def save_record(record: SimulationRecord, directory: str | Path) -> None:
    """Write ``record`` into ``directory``, which is created.

    The files are those of :data:`RECORD_FILES`, and :data:`EXTERNAL_FILE` if anything but the floor pushed
    the body.
    """
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    constants = {name: getattr(record, name) for name in CONSTANTS}
    known = {"format": _FORMAT, "steps": record.steps, "substeps": record.substeps, **constants}
    header = json.dumps(json_ready(known), allow_nan=False).encode()
    states = stored_rows(record.steps, record.time_step)
    kept = np.searchsorted(record.state_rows, states)
    rows = {"R": kept, "R-1": kept[:-1]}
    times = {
        JOINTS_FILE: record.time[states],
        CONTACTS_FILE: record.time[states[:-1]],
        TICKS_FILE: record.time[: record.steps : record.substeps],
        EXTERNAL_FILE: record.time[:-1],
    }
    files: dict[str, dict[str, NDArray[Any]]] = {}
    for name, (columns, _) in stored_columns(constants).items():
        array = getattr(record, name)
        array = array[rows.get(SHAPES[name].split()[0], slice(None))]
        table = files.setdefault(STORED[name], {"time": times[STORED[name]]})
        table.update(zip(columns, array.reshape(len(array), len(columns)).T, strict=True))
    for file, table in files.items():
        write_table(pa.table(table).replace_schema_metadata({_HEADER: header}), directory / file)


def write_table(table: pa.Table, path: Path) -> None:
    """Write a table: floats with zstd over split bytes and without a dictionary, which suits them best."""
    floats = [item.name for item in table.schema if pa.types.is_floating(item.type)]
    other = [name for name in table.column_names if name not in floats]
    pq.write_table(
        table, path, compression="zstd", use_byte_stream_split=floats, use_dictionary=other or False
    )


def load_record(directory: str | Path) -> SimulationRecord:
    """Read the record of a folder: all that :func:`save_record` wrote.

    Raises:
        InputError: there is no record, one of another format, or a file or column is missing or damaged.
    """
    directory = Path(directory)
    header = read_header(directory)
    try:
        constants = _constants(header)
        steps, substeps, dt = int(header["steps"]), int(header["substeps"]), constants["time_step"]
        time = np.arange(steps + 1, dtype=np.float64) * dt
        tick_time = np.arange(-(-steps // substeps), dtype=np.float64) * (substeps * dt)
        states = stored_rows(steps, dt)
        stored = stored_columns(constants)
    except (ArithmeticError, AttributeError, KeyError, MemoryError, TypeError, ValueError) as error:
        raise InputError(
            f"{directory / JOINTS_FILE} is damaged: its description cannot be read ({error}); walk "
            "the gait again."
        ) from error
    counts = {"R": len(states), "R-1": len(states) - 1, "T": len(tick_time), "K": steps}
    arrays: dict[str, Any] = {name: None for name in SHAPES if name not in constants}
    tables = {file: read_table(directory / file) for file in dict.fromkeys(STORED[name] for name in stored)}
    for name, (columns, shape) in stored.items():
        table, path = tables[STORED[name]], directory / STORED[name]
        if missing := sorted(set(columns) - set(table.column_names)):
            raise InputError(f"{path} is damaged: it has no column {missing[0]!r}; walk the gait again.")
        rows, kind = counts[SHAPES[name].split()[0]], np.dtype(INTEGERS.get(name, np.float64))
        found = [table[column].to_numpy() for column in columns]
        if table.num_rows != rows or any(column.dtype != kind for column in found):
            raise InputError(
                f"{path} is damaged: {columns[0]!r} should have {rows} numbers; walk the gait again."
            )
        # A log has no columns.
        arrays[name] = (np.column_stack(found) if found else np.zeros((rows, 0), kind)).reshape(rows, *shape)
        arrays[name].setflags(write=False)
    arrays |= {"time": time, "tick_time": tick_time, "state_rows": states}
    try:
        return SimulationRecord(**arrays, **constants)
    except InputError as error:
        raise InputError(f"{directory / JOINTS_FILE} is damaged: {error} Walk the gait again.") from None


def read_header(directory: Path) -> dict[str, Any]:
    """Description of the recorded run of a folder.

    Raises:
        InputError: there is no record, or one of another format.
    """
    path = directory / JOINTS_FILE
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
            shape = map(int, SHAPES[name].split()[1:])
            found[name] = np.array(value, dtype=INTEGERS.get(name, np.float64)).reshape(-1, *shape)
        elif name in ("mass", "gravity", "time_step", "friction"):
            found[name] = math.nan if value is None else float(value)
        else:
            found[name] = tuple(value) if isinstance(value, list) else value
    return found | {"outcome": Outcome(**header["outcome"])}


def load_model(directory: Path, record: SimulationRecord) -> mujoco.MjModel:
    """The model that was simulated for a record.

    Raises:
        InputError: its file is missing or damaged, or of another body, or the record is of a log.
    """
    if not record.joint_names:
        raise InputError(f"{directory} is of a log, which has no joints; give the folder of a walk.")
    path = directory / MODEL_FILE
    try:
        model = mujoco.MjModel.from_xml_string(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path} cannot be read ({error}); give the folder of a run.") from error
    shape = model.nq, model.nv, model.nu
    recorded = record.q.shape[1], record.qd.shape[1], len(record.joint_names)
    if shape != recorded:
        raise InputError(
            f"{path} has (nq, nv, nu) = {shape}, the record {recorded}; "
            "the files are of two runs, give the folder of one."
        )
    return model


def read_table(path: Path) -> pa.Table:
    """Read a file of a run.

    Raises:
        InputError: it is missing or cannot be read.
    """
    return _readable(path, lambda path: pq.read_table(path, partitioning=None))


def _readable(path: Path, read: Callable[[Path], Any]) -> Any:
    if not path.is_file():  # to open a pipe would wait for its writer
        what = "is not a regular file" if path.exists() else "is missing"
        raise InputError(f"{path} {what}; give the folder of a recorded run.")
    try:
        return read(path)
    except (pa.ArrowException, OSError) as error:
        raise InputError(f"{path} cannot be read ({error}); walk the gait again.") from error
