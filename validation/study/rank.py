"""Ranks of planners, or of other values that a sweep varies: task by task, where a difference is decided.

Every gait of the sweep is a task. Runs of a task that differ only in other varied keys (seeds, friction,
mass, engine) are its replicas; those of equal values are pairs of two planners. One planner is better than
another in a task

- if their survival differs: the 95 % intervals (Wilson) of the shares of completed walks do not meet;
- else if its error ahead is smaller by more than the doubt: the 95 % interval of the median of the pairs'
  differences (order statistics) is farther from zero than the numerical uncertainty and the contact spread
  together.

The rank is one more than the number of those that are better. So planners whose difference is not decided
share a rank.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ampm.exceptions import InputError
from validation.store.json import json_ready
from validation.study.compare.comparison import SHARE
from validation.study.sweep.design import CONTROLLER_KEY, ENGINE_KEY, PLANNER_KEY
from validation.study.sweep.schema import AHEAD, ahead_column
from validation.study.sweep.table import BROKEN, LOST, State, SweepTable, read_sweep
from validation.table import ABSENT, Table, Tabled, format_number
from validation.trial.followed import JUDGED_LEAD, LEADS
from validation.trial.users import SUFFIXES

SHORT = {"planner": PLANNER_KEY, "controller": CONTROLLER_KEY}
"""Short names of keys."""
CONFIDENCE = 0.95
"""Of the intervals of survival and of medians."""
FILES = (".toml", *SUFFIXES)
"""Endings of gaits and tables, which are named without them."""
_DEVIATES = 1.959963984540054  # of a normal distribution, for 95 %
EFFORT = "energy_cost_of_transport"
"""Metric of the effort."""


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """Interval of a share by Wilson's score, at 95 %; 0 to 1 without any trial."""
    if not trials:
        return 0.0, 1.0
    z2, share = _DEVIATES**2 / trials, successes / trials
    middle, half = share + 0.5 * z2, math.sqrt(z2 * (share * (1.0 - share) + 0.25 * z2))
    return max(0.0, (middle - half) / (1.0 + z2)), min(1.0, (middle + half) / (1.0 + z2))


def median_interval(values: NDArray[np.float64]) -> tuple[float, float]:
    """Interval of a median by order statistics, at 95 % or more; infinite for less than six values."""
    # Imported here because SciPy is slow to load.
    from scipy.stats import binom

    outside = int(binom.ppf(0.5 * (1.0 - CONFIDENCE), len(values), 0.5)) if len(values) else 0
    if not outside:
        return -math.inf, math.inf
    ordered = np.sort(values)
    return float(ordered[outside - 1]), float(ordered[-outside])


@dataclass(frozen=True)
class Cell:
    """All walks of a planner in a task.

    Attributes:
        task: name of the gait.
        name: of the planner.
        runs: that should have walked; those that were refused are not counted.
        survived: walks that completed.
        error: median of the ZMP's RMS error ahead over the completed walks, NaN without any [m].
        effort: median of their mechanical cost of transport [1].
        notes: how runs ended otherwise, with the sentence of the first of each kind.
        best: completed run with the least error; None without any.
        worst: the run that ended first, or else that with the largest error; None if none walked.
        errors: by the other varied values of each completed walk [m].
    """

    task: str
    name: str
    runs: int
    survived: int
    error: float
    effort: float
    notes: tuple[str, ...]
    best: int | None
    worst: int | None
    errors: Mapping[tuple[Any, ...], float] = field(repr=False)

    @property
    def interval(self) -> tuple[float, float]:
        """Of the survival, at 95 % [1]."""
        return wilson(self.survived, self.runs)

    def pairs(self, other: "Cell") -> dict[tuple[Any, ...], float]:
        """Error of the other one minus this one, in each replica that both completed [m]."""
        return {at: other.errors[at] - error for at, error in self.errors.items() if at in other.errors}


