"""Two sweeps compared run by run; the first is the reference.

Two runs of one revision on one machine have the same bits, so only a difference beyond rounding counts, or
beyond the numerical uncertainty of a convergence study.
"""

import math
from collections import Counter, defaultdict, deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ampm.brief import Brief
from ampm.exceptions import InputError
from ampm.geometry import Array
from validation.judge.metrics import display_unit
from validation.judge.uncertainty import Uncertainty, load_uncertainty, rounding
from validation.show.text import format_value
from validation.store.json import json_ready
from validation.study.sweep.table import METRIC, STATES, State, SweepTable, read_sweep
from validation.table import Table, Tabled, format_number, short_unit

Rows = NDArray[np.int64]
Mask = NDArray[np.bool_]

TOLERANCE = 0.1
"""Share of its limit by which a metric may grow before that is a regression [1]."""
KINDS = ("newly failing", "worse", "newly passing", "better")
"""Changes of a run; the first two are regressions."""
_SHOWN = 100
"""Rows of the table of runs."""


@dataclass(frozen=True)
class MetricChange:
    """One metric of the N runs that both sweeps have; every array of shape (N,).

    Attributes:
        name: of the metric.
        unit: SI unit.
        a, b: values in the first and in the second sweep, NaN unless both runs completed.
        worse: whether it grew by more than noise and tolerance, or has no value any more.
        better: whether it fell by as much.
        crossed: whether it is on another side of its limit.
        is_noise: whether the difference is noise.
    """

    name: str
    unit: str
    a: Array
    b: Array
    worse: Mask
    better: Mask
    crossed: Mask
    is_noise: Mask

    def as_dict(self, names: Sequence[str], scale: Array | float = 1.0) -> dict[str, Any]:
        """Counts, medians over the runs with both values, and the run that got worse most.

        Args:
            names: of the runs.
            scale: factor on all values, a number or shape (N,).
        """
        a, b = scale * self.a, scale * self.b
        both = np.isfinite(a) & np.isfinite(b)
        worst = int(np.argmax(np.where(self.worse, np.nan_to_num(b - a, nan=np.inf), -np.inf)))
        return {
            "unit": self.unit,
            "worse": int(self.worse.sum()),
            "better": int(self.better.sum()),
            "median_a": float(np.median(a[both])) if both.any() else math.nan,
            "median_b": float(np.median(b[both])) if both.any() else math.nan,
            "worst": {"run": names[worst], "a": a[worst], "b": b[worst]} if self.worse.any() else None,
        }


@dataclass(frozen=True)
class Change:
    """A run that changed.

    Attributes:
        kind: one of :data:`KINDS`.
        run: name in the first sweep.
        before, after: state in the first and in the second sweep.
        metrics: that are worse or on another side of their limit; of a better run those that are better.
        parameters: values of what varies.
    """

    kind: str
    run: str
    before: State
    after: State
    metrics: tuple[str, ...]
    parameters: Mapping[str, Any]


