"""Two sweeps compared run by run: improvements, regressions, noise.

Two runs of one revision on one machine have the same bits, so there is no scatter to estimate. Between two
revisions or machines that compute the same, only rounding differs: perturbing the body's mass by 1e-15 to
1e-12 of itself moves every metric of `normal` and `momentum` that is not rounding itself by less than 1e-9 of
its value. The default noise floor is a thousand times that. A convergence study gives a wider one: the
numerical uncertainty of every metric, below which a difference may come from the time step alone.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import false_discovery_control, wilcoxon

from ampm.brief import Brief
from ampm.exceptions import InputError
from ampm.geometry import Array
from validation.judge.uncertainty import Uncertainty, load_uncertainty
from validation.study.sweep.table import METRIC, STATES, State, SweepTable, read_sweep

Rows = NDArray[np.int64]
Mask = NDArray[np.bool_]
Runs = tuple[SweepTable, Rows]
"""A sweep, and rows of it, shape (N,)."""

TOLERANCE = 0.1
"""Share of its limit by which a metric may grow before that is a regression [1]."""
RELATIVE_FLOOR = 1e-6
"""Share of a metric's value below which a difference is rounding [1]."""
ABSOLUTE_FLOOR: Mapping[str, float] = {"m": 1e-11, "N": 1e-8, "N m s": 1e-10, "1": 1e-12}
"""The same in a metric's unit, for values near zero: ten times the largest observed effect of rounding."""
SIGNIFICANCE = 0.05
LEAST_PAIRS = 8
"""Pairs below which no shift over all runs is reported: all of 8 have one sign by chance with 1/128."""
KINDS: Mapping[str, str] = {
    "newly_failing": "newly failing",
    "worse_outcome": "with a worse outcome",
    "worse_metrics": "with a metric worse beyond tolerance",
    "newly_passing": "newly passing",
    "better_outcome": "with a better outcome",
    "other_outcome": "with another outcome, neither better nor worse",
    "verdict_only": "with another verdict, though no metric changed beyond noise",
}
"""Possible changes of a run; the first three are regressions."""
_REGRESSIONS = tuple(KINDS)[:3]
_SEVERITY: Mapping[State, int] = {
    State.PASS: 0,
    State.OUT_OF_TOLERANCE: 1,
    State.NOT_MEASURED: 1,
    State.REFUSED: 2,
    State.FELL: 3,
    State.DIVERGED: 3,
    State.INFEASIBLE: 3,
    State.CRASHED: 4,
    State.TIMED_OUT: 4,
    State.INTERRUPTED: 4,
}
"""From good to bad. A refusal is a valid result, better than a fall; a crash is no result."""
_MACHINE = ("processor", "platform", "version_mujoco", "version_numpy", "version_pin", "version_osqp")


@dataclass(frozen=True)
class MetricChange:
    """One metric of the N runs that both sweeps have; every array of shape (N,).

    Attributes:
        name: of the metric.
        unit: SI unit of all values.
        before, after: values in the first and in the second sweep.
        both: whether the run completed in both, with a finite value.
        growth: second minus first; infinite where only the second sweep lacks a value, else zero without one.
        noise: largest difference that counts as none; infinite if the study has no bound.
        noise_from: ``floating point`` or ``convergence study``.
        allowed: growth that is no regression; NaN without a limit.
        better: whether it fell by more than the noise.
        worse: whether it grew by more than the noise, or lost its value.
        regressed: whether it got worse by more than is allowed, too, or lost its value.
        over_a, over_b: whether it is over its limit.
        p: probability of the differences by chance (Wilcoxon's signed-rank test, differences within the noise
            count as none), corrected for the number of metrics (Benjamini-Hochberg); NaN with too few runs.
    """

    name: str
    unit: str
    before: Array
    after: Array
    both: Mask
    growth: Array
    noise: Array
    noise_from: str
    allowed: Array
    better: Mask
    worse: Mask
    regressed: Mask
    over_a: Mask
    over_b: Mask
    p: float

    def median(self, values: Array) -> float:
        """Median over the runs with a value in both sweeps."""
        return float(np.median(values[self.both])) if self.both.any() else math.nan

    @property
    def verdict(self) -> str:
        """Judgement of the shift over all runs: ``better``, ``worse``, ``same``, or ``too few`` runs."""
        shift = self.median(self.growth)
        if self.p < SIGNIFICANCE and abs(shift) > self.median(self.noise):
            return "worse" if shift > 0.0 else "better"
        return "too few" if math.isnan(self.p) else "same"


