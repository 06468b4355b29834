"""Two sweeps compared run by run; the first is the reference.

Two runs of one revision on one machine have the same bits, so only a difference beyond rounding counts.
"""

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ampm.exceptions import InputError
from validation.judge.uncertainty import rounding
from validation.study.sweep.table import METRIC, RunState, SweepTable, read_sweep
from validation.table import Table, Tabled, format_value

_TOLERANCE = 0.1  # share of its limit by which a metric may grow before that is a regression [1]
KINDS = ("newly failing", "worse", "missing")
"""Regressions of a run. What got better is found by the two sweeps in the other order."""
_SHOWN = 100  # rows of the table of runs that are shown


@dataclass(frozen=True)
class SweepComparison(Tabled):
    """Two sweeps compared."""

    title: str  # both sweeps
    matched: int  # number of runs that both have
    changes: Table  # runs that got worse or are missing, in the order of `KINDS`; notes are its conditions
    sides = ()  # there is no walk to draw

    @property
    def counts(self) -> dict[str, int]:
        """Number of runs by kind; empty if the comparison passes."""
        return Counter(row[0] for row in self.changes.rows)

    @property
    def sentence(self) -> str:
        """The result in one sentence."""
        found = ", ".join(f"{number:,} {kind}" for kind, number in self.counts.items())
        runs = f"{self.matched:,} matched run{'' if self.matched == 1 else 's'}"
        return f"{'Regression' if self.counts else 'No regression'} in {runs}{found and ': '}{found}."

    def tables(self) -> list[Table]:
        """The first runs that got worse."""
        rows, notes = self.changes.rows, self.changes.notes
        more = [f"and {len(rows) - _SHOWN:,} more"] if len(rows) > _SHOWN else []
        return [replace(self.changes, rows=rows[:_SHOWN], notes=[*more, *notes])]

    def as_dict(self) -> dict[str, Any]:
        """Everything, as plain data."""
        changes = [dict(zip(self.changes.headers, row, strict=True)) for row in self.changes.rows]
        said = {"sentence": self.sentence, "title": self.title, "matched": self.matched}
        return {**said, "counts": self.counts, "changes": changes, "notes": list(self.changes.notes)}


def compare_sweeps(a: Path | str | SweepTable, b: Path | str | SweepTable) -> SweepComparison:
    """Compare a sweep, by folder or table, with a reference, the first; InputError without a run to match."""
    a, b = (side if isinstance(side, SweepTable) else read_sweep(side) for side in (a, b))
    rows_a, rows_b = join(a, b)
    if not a.measured[rows_a].any():
        raise InputError(f"no run of {a.source} was measured, so none gets worse; give one that walks.")
    sides = (b, rows_b), (a, rows_a)
    judged = dict.fromkeys((*a.judged, *b.judged))
    metrics = [name for name in judged if METRIC + name in a and METRIC + name in b]
    worse, crossed, counts = np.zeros((3, len(metrics), len(rows_a)), dtype=bool)
    completed = a.measured[rows_a] & b.measured[rows_b]
    for number, name in enumerate(metrics):
        before, after = a.numbers(METRIC + name)[rows_a], b.numbers(METRIC + name)[rows_b]
        both = completed & np.isfinite(before) & np.isfinite(after)
        growth = np.subtract(after, before, out=np.zeros(len(rows_a)), where=both)
        limits = [side.limit_values(name)[rows] for side, rows in sides if name in side.limits]
        limit = limits[0]
        noise = rounding(np.fmax(before, after), a.unit(METRIC + name))
        is_lost = completed & np.isfinite(before) & ~np.isfinite(after)
        worse[number] = is_lost | (growth > np.fmax(noise, _TOLERANCE * limit))
        crossed[number] = (a.used(name)[rows_a] > 1.0) != (b.used(name)[rows_b] > 1.0)
        is_new = name in b.limits and name not in a.limits
        counts[number] = is_lost | (np.abs(growth) > noise) | (limit != limits[-1]) | is_new
    # A verdict may change by a difference below the noise, which is no result.
    is_noise = crossed.any(axis=0) & ~(crossed & counts).any(axis=0)
    failing = a.is_state(RunState.PASS)[rows_a] & ~b.is_state(RunState.PASS)[rows_b] & ~is_noise
    what = np.select([failing, worse.any(axis=0) | (a.measured[rows_a] & ~b.measured[rows_b])], KINDS[:2], "")
    labels, shown = [b.label(name) for name in metrics], worse | crossed
    found = [
        (str(what[k]), int(rows_a[k]), b.states[rows_b[k]].label, "; ".join(compress(labels, shown[:, k])))
        for k in np.flatnonzero(what != "")
    ]
    found += [("missing", int(row), "", "") for row in np.setdiff1d(np.arange(len(a)), rows_a)]
    names, varied = a.words("name"), [key for key in dict.fromkeys((*a.varied, *b.varied)) if key in a]
    rows = []
    for kind, row, state, why in sorted(found, key=lambda item: (KINDS.index(item[0]), item[1])):
        parameters = ", ".join(f"{key} {format_value(a.table.column(key)[row].as_py())}" for key in varied)
        rows.append((kind, names[row], a.states[row].label, state, why, parameters))
    columns = ("change", "run", "in A", "in B", "metrics", "parameters")
    changes = Table("regressions", columns, rows, tuple(_notes(a, b)))
    return SweepComparison(f"{b.source} (B) against {a.source} (A)", len(rows_a), changes)