@dataclass(frozen=True)
class SweepComparison(Brief, Tabled):
    """Two sweeps compared.

    Attributes:
        a, b: the sweeps; the first is the reference.
        rows_a, rows_b: rows of the runs that both have, shape (N,) each.
        changes: runs that changed, in the order of :data:`KINDS`.
        metrics: in the profile's order.
        notes: conditions of the comparison.
        require_all: whether missing runs are regressions.
    """

    a: SweepTable
    b: SweepTable
    rows_a: Rows
    rows_b: Rows
    changes: tuple[Change, ...]
    metrics: tuple[MetricChange, ...]
    notes: tuple[str, ...]
    require_all: bool = False

    @property
    def title(self) -> str:
        """Both sweeps."""
        return f"{self.b.source} against {self.a.source}"

    @property
    def missing(self) -> list[str]:
        """Names of runs that only the first sweep has."""
        return [str(name) for name in np.delete(self.a.words("name"), self.rows_a)]

    @property
    def counts(self) -> dict[str, int]:
        """Number of changes of every kind."""
        found = Counter(change.kind for change in self.changes)
        return {kind: found[kind] for kind in KINDS}

    @property
    def regressions(self) -> list[str]:
        """Reasons why the comparison fails; empty if it passes."""
        found = [f"{self.counts[kind]:,} {kind}" for kind in KINDS[:2] if self.counts[kind]]
        return [*found, f"{len(self.missing):,} missing"] if self.require_all and self.missing else found

    @property
    def sentence(self) -> str:
        """The result in one sentence."""
        runs = f"{len(self.rows_a):,} matched run{'' if len(self.rows_a) == 1 else 's'}"
        gains = [f"{self.counts[kind]:,} {kind}" for kind in KINDS[2:] if self.counts[kind]]
        found = ", ".join([*self.regressions, *gains])
        lacking = f"; {len(self.missing):,} of the {len(self.a):,} runs of A are missing in B"
        return (
            f"{'Regression' if self.regressions else 'No regression'} in {runs}{': ' if found else ''}{found}"
            f"{lacking if self.missing else ''}."
        )

    def tables(self) -> list[Table]:
        """Outcomes, metrics, and runs that changed."""
        counted = Counter(zip(self.a.states[self.rows_a], self.b.states[self.rows_b], strict=True))
        outcomes = [(STATES[a].label, STATES[b].label, f"{n:,}") for (a, b), n in sorted(counted.items())]
        columns = ("metric", ">worse", ">better", ">median A", ">median B", "unit", "worst")
        note = "Worse, better: runs of which the metric grew or fell by more than noise and tolerance."
        changes = [
            (
                change.kind,
                change.run,
                change.before.label,
                change.after.label,
                "; ".join(map(self.b.label, change.metrics)),
                ", ".join(f"{key} {format_value(value)}" for key, value in change.parameters.items()),
            )
            for change in self.changes[:_SHOWN]
        ]
        more = len(self.changes) - _SHOWN
        heads = ("change", "run", "in A", "in B", "metrics", "parameters")
        found = [
            Table("outcomes", ("in A", "in B", ">runs"), outcomes, self.notes),
            Table(
                "metrics of the runs that completed in both",
                columns,
                [*map(self._cells, self.metrics)],
                [note],
            ),
            Table("runs that changed", heads, changes, [f"and {more:,} more"] if more > 0 else []),
        ]
        return [table for table in found if table.rows]

    def _cells(self, item: MetricChange) -> list[str]:
        """Cells of a metric, in millimetres and per cent of the body weight of the runs of A."""
        scale, unit = display_unit(item.unit, self.a.weight[self.rows_a])
        found = item.as_dict(self._names, scale)
        worst = ""
        if found["worst"]:
            run, a, b = found["worst"].values()
            worst = f"{run}: {format_number(a, 3)} → {format_number(b, 3)}"
        return [
            self.b.label(item.name),
            f"{found['worse']:,}",
            f"{found['better']:,}",
            format_number(found["median_a"]),
            format_number(found["median_b"]),
            short_unit(unit),
            worst,
        ]

    @property
    def _names(self) -> list[str]:
        names = self.a.words("name")
        return [names[row] for row in self.rows_a]

    def as_dict(self) -> dict[str, Any]:
        """Everything, as plain data in SI units."""
        sides = {
            name: {"source": side.source, "name": side.name, "runs": len(side), "profile": side.profile}
            | {"environment": side.metadata["environment"]}
            for name, side in (("a", self.a), ("b", self.b))
        }
        table = {
            "sentence": self.sentence,
            "regressions": self.regressions,
            **sides,
            "matched": len(self.rows_a),
            "missing": self.missing,
            "notes": self.notes,
            "counts": self.counts,
            "changes": [asdict(change) for change in self.changes],
            "metrics": {item.name: item.as_dict(self._names) for item in self.metrics},
        }
        return dict(json_ready(table))


