"""``signals.parquet``: plan, command and measurement on one clock, one row per simulation step.

Every column carries its unit, its frame and its meaning in the metadata of its field, from :data:`COLUMNS`.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, Self

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from ampm.brief import Brief
from ampm.exceptions import InputError
from ampm.geometry import Array
from ampm.section import unknown
from validation.store.record import read_table, write_table
from validation.table import package_rows
from validation.trial.files import RunFile


class SignalKind(NamedTuple):
    """Columns of one kind: a row of ``signals.csv``."""

    columns: str  # their names: `(left|right)` and `[xyz]` stand for each of several
    unit: str  # SI unit, empty for labels and flags
    frame: str  # in which vectors are written, empty for anything else
    source: str  # where :mod:`validation.judge.signals` finds the values, a thing and its attribute
    meaning: str  # one phrase

    @property
    def names(self) -> list[str]:
        """Names of the columns, the last choice changing fastest."""
        parts = re.findall(r"\((.*?)\)|\[(.*?)\]|([^(\[]+)", self.columns)
        choices = (words.split("|") if words else axes or [text] for words, axes, text in parts)
        return list(map("".join, product(*choices)))


KINDS = tuple(SignalKind(**row) for row in package_rows("store/signals.csv"))
"""All kinds of columns, in order."""
COLUMNS: Mapping[str, SignalKind] = MappingProxyType({name: kind for kind in KINDS for name in kind.names})
"""Kind of every column."""


@dataclass(frozen=True)
class Signals(Brief):
    """Columns of ``signals.parquet``; a null is NaN."""

    columns: Mapping[str, NDArray[Any]]  # name to array (N,): float64, bool, or object for the labels

    def __getitem__(self, name: str) -> NDArray[Any]:
        if name not in self.columns:
            raise unknown(name, self.columns, f"column of {RunFile.SIGNALS}")
        return self.columns[name]

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    def __len__(self) -> int:
        return len(self["time"])

    @property
    def time(self) -> Array:
        """Start of each step (N,) [s]."""
        return self["time"]

    def take(self, rows: NDArray[np.intp]) -> Self:
        """Some of the rows, of every column."""
        return type(self)({name: column[rows] for name, column in self.columns.items()})

    def switches(self) -> NDArray[np.intp]:
        """Rows at which a planned phase begins, the first row included."""
        return changes(np.column_stack([self["phase"], self["stance"]]))[: len(self)]

    def first_step(self) -> int:
        """Number of rows of the first step: one single and one double support."""
        starts = self.switches()
        return int(starts[2]) if len(starts) > 2 else len(self)

    def vector(self, name: str, axes: str = "xyz") -> Array:
        """Stack ``{name}_{axis}``, shape (N, len(axes)), in their unit; InputError if one is missing."""
        return np.column_stack([self[f"{name}_{axis}"] for axis in axes])


def save_signals(table: pa.Table, path: Path) -> None:
    """Write the table, with unit, frame and meaning of every column."""
    fields = []
    for field in table.schema:
        kind = COLUMNS[field.name]
        known = {"unit": kind.unit, "frame": kind.frame, "meaning": kind.meaning}
        fields.append(field.with_metadata({key: text for key, text in known.items() if text}))
    write_table(table.cast(pa.schema(fields)), path)


def load_signals(path: Path) -> Signals:
    """Read the table; raises InputError if the file is missing or is not a table of signals."""
    table = read_table(path)
    arrays: dict[str, NDArray[Any]] = {}
    for field in table.schema:
        if not any(of(field.type) for of in (pa.types.is_string, pa.types.is_floating, pa.types.is_boolean)):
            raise InputError(
                f"{path} is damaged: column {field.name!r} holds {field.type} values; run the gait again."
            )
        arrays[field.name] = table.column(field.name).to_numpy()
        arrays[field.name].setflags(write=False)
    return Signals(arrays)


def changes(values: NDArray[Any]) -> NDArray[np.intp]:
    """Rows that differ from the one before, and the first; ``values`` has one row per instant."""
    differs = values[1:] != values[:-1]
    return np.flatnonzero(np.r_[True, differs.any(axis=1) if differs.ndim == 2 else differs])