def join(a: SweepTable, b: SweepTable) -> NDArray[np.intp]:
    """Rows of the runs that both sweeps have, in each, shape (2, N): either varies nothing else.

    Raises :class:`InputError` if no run is in both.
    """
    varied = list(dict.fromkeys(key for side in (a, b) for key in side.metadata["varied"]))
    if any(len(side.table.column("gait").unique()) > 1 for side in (a, b)):
        varied.append("gait")
    pairs = list[tuple[int, int]]()
    if all(key in side for key in varied for side in (a, b)):
        places_a, places_b = (_places(side.table.select(varied).to_pylist()) for side in (a, b))
        pairs = [(row, places_b[text]) for text, row in places_a.items() if text in places_b]
    if not pairs:
        ranges = " and ".join(", ".join(sorted(side.metadata["varied"])) for side in (a, b))
        raise InputError(
            f"no run of {a.source} is in {b.source} (they have {len(a)} and {len(b)} runs, and vary "
            f"{ranges}); give two sweeps of the same definition."
        )
    return np.array(pairs, dtype=np.intp).T


def _places(rows: Iterable[Mapping[str, Any]]) -> dict[tuple[str, int], int]:
    """Places of rows by text and number, as a sweep of whole numbers may draw a row again."""
    seen = defaultdict[str, list[int]](list)
    for place, row in enumerate(rows):
        seen[str(row)].append(place)
    return {(text, number): place for text, found in seen.items() for number, place in enumerate(found)}


def _notes(a: SweepTable, b: SweepTable) -> Iterator[str]:
    """Warnings about the comparison of two sweeps."""
    for key in a.parameters:
        if key in b and key not in (*a.varied, *b.varied):
            one, two = (side.table.column(key)[0].as_py() for side in (a, b))
            if one != two:
                yield f"{key} is {one} in all runs of A, {two} in those of B"
    for name, side in (("A", a), ("B", b)):
        if side.planned > len(side):
            yield f"{name} is not finished: {len(side):,} of {side.planned:,} runs"
    limits = [(side.metadata["profile"], side.metadata["tolerances"]) for side in (a, b)]
    if limits[0] != limits[1]:
        yield f"the limits differ (profiles {limits[0][0]} and {limits[1][0]}); those of B count"
    if gone := [name for name in a.judged if METRIC + name not in b]:
        yield f"only A has {'; '.join(map(a.label, gone))}"
    one, two = (side.metadata["environment"] for side in (a, b))
    if differ := [key for key in ("processor", "platform", "versions") if one.get(key) != two.get(key)]:
        yield f"{', '.join(differ)} of the machines differ; values may differ for that alone"