def compare_sweeps(
    a: Path | str | SweepTable,
    b: Path | str | SweepTable,
    *,
    tolerances: Sequence[str] = (),
    uncertainty: Path | Uncertainty | None = None,
    require_all: bool = False,
) -> SweepComparison:
    """Compare two sweeps, the first of which is the reference.

    Args:
        a: folder or table of the reference.
        b: folder or table of the sweep that is compared with it.
        tolerances: shares of the limits by which metrics may grow: ``"0.1"``, or ``"zmp_x_rmse=0.2"``.
        uncertainty: ``convergence.json``; its numerical uncertainty counts where it exceeds rounding.
        require_all: whether a run that the second sweep lacks is a regression.

    Raises:
        InputError: no two sweeps, no common run, or a bad tolerance.
    """
    a, b = (side if isinstance(side, SweepTable) else read_sweep(side) for side in (a, b))
    known = load_uncertainty(uncertainty) if isinstance(uncertainty, Path) else uncertainty
    shares = _read_tolerances(tolerances, {*a.metrics, *b.metrics})
    rows_a, rows_b, notes = join(a, b)
    metrics = []
    for name in a.metrics:
        if METRIC + name in b and (name in a.limits or name in b.limits):
            bound = 0.0 if known is None else known.values.get(name, 0.0)
            share = shares.get(name, shares[""])
            metrics.append(_compare_metric(name, (a, rows_a), (b, rows_b), share, bound))
    notes += _notes(a, b)
    if known is not None:
        notes.append(f"noise: numerical uncertainty of {known.gait}, taken for all gaits of the sweeps")
    found = _changes(a, b, rows_a, rows_b, metrics)
    changes = sorted(found, key=lambda change: (KINDS.index(change.kind), change.run))
    return SweepComparison(a, b, rows_a, rows_b, tuple(changes), tuple(metrics), tuple(notes), require_all)


def _read_tolerances(texts: Sequence[str], metrics: set[str]) -> dict[str, float]:
    """Shares of the limits by metric; that of the empty name holds for all others."""
    found = {"": TOLERANCE}
    for text in texts:
        name, _, number = text.rpartition("=")
        try:
            value = float(number)
        except ValueError:
            value = math.nan
        if name.strip() not in {"", *metrics} or not 0.0 <= value < math.inf:
            raise InputError(
                f"--tolerance {text}: give the share of its limit by which a metric may grow, such as 0.1, "
                "or METRIC=0.1 with a metric of the sweeps, such as zmp_x_rmse=0.1."
            )
        found[name.strip()] = value
    return found


def join(a: SweepTable, b: SweepTable) -> tuple[Rows, Rows, list[str]]:
    """Rows of the runs that both sweeps have, and notes on how they differ.

    Runs with the same key are the same: it hashes the parameters that differ from the defaults. Where a
    parameter was changed for all runs no key is the same; runs are then matched by the varied values.

    Raises:
        InputError: no run is in both.
    """
    varied = list(dict.fromkeys((*a.varied, *b.varied)))
    notes = []
    pairs = _pairs(a.words("key"), b.words("key"))
    if not pairs and varied and all(key in sweep for key in varied for sweep in (a, b)):
        pairs = _pairs(*(sweep.table.select(varied).to_pylist() for sweep in (a, b)))
        for key in (key for key in a.parameters if pairs and key in b and key not in varied):
            one, two = (sweep.table.column(key)[0].as_py() for sweep in (a, b))
            if one != two:
                notes.append(f"{key} is {one} in all runs of A, {two} in those of B")
    if not pairs:
        ranges = " and ".join(", ".join(sorted(sweep.varied)) or "nothing" for sweep in (a, b))
        raise InputError(
            f"no run of {a.source} is in {b.source} (they have {len(a)} and {len(b)} runs, and vary "
            f"{ranges}); give two sweeps of the same definition."
        )
    rows = np.array(pairs, dtype=np.int64)
    return rows[:, 0], rows[:, 1], notes


