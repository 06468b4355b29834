"""A record on disk: its arrays as columns of Parquet files, its constants in the header of each.

``joints.parquet`` has the state every 10 ms, ``contacts.parquet`` the contact forces at the same instants,
``ticks.parquet`` torques and solver of every control tick, and ``external.parquet`` the forces of
disturbances, if there were any. Start, torques and external forces are all that the physics of a walk depends
on beside the model, see :mod:`validation.run.replay`. Nothing is pickled or rounded.
"""

import json
import math
import re
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from pyarrow import csv

from ampm.exceptions import InputError
from ampm.files import check_regular
from validation.store.json import json_ready
from validation.trial.files import RunFile
from validation.trial.outcome import Outcome
from validation.trial.record import CONSTANTS, INTEGERS, SHAPES, STORED, SimulationRecord, stored_rows

RECORD_FILES = (RunFile.JOINTS, RunFile.CONTACTS, RunFile.TICKS)

_FORMAT = 8
_HEADER = b"ampm_record"
_ROOT_Q = ("root_x", "root_y", "root_z", "root_qw", "root_qx", "root_qy", "root_qz")
_ROOT_V = ("root_x", "root_y", "root_z", "root_wx", "root_wy", "root_wz")


def stored_columns(about: Mapping[str, Any]) -> dict[str, tuple[list[str], tuple[int, ...]]]:
    """Columns of every array on disk, and its shape without the rows, from the constants of a record."""
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
        if (file == RunFile.EXTERNAL and not labels["S"]) or (name == "tick_plan" and not about["changes"]):
            continue
        word = re.sub("^(point|external|tick)_", "", name)
        parts = [labels[symbol] for symbol in SHAPES[name].split()[1:]]
        columns = ["_".join([word, *map(str, part)]) for part in product(*parts)]
        found[name] = columns, tuple(map(len, parts))
    return found


def save_record(record: SimulationRecord, directory: Path) -> None:
    """Write ``record`` into ``directory``, which is created.

    The files are those of :data:`RECORD_FILES`, and ``external.parquet`` if anything but the floor pushed the
    body.
    """
    directory.mkdir(parents=True, exist_ok=True)
    constants = {name: getattr(record, name) for name in CONSTANTS}
    known = {"format": _FORMAT, "steps": record.steps, "substeps": record.substeps, **constants}
    header = json.dumps(json_ready(known), allow_nan=False).encode()
    for file, table in record_tables(record).items():
        write_table(pa.table(table).replace_schema_metadata({_HEADER: header}), directory / file)


def record_tables(record: SimulationRecord) -> dict[str, dict[str, NDArray[Any]]]:
    """What is on disk of a record: columns by file, the first of which is ``time``."""
    states = stored_rows(record.steps, record.time_step)
    kept = np.searchsorted(record.state_rows, states)
    rows = {"R": kept, "R-1": kept[:-1]}
    files: dict[str, dict[str, NDArray[Any]]] = {
        RunFile.JOINTS: {"time": record.time[states]},
        RunFile.CONTACTS: {"time": record.time[states[:-1]]},
        RunFile.TICKS: {"time": record.time[: record.steps : record.substeps]},
    }
    for name, (columns, _) in stored_columns(vars(record)).items():
        array = getattr(record, name)[rows.get(SHAPES[name].split()[0], slice(None))]
        table = files.setdefault(STORED[name], {"time": record.time[:-1]})
        table.update(zip(columns, array.reshape(len(array), len(columns)).T, strict=True))
    return files


def write_table(table: pa.Table, path: Path) -> None:
    """Write a table: floats with zstd over split bytes and without a dictionary, which suits them best."""
    floats = [item.name for item in table.schema if pa.types.is_floating(item.type)]
    other = [name for name in table.column_names if name not in floats] or False
    pq.write_table(table, path, compression="zstd", use_byte_stream_split=floats, use_dictionary=other)


def write_columns(columns: Mapping[str, NDArray[Any]], path: Path) -> None:
    """Write columns (N,) as Parquet or CSV, by the suffix; floats keep every bit, NaN is an empty cell."""
    table = pa.table({name: pa.array(column, from_pandas=True) for name, column in columns.items()})
    if path.suffix == ".parquet":
        pq.write_table(table, path, compression="zstd")
    else:
        csv.write_csv(table, path)


def load_record(directory: Path) -> SimulationRecord:
    """Read what :func:`save_record` wrote; raises InputError if it is missing, damaged or another format."""
    header = read_header(directory)
    files = [*RECORD_FILES, *([RunFile.EXTERNAL] if header.get("external_segments") else [])]
    tables = {file: read_table(directory / file) for file in files}
    try:
        constants: dict[str, Any] = {}
        for name in CONSTANTS:
            value = header[name]
            if name in SHAPES:
                row = map(int, SHAPES[name].split()[1:])
                constants[name] = np.array(value, dtype=INTEGERS.get(name, np.float64)).reshape(-1, *row)
            elif name in ("mass", "gravity", "time_step", "friction"):
                constants[name] = math.nan if value is None else float(value)
            else:
                constants[name] = tuple(value) if isinstance(value, list) else value
        constants["outcome"] = Outcome(**header["outcome"])
        steps, substeps, dt = int(header["steps"]), int(header["substeps"]), constants["time_step"]
        arrays: dict[str, Any] = {name: None for name in SHAPES if name not in constants}
        arrays["time"] = np.arange(steps + 1, dtype=np.float64) * dt
        arrays["tick_time"] = np.arange(-(-steps // substeps), dtype=np.float64) * (substeps * dt)
        arrays["state_rows"] = stored_rows(steps, dt)
        for name, (columns, shape) in stored_columns(constants).items():
            table, kind = tables[STORED[name]], np.dtype(INTEGERS.get(name, np.float64))
            found = [table[column].to_numpy() for column in columns]
            if wrong := [column.dtype for column in found if column.dtype != kind]:
                raise TypeError(f"{columns[0]} holds {wrong[0]} values")
            # A log has no columns.
            stacked = np.column_stack(found) if found else np.zeros((table.num_rows, 0), kind)
            arrays[name] = stacked.reshape(table.num_rows, *shape)
        return SimulationRecord(**arrays, **constants)
    except Exception as error:  # the header may hold anything
        why = str(error).rstrip(".")
        raise InputError(f"the record in {directory} is damaged: {why}; walk the gait again.") from error


def read_header(directory: Path) -> dict[str, Any]:
    """Description of the recorded run; raises InputError if there is none, or of another format."""
    path = directory / RunFile.JOINTS
    raw = (read_table(path, only_schema=True).metadata or {}).get(_HEADER)
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


def read_table(path: Path, *, only_schema: bool = False) -> Any:
    """Read a file of a run, or its schema alone; raises InputError if it is missing or cannot be read."""
    check_regular(path)
    if not path.exists():
        raise InputError(f"{path} is missing; give the folder of a recorded run.")
    try:
        return pq.read_schema(path) if only_schema else pq.read_table(path, partitioning=None)
    except (pa.ArrowException, OSError) as error:
        raise InputError(f"{path} cannot be read ({error}); walk the gait again.") from error