@dataclass(frozen=True)
class Ranking(Tabled):
    """Ranks in every task.

    Attributes:
        by: key that is ranked.
        ahead: how long before an instant the plan stood that it is compared with [s].
        cells: of every task and planner.
        engines: place of the engine among the values of a replica; None if the sweep has one engine.
        planned: runs of the sweep.
        found: those with a result.
    """

    by: str
    ahead: float
    cells: tuple[Cell, ...]
    engines: int | None
    planned: int
    found: int

    def better(self, one: Cell, other: Cell) -> bool:
        """Whether it is decided that one is better than the other in their task."""
        if one.interval[0] > other.interval[1]:
            return True
        if other.interval[0] > one.interval[1]:
            return False
        pairs = one.pairs(other)
        least = median_interval(np.array(list(pairs.values())))[0]
        return least > self.doubt(one, other, pairs)

    def doubt(self, one: Cell, other: Cell, pairs: Mapping[tuple[Any, ...], float]) -> float:
        """Numerical uncertainty of the smaller error, and spread of the difference between engines [m]."""
        numerical = SHARE * min(one.error, other.error)
        if self.engines is None or not pairs:
            return numerical
        place, whole = self.engines, np.median(list(pairs.values()))
        engines = {at[place] for at in pairs}
        medians = [np.median([d for at, d in pairs.items() if at[place] == name]) for name in engines]
        return numerical + float(np.abs(medians - whole).max())

    @cached_property
    def ranks(self) -> dict[tuple[str, str], int]:
        """Rank by task and planner; those without a walk have none."""
        walked = [cell for cell in self.cells if cell.runs]
        return {
            (cell.task, cell.name): 1 + sum(self.better(o, cell) for o in walked if o.task == cell.task)
            for cell in walked
        }

    @property
    def tasks(self) -> tuple[str, ...]:
        """Tasks, in the order of the sweep."""
        return tuple(dict.fromkeys(cell.task for cell in self.cells))

    @property
    def names(self) -> tuple[str, ...]:
        """What is ranked, in the order of the sweep."""
        return tuple(dict.fromkeys(cell.name for cell in self.cells))

    @property
    def sentence(self) -> str:
        """How many differences are decided."""
        walked = [cell for cell in self.cells if cell.runs]
        pairs = [(a, b) for a in walked for b in walked if a.task == b.task and a.name < b.name]
        decided = sum(self.better(a, b) or self.better(b, a) for a, b in pairs)
        missing = f" {self.planned - self.found} runs have no result yet." * (self.found < self.planned)
        return f"{decided} of {len(pairs)} differences of two in a task are decided.{missing}"

    def tables(self) -> list[Table]:
        """Ranks of all tasks, then each task."""
        ranks = [
            (name, *(str(self.ranks.get((task, name), ABSENT)) for task in self.tasks)) for name in self.names
        ]
        head = self.by.rpartition(".")[2]
        overview = Table("ranks", (head, *(f">{task}" for task in self.tasks)), ranks, [self._note()])
        columns = (">rank", head, ">error [mm]", ">survived", ">95 % [%]", ">cost of transport", "not walked")
        return [overview, *(Table(task, columns, self._rows(task)) for task in self.tasks)]

    def _rows(self, task: str) -> list[tuple[str, ...]]:
        cells = [cell for cell in self.cells if cell.task == task]
        order = {cell.name: self.ranks.get((task, cell.name), len(cells) + 1) for cell in cells}
        cells.sort(key=lambda cell: (order[cell.name], np.nan_to_num(cell.error, nan=np.inf)))
        return [
            (
                str(self.ranks.get((task, cell.name), ABSENT)),
                cell.name,
                format_number(1e3 * cell.error, 3),
                f"{cell.survived} of {cell.runs}" if cell.runs else ABSENT,
                "{:.0f}–{:.0f}".format(*(100.0 * end for end in cell.interval)) if cell.runs else ABSENT,
                format_number(cell.effort, 3),
                "; ".join(cell.notes),
            )
            for cell in cells
        ]

    def _note(self) -> str:
        spread = "the spread between the engines"
        if self.engines is None:
            spread = "the spread of the contact, which one engine does not show"
        return (
            f"Error: median of the ZMP's RMS distance from the plan as it stood {self.ahead:g} s before. "
            f"Ranks are shared where the replicas (95 % interval), numerical uncertainty "
            f"({100.0 * SHARE:g} %) and {spread} leave the difference open."
        )

    def as_dict(self) -> dict[str, Any]:
        """Plain values in SI units."""
        cells = [
            {
                **{name: value for name, value in asdict(cell).items() if name != "errors"},
                "interval": cell.interval,
                "rank": self.ranks.get((cell.task, cell.name)),
            }
            for cell in self.cells
        ]
        head = {"by": self.by, "ahead": self.ahead, "runs": self.planned, "found": self.found}
        return dict(json_ready({**head, "cells": cells}))


