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
from validation.judge.metrics import display_unit, metric_label
from validation.judge.uncertainty import Uncertainty, load_uncertainty
from validation.show.text import format_number, format_value
from validation.store.json import json_ready
from validation.study.compare.metrics import rounding
from validation.study.sweep.table import METRIC, STATES, State, SweepTable, read_sweep
from validation.table import Table

Rows = NDArray[np.int64]
Mask = NDArray[np.bool_]

TOLERANCE = 0.1
"""Share of its limit by which a metric may grow before that is a regression [1]."""
KINDS: Mapping[str, str] = {
    "newly_failing": "newly failing",
    "worse_outcome": "with a worse outcome",
    "worse_metrics": "with a metric worse beyond tolerance",
    "newly_passing": "newly passing",
    "better_outcome": "with a better outcome",
    "other_change": "with another outcome or verdict, and no difference beyond noise",
}
"""Possible changes of a run; the first three are regressions."""
_REGRESSIONS = tuple(KINDS)[:3]
_SEVERITY = {State.PASS: 0, State.OUT_OF_TOLERANCE: 1, State.NOT_MEASURED: 1, State.REFUSED: 2}
_SEVERITY |= {State.FELL: 3, State.DIVERGED: 3, State.INFEASIBLE: 3}
_SEVERITY |= {State.CRASHED: 4, State.TIMED_OUT: 4}
_SHOWN = 100
"""Rows of a table of runs."""


@dataclass(frozen=True)
class MetricChange:
    """One metric of the N runs that both sweeps have; every array of shape (N,).

    Attributes:
        name: of the metric.
        unit: SI unit.
        before, after: values in the first and in the second sweep.
        both: whether the run completed in both, with a finite value.
        growth: second minus first; infinite where only the second sweep lacks a value, else zero without one.
        noise: largest difference that counts as none; infinite if the study has no bound.
        regressed: whether it grew by more than noise and tolerance, or lost its value.
        over_a, over_b: whether it is over its limit.
    """

    name: str
    unit: str
    before: Array
    after: Array
    both: Mask
    growth: Array
    noise: Array
    regressed: Mask
    over_a: Mask
    over_b: Mask

    @property
    def better(self) -> Mask:
        """Where it fell by more than the noise."""
        return -self.growth > self.noise

    @property
    def worse(self) -> Mask:
        """Where it grew by more than the noise, or lost its value."""
        return (self.growth > self.noise) | np.isinf(self.growth)

    def as_dict(self, names: Sequence[str], scale: Array | float = 1.0) -> dict[str, Any]:
        """Counts, medians over the runs with both values, and the run that got worse most.

        Args:
            names: of the runs.
            scale: factor on all values, a number or shape (N,).
        """
        before, after = scale * self.before, scale * self.after
        row = int(np.argmax(np.where(self.worse, self.growth, -np.inf)))
        worst = {"run": names[row], "a": float(before[row]), "b": float(after[row])}
        return {
            "unit": self.unit,
            "pairs": int(self.both.sum()),
            **{key: int(getattr(self, key).sum()) for key in ("better", "worse", "regressed")},
            "median": {
                key: float(np.median(values[self.both])) if self.both.any() else math.nan
                for key, values in (("a", before), ("b", after))
            },
            "worst": worst if self.worse.any() else None,
        }


@dataclass(frozen=True)
class Change:
    """A run whose outcome or metrics changed.

    Attributes:
        kind: one of :data:`KINDS`.
        a, b: name in the first and in the second sweep.
        before, after: state in either.
        metrics: those that got worse beyond tolerance, or are newly over their limit.
        parameters: values of what varies.
    """

    kind: str
    a: str
    b: str
    before: State
    after: State
    metrics: tuple[str, ...]
    parameters: Mapping[str, Any]


