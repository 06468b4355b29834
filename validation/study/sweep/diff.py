"""Two sweeps compared run by run: what got better, what got worse, and what is only noise."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import false_discovery_control

from ampm.exceptions import InputError
from validation.judge.uncertainty import Uncertainty, load_uncertainty
from validation.study.sweep.metric_change import MetricChange, Rows, Runs
from validation.study.sweep.table import METRIC, STATES, State, SweepTable, read_sweep

TOLERANCE = 0.1
"""Share of its limit by which a metric may grow before that is a regression [1]."""
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
        """Reasons why the comparison fails, in words; empty if it passes."""
        found = [f"{len(self.of_kind(kind))} {KINDS[kind]}" for kind in _REGRESSIONS if self.of_kind(kind)]
        return [*found, f"{len(self.missing)} missing"] if self.require_all and self.missing else found

    @property
    def lacking(self) -> list[str]:
        """Runs that are not compared, in words; empty if every run of either has a partner."""
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
        b: of what is compared with it.
        tolerances: shares of the limits by which metrics may grow: ``"0.1"``, or ``"zmp_x_rmse=0.2"``.
        uncertainty: ``convergence.json``, whose numerical uncertainty takes the place of the noise floor.
        require_all: whether a run that the second sweep lacks is a regression.

    Raises:
        InputError: no two sweeps, no run in common, or a tolerance that is none.
    """
    a, b = (side if isinstance(side, SweepTable) else read_sweep(side) for side in (a, b))
    known = load_uncertainty(uncertainty) if isinstance(uncertainty, Path) else uncertainty
    bounds = known.bounds if known is not None else {}
    allowed = read_tolerances(tolerances, {*a.metrics, *b.metrics})
    rows_a, rows_b, notes = join(a, b)
    metrics = [
        MetricChange.of(name, (a, rows_a), (b, rows_b), allowed.get(name, allowed[""]), bounds.get(name))
        for name in a.metrics
        if METRIC + name in b and (name in a.limits or name in b.limits)
    ]
    metrics = [item for item in metrics if item.completed.any()]
    p = np.array([item.p_value for item in metrics])
    p[~np.isnan(p)] = false_discovery_control(p[~np.isnan(p)]) if np.isfinite(p).any() else []
    changes = _changes((a, rows_a), (b, rows_b), metrics)
    notes += [*_notes(a, b), *_study_notes(known)]
    return SweepDiff(
        a, b, rows_a, rows_b, tuple(changes), tuple(metrics), tuple(p.tolist()), tuple(notes), require_all
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
        first, second = (_distinct(sweep, f"environment_{entry}") for sweep in (a, b))
        if first and second and first != second:
            found.append(
                f"{entry.removeprefix('version_')}: {' and '.join(first)}, then {' and '.join(second)}; bits "
                "may differ for that alone"
            )
    for sweep, which in ((a, "first"), (b, "second")):
        if len(_distinct(sweep, "environment_revision")) > 1:
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
    """Change of a run; None without one."""
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
