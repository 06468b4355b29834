"""Result of a robustness study."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ampm.brief import Brief
from validation.store.json import json_ready
from validation.study.robustness.cells import PUSHES, Cell, needed
from validation.study.robustness.walks import LevelResult


@dataclass(frozen=True)
class CellResult:
    """What a cell showed.

    Attributes:
        cell: the disturbance.
        levels: value and result, in the order in which they were tried.
        replicas: of each level.
        bound: of a push, what legs can capture [m/s]; None for all else.
    """

    cell: Cell
    levels: tuple[tuple[float, LevelResult], ...]
    replicas: int
    bound: float | None = None

    def _last(self, name: str) -> float | None:
        """Last value up to which enough replicas did it at every value."""
        best = None
        for value, result in self.levels:
            if getattr(result, name) < needed(self.replicas):
                break
            best = value
        return best

    @property
    def survived(self) -> float | None:
        """Largest value survived with all smaller ones; None if there is none."""
        return self._last("walked")

    @property
    def within(self) -> float | None:
        """Largest value that kept the tolerances with all smaller ones; None if there is none."""
        return self._last("passed")

    @property
    def complete(self) -> bool:
        """Whether all values were survived, so that the limit is not known."""
        return bool(self.levels) and self.survived == self.cell.values[-1]

    @property
    def cause(self) -> str:
        """How a walk of the first value that was not survived ended; empty if there is none."""
        failed = [result.causes for _, result in self.levels if result.walked < needed(self.replicas)]
        return failed[0][0] if failed and failed[0] else ""

    @property
    def share(self) -> float | None:
        """Share of the bound that was survived [1]."""
        return None if not self.bound else (self.survived or 0.0) / self.bound

    @property
    def zmp(self) -> tuple[float, float]:
        """Largest RMSE of the ZMP at the largest value survived [m]; NaN if there is none."""
        found = {value: result.zmp for value, result in self.levels}
        return (
            found.get(self.survived, (math.nan, math.nan)) if self.survived is not None else (math.nan,) * 2
        )


@dataclass(frozen=True)
class Robustness(Brief):
    """A robustness study.

    Attributes:
        gait: its name.
        body: its name.
        controller: its name.
        replicas: of each value.
        cells: results.
        quick: whether it is the small subset.
    """

    gait: str
    body: str
    controller: str
    replicas: int
    cells: tuple[CellResult, ...]
    quick: bool = False

    @property
    def pushes(self) -> tuple[CellResult, ...]:
        """Those of pushes."""
        return tuple(item for item in self.cells if item.cell.key == PUSHES)

    @property
    def others(self) -> tuple[CellResult, ...]:
        """All others."""
        return tuple(item for item in self.cells if item.cell.key != PUSHES)

    def push(self, height: str, phase: str, direction: str) -> CellResult:
        """One kind of push.

        Raises:
            KeyError: it was not tried.
        """
        for item in self.pushes:
            if (item.cell.height, item.cell.phase, item.cell.direction) == (height, phase, direction):
                return item
        raise KeyError(f"{height} {phase} {direction}")

    def as_dict(self) -> dict[str, Any]:
        """Everything, as plain values; values in the unit beside them."""
        cells = [_plain(item) for item in self.cells]
        return dict(json_ready({**vars(self), "needed": needed(self.replicas), "cells": cells}))


def _plain(item: CellResult) -> Mapping[str, Any]:
    cell = item.cell
    about = {"height": cell.height, "phase": cell.phase, "direction": cell.direction}
    return {
        "name": cell.name,
        "key": cell.key,
        "unit": cell.unit,
        "fixed": dict(cell.fixed),
        **(about if cell.key == PUSHES else {}),
        "survived": item.survived,
        "within_tolerance": item.within,
        "bound": item.bound,
        "share_of_bound": item.share,
        "cause": item.cause,
        "zmp_rmse": item.zmp,
        "levels": [
            {"value": value, "walked": result.walked, "passed": result.passed, "zmp_rmse": result.zmp,
             "causes": result.causes}
            for value, result in item.levels
        ],
    }  # fmt: skip