@dataclass(frozen=True)
class SweepComparison(Brief):
    """Two sweeps compared.

    Attributes:
        a, b: the sweeps; the first is the reference.
        rows_a, rows_b: rows of the runs that both have, shape (N,) each.
        changes: runs that changed, the worst outcome first.
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
        found = [f"{self.counts[kind]} {KINDS[kind]}" for kind in _REGRESSIONS if self.counts[kind]]
        return [*found, f"{len(self.missing)} missing"] if self.require_all and self.missing else found

    @property
    def sentence(self) -> str:
        """The result in one sentence."""
        runs = f"{len(self.rows_a):,} matched run{'' if len(self.rows_a) == 1 else 's'}"
        lacking = (
            f"; {len(self.missing):,} of the {len(self.a):,} runs of A are missing in B"
            if self.missing
            else ""
        )
        late = [name for name, side in (("A", self.a), ("B", self.b)) if side.planned > len(side)]
        lacking += f"; {' and '.join(late)} {'is' if len(late) == 1 else 'are'} not finished" if late else ""
        if self.regressions:
            return f"Regression in {runs}: {', '.join(self.regressions)}{lacking}."
        if self.counts["newly_passing"]:
            return f"No regression in {runs}, {self.counts['newly_passing']} newly passing{lacking}."
        changed = self.changes or any((item.better | item.worse).any() for item in self.metrics)
        return f"No {'regression' if changed else 'difference beyond noise'} in {runs}{lacking}."

    def tables(self) -> list[Table]:
        """Outcomes, metrics, and runs that changed."""
        counted = Counter(zip(self.a.states[self.rows_a], self.b.states[self.rows_b], strict=True))
        outcomes = [(STATES[a].label, STATES[b].label, f"{n:,}") for (a, b), n in sorted(counted.items())]
        columns = ("metric", ">better", ">worse", ">beyond", ">median A", ">median B", "unit", "worst")
        note = "Better, worse: runs that differ by more than noise. Beyond: grown by more than the tolerance."
        found = [
            Table("outcomes", ("in A", "in B", ">runs"), outcomes, self.notes),
            Table(
                "metrics of the runs that completed in both",
                columns,
                [*map(self._cells, self.metrics)],
                [note],
            ),
        ]
        for kind, title in KINDS.items():
            changes = [change for change in self.changes if change.kind == kind]
            rows = [
                (
                    change.a if change.a == change.b else f"{change.a} / {change.b}",
                    change.before.label,
                    change.after.label,
                    "; ".join(map(metric_label, change.metrics)),
                    ", ".join(f"{key} {format_value(value)}" for key, value in change.parameters.items()),
                )
                for change in changes[:_SHOWN]
            ]
            more = [f"and {len(changes) - _SHOWN:,} more"] if len(changes) > _SHOWN else []
            heads = ("run", "in A", "in B", "metrics", "parameters")
            found.append(Table(f"{len(changes):,} {title}", heads, rows, more))
        return [table for table in found if table.rows]

    def _cells(self, item: MetricChange) -> list[str]:
        """Cells of a metric, in millimetres and per cent of the body weight of the runs of A."""
        scale, unit = display_unit(item.unit, self.a.weight[self.rows_a])
        found = item.as_dict(self._names, scale)
        worst = found["worst"]
        return [
            metric_label(item.name),
            *(f"{found[key]:,}" for key in ("better", "worse", "regressed")),
            *(format_number(found["median"][side]) for side in "ab"),
            unit,
            f"{worst['run']}: {format_number(worst['a'], 3)} → {format_number(worst['b'], 3)}"
            if worst
            else "",
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
    allowed = _read_tolerances(tolerances, {*a.metrics, *b.metrics})
    rows_a, rows_b, notes = join(a, b)
    metrics = []
    for name in a.metrics:
        if METRIC + name in b and (name in a.limits or name in b.limits):
            bound = 0.0 if known is None else known.bounds.get(name, 0.0)
            item = _compare_metric(name, (a, rows_a), (b, rows_b), allowed.get(name, allowed[""]), bound)
            if (item.both | item.worse).any():
                metrics.append(item)
    notes += _notes(a, b)
    if known is not None:
        notes.append(f"noise: numerical uncertainty of {known.gait}, taken for all gaits of the sweeps")
    changes = sorted(
        _changes(a, b, rows_a, rows_b, metrics), key=lambda change: (-_SEVERITY[change.after], change.a)
    )
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
    if a.profile != b.profile:
        yield f"the verdicts are of different profiles: {a.profile or '?'} and {b.profile or '?'}"
    elif {n: i.limit for n, i in a.limits.items()} != {n: i.limit for n, i in b.limits.items()}:
        yield "the limits of the profile are not the same in both sweeps; those of B count"
    if gone := [name for name in a.judged if METRIC + name not in b]:
        yield f"only A has {', '.join(gone)}"
    machines = (
        {**side.metadata["environment"].get("versions", {}), **side.metadata["environment"]}
        for side in (a, b)
    )
    one, two = machines
    for entry in ("processor", "platform", "mujoco", "numpy", "pin", "osqp"):
        if one.get(entry) != two.get(entry):
            yield f"{entry}: {one.get(entry)}, then {two.get(entry)}; bits may differ for that alone"


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
    before, after = first.numbers(METRIC + name)[rows_a], second.numbers(METRIC + name)[rows_b]
    limit = second.limit_values(name)[rows_b]
    limit = np.where(np.isnan(limit), first.limit_values(name)[rows_a], limit)
    noise = np.maximum(rounding(np.fmax(np.abs(before), np.abs(after)), unit), bound)
    completed = first.measured[rows_a] & second.measured[rows_b] & np.isfinite(before)
    both = completed & np.isfinite(after)
    growth = np.where(both, after - before, np.where(completed, np.inf, 0.0))
    return MetricChange(
        name=name,
        unit=unit,
        before=before,
        after=after,
        both=both,
        growth=growth,
        noise=noise,
        regressed=(completed & ~both) | ((growth > noise) & (growth > share * limit)),
        over_a=first.used(name)[rows_a] > 1.0,
        over_b=second.used(name)[rows_b] > 1.0,
    )


def _changes(
    a: SweepTable, b: SweepTable, rows_a: Rows, rows_b: Rows, metrics: Sequence[MetricChange]
) -> Iterator[Change]:
    """Runs that changed."""
    names_a, names_b = a.words("name"), b.words("name")
    varied = [key for key in dict.fromkeys((*a.varied, *b.varied)) if key in a]
    moved = np.any([a.states[rows_a] != b.states[rows_b], *(item.regressed for item in metrics)], axis=0)
    for i in np.flatnonzero(moved).tolist():
        left, right = int(rows_a[i]), int(rows_b[i])
        before, after = a.state(left), b.state(right)
        grown = {item.name: None for item in metrics if item.regressed[i]}
        over = {item.name: None for item in metrics if item.over_b[i] and not item.over_a[i]}
        kind = _kind(before, after, bool(grown), metrics, i)
        values = {key: a.table.column(key)[left].as_py() for key in varied}
        yield Change(kind, names_a[left], names_b[right], before, after, tuple(over | grown), values)


def _kind(before: State, after: State, grown: bool, metrics: Sequence[MetricChange], i: int) -> str:
    """Change of a run whose state changed or that has a metric worse beyond tolerance."""
    if {before, after} == {State.PASS, State.OUT_OF_TOLERANCE}:
        # A verdict may change by a difference below the noise, which is no result.
        failing = after is State.OUT_OF_TOLERANCE
        crossed = [item for item in metrics if (item.over_b if failing else item.over_a)[i]]
        real = any((item.worse | ~item.both if failing else item.better)[i] for item in crossed)
        if crossed and not real:  # without a metric over its limit the verdict has other reasons
            return "worse_metrics" if grown else "other_change"
    if before is not after and State.PASS in (before, after):
        return "newly_failing" if before is State.PASS else "newly_passing"
    if _SEVERITY[before] == _SEVERITY[after]:
        return "worse_metrics" if grown else "other_change"
    return "worse_outcome" if _SEVERITY[after] > _SEVERITY[before] else "better_outcome"
