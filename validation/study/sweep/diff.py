"""Two sweeps compared run by run: what got better, what got worse, and what is only noise.

Two runs of one revision on one machine have the same bits, so there is no scatter to estimate. What remains
between two revisions or machines that compute the same thing is rounding: perturbing the body's mass by 1e-15
to 1e-12 of itself moves every metric of `normal` and `momentum` that is not rounding itself by less than 1e-9
of its value. The default noise floor is a thousand times that. A convergence study gives a wider one: the
numerical uncertainty of every metric, below which a difference says more of the time step than of the gait.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import false_discovery_control, wilcoxon

from ampm.exceptions import InputError
from validation.judge.uncertainty import Uncertainty, load_uncertainty
from validation.study.sweep.table import METRIC, STATES, State, SweepTable, read_sweep

Array = NDArray[np.float64]
Rows = NDArray[np.int64]
Mask = NDArray[np.bool_]

Runs = tuple[SweepTable, Rows]
"""A sweep, and rows of it, shape (N,)."""

RELATIVE_FLOOR = 1e-6
"""Share of a metric's value below which a difference is rounding [1]."""
ABSOLUTE_FLOOR: Mapping[str, float] = {"m": 1e-11, "N": 1e-8, "N m s": 1e-10, "1": 1e-12}
"""The same in a metric's unit, for values near zero: ten times what rounding did to any metric."""
TOLERANCE = 0.1
"""Share of its limit by which a metric may grow before that is a regression [1]."""
SIGNIFICANCE = 0.05
LEAST_PAIRS = 8
"""Pairs below which no shift over all runs is claimed: of 8, chance alone moves all one way in 1 of 128."""

KINDS: Mapping[str, str] = {
    "newly_failing": "newly failing",
    "worse_outcome": "with a worse outcome",
    "worse_metrics": "with a metric worse beyond tolerance",
    "newly_passing": "newly passing",
    "better_outcome": "with a better outcome",
    "other_outcome": "with another outcome, neither better nor worse",
    "verdict_only": "with another verdict, though no metric changed beyond noise",
}
"""What can happen to a run; the first three are regressions."""
_REGRESSIONS = tuple(KINDS)[:3]
_SEVERITY: Mapping[State, int] = {
    state: severity
    for severity, states in enumerate(
        (
            (State.PASS,),
            (State.OUT_OF_TOLERANCE, State.NOT_MEASURED),
            (State.REFUSED,),
            (State.FELL, State.DIVERGED, State.INFEASIBLE),
            (State.CRASHED, State.TIMED_OUT, State.INTERRUPTED),
        )
    )
    for state in states
}
"""From good to bad. A refusal is an honest answer, better than a fall; a crash is none."""
_MACHINE = ("processor", "platform", "version_mujoco", "version_numpy", "version_pin", "version_osqp")


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
class MetricChange:
    """One metric of the N runs that both sweeps have; every array of shape (N,).

    Attributes:
        name: of the metric.
        unit: SI unit of all values.
        before, after: values in the first and in the second sweep.
        completed: whether the run completed in both, with a finite value in the first sweep.
        noise: what a difference must exceed to be one; infinite if the study has no bound.
        noise_from: ``floating point`` or ``convergence study``.
        allowed: growth that is no regression; NaN without a limit.
        over_a, over_b: whether it is over its limit.
    """

    name: str
    unit: str
    before: Array
    after: Array
    completed: Mask
    noise: Array
    noise_from: str
    allowed: Array
    over_a: Mask
    over_b: Mask

    @property
    def both(self) -> Mask:
        """Runs with a finite value in both sweeps."""
        return self.completed & np.isfinite(self.after)

    @property
    def growth(self) -> Array:
        """Second minus first; zero where there is no value in both, infinite where the second lacks one."""
        lost = np.where(self.completed, np.inf, 0.0)
        return np.where(self.both, self.after - self.before, lost)

    @property
    def worse(self) -> Mask:
        """Runs that grew by more than the noise, or lost their value."""
        return self.growth > np.where(self.both, self.noise, 0.0)

    @property
    def better(self) -> Mask:
        """Runs that fell by more than the noise."""
        return -self.growth > self.noise

    @property
    def regressed(self) -> Mask:
        """Runs that got worse by more than the tolerance, too, or lost their value."""
        return self.worse & (self.growth > np.where(self.both, np.nan_to_num(self.allowed, nan=np.inf), 0.0))

    def median(self, values: Array) -> float:
        """Median over the runs with a value in both sweeps."""
        return float(np.median(values[self.both])) if self.both.any() else math.nan

    @property
    def p_value(self) -> float:
        """Probability of the differences by chance (Wilcoxon's signed-rank test); NaN with too few runs.

        Differences within the noise count as none.
        """
        growth = np.where(self.worse | self.better, self.growth, 0.0)[self.both]
        if len(growth) < LEAST_PAIRS:
            return math.nan
        return float(wilcoxon(growth, zero_method="zsplit").pvalue) if growth.any() else 1.0

    def verdict(self, p: float) -> str:
        """What is said of the shift over all runs: ``better``, ``worse``, ``same``, or ``too few`` to say.

        Args:
            p: of :attr:`p_value`, corrected for the number of metrics.
        """
        shift = self.median(self.growth)
        if p < SIGNIFICANCE and abs(shift) > self.median(self.noise):
            return "worse" if shift > 0.0 else "better"
        return "too few" if math.isnan(p) else "same"

    @classmethod
    def of(cls, name: str, a: Runs, b: Runs, share: float, bound: float | None) -> MetricChange:
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
        rounding = RELATIVE_FLOOR * np.fmax(np.abs(before), np.abs(after))
        limit = second.limit_values(name)[rows_b]
        limit = np.where(np.isnan(limit), first.limit_values(name)[rows_a], limit)
        over_a, over_b = (np.nan_to_num(sweep.used(name)[rows]) > 1.0 for sweep, rows in (a, b))
        return cls(
            name=name,
            unit=unit,
            before=before,
            after=after,
            completed=first.measured[rows_a] & second.measured[rows_b] & np.isfinite(before),
            noise=np.maximum(np.maximum(rounding, ABSOLUTE_FLOOR.get(unit, 0.0)), bound or 0.0),
            noise_from="floating point" if bound is None else "convergence study",
            allowed=share * limit,
            over_a=over_a,
            over_b=over_b,
        )