def _pairs(a: Sequence[Any], b: Sequence[Any]) -> list[tuple[int, int]]:
    """Rows of equal identity; runs that were repeated are paired in their order."""
    places: defaultdict[str, deque[int]] = defaultdict(deque)
    for row, identity in enumerate(b):
        places[str(identity)].append(row)
    return [(row, places[str(i)].popleft()) for row, i in enumerate(a) if places[str(i)]]


def _notes(a: SweepTable, b: SweepTable) -> Iterator[str]:
    """Warnings about the comparison of two sweeps."""
    for name, side in (("A", a), ("B", b)):
        if side.planned > len(side):
            yield f"{name} is not finished: {len(side):,} of {side.planned:,} runs"
    if a.profile != b.profile or a.metadata["tolerances"] != b.metadata["tolerances"]:
        yield f"the limits differ (profiles {a.profile or '?'} and {b.profile or '?'}); those of B count"
    if gone := [name for name in a.judged if METRIC + name not in b]:
        yield f"only A has {'; '.join(map(a.label, gone))}"
    one, two = (side.metadata["environment"] for side in (a, b))
    if differ := [key for key in ("processor", "platform", "versions") if one.get(key) != two.get(key)]:
        yield f"{', '.join(differ)} of the machines differ; values may differ for that alone"


def _compare_metric(
    name: str, a: tuple[SweepTable, Rows], b: tuple[SweepTable, Rows], share: float, bound: float
) -> MetricChange:
    """Compare a metric.

    Args:
        name: of the metric.
        a: first sweep and the rows to compare.
        b: second sweep, likewise.
        share: of its limit by which it may grow.
        bound: numerical uncertainty.
    """
    (first, rows_a), (second, rows_b) = a, b
    unit = first.unit(METRIC + name)
    completed = first.measured[rows_a] & second.measured[rows_b]
    before, after = (
        np.where(completed, sweep.numbers(METRIC + name)[rows], np.nan) for sweep, rows in (a, b)
    )
    limit = second.limit_values(name)[rows_b]
    limit = np.where(np.isnan(limit), first.limit_values(name)[rows_a], limit)
    noise = np.maximum(rounding(np.fmax(np.abs(before), np.abs(after)), unit), bound)
    lost = completed & np.isfinite(before) & ~np.isfinite(after)
    growth = np.where(lost, np.inf, np.where(np.isfinite(before) & np.isfinite(after), after - before, 0.0))
    allowed = np.fmax(noise, share * limit)
    return MetricChange(
        name=name,
        unit=unit,
        a=before,
        b=after,
        worse=lost | (growth > allowed),
        better=-growth > allowed,
        crossed=(first.used(name)[rows_a] > 1.0) != (second.used(name)[rows_b] > 1.0),
        is_noise=np.abs(growth) <= noise,
    )


def _changes(
    a: SweepTable, b: SweepTable, rows_a: Rows, rows_b: Rows, metrics: Sequence[MetricChange]
) -> Iterator[Change]:
    """Runs that changed."""
    names = a.words("name")
    varied = [key for key in dict.fromkeys((*a.varied, *b.varied)) if key in a]
    lost = a.measured[rows_a] & ~b.measured[rows_b]
    for i, (left, right) in enumerate(zip(rows_a.tolist(), rows_b.tolist(), strict=True)):
        before, after = a.state(left), b.state(right)
        worse, better = (
            [item.name for item in metrics if getattr(item, kind)[i]] for kind in ("worse", "better")
        )
        crossed = [item for item in metrics if item.crossed[i]]
        # A verdict may change by a difference below the noise, which is no result.
        is_noise = bool(crossed) and all(item.is_noise[i] for item in crossed)
        if before is not after and State.PASS in (before, after) and not is_noise:
            kind = "newly failing" if before is State.PASS else "newly passing"
        elif worse or lost[i]:
            kind = "worse"
        elif better:
            kind = "better"
        else:
            continue
        shown = better if kind == "better" else dict.fromkeys([*worse, *(item.name for item in crossed)])
        values = {key: a.table.column(key)[left].as_py() for key in varied}
        yield Change(kind, names[left], before, after, tuple(shown), values)
