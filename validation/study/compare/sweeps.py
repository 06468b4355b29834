"""Two sweeps compared run by run; the first is the reference.

Two runs of one revision on one machine have the same bits, so only a difference beyond rounding counts, or
beyond the numerical uncertainty of a convergence study.
"""

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import compress
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

Rows = NDArray[np.intp]
Mask = NDArray[np.bool_]

TOLERANCE = 0.1
"""Share of its limit by which a metric may grow before that is a regression [1]."""
KINDS = ("newly failing", "worse", "newly passing", "better")
"""Changes of a run; the first two are regressions."""
_SHOWN = 100
"""Rows of the table of runs."""


@dataclass(frozen=True)
class SweepComparison(Brief, Tabled):
    """Two sweeps compared: the N runs that both have, by M metrics.

    Attributes:
        a, b: the sweeps; the first is the reference.
        rows_a, rows_b: rows of the runs, shape (N,) each.
        metrics: names, in the profile's order.
        values_a, values_b: of the metrics in SI units, shape (M, N), NaN unless both runs completed.
        worse: whether a metric grew by more than noise and tolerance, or lost its value, shape (M, N).
        better: whether it fell by as much, shape (M, N).
        crossed: whether it is on another side of its limit, shape (M, N).
        kinds: change of each run, one of :data:`KINDS`; empty if there is none.
        notes: conditions of the comparison.
        require_all: whether missing runs are regressions.
    """

    a: SweepTable
    b: SweepTable
    rows_a: Rows
    rows_b: Rows
    metrics: tuple[str, ...]
    values_a: Array
    values_b: Array
    worse: Mask
    better: Mask
    crossed: Mask
    kinds: tuple[str, ...]
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
        """Number of runs that changed in every way."""
        return {kind: self.kinds.count(kind) for kind in KINDS}

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

    def changes(self) -> list[dict[str, Any]]:
        """Runs that changed, regressions first: kind, name, state in both, metrics and varied parameters."""
        names = self.a.words("name")
        varied = [key for key in dict.fromkeys((*self.a.varied, *self.b.varied)) if key in self.a]
        found = []
        for run, (kind, row_a, row_b) in enumerate(zip(self.kinds, self.rows_a, self.rows_b, strict=True)):
            named = self.better[:, run] if kind == "better" else self.worse[:, run] | self.crossed[:, run]
            if kind:
                found.append(
                    {
                        "kind": kind,
                        "run": names[row_a],
                        "before": self.a.state(row_a),
                        "after": self.b.state(row_b),
                        "metrics": list(compress(self.metrics, named)),
                        "parameters": {key: self.a.table.column(key)[int(row_a)].as_py() for key in varied},
                    }
                )
        return sorted(found, key=lambda change: (KINDS.index(change["kind"]), change["run"]))

    def medians(self, metric: int, scale: Array | float = 1.0) -> tuple[float, float]:
        """Medians of a metric in both sweeps, over the runs with both values; NaN without one.

        Args:
            metric: its number.
            scale: factor on the values, a number or shape (N,).
        """
        a, b = scale * self.values_a[metric], scale * self.values_b[metric]
        both = np.isfinite(a) & np.isfinite(b)
        return (float(np.median(a[both])), float(np.median(b[both]))) if both.any() else (math.nan, math.nan)

    def tables(self) -> list[Table]:
        """Outcomes, metrics, and runs that changed."""
        counted = Counter(zip(self.a.states[self.rows_a], self.b.states[self.rows_b], strict=True))
        outcomes = [(STATES[a].label, STATES[b].label, f"{n:,}") for (a, b), n in sorted(counted.items())]
        metrics = []
        for number, name in enumerate(self.metrics):
            scale, unit = display_unit(self.a.unit(METRIC + name), self.a.weight[self.rows_a])
            worse, better = f"{self.worse[number].sum():,}", f"{self.better[number].sum():,}"
            medians = (format_number(value) for value in self.medians(number, scale))
            metrics.append((self.b.label(name), worse, better, *medians, short_unit(unit)))
        changes = self.changes()
        runs = [
            (
                change["kind"],
                change["run"],
                change["before"].label,
                change["after"].label,
                "; ".join(map(self.b.label, change["metrics"])),
                ", ".join(f"{key} {format_value(value)}" for key, value in change["parameters"].items()),
            )
            for change in changes[:_SHOWN]
        ]
        more = [f"and {len(changes) - _SHOWN:,} more"] if len(changes) > _SHOWN else []
        heads = ("change", "run", "in A", "in B", "metrics", "parameters")
        found = [
            Table("outcomes", ("in A", "in B", ">runs"), outcomes, self.notes),
            Table(
                "metrics of the runs that completed in both",
                ("metric", ">worse", ">better", ">median A", ">median B", "unit"),
                metrics,
                ["Worse, better: runs of which the metric grew or fell by more than noise and tolerance."],
            ),
            Table("runs that changed", heads, runs, more),
        ]
        return [table for table in found if table.rows]

    def as_dict(self) -> dict[str, Any]:
        """Everything, as plain data in SI units."""
        sides = {
            name: {"source": side.source, "name": side.name, "runs": len(side), "profile": side.profile}
            | {"environment": side.metadata["environment"]}
            for name, side in (("a", self.a), ("b", self.b))
        }
        metrics = {
            name: {
                "unit": self.a.unit(METRIC + name),
                "worse": self.worse[number].sum(),
                "better": self.better[number].sum(),
                "medians": self.medians(number),
            }
            for number, name in enumerate(self.metrics)
        }
        table = {
            "sentence": self.sentence,
            "regressions": self.regressions,
            **sides,
            "matched": len(self.rows_a),
            "missing": self.missing,
            "notes": self.notes,
            "counts": self.counts,
            "changes": self.changes(),
            "metrics": metrics,
        }
        return dict(json_ready(table))


