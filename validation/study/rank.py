"""Ranks of planners, or of other values that a sweep varies: task by task, where a difference is decided.

Every gait of the sweep is a task. Runs of a task that differ only in other varied keys (seeds, friction,
mass, engine) are its replicas; those of equal values are pairs of two planners. ``docs/league.md`` has the
rule.
"""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ampm.exceptions import InputError
from validation.judge.margins import STANDING
from validation.judge.metrics import METRICS
from validation.store.json import json_ready
from validation.study.sweep.design import ENGINE_KEY
from validation.study.sweep.schema import AHEAD, ahead_column
from validation.study.sweep.table import BROKEN, RunState, SweepTable, read_sweep, short_names
from validation.table import ABSENT, Table, Tabled, format_number
from validation.trial.followed import JUDGED_LEAD

Rows = NDArray[np.intp]
SHORT = {"planner": "gait.planner", "controller": "controller.name"}
"""Short names of keys."""
SAME_PACE = 0.05
"""Share by which a planner's speed may differ from the median of its task without a note [1]."""
SHARE = 0.1
"""Numerical uncertainty, of the smaller error [1].

At half the time step the ZMP's RMS errors of the presets change by 7 % at most, of ``pitch-low`` by 12 %.
"""
_LEAST_PAIRS = 6  # pairs from which order statistics bound a median at 95 %


@dataclass(frozen=True)
class TaskResult:
    """All walks of a planner in a task."""

    task: str  # name of the gait
    name: str  # of the planner
    runs: int  # that should have walked, see :func:`rank`; 0 if all broke; equal ones count once
    survived: int  # walks that completed
    error: float  # median of the ZMP's RMS error ahead over the completed walks, NaN without any [m]
    effort: float  # median of their mechanical cost of transport [1]
    # how runs ended otherwise, with the sentence of the first; how many were equal; another speed
    notes: tuple[str, ...]
    # by the other varied values: of each completed walk [m]
    errors: Mapping[tuple[Any, ...], float] = field(repr=False)
    # likewise, whether each run completed that should have walked, equal ones once
    completed: Sequence[tuple[tuple[Any, ...], bool]] = field(repr=False)
    replicas: frozenset[tuple[Any, ...]] = field(repr=False)  # likewise, of all of them

    @property
    def is_ranked(self) -> bool:
        """Whether it walked, and its walks have an error, unless none completed."""
        return self.runs > 0 and (not self.survived or math.isfinite(self.error))

    def interval(self, other: "TaskResult | None" = None) -> tuple[float, float]:
        """Wilson's interval of the survival at 95 %, over common replicas; 0 to 1 without any walk [1]."""
        from scipy.stats import binomtest  # slow to load

        ends = [done for at, done in self.completed if other is None or at in other.replicas]
        if not ends:
            return 0.0, 1.0
        low, high = binomtest(sum(ends), len(ends)).proportion_ci(0.95, method="wilson")
        return float(low), float(high)

    def pairs(self, other: "TaskResult") -> dict[tuple[Any, ...], float]:
        """Error of the other one minus this one, in each replica that both completed [m]."""
        return {at: other.errors[at] - error for at, error in self.errors.items() if at in other.errors}


