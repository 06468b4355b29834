"""Result of a robustness study: what every disturbance showed, and the table of all."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ampm.exceptions import InputError
from validation.store.json import json_ready, read_json
from validation.study.robustness.cells import DURATION, Cell
from validation.table import Table, Tabled

ROBUSTNESS_FILE = "robustness.json"
_NEEDED = 0.8  # share of the replicas that has to survive


@dataclass(frozen=True)
class CellResult:
    """What a cell showed; values in its unit."""

    cell: Cell  # the disturbance
    survived: float | None = None  # worst value survived with all milder ones; None if there is none
    cause: str = ""  # how a walk of the first value that was not survived ended; empty if there is none

    def row(self) -> tuple[str, ...]:
        """Row of the table; angles in degrees."""
        unit = self.cell.unit
        value = self.cell.values[0] if self.survived is None else self.survived
        if unit == "rad":
            value, unit = math.degrees(value), "degrees"
        shown = f"none from {value:.4g} on" if self.survived is None else f"{value:.4g}"
        every = " (all tried)" if self.survived == self.cell.values[-1] else ""
        return self.cell.name, unit, shown + every, self.cause.partition("; ")[0].partition(" at ")[0]


@dataclass(frozen=True)
class Robustness(Tabled):
    """A robustness study."""

    gait: str  # its name
    planner: str  # its name
    body: str  # its name
    controller: str  # its name
    replicas: int  # of each value
    cells: tuple[CellResult, ...]  # results
    # runs that an error of program or machine ended, with its cause; they count as not survived
    crashes: tuple[str, ...] = ()

    @property
    def title(self) -> str:
        """Gait, planner, body and controller, and how many walks have to survive."""
        rule = f"survived by {needed(self.replicas)} of {self.replicas} walks"
        walker = f"planner {self.planner}, body {self.body}, controller {self.controller}"
        return f"{self.gait}, {walker}: {rule}"

    def survived(self, name: str) -> str:
        """Largest value of a disturbance that was survived, for tables; empty if it was not studied."""
        return next((item.row()[2] for item in self.cells if item.cell.name == name), "")

    def as_dict(self) -> dict[str, Any]:
        """Everything, as plain values; those of a cell in the unit of its key, of pushes in m/s."""
        return dict(json_ready(vars(self)))

    def tables(self) -> list[Table]:
        """Largest value survived of every disturbance."""
        note = f"Pushes of {DURATION:g} s: the velocity change. A value counts with all milder ones."
        columns = ("disturbance", "unit", "survived", "first failure")
        return [Table(self.title, columns, [item.row() for item in self.cells], (note, *self.crashes))]


def needed(replicas: int) -> int:
    """Replicas that have to survive; an InputError for less than one."""
    if replicas < 1:
        raise InputError(f"--replicas {replicas}: at least one walk is needed.", value=replicas)
    return math.ceil(_NEEDED * replicas - 1e-9)


def load_robustness(path: Path) -> Robustness:
    """Read ``robustness.json``, or that of a folder; InputError if there is none, or it is damaged."""
    file = path / ROBUSTNESS_FILE if path.is_dir() else path
    return read_json(file, Robustness, f"give a {ROBUSTNESS_FILE} of 'ampm robustness --out'")[1]