def rank(sweep: str | Path | SweepTable, by: str = "planner", *, ahead: float = JUDGED_LEAD) -> Ranking:
    """Rank what a sweep varies, task by task; see :mod:`validation.study.rank`.

    Args:
        sweep: folder of a sweep, finished or not, or its table.
        by: key of what is ranked, or ``planner`` or ``controller``.
        ahead: how long before an instant the plan stood that it is compared with, one of 0, 0.05, 0.1, 0.2
            and 0.4 [s].

    Raises:
        InputError: there is no such sweep, it does not vary this key, or it has no such error.
    """
    table = sweep if isinstance(sweep, SweepTable) else read_sweep(sweep)
    key, varied = SHORT.get(by, by), list(table.metadata["varied"])
    if key not in varied:
        raise InputError(f"{table.source} does not vary {key!r}; rank by one of {', '.join(varied)}.")
    if ahead not in LEADS or ahead_column(AHEAD[0], ahead) not in table:
        known = ", ".join(f"{lead:g}" for lead in LEADS)
        raise InputError(
            f"{table.source} has no error {ahead:g} s ahead; take one of {known} s.", value=ahead
        )
    others = [name for name in varied if name != key]
    places = zip(_short(table.words("gait")), _short(table.words(key)), strict=True)
    groups: dict[tuple[str, str], list[_Run]] = {}
    for place, run in zip(places, _runs(table, others, ahead), strict=True):
        groups.setdefault(place, []).append(run)
    cells = tuple(_cell(*place, runs) for place, runs in groups.items())
    engines = others.index(ENGINE_KEY) if ENGINE_KEY in others else None
    return Ranking(key, ahead, cells, engines, table.planned, len(table))


class _Run(NamedTuple):
    """One run of the sweep: its number, replica and end; errors in m, times in s."""

    number: int
    replica: tuple[Any, ...]
    state: State
    cause: str
    time: float
    error: float
    effort: float


def _runs(table: SweepTable, others: Sequence[str], ahead: float) -> Iterator[_Run]:
    columns = [table.values(name).tolist() for name in others]
    error = np.hypot(*(table.numbers(ahead_column(name, ahead)) for name in AHEAD))
    number, cause, effort = table.table["run"].to_pylist(), table.words("cause"), table.numbers(EFFORT)
    time = table.numbers("outcome_time")
    for row in range(len(table)):
        replica = tuple(values[row] for values in columns)
        yield _Run(
            number[row], replica, table.state(row), cause[row], time[row], float(error[row]), effort[row]
        )


def _cell(task: str, name: str, runs: Sequence[_Run]) -> Cell:
    """The walks of one task and planner."""
    walked = [run for run in runs if run.state is not State.REFUSED]
    measured = (run for run in walked if run.state in (State.PASS, State.OUT_OF_TOLERANCE))
    done = sorted(measured, key=lambda run: run.error)
    lost = sorted((run for run in walked if run.state in LOST), key=lambda run: run.time)
    worst = lost[:1] or done[-1:]
    notes = []
    for state in (State.REFUSED, *BROKEN):
        ended = [run for run in runs if run.state is state]
        notes += [f"{len(ended)} {state.label}: {ended[0].cause}"] if ended else []
    return Cell(
        task,
        name,
        runs=len(walked),
        survived=len(done),
        error=float(np.median([run.error for run in done])) if done else math.nan,
        effort=float(np.median([run.effort for run in done])) if done else math.nan,
        notes=tuple(notes),
        best=done[0].number if done else None,
        worst=worst[0].number if worst else None,
        errors={run.replica: run.error for run in done},
    )


def _short(names: Sequence[str]) -> list[str]:
    """Classes of ``module:Class``, files without suffix; the names as they are if two would be equal."""
    short = {name: name.rpartition(":")[2] for name in names}
    short |= {name: Path(name).stem for name in names if Path(name).suffix in FILES}
    unique = len(set(short.values())) == len(short)
    return [short[name] if unique else name for name in names]