@dataclass(frozen=True)
class SweepDiff:
    """Two sweeps compared.

    Attributes:
        a, b: the sweeps; the first is the reference.
        rows_a, rows_b: rows of the runs that both have, shape (N,) each.
        changes: runs that changed, the worst outcome first.
        metrics: in the profile's order.
        p_values: of the shift of every metric, corrected for their number (Benjamini-Hochberg).
        notes: what a reader must know to believe the rest.
        require_all: whether missing runs are regressions.
    """

    a: SweepTable
    b: SweepTable
    rows_a: Rows
    rows_b: Rows
    changes: tuple[Change, ...]
    metrics: tuple[MetricChange, ...]
    p_values: tuple[float, ...]
    notes: tuple[str, ...]
    require_all: bool = False

    def of_kind(self, kind: str) -> list[Change]:
        """Changes of one kind."""
        return [change for change in self.changes if change.kind == kind]

    @property
    def missing(self) -> list[str]:
        """Names of runs that only the first sweep has."""
        return _others(self.a, self.rows_a)

    @property
    def new(self) -> list[str]:
        """Names of runs that only the second sweep has."""
        return _others(self.b, self.rows_b)

    @property
    def transitions(self) -> list[tuple[State, State, int]]:
        """State before, state after, number of runs."""
        counted = Counter(zip(self.a.states[self.rows_a], self.b.states[self.rows_b], strict=True))
        return [(STATES[before], STATES[after], count) for (before, after), count in sorted(counted.items())]

    @property
    def regressions(self) -> list[str]:
        """What fails the comparison, in words; empty if nothing does."""
        found = [f"{len(self.of_kind(kind))} {KINDS[kind]}" for kind in _REGRESSIONS if self.of_kind(kind)]
        return [*found, f"{len(self.missing)} missing"] if self.require_all and self.missing else found

    @property
    def lacking(self) -> list[str]:
        """What the comparison says nothing of, in words; empty if every run of either has a partner."""
        found = []
        for names, own, other in ((self.missing, "A", "B"), (self.new, "B", "A")):
            sweep, partner = (self.a, self.b) if own == "A" else (self.b, self.a)
            unfinished = partner.planned > len(partner)
            # Runs that only B has are no gap, unless A was to have them.
            if names and (own == "A" or unfinished):
                state = ", which is not finished" if unfinished else ""
                found.append(f"{len(names):,} of the {len(sweep):,} runs of {own} missing in {other}{state}")
        return found or [
            f"{name} is not finished" for name, s in (("A", self.a), ("B", self.b)) if s.planned > len(s)
        ]

    @property
    def sentence(self) -> str:
        """The answer in one sentence."""
        runs = f"{len(self.rows_a):,} matched run{'' if len(self.rows_a) == 1 else 's'}"
        end = "".join(f"; {part}" for part in self.lacking) + "."
        if self.regressions:
            return f"Regression in {runs}: {', '.join(self.regressions)}{end}"
        gained = len(self.of_kind("newly_passing"))
        better = sum(item.verdict(p) == "better" for item, p in zip(self.metrics, self.p_values, strict=True))
        parts = [f"{gained} newly passing"] if gained else []
        parts += [f"{better} metric{'' if better == 1 else 's'} better over all runs"] if better else []
        if parts:
            return f"No regression in {runs}; {', '.join(parts)}{end}"
        changed = self.changes or any((item.better | item.worse).any() for item in self.metrics)
        return f"No {'regression' if changed else 'difference beyond noise'} in {runs}{end}"