def compare_sweeps(
    a: Path | str | SweepTable,
    b: Path | str | SweepTable,
    *,
    tolerance: float = TOLERANCE,
    uncertainty: Path | Uncertainty | None = None,
    require_all: bool = False,
) -> SweepComparison:
    """Compare two sweeps, the first of which is the reference.

    Args:
        a: folder or table of the reference.
        b: folder or table of the sweep that is compared with it.
        tolerance: share of its limit by which a metric may grow [1].
        uncertainty: ``convergence.json``; its numerical uncertainty counts where it exceeds rounding.
        require_all: whether a run that the second sweep lacks is a regression.

    Raises:
        InputError: no two sweeps, no common run, or a bad tolerance.
    """
    if not 0.0 <= tolerance < math.inf:
        raise InputError(
            f"--tolerance {tolerance:g}: give the share of its limit by which a metric may grow, such as 0.1."
        )
    a, b = (side if isinstance(side, SweepTable) else read_sweep(side) for side in (a, b))
    known = load_uncertainty(uncertainty) if isinstance(uncertainty, Path) else uncertainty
    bounds = {} if known is None else known.values
    rows_a, rows_b, notes = join(a, b)
    names = [name for name in a.metrics if METRIC + name in b and (name in a.limits or name in b.limits)]
    shape = len(names), len(rows_a)
    values_a, values_b, noise, limit = np.full((4, *shape), np.nan)
    crossed = np.zeros(shape, dtype=bool)
    completed = a.measured[rows_a] & b.measured[rows_b]
    for number, name in enumerate(names):
        before, after = a.numbers(METRIC + name)[rows_a], b.numbers(METRIC + name)[rows_b]
        values_a[number] = np.where(completed, before, np.nan)
        values_b[number] = np.where(completed, after, np.nan)
        size = np.fmax(np.abs(before), np.abs(after))
        noise[number] = np.fmax(rounding(size, a.unit(METRIC + name)), bounds.get(name, 0.0))
        limit_b = b.limit_values(name)[rows_b]
        limit[number] = np.where(np.isnan(limit_b), a.limit_values(name)[rows_a], limit_b)
        crossed[number] = (a.used(name)[rows_a] > 1.0) != (b.used(name)[rows_b] > 1.0)
    is_lost = completed & np.isfinite(values_a) & ~np.isfinite(values_b)
    growth = np.nan_to_num(values_b - values_a, posinf=0.0, neginf=0.0)
    allowed = np.fmax(noise, tolerance * limit)
    worse, better = is_lost | (growth > allowed), -growth > allowed
    # A verdict may change by a difference below the noise, which is no result.
    is_noise = crossed.any(axis=0) & ~(crossed & (np.abs(growth) > noise)).any(axis=0)
    passed, passes = a.is_state(State.PASS)[rows_a], b.is_state(State.PASS)[rows_b]
    stopped = a.measured[rows_a] & ~b.measured[rows_b]
    conditions = {
        "newly failing": passed & ~passes & ~is_noise,
        "newly passing": passes & ~passed & ~is_noise,
        "worse": worse.any(axis=0) | stopped,
        "better": better.any(axis=0),
    }
    notes += _notes(a, b)
    if known is not None:
        notes.append(f"noise: numerical uncertainty of {known.gait}, taken for all gaits of the sweeps")
    return SweepComparison(
        a=a,
        b=b,
        rows_a=rows_a,
        rows_b=rows_b,
        metrics=tuple(names),
        values_a=values_a,
        values_b=values_b,
        worse=worse,
        better=better,
        crossed=crossed,
        kinds=tuple(np.select(list(conditions.values()), list(conditions), "").tolist()),
        notes=tuple(notes),
        require_all=require_all,
    )


def join(a: SweepTable, b: SweepTable) -> tuple[Rows, Rows, list[str]]:
    """Rows of the runs that both sweeps have, in the order of the first, and notes on how they differ.

    Runs with the same key are the same: it hashes the parameters that differ from the defaults. Where a
    parameter was changed for all runs no key is the same; runs are then matched by the varied values.

    Raises:
        InputError: no run is in both.
    """
    varied = list(dict.fromkeys((*a.varied, *b.varied)))
    notes = []
    _, rows_a, rows_b = np.intersect1d(a.words("key"), b.words("key"), return_indices=True)
    if not len(rows_a) and varied and all(key in sweep for key in varied for sweep in (a, b)):
        values_a, values_b = ([str(row) for row in side.table.select(varied).to_pylist()] for side in (a, b))
        _, rows_a, rows_b = np.intersect1d(values_a, values_b, return_indices=True)
        for key in (key for key in a.parameters if len(rows_a) and key in b and key not in varied):
            one, two = (sweep.table.column(key)[0].as_py() for sweep in (a, b))
            if one != two:
                notes.append(f"{key} is {one} in all runs of A, {two} in those of B")
    if not len(rows_a):
        ranges = " and ".join(", ".join(sorted(sweep.varied)) or "nothing" for sweep in (a, b))
        raise InputError(
            f"no run of {a.source} is in {b.source} (they have {len(a)} and {len(b)} runs, and vary "
            f"{ranges}); give two sweeps of the same definition."
        )
    order = np.argsort(rows_a)
    return rows_a[order], rows_b[order], notes


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