@dataclass(frozen=True)
class Change:
    """A run whose outcome or metrics changed.

    Attributes:
        kind: one of :data:`KINDS`.
        a, b: name in the first and in the second sweep.
        before, after: state in either.
        metrics: those that got worse beyond tolerance, were lost, or are newly over their limit.
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
class SweepDiff(Brief):
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

    def of_kind(self, kind: str) -> list[Change]:
        """Changes of one kind."""
        return [change for change in self.changes if change.kind == kind]

    @property
    def missing(self) -> list[str]:
        """Names of runs that only the first sweep has."""
        return np.delete(self.a.words("name"), self.rows_a).tolist()

    @property
    def new(self) -> list[str]:
        """Names of runs that only the second sweep has."""
        return np.delete(self.b.words("name"), self.rows_b).tolist()

    @property
    def transitions(self) -> list[tuple[State, State, int]]:
        """State before, state after, number of runs."""
        counted = Counter(zip(self.a.states[self.rows_a], self.b.states[self.rows_b], strict=True))
        return [(STATES[before], STATES[after], count) for (before, after), count in sorted(counted.items())]

    @property
    def regressions(self) -> list[str]:
        """Reasons why the comparison fails; empty if it passes."""
        found = [f"{len(self.of_kind(kind))} {KINDS[kind]}" for kind in _REGRESSIONS if self.of_kind(kind)]
        return [*found, f"{len(self.missing)} missing"] if self.require_all and self.missing else found

    @property
    def lacking(self) -> list[str]:
        """Text on runs that are not compared; empty if all runs are matched."""
        found = []
        (a, late_a), (b, late_b) = ((len(side), side.planned > len(side)) for side in (self.a, self.b))
        if self.missing:
            state = ", which is not finished" if late_b else ""
            found.append(f"{len(self.missing):,} of the {a:,} runs of A missing in B{state}")
        if self.new and late_a:  # runs that only B has are no gap, unless A is unfinished
            found.append(f"{len(self.new):,} of the {b:,} runs of B missing in A, which is not finished")
        return found or [f"{name} is not finished" for name, late in (("A", late_a), ("B", late_b)) if late]

    @property
    def sentence(self) -> str:
        """The result in one sentence."""
        runs = f"{len(self.rows_a):,} matched run{'' if len(self.rows_a) == 1 else 's'}"
        end = "".join(f"; {part}" for part in self.lacking) + "."
        if self.regressions:
            return f"Regression in {runs}: {', '.join(self.regressions)}{end}"
        gained = len(self.of_kind("newly_passing"))
        better = sum(item.verdict == "better" for item in self.metrics)
        parts = [f"{gained} newly passing"] if gained else []
        parts += [f"{better} metric{'' if better == 1 else 's'} better over all runs"] if better else []
        if parts:
            return f"No regression in {runs}; {', '.join(parts)}{end}"
        changed = self.changes or any((item.better | item.worse).any() for item in self.metrics)
        return f"No {'regression' if changed else 'difference beyond noise'} in {runs}{end}"


def compare_sweeps(
    a: Path | str | SweepTable,
    b: Path | str | SweepTable,
    *,
    tolerances: Sequence[str] = (),
    uncertainty: Path | Uncertainty | None = None,
    require_all: bool = False,
) -> SweepDiff:
    """Compare two sweeps, the first of which is the reference.

    Args:
        a: folder or table of the reference.
        b: folder or table of the sweep that is compared with it.
        tolerances: shares of the limits by which metrics may grow: ``"0.1"``, or ``"zmp_x_rmse=0.2"``.
        uncertainty: ``convergence.json``, whose numerical uncertainty takes the place of the noise floor.
        require_all: whether a run that the second sweep lacks is a regression.

    Raises:
        InputError: no two sweeps, no common run, or a bad tolerance.
    """
    a, b = (side if isinstance(side, SweepTable) else read_sweep(side) for side in (a, b))
    known = load_uncertainty(uncertainty) if isinstance(uncertainty, Path) else uncertainty
    bounds = known.bounds if known is not None else {}
    allowed = _read_tolerances(tolerances, {*a.metrics, *b.metrics})
    rows_a, rows_b, notes = join(a, b)
    one, two = (a, rows_a), (b, rows_b)
    metrics = [
        _compare_metric(name, one, two, allowed.get(name, allowed[""]), bounds.get(name))
        for name in a.metrics
        if METRIC + name in b and (name in a.limits or name in b.limits)
    ]
    metrics = [item for item in metrics if (item.both | item.worse).any()]
    p = np.array([item.p for item in metrics])
    if len(tested := np.flatnonzero(~np.isnan(p))):
        p[tested] = false_discovery_control(p[tested])
    metrics = [replace(item, p=value) for item, value in zip(metrics, p.tolist(), strict=True)]
    notes += [*_notes(a, b), *_study_notes(known)]
    changes = _changes(one, two, metrics)
    return SweepDiff(a, b, rows_a, rows_b, tuple(changes), tuple(metrics), tuple(notes), require_all)


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


# -------------------------------------------------------------------------------------- which run is which


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
        pairs = _pairs(*(s.table.select(varied).to_pylist() for s in (a, b)))
        for key in (key for key in a.parameters if pairs and key in b and key not in varied):
            one, two = (sweep.table.column(key)[0].as_py() for sweep in (a, b))
            if one != two:
                notes.append(f"{key} is {one} in all runs of the first sweep, {two} in those of the second")
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


def _notes(a: SweepTable, b: SweepTable) -> list[str]:
    """Warnings about the comparison of two sweeps."""
    found = []
    if a.profile != b.profile:
        found.append(f"the verdicts are of different profiles: {a.profile or '?'} and {b.profile or '?'}")
    elif {n: i.limit for n, i in a.limits.items()} != {n: i.limit for n, i in b.limits.items()}:
        found.append("the limits of the profile are not the same in both sweeps; those of the second count")
    gone = [name for name in a.limits if METRIC + name in a and METRIC + name not in b]
    if gone:
        found.append(f"only the first sweep has {', '.join(gone)}")
    for entry in _MACHINE:
        first, second = (sweep.distinct(f"environment_{entry}") for sweep in (a, b))
        if first and second and first != second:
            found.append(
                f"{entry.removeprefix('version_')}: {' and '.join(first)}, then {' and '.join(second)}; bits "
                "may differ for that alone"
            )
    for sweep, which in ((a, "first"), (b, "second")):
        if len(sweep.distinct("environment_revision")) > 1:
            found.append(f"the {which} sweep mixes revisions")
    return found


def _study_notes(uncertainty: Uncertainty | None) -> list[str]:
    if uncertainty is None:
        return []
    inside = f" ({' + '.join(uncertainty.studies)})" if uncertainty.studies else ""
    found = [
        f"the noise is the numerical uncertainty{inside} of {uncertainty.gait}, taken for all gaits of the "
        "sweeps"
    ]
    if uncertainty.not_studied:
        found.append(
            f"not studied: {', '.join(uncertainty.not_studied)}; metrics whose uncertainty lacks that have "
            "no bound, and no difference of theirs is called one"
        )
    return found


# ------------------------------------------------------------------------------------------ what changed


def _compare_metric(name: str, a: Runs, b: Runs, share: float, bound: float | None) -> MetricChange:
    """Compare a metric.

    Args:
        name: of the metric.
        a: first sweep and the rows to compare.
        b: second sweep, likewise.
        share: of its limit by which it may grow.
        bound: numerical uncertainty, None without a study of it.
    """
    (first, rows_a), (second, rows_b) = a, b
    unit = first.unit(METRIC + name)
    before, after = first.numbers(METRIC + name)[rows_a], second.numbers(METRIC + name)[rows_b]
    limit = second.limit_values(name)[rows_b]
    limit = np.where(np.isnan(limit), first.limit_values(name)[rows_a], limit)
    allowed, rounding = share * limit, RELATIVE_FLOOR * np.fmax(np.abs(before), np.abs(after))
    noise = np.maximum(np.maximum(rounding, ABSOLUTE_FLOOR.get(unit, 0.0)), bound or 0.0)
    completed = first.measured[rows_a] & second.measured[rows_b] & np.isfinite(before)
    both = completed & np.isfinite(after)
    lost = completed & ~both
    growth = np.where(both, after - before, np.where(lost, np.inf, 0.0))
    better, worse = -growth > noise, lost | (growth > noise)
    beyond_noise, p = np.where(worse | better, growth, 0.0)[both], math.nan
    if len(beyond_noise) >= LEAST_PAIRS:
        p = float(wilcoxon(beyond_noise, zero_method="zsplit").pvalue) if beyond_noise.any() else 1.0
    return MetricChange(
        name=name,
        unit=unit,
        before=before,
        after=after,
        both=both,
        growth=growth,
        noise=noise,
        noise_from="floating point" if bound is None else "convergence study",
        allowed=allowed,
        better=better,
        worse=worse,
        regressed=lost | (worse & (growth > allowed)),
        over_a=first.used(name)[rows_a] > 1.0,
        over_b=second.used(name)[rows_b] > 1.0,
        p=p,
    )


def _changes(a: Runs, b: Runs, metrics: Sequence[MetricChange]) -> list[Change]:
    (first, rows_a), (second, rows_b) = a, b
    names_a, names_b = first.words("name"), second.words("name")
    varied = [key for key in dict.fromkeys((*first.varied, *second.varied)) if key in first]
    moved = np.any([first.states[rows_a] != second.states[rows_b], *(m.regressed for m in metrics)], axis=0)
    found = []
    for i in np.flatnonzero(moved).tolist():
        left, right = int(rows_a[i]), int(rows_b[i])
        before, after = first.state(left), second.state(right)
        grown = [item.name for item in metrics if item.regressed[i]]
        kind = _kind(before, after, bool(grown), metrics, i)
        if kind in ("newly_failing", "verdict_only"):
            over = (item.name for item in metrics if item.over_b[i] and not item.over_a[i])
            grown = list(dict.fromkeys((*over, *grown)))
        values = {key: first.table.column(key)[left].as_py() for key in varied}
        if kind is not None:
            found.append(Change(kind, names_a[left], names_b[right], before, after, tuple(grown), values))
    return sorted(found, key=lambda change: (-_SEVERITY[change.after], change.a))


def _kind(before: State, after: State, grown: bool, metrics: Sequence[MetricChange], i: int) -> str | None:
    """Change of a run; None without one."""
    same = "worse_metrics" if grown else None
    if {before, after} == {State.PASS, State.OUT_OF_TOLERANCE}:
        # A verdict may change by a difference below the noise, which is no result.
        worse = after is State.OUT_OF_TOLERANCE
        crossed = [item for item in metrics if (item.over_b if worse else item.over_a)[i]]
        real = any((item.worse | ~item.both if worse else item.better)[i] for item in crossed)
        if crossed and not real:  # without a metric over its limit the verdict has other reasons
            return same or "verdict_only"
    if before is after:
        return same
    if State.PASS in (before, after):
        return "newly_failing" if before is State.PASS else "newly_passing"
    if _SEVERITY[before] == _SEVERITY[after]:
        return same or "other_outcome"
    return "worse_outcome" if _SEVERITY[after] > _SEVERITY[before] else "better_outcome"