def _others(sweep: SweepTable, rows: Rows) -> list[str]:
    names = sweep.words("name")
    return [names[row] for row in np.setdiff1d(np.arange(len(sweep)), rows)]


def compare_sweeps(
    a: Path | str,
    b: Path | str,
    *,
    tolerances: Sequence[str] = (),
    uncertainty: Path | None = None,
    require_all: bool = False,
) -> SweepDiff:
    """Compare two sweeps, the first of which is the reference.

    Args:
        a: folder or table of the reference.
        b: of what is compared with it.
        tolerances: shares of the limits by which metrics may grow: ``"0.1"``, or ``"zmp_x_rmse=0.2"``.
        uncertainty: ``convergence.json``, whose numerical uncertainty takes the place of the noise floor.
        require_all: whether a run that the second sweep lacks is a regression.

    Raises:
        InputError: no two sweeps, no run in common, or a tolerance that is none.
    """
    first, second = read_sweep(a), read_sweep(b)
    known = load_uncertainty(uncertainty) if uncertainty is not None else None
    allowed = read_tolerances(tolerances, {*first.metrics, *second.metrics})
    return diff_tables(first, second, allowed=allowed, uncertainty=known, require_all=require_all)


def diff_tables(
    a: SweepTable,
    b: SweepTable,
    *,
    allowed: Mapping[str, float] | None = None,
    uncertainty: Uncertainty | None = None,
    require_all: bool = False,
) -> SweepDiff:
    """The same for tables that are read already; ``allowed`` as from :func:`read_tolerances`."""
    rows_a, rows_b, notes = join(a, b)
    allowed = allowed if allowed is not None else {"": TOLERANCE}
    bounds = uncertainty.bounds if uncertainty is not None else {}
    metrics = [
        MetricChange.of(name, (a, rows_a), (b, rows_b), allowed.get(name, allowed[""]), bounds.get(name))
        for name in a.metrics
        if METRIC + name in b and (name in a.limits or name in b.limits)
    ]
    metrics = [item for item in metrics if item.completed.any()]
    p = np.array([item.p_value for item in metrics])
    p[~np.isnan(p)] = false_discovery_control(p[~np.isnan(p)]) if np.isfinite(p).any() else []
    return SweepDiff(
        a=a,
        b=b,
        rows_a=rows_a,
        rows_b=rows_b,
        changes=tuple(_changes((a, rows_a), (b, rows_b), metrics)),
        metrics=tuple(metrics),
        p_values=tuple(p.tolist()),
        notes=(*notes, *_notes(a, b), *_study_notes(uncertainty)),
        require_all=require_all,
    )


def read_tolerances(texts: Sequence[str], metrics: set[str]) -> dict[str, float]:
    """Shares of the limits by metric; that of the empty name holds for all others.

    Raises:
        InputError: no such metric, or no number of at least 0.
    """
    found = {"": TOLERANCE}
    for text in texts:
        name, equals, number = text.rpartition("=")
        name = name.strip()
        if equals and name not in metrics:
            raise InputError(
                f"--tolerance {text}: neither sweep has a metric {name!r}; use one of "
                f"{', '.join(sorted(metrics))}."
            )
        try:
            value = float(number)
        except ValueError:
            value = math.nan
        if not 0.0 <= value < math.inf:
            raise InputError(
                f"--tolerance {text}: {number!r} is no number of at least 0; give the share of its limit by "
                "which a metric may grow, such as 0.1, or METRIC=0.1."
            )
        found[name] = value
    return found


# -------------------------------------------------------------------------------------- which run is which