@dataclass(frozen=True)
class Ranking(Tabled):
    """Ranks in every task."""

    by: str  # key that is ranked
    cells: tuple[TaskResult, ...]  # of every task and planner
    engines: int | None  # place of the engine among the values of a replica; None if there is one engine
    extremes: Mapping[str, int]  # number of the best and of the worst run of each planner, by `NAME-best` ...
    planned: int  # runs of the sweep
    found: int  # those with a result

    def better(self, one: TaskResult, other: TaskResult) -> bool:
        """Whether it is decided that one is better than the other in their task."""
        mine, others = one.interval(other), other.interval(one)
        if mine[0] > others[1] or others[0] > mine[1]:
            return mine[0] > others[1]
        from scipy.stats import quantile_test  # slow to load

        pairs = one.pairs(other)
        if len(pairs) < _LEAST_PAIRS:
            return False
        found = quantile_test(list(pairs.values()), p=0.5).confidence_interval(0.95)
        return bool(found.low > self.doubt(one, other, pairs))

    def doubt(self, one: TaskResult, other: TaskResult, pairs: Mapping[tuple[Any, ...], float]) -> float:
        """Numerical uncertainty of the smaller error, and spread of the difference between engines [m]."""
        numerical = SHARE * min(one.error, other.error)
        if self.engines is None:
            return numerical
        place, whole = self.engines, np.median(list(pairs.values()))
        engines = {at[place] for at in pairs}
        medians = [np.median([d for at, d in pairs.items() if at[place] == name]) for name in engines]
        return numerical + float(np.abs(medians - whole).max())

    @cached_property
    def wins(self) -> list[tuple[TaskResult, TaskResult]]:
        """Pairs of cells of a task of which the first is better."""
        walked = [cell for cell in self.cells if cell.is_ranked]
        pairs = [(one, other) for one in walked for other in walked if one.task == other.task]
        return [(one, other) for one, other in pairs if one is not other and self.better(one, other)]

    @cached_property
    def ranks(self) -> dict[tuple[str, str], int]:
        """Rank by task and planner; those without a walk have none."""
        lost = [other for _, other in self.wins]
        return {
            (cell.task, cell.name): 1 + sum(other is cell for other in lost)
            for cell in self.cells
            if cell.is_ranked
        }

    @property
    def sentence(self) -> str:
        """How many differences are decided."""
        walked = [cell.task for cell in self.cells if cell.is_ranked]
        pairs = sum(math.comb(walked.count(task), 2) for task in set(walked))
        missing = f" Runs without a result yet: {self.planned - self.found}." * (self.found < self.planned)
        few = " Errors decide from six replicas on." * all(
            len(cell.errors) < _LEAST_PAIRS for cell in self.cells
        )
        return f"{len(self.wins)} of {pairs} differences within a task are decided.{missing}{few}"

    def tables(self) -> list[Table]:
        """Ranks of all tasks, then each task."""
        tasks, names = (
            list(dict.fromkeys(getattr(cell, what) for cell in self.cells)) for what in ("task", "name")
        )
        head = {key: short for short, key in SHORT.items()}.get(self.by, self.by.rpartition(".")[2])
        ranks = [(name, *(str(self.ranks.get((task, name), ABSENT)) for task in tasks)) for name in names]
        spread = " or the spread between engines exceeds the difference."
        if self.engines is None:
            spread = " exceeds the difference. One engine does not show the spread of the contact."
        note = (
            "The error is the median of the ZMP's RMS distance from the plan as it stood "
            f"{JUDGED_LEAD:g} s before. A rank is shared if the spread of replicas (95 %) or the numerical "
            f"uncertainty ({100.0 * SHARE:g} %){spread} 95 %: interval of survival. Cost: cost of transport."
        )
        columns = (">rank", head, ">error [mm]", ">survived", ">95 % [%]", ">cost", "notes")
        overview = Table("ranks", (head, *(f">{task}" for task in tasks)), ranks, [note])
        return [overview, *(Table(task, columns, self._rows(task)) for task in tasks)]

    def _rows(self, task: str) -> list[tuple[str, ...]]:
        """Rows of a task, the best first."""
        cells = [cell for cell in self.cells if cell.task == task]
        order = {cell.name: self.ranks.get((task, cell.name), math.inf) for cell in cells}
        cells.sort(key=lambda cell: (order[cell.name], np.nan_to_num(cell.error, nan=np.inf)))
        return [
            (
                str(self.ranks.get((task, cell.name), ABSENT)),
                cell.name,
                format_number(1e3 * cell.error, 3),
                f"{cell.survived} of {cell.runs}" if cell.runs else ABSENT,
                "{:.0f}–{:.0f}".format(*(100.0 * end for end in cell.interval())) if cell.runs else ABSENT,
                format_number(cell.effort, 3),
                "; ".join(cell.notes),
            )
            for cell in cells
        ]

    def as_dict(self) -> dict[str, Any]:
        """Plain values in SI units."""
        cells = []
        for cell in self.cells:
            rank = self.ranks.get((cell.task, cell.name))
            cells.append({**asdict(cell), "interval": cell.interval(), "rank": rank})
            del cells[-1]["errors"], cells[-1]["completed"], cells[-1]["replicas"]
        head = {"by": self.by, "ahead": JUDGED_LEAD, "runs": self.planned, "found": self.found}
        return dict(json_ready({**head, "cells": cells}))


def rank(sweep: str | Path | SweepTable, by: str = "planner") -> Ranking:
    """Rank what a sweep varies, task by task; see :mod:`validation.study.rank`.

    A planner that refuses all of a task leaves it out. If it walks some replicas, those that it refuses and
    others walk count as not completed. A walk whose steps are not the task's does not count.

    Args:
        sweep: folder of a sweep, finished or not, or its table.
        by: key of what is ranked, or ``planner`` or ``controller``.

    Raises:
        InputError: there is no such sweep, it does not vary this key.
    """
    table = sweep if isinstance(sweep, SweepTable) else read_sweep(sweep)
    varied = list(table.metadata["varied"])
    named = [SHORT[by]] if by in SHORT else [key for key in varied if key.endswith(f".{by}")] or [by]
    if len(named) > 1:
        raise InputError(f"--by {by} may be {' or '.join(named)}; give the whole key.", value=by)
    (key,) = named
    if key not in varied:
        raise InputError(f"{table.source} does not vary {key!r}; rank by one of {', '.join(varied)}.")
    others = [name for name in varied if name != key]
    runs = _Runs(table, key, others)
    cells = tuple(runs.result(*place) for place in dict.fromkeys(runs.places))
    engines = others.index(ENGINE_KEY) if ENGINE_KEY in others else None
    return Ranking(key, cells, engines, runs.extremes(), table.planned, len(table))


