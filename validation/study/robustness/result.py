"""Result of a robustness study: what every disturbance showed, and the tables of all."""

import math
from dataclasses import dataclass
from typing import Any

from ampm.brief import Brief
from validation.show.text import ABSENT
from validation.store.json import json_ready
from validation.study.robustness.cells import DURATION, Cell, needed
from validation.study.robustness.push import DIRECTIONS, PUSH_PHASES
from validation.table import Table, Tabled

PHASE_NAMES = {
    "early": "12 % of single support",
    "mid": "50 % of single support",
    "late": "85 % of single support",
    "double": "mid double support",
}
"""When a push begins."""


@dataclass(frozen=True)
class CellResult:
    """What a cell showed.

    Attributes:
        cell: the disturbance.
        survived: largest value survived with all smaller ones; None if there is none.
        within: largest value that kept the tolerances with all smaller ones; None if there is none.
        zmp: largest RMSE of the ZMP along x and y at ``survived`` [m]; NaN if there is none.
        cause: how a walk of the first value that was not survived ended; empty if there is none.
    """

    cell: Cell
    survived: float | None = None
    within: float | None = None
    zmp: tuple[float, float] = (math.nan, math.nan)
    cause: str = ""

    @property
    def complete(self) -> bool:
        """Whether all values were survived, so that the limit is not known."""
        return self.survived == self.cell.values[-1]

    def push_text(self) -> str:
        """Velocity change survived; ``>`` where the end of the ladder was survived."""
        return f"{'> ' if self.complete else ''}{self.survived or 0.0:.2f}"

    def cells(self) -> tuple[str, ...]:
        """Row of :meth:`Robustness.others_table`."""
        is_angle = self.cell.kind in ("slope_along", "slope_across")
        unit, scale = ("degrees", 180.0 / math.pi) if is_angle else (self.cell.unit, 1.0)

        def shown(value: float | None) -> str:
            return "none" if value is None else f"{scale * value:.4g}"

        zmp = ABSENT if math.isnan(self.zmp[0]) else ", ".join(f"{1e3 * value:.1f}" for value in self.zmp)
        more = " (all tried)" if self.complete else ""
        cause = self.cause.partition("; ")[0].partition(" at ")[0]
        return self.cell.name, unit, shown(self.survived) + more, shown(self.within), zmp, cause


@dataclass(frozen=True)
class Robustness(Brief, Tabled):
    """A robustness study.

    Attributes:
        gait: its name.
        body: its name.
        controller: its name.
        replicas: of each value.
        cells: results.
        crashes: runs that an error of program or machine ended, with its cause; they count as not survived.
    """

    gait: str
    body: str
    controller: str
    replicas: int
    cells: tuple[CellResult, ...]
    crashes: tuple[str, ...] = ()

    @property
    def pushes(self) -> tuple[CellResult, ...]:
        """Those of pushes."""
        return tuple(item for item in self.cells if item.cell.is_push)

    @property
    def others(self) -> tuple[CellResult, ...]:
        """All others."""
        return tuple(item for item in self.cells if not item.cell.is_push)

    @property
    def title(self) -> str:
        """Gait, body, controller and the rule."""
        rule = f"survived by {needed(self.replicas)} of {self.replicas} walks"
        return f"{self.gait}, body {self.body}, controller {self.controller}: {rule}"

    def as_dict(self) -> dict[str, Any]:
        """Everything, as plain values; those of a cell in the unit of its key, of pushes in m/s."""
        return dict(json_ready(vars(self)))

    def tables(self) -> list[Table]:
        """The table of pushes and that of all others, without an empty one."""
        return [table for table in (self.pushes_table(), self.others_table()) if table.rows]

    def pushes_table(self) -> Table:
        """Velocity change survived, by height, phase and direction."""
        texts = {
            (item.cell.height, item.cell.phase, item.cell.direction): item.push_text() for item in self.pushes
        }
        rows = [
            (height, PHASE_NAMES[phase], *(texts[height, phase, direction] for direction in DIRECTIONS))
            for height in dict.fromkeys(height for height, _, _ in texts)
            for phase in PUSH_PHASES
            if (height, phase, DIRECTIONS[0]) in texts
        ]
        columns = ("push at", "begins at", *(f"{name} [m/s]" for name in DIRECTIONS))
        notes = (f"Pushes of {DURATION:g} s, survived with all smaller ones.", *self.crashes)
        return Table(self.title, columns, rows, notes)

    def others_table(self) -> Table:
        """Largest value survived, and that within the tolerances, of every other disturbance."""
        columns = "disturbance", "unit", "survived", "within tolerance", "ZMP RMSE x, y [mm]", "first failure"
        return Table(self.title, columns, [item.cells() for item in self.others], self.crashes)


# ------------------------------------------------------------------------------------------- the study