def join(a: SweepTable, b: SweepTable) -> tuple[Rows, Rows, list[str]]:
    """Rows of the runs that both sweeps have, and notes on how they differ.

    Runs with the same key are the same: it hashes the parameters that differ from the defaults. Where a
    parameter was changed for all runs alike no key is left the same; the values of what varies then decide.

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
        ranges = [", ".join(sorted(sweep.varied)) or "nothing" for sweep in (a, b)]
        why = "they vary " + " and ".join(ranges)
        if ranges[0] == ranges[1]:
            why = f"both vary {ranges[0]}, but at other values"
        if not (len(a) and len(b)):
            why = "one of them has no run"
        raise InputError(
            f"no run of {a.source} is in {b.source} ({why}); give two sweeps of the same definition."
        )
    rows = np.array(pairs, dtype=np.int64)
    return rows[:, 0], rows[:, 1], notes


def _pairs(a: Sequence[Any], b: Sequence[Any]) -> list[tuple[int, int]]:
    """Rows of equal identity; runs that were repeated are paired in their order."""
    place = {identity: row for row, identity in enumerate(_numbered(b))}
    return [(row, place[identity]) for row, identity in enumerate(_numbered(a)) if identity in place]


def _numbered(identities: Sequence[Any]) -> list[tuple[str, int]]:
    seen: Counter[str] = Counter()
    found = []
    for identity in map(str, identities):
        found.append((identity, seen[identity]))
        seen[identity] += 1
    return found


def _notes(a: SweepTable, b: SweepTable) -> list[str]:
    """What a reader must know of two sweeps to believe their comparison."""
    found = []
    if a.profile != b.profile:
        found.append(f"the verdicts are of different profiles: {a.profile or '?'} and {b.profile or '?'}")
    elif {n: i.limit for n, i in a.limits.items()} != {n: i.limit for n, i in b.limits.items()}:
        found.append("the limits of the profile are not the same in both sweeps; those of the second count")
    gone = [name for name in a.limits if METRIC + name in a and METRIC + name not in b]
    if gone:
        found.append(f"only the first sweep has {', '.join(gone)}")
    for entry in _MACHINE:
        first, second = (_distinct(sweep, f"environment_{entry}") for sweep in (a, b))
        if first and second and first != second:
            found.append(
                f"{entry.removeprefix('version_')}: {' and '.join(first)}, then {' and '.join(second)}; bits "
                "may differ for that alone"
            )
    for sweep, which in ((a, "first"), (b, "second")):
        if len(_distinct(sweep, "environment_revision")) > 1:
            found.append(f"the {which} sweep mixes revisions")
        if sweep.planned > len(sweep):
            found.append(f"the {which} sweep is not finished: {len(sweep):,} of {sweep.planned:,} runs")
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


def revision(sweep: SweepTable) -> str:
    """Revisions of a sweep, shortened."""
    found = _distinct(sweep, "environment_revision")
    modified = found and "True" in sweep.words("environment_modified")
    return ", ".join(word[:10] for word in found) + (" (changed since)" if modified else "")


def _distinct(sweep: SweepTable, column: str) -> list[str]:
    return sorted({word for word in sweep.words(column) if word})


# ------------------------------------------------------------------------------------------ what changed


def _changes(a: Runs, b: Runs, metrics: Sequence[MetricChange]) -> list[Change]:
    (first, rows_a), (second, rows_b) = a, b
    names_a, names_b = first.words("name"), second.words("name")
    varied = [key for key in dict.fromkeys((*first.varied, *second.varied)) if key in first]
    regressed = [item.regressed for item in metrics]
    moved = np.any([first.states[rows_a] != second.states[rows_b], *regressed], axis=0)
    found = []
    for i in np.flatnonzero(moved).tolist():
        left, right = int(rows_a[i]), int(rows_b[i])
        before, after = STATES[first.states[left]], STATES[second.states[right]]
        grown = [item.name for item, mask in zip(metrics, regressed, strict=True) if mask[i]]
        kind = _kind(before, after, bool(grown), metrics, i)
        if kind in ("newly_failing", "verdict_only"):
            over = (item.name for item in metrics if item.over_b[i] and not item.over_a[i])
            grown = list(dict.fromkeys((*over, *grown)))
        values = {key: first.table.column(key)[left].as_py() for key in varied}
        if kind is not None:
            found.append(Change(kind, names_a[left], names_b[right], before, after, tuple(grown), values))
    return sorted(found, key=lambda change: (-_SEVERITY[change.after], change.a))


def _kind(before: State, after: State, grown: bool, metrics: Sequence[MetricChange], i: int) -> str | None:
    """What happened to a run; None if nothing did."""
    same = "worse_metrics" if grown else None
    if {before, after} == {State.PASS, State.OUT_OF_TOLERANCE}:
        # A verdict turns at a limit, however small the step across it; below the noise that is no result.
        worse = after is State.OUT_OF_TOLERANCE
        crossed = [item for item in metrics if (item.over_b if worse else item.over_a)[i]]
        real = any((item.worse if worse else item.better)[i] for item in crossed)
        if crossed and not real:  # with no metric over its limit the verdict has reasons that are not here
            return same or "verdict_only"
    if before is after:
        return same
    if State.PASS in (before, after):
        return "newly_failing" if before is State.PASS else "newly_passing"
    if _SEVERITY[before] == _SEVERITY[after]:
        return same or "other_outcome"
    return "worse_outcome" if _SEVERITY[after] > _SEVERITY[before] else "better_outcome"