class _Runs:
    """The runs of a sweep, as they are ranked; lists and arrays have an entry for each of N."""

    def __init__(self, table: SweepTable, key: str, others: Sequence[str]) -> None:
        self.table = table
        self.names, self.tasks = short_names(table.words(key)), short_names(table.words("gait"))
        self.places = list(zip(self.tasks, self.names, strict=True))
        replicas = zip(*(table.values(name).tolist() for name in others), strict=True)
        self.replicas = list(replicas) or [()] * len(table)
        self.errors = np.hypot(*(table.numbers(ahead_column(name, JUDGED_LEAD)) for name in AHEAD))
        self.completed = np.array(table.words("outcome")) == "completed"
        self.pace = np.where(self.completed, table.numbers("energy_speed"), np.nan)
        checks = {item.name for item in METRICS.values() if item.is_self_check}
        failed = (words.split(",") for words in table.words("failed"))
        self.unsound = np.array([not checks.isdisjoint(names) for names in failed], dtype=bool)
        self.plan_notes, self.causes = np.array(table.words("plan_note")), table.words("cause")
        self.is_other = self.plan_notes != ""  # walks of other steps, which say nothing about the task
        self.refused = table.is_state(RunState.REFUSED)
        walked = np.flatnonzero(~self.refused)
        self.walkable = {(self.tasks[row], self.replicas[row]) for row in walked}  # by some planner

    def result(self, task: str, name: str) -> TaskResult:
        """All walks of a planner in a task."""
        rows = np.array([row for row, place in enumerate(self.places) if place == (task, name)])
        replicas = self.replicas
        expected = np.array([(task, replicas[row]) in self.walkable for row in rows])
        counted = rows[expected & ~self.refused[rows].all()]  # no run of a task that this planner leaves out
        counted = counted[~(self.unsound | self.is_other)[counted]]  # unsound numbers are not reliable
        if self.table.is_state(RunState.REFUSED, *BROKEN)[counted].all():  # no answer about its walk
            counted = counted[:0]
        distinct = self._distinct(counted)
        done = distinct[self.completed[distinct]]
        return TaskResult(
            task,
            name,
            runs=len(distinct),
            survived=len(done),
            error=_median(self.errors[done]),
            effort=_median(self.table.numbers("energy_cost_of_transport")[done]),
            notes=tuple(self._notes(task, rows, done, len(counted) - len(distinct))),
            errors={replicas[row]: float(self.errors[row]) for row in done if np.isfinite(self.errors[row])},
            completed=[(replicas[row], bool(self.completed[row])) for row in distinct],
            replicas=frozenset(replicas[row] for row in counted),
        )

    def _distinct(self, rows: Rows) -> Rows:
        """The first of rows that are equal to the bit; those without an error are never equal."""
        ends, errors = self.table.numbers("outcome_time"), self.errors
        keys = {row: (ends[row], errors[row]) if errors[row] >= 0.0 else row for row in rows.tolist()}
        return np.array(sorted({keys[row]: row for row in reversed(keys)}.values()), dtype=np.intp)

    def _notes(self, task: str, rows: Rows, done: Rows, equal: int) -> Iterator[str]:
        """How runs of a planner in a task ended otherwise, and what is special of those that completed."""
        for state in (RunState.NOT_MEASURED, RunState.REFUSED, *BROKEN):
            if (at := rows[self.table.is_state(state)[rows]]).size:
                yield f"{len(at)} {state.label}: {self.causes[at[0]]}"
        if wrong := np.count_nonzero(self.unsound[rows]):
            yield f"{wrong} fail a check of the measurement and do not count"
        if other := rows[self.is_other[rows]].tolist():
            words = f"with steps unlike the task's do not count: {self.plan_notes[other[0]]}"
            yield f"{len(other)} {words}"
        if met := np.count_nonzero(self.table.numbers("margin_clearance")[done] < 0.0):
            yield f"in {met} of those that survived, parts of the body pass through each other"
        if equal:
            yield f"{equal} equal another one to the bit: they count once"
        usual = _median(self.pace[np.array(self.tasks) == task])
        faster = _median(self.pace[done]) / usual - 1.0
        if usual >= STANDING and abs(faster) > SAME_PACE:
            yield f"{100 * abs(faster):.0f} % {'faster' if faster > 0 else 'slower'} than the median"

    def extremes(self) -> dict[str, int]:
        """Number of the best and of the worst run of each planner, by its name as that of a folder."""
        found, numbers = dict[str, int](), self.table.table["run"].to_pylist()
        for name in dict.fromkeys(self.names):
            rows = [row for row in self.table.worst if self.names[row] == name]
            done = [row for row in rows if self.completed[row] and not (self.unsound | self.is_other)[row]]
            folder = re.sub(r"[^\w.-]+", "_", name).strip("_.")  # that of a user's file is its whole path
            best = min(done, key=np.nan_to_num(self.errors, nan=np.inf).__getitem__, default=None)
            found |= {} if best is None else {f"{folder}-best": numbers[best]}
            found |= {f"{folder}-worst": numbers[rows[0]]} if rows else {}
        return found


def _median(values: NDArray[np.float64]) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else math.nan
