"""Two sweeps compared run by run; the first is the reference.

Two runs of one revision on one machine have the same bits, so only a difference beyond rounding counts, or
beyond the numerical uncertainty of a convergence study.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import compress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ampm.exceptions import InputError
from validation.judge.uncertainty import Uncertainty, load_uncertainty, rounding
from validation.show.text import format_value
from validation.store.json import json_ready
from validation.study.sweep.table import METRIC, RunState, SweepTable, read_sweep
from validation.table import Table, Tabled

Rows = NDArray[np.intp]

TOLERANCE = 0.1
"""Share of its limit by which a metric may grow before that is a regression [1]."""
KINDS = ("newly failing", "worse", "missing")
"""Regressions of a run. What got better is found by the two sweeps in the other order."""
_SHOWN = 100
"""Rows of the table of runs."""


class RunChange(NamedTuple):
    """A run that got worse."""

    kind: str  # one of `KINDS`
    run: str  # name in the first sweep
    before: str  # state in the first sweep
    after: str  # state in the second sweep
    metrics: tuple[str, ...]  # labels of those that are worse or on another side of their limit
    parameters: Mapping[str, Any]  # values of what varies


@dataclass(frozen=True)
class SweepComparison(Tabled):
    """Two sweeps compared."""

    a: str  # what a user calls the first, the reference
    b: str  # what a user calls the second
    matched: int  # number of runs that both have
    missing: tuple[str, ...]  # names of runs that only the first has
    changes: tuple[RunChange, ...]  # runs that got worse, in the order of `KINDS`
    notes: tuple[str, ...]  # conditions of the comparison

    @property
    def title(self) -> str:
        """Both sweeps."""
        return f"{self.b} against {self.a}"

    @property
    def counts(self) -> dict[str, int]:
        """Number of runs by kind, missing ones among them; empty if the comparison passes."""
        found = Counter(change.kind for change in self.changes)
        found["missing"] = len(self.missing)
        return {kind: found[kind] for kind in KINDS if found[kind]}

    @property
    def sentence(self) -> str:
        """The result in one sentence."""
        found = ", ".join(f"{number:,} {kind}" for kind, number in self.counts.items())
        runs = f"{self.matched:,} matched run{'' if self.matched == 1 else 's'}"
        return f"{'Regression' if self.counts else 'No regression'} in {runs}{found and ': '}{found}."

    def tables(self) -> list[Table]:
        """The runs that got worse."""
        rows = [
            (
                *change[:4],
                "; ".join(change.metrics),
                ", ".join(f"{key} {format_value(value)}" for key, value in change.parameters.items()),
            )
            for change in self.changes[:_SHOWN]
        ]
        more = len(self.changes) - _SHOWN
        notes = [*([f"and {more:,} more"] if more > 0 else []), *self.notes]
        columns = ("change", "run", "in A", "in B", "metrics", "parameters")
        return [Table("regressions", columns, rows, notes)]

    def as_dict(self) -> dict[str, Any]:
        """Everything, as plain data."""
        said = {name: getattr(self, name) for name in ("sentence", "counts")}
        changes = [change._asdict() for change in self.changes]
        return dict(json_ready({**said, **vars(self), "changes": changes}))


def compare_sweeps(
    a: Path | str | SweepTable,
    b: Path | str | SweepTable,
    *,
    uncertainty: Path | Uncertainty | None = None,
) -> SweepComparison:
    """Compare two sweeps, the first of which is the reference.

    Args:
        a: folder or table of the reference.
        b: the same of the sweep that is compared with it.
        uncertainty: ``convergence.json``; its numerical uncertainty counts where it exceeds rounding.

    Raises:
        InputError: no two sweeps, or no common run.
    """
    a, b = (side if isinstance(side, SweepTable) else read_sweep(side) for side in (a, b))
    known = load_uncertainty(uncertainty) if isinstance(uncertainty, Path) else uncertainty
    rows_a, rows_b = join(a, b)
    judged = dict.fromkeys((*a.judged, *b.judged))
    metrics = [name for name in judged if METRIC + name in a and METRIC + name in b]
    worse, crossed, counts = np.zeros((3, len(metrics), len(rows_a)), dtype=bool)
    completed = a.measured[rows_a] & b.measured[rows_b]
    for number, name in enumerate(metrics):
        before, after = a.numbers(METRIC + name)[rows_a], b.numbers(METRIC + name)[rows_b]
        both = completed & np.isfinite(before) & np.isfinite(after)
        growth = np.where(both, after - before, 0.0)
        limit = b.limit_values(name)[rows_b] if name in b.limits else a.limit_values(name)[rows_a]
        bound = 0.0 if known is None else known.values.get(name, 0.0)
        noise = np.fmax(rounding(np.fmax(before, after), a.unit(METRIC + name)), bound)
        allowed = np.fmax(noise, TOLERANCE * limit)
        is_lost = completed & np.isfinite(before) & ~np.isfinite(after)
        worse[number] = is_lost | (growth > allowed)
        crossed[number] = (a.used(name)[rows_a] > 1.0) != (b.used(name)[rows_b] > 1.0)
        counts[number] = is_lost | (np.abs(growth) > noise)
    passed, passes = a.is_state(RunState.PASS)[rows_a], b.is_state(RunState.PASS)[rows_b]
    # A verdict may change by a difference below the noise, which is no result.
    is_noise = crossed.any(axis=0) & ~(crossed & counts).any(axis=0)
    conditions = {
        "newly failing": passed & ~passes & ~is_noise,
        "worse": worse.any(axis=0) | (a.measured[rows_a] & ~b.measured[rows_b]),
    }
    kinds = np.select(list(conditions.values()), list(conditions), "")
    names, labels = a.words("name"), [b.label(name) for name in metrics]
    varied = [key for key in dict.fromkeys((*a.varied, *b.varied)) if key in a]
    changes = [
        RunChange(
            kind=str(kinds[run]),
            run=names[rows_a[run]],
            before=a.states[rows_a[run]].label,
            after=b.states[rows_b[run]].label,
            metrics=tuple(compress(labels, (worse | crossed)[:, run])),
            parameters={key: a.table.column(key)[int(rows_a[run])].as_py() for key in varied},
        )
        for run in np.flatnonzero(kinds != "")
    ]
    notes = list(_notes(a, b))
    if known is not None:
        notes.append(f"noise: numerical uncertainty of {known.gait}, taken for all gaits of the sweeps")
    return SweepComparison(
        a=a.source,
        b=b.source,
        matched=len(rows_a),
        missing=tuple(np.delete(names, rows_a).tolist()),
        changes=tuple(sorted(changes, key=lambda change: (KINDS.index(change.kind), change.run))),
        notes=tuple(notes),
    )


def join(a: SweepTable, b: SweepTable) -> tuple[Rows, Rows]:
    """Rows of the runs that both sweeps have, in the order of the first: either varies nothing else.

    Raises:
        InputError: no run is in both.
    """
    varied = list(dict.fromkeys(key for side in (a, b) for key in side.metadata["varied"]))
    if any(len(side.table.column("gait").unique()) > 1 for side in (a, b)):
        varied.append("gait")
    rows_a = rows_b = np.array([], dtype=np.intp)
    if all(key in side for key in varied for side in (a, b)):
        values_a, values_b = ([str(row) for row in side.table.select(varied).to_pylist()] for side in (a, b))
        _, rows_a, rows_b = np.intersect1d(values_a, values_b, return_indices=True)
    if not len(rows_a):
        ranges = " and ".join(", ".join(sorted(side.metadata["varied"])) for side in (a, b))
        raise InputError(
            f"no run of {a.source} is in {b.source} (they have {len(a)} and {len(b)} runs, and vary "
            f"{ranges}); give two sweeps of the same definition."
        )
    order = np.argsort(rows_a)
    return rows_a[order], rows_b[order]


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
