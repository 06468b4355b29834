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
from validation.study.sweep.matching import Matching, match, notes
from validation.study.sweep.table import METRIC, STATES, State, SweepTable, read_sweep

Array = NDArray[np.float64]

RELATIVE_FLOOR = 1e-6
"""Share of a metric's value below which a difference is rounding [1]."""
ABSOLUTE_FLOOR: Mapping[str, float] = {"m": 1e-11, "N": 1e-8, "N m s": 1e-10, "1": 1e-12}
"""The same in a metric's unit, for values near zero: ten times what rounding did to any metric."""
TOLERANCE = 0.1
"""Share of its limit by which a metric may grow before that is a regression [1]."""
SIGNIFICANCE = 0.05
LEAST_PAIRS = 8
"""Pairs below which no shift over all runs is claimed: of 8, chance alone moves all one way in 1 of 128."""

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
"""From good to bad. A refusal is an honest answer, better than a fall; a crash is none."""


@dataclass(frozen=True)
class Change:
    """A run whose outcome or figures changed.

    Attributes:
        kind: ``newly_failing``, ``newly_passing``, ``worse_outcome``, ``better_outcome``, ``other_outcome``
            (another, neither better nor worse), ``verdict_only`` (another verdict, though no figure changed
            beyond noise), or ``worse_figures``.
        a: name in the first sweep.
        b: name in the second.
        parameters: values of what varies.
        before: state in the first sweep.
        after: state in the second.
        metrics: those that got worse beyond tolerance, or are newly over their limit.
    """

    kind: str
    a: str
    b: str
    parameters: Mapping[str, Any]
    before: State
    after: State
    metrics: tuple[str, ...] = ()


@dataclass(frozen=True)
class MetricChange:
    """One metric over all pairs of runs that completed in both sweeps.

    Attributes:
        metric: name.
        unit: SI unit of all values.
        pairs: how many.
        better, worse: pairs that differ by more than the noise.
        regressed: pairs that got worse by more than noise and tolerance.
        noise: median over the pairs of what a difference must exceed; infinite if the study has no bound.
        noise_from: ``floating point`` or ``convergence study``.
        allowed: median growth that is no regression, None for a metric without limit.
        before, after: medians.
        shift: median of the differences, second minus first.
        p: of Wilcoxon's signed-rank test on the differences, those within noise counted as none, corrected
            for the number of metrics (Benjamini-Hochberg); NaN without enough pairs.
        verdict: ``better``, ``worse`` or ``same``: of the shift over all runs; ``too few`` to say.
        worst: name of the run in the first sweep that got worse most, empty if none did.
        worst_before, worst_after: its values.
    """

    metric: str
    unit: str
    pairs: int
    better: int
    worse: int
    regressed: int
    noise: float
    noise_from: str
    allowed: float | None
    before: float
    after: float
    shift: float
    p: float
    verdict: str
    worst: str
    worst_before: float
    worst_after: float


@dataclass(frozen=True)
class SweepDiff:
    """Two sweeps compared.

    Attributes:
        a: first sweep.
        b: second sweep.
        matching: which run is which.
        changes: runs that changed.
        metrics: in the profile's order.
        transitions: counts by state before and after.
        notes: what a reader must know to believe the rest.
        require_all: whether missing runs are regressions.
    """

    a: SweepTable
    b: SweepTable
    matching: Matching
    changes: tuple[Change, ...]
    metrics: tuple[MetricChange, ...]
    transitions: Mapping[tuple[State, State], int]
    notes: tuple[str, ...]
    require_all: bool = False

    def of_kind(self, *kinds: str) -> list[Change]:
        """Changes of these kinds."""
        return [change for change in self.changes if change.kind in kinds]

    @property
    def regressions(self) -> list[str]:
        """What fails the comparison, in words; empty if nothing does."""
        found = []
        for kind, words in _REGRESSIONS.items():
            count = len(self.of_kind(kind))
            if count:
                found.append(f"{count} {words}")
        missing = len(self.matching.missing)
        if self.require_all and missing:
            found.append(f"{missing} missing")
        return found

    @property
    def sentence(self) -> str:
        """The answer in one sentence."""
        pairs = len(self.matching.a)
        runs = f"{pairs:,} matched run{'' if pairs == 1 else 's'}"
        lacking = "".join(f"; {part}" for part in self.lacking)
        if self.regressions:
            return f"Regression in {runs}: {', '.join(self.regressions)}{lacking}."
        gained = len(self.of_kind("newly_passing"))
        better = sum(item.verdict == "better" for item in self.metrics)
        parts = [f"{gained} newly passing"] if gained else []
        parts += [f"{better} figure{'' if better == 1 else 's'} better over all runs"] if better else []
        if parts:
            return f"No regression in {runs}; {', '.join(parts)}{lacking}."
        changed = any(item.better or item.worse for item in self.metrics) or self.changes
        return f"No {'regression' if changed else 'difference beyond noise'} in {runs}{lacking}."

    @property
    def lacking(self) -> list[str]:
        """What the comparison says nothing of, in words; empty if every run of either sweep has a partner."""
        found = []
        severally = len(self.matching.ambiguous)
        for rows, left, right, name, other in (
            (len(self.matching.missing) - severally, self.a, self.b, "A", "B"),
            (len(self.matching.new), self.b, self.a, "B", "A"),
        ):
            # Runs that only B has are no gap, unless A was to have them.
            unfinished = right.planned > len(right)
            if rows > 0 and (name == "A" or unfinished):
                state = ", which is not finished" if unfinished else ""
                verb = "is" if rows == 1 else "are"
                found.append(f"{rows:,} of the {len(left):,} runs of {name} {verb} missing in {other}{state}")
        if severally:
            found.append(f"{severally:,} of A {'has' if severally == 1 else 'have'} several partners in B")
        if not found:
            open_ends = [name for name, side in (("A", self.a), ("B", self.b)) if side.planned > len(side)]
            if open_ends:
                verb = "is" if len(open_ends) == 1 else "are"
                found.append(f"{' and '.join(open_ends)} {verb} not finished")
        return found


_REGRESSIONS = {
    "newly_failing": "newly failing",
    "worse_outcome": "with a worse outcome",
    "worse_figures": "with a figure worse beyond tolerance",
}


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
    matching = match(a, b)
    allowed = allowed if allowed is not None else {"": TOLERANCE}
    values = uncertainty.bounds if uncertainty is not None else {}
    rows = [
        _Compared.of(name, a, b, matching, allowed.get(name, allowed[""]), values.get(name))
        for name in a.metrics
        if METRIC + name in b and (name in a.limits or name in b.limits)
    ]
    rows = [row for row in rows if row.both.any()]
    return SweepDiff(
        a=a,
        b=b,
        matching=matching,
        changes=tuple(_changes(a, b, matching, rows)),
        metrics=tuple(_metric_changes(a, matching, rows)),
        transitions=Counter(
            zip(
                (STATES[i] for i in a.states[matching.a]),
                (STATES[i] for i in b.states[matching.b]),
                strict=True,
            )
        ),
        notes=(*notes(a, b, matching), *_of_study(uncertainty)),
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


@dataclass(frozen=True)
class _Compared:
    """One metric of all pairs.

    Attributes:
        name: of the metric.
        unit: SI unit.
        before, after: shape (N,).
        both: where it was measured in both sweeps, shape (N,).
        noise: what a difference must exceed to be one, shape (N,).
        from_study: whether that is from a convergence study.
        over_a, over_b: over its limit, shape (N,).
        allowed: growth that is no regression, shape (N,); NaN without a limit.
    """

    name: str
    unit: str
    before: Array
    after: Array
    both: NDArray[np.bool_]
    noise: Array
    from_study: bool
    over_a: NDArray[np.bool_]
    over_b: NDArray[np.bool_]
    allowed: Array

    @classmethod
    def of(
        cls,
        name: str,
        a: SweepTable,
        b: SweepTable,
        matching: Matching,
        share: float,
        uncertainty: float | None,
    ) -> _Compared:
        unit = a.unit(METRIC + name)
        before, after = a.numbers(METRIC + name)[matching.a], b.numbers(METRIC + name)[matching.b]
        both = a.measured[matching.a] & b.measured[matching.b] & np.isfinite(before) & np.isfinite(after)
        floor = np.maximum(
            RELATIVE_FLOOR * np.maximum(np.abs(before), np.abs(after)), ABSOLUTE_FLOOR.get(unit, 0.0)
        )
        limit = b.limit_values(name)[matching.b]
        limit = np.where(np.isnan(limit), a.limit_values(name)[matching.a], limit)
        return cls(
            name=name,
            unit=unit,
            before=before,
            after=after,
            both=both,
            noise=floor if uncertainty is None else np.maximum(floor, uncertainty),
            from_study=uncertainty is not None,
            over_a=_over(a, name)[matching.a],
            over_b=_over(b, name)[matching.b],
            allowed=share * limit,
        )

    @property
    def growth(self) -> Array:
        """Second minus first, zero where it is not measured in both, shape (N,)."""
        return np.where(self.both, self.after - self.before, 0.0)

    @property
    def worse(self) -> NDArray[np.bool_]:
        return self.growth > self.noise

    @property
    def better(self) -> NDArray[np.bool_]:
        return -self.growth > self.noise

    @property
    def regressed(self) -> NDArray[np.bool_]:
        return self.worse & (self.growth > np.where(np.isnan(self.allowed), np.inf, self.allowed))


def _over(sweep: SweepTable, metric: str) -> NDArray[np.bool_]:
    return np.nan_to_num(sweep.used(metric), nan=0.0) > 1.0


def _changes(a: SweepTable, b: SweepTable, matching: Matching, rows: Sequence[_Compared]) -> list[Change]:
    names_a, names_b = a.words("name"), b.words("name")
    varied = [key for key in dict.fromkeys((*a.varied, *b.varied)) if key in a]
    columns = {key: a.table.column(key) for key in varied}
    regressed = [(row.name, row.regressed) for row in rows]
    moved = np.zeros(len(matching.a), dtype=bool)
    for _, mask in regressed:
        moved |= mask
    moved |= a.states[matching.a] != b.states[matching.b]
    found = []
    for i in np.flatnonzero(moved).tolist():
        left, right = int(matching.a[i]), int(matching.b[i])
        before, after = STATES[a.states[left]], STATES[b.states[right]]
        grown = tuple(name for name, mask in regressed if mask[i])
        kind = _kind(before, after, grown, rows, i)
        if kind is None:
            continue
        if kind in ("newly_failing", "verdict_only"):
            over = tuple(row.name for row in rows if row.over_b[i] and not row.over_a[i])
            grown = tuple(dict.fromkeys((*over, *grown)))
        values = {key: column[left].as_py() for key, column in columns.items()}
        found.append(
            Change(
                kind, names_a[left] or str(left), names_b[right] or str(right), values, before, after, grown
            )
        )
    return sorted(found, key=lambda change: (-_SEVERITY[change.after], change.a))


def _kind(
    before: State, after: State, grown: tuple[str, ...], rows: Sequence[_Compared], i: int
) -> str | None:
    """What happened to a run."""
    if {before, after} == {State.PASS, State.OUT_OF_TOLERANCE}:
        # A verdict turns at a limit, however small the step across it; below the noise that is no result.
        worse = after is State.OUT_OF_TOLERANCE
        crossed = [row for row in rows if (row.over_b[i] if worse else row.over_a[i])]
        real = any((row.worse if worse else row.better)[i] for row in crossed)
        if crossed and not real:  # with no figure over its limit the verdict has reasons that are not here
            return "worse_figures" if grown else "verdict_only"
    if before is after:
        return "worse_figures" if grown else None
    if before is State.PASS:
        return "newly_failing"
    if after is State.PASS:
        return "newly_passing"
    if _SEVERITY[before] == _SEVERITY[after]:
        return "worse_figures" if grown else "other_outcome"
    return "worse_outcome" if _SEVERITY[after] > _SEVERITY[before] else "better_outcome"


def _metric_changes(a: SweepTable, matching: Matching, rows: Sequence[_Compared]) -> list[MetricChange]:
    names = a.words("name")
    tests = [_shift_test(row) for row in rows]
    known = [p for p in tests if not math.isnan(p)]
    corrected = iter(false_discovery_control(known, method="bh") if known else [])
    adjusted = [math.nan if math.isnan(p) else float(next(corrected)) for p in tests]
    found = []
    for row, p in zip(rows, adjusted, strict=True):
        both = row.both
        growth, noise = row.growth[both], row.noise[both]
        shift = float(np.median(growth))
        real = not math.isnan(p) and p < SIGNIFICANCE and abs(shift) > float(np.median(noise))
        worst = int(np.argmax(np.where(row.worse, row.growth, -np.inf))) if row.worse.any() else None
        allowed = row.allowed[both]
        found.append(
            MetricChange(
                metric=row.name,
                unit=row.unit,
                pairs=int(both.sum()),
                better=int(row.better.sum()),
                worse=int(row.worse.sum()),
                regressed=int(row.regressed.sum()),
                noise=float(np.median(noise)),
                noise_from="convergence study" if row.from_study else "floating point",
                allowed=None if np.isnan(allowed).all() else float(np.nanmedian(allowed)),
                before=float(np.median(row.before[both])),
                after=float(np.median(row.after[both])),
                shift=shift,
                p=p,
                verdict=_shift_verdict(shift, p, real),
                worst="" if worst is None else names[int(matching.a[worst])],
                worst_before=math.nan if worst is None else float(row.before[worst]),
                worst_after=math.nan if worst is None else float(row.after[worst]),
            )
        )
    return found


def _shift_verdict(shift: float, p: float, real: bool) -> str:
    if math.isnan(p):
        return "too few"
    return ("worse" if shift > 0.0 else "better") if real else "same"


def _shift_test(row: _Compared) -> float:
    """Wilcoxon's signed-rank test of the differences; NaN with too few pairs."""
    growth = np.where(row.worse | row.better, row.growth, 0.0)[row.both]
    if len(growth) < LEAST_PAIRS:
        return math.nan
    if not growth.any():
        return 1.0
    return float(wilcoxon(growth, zero_method="zsplit").pvalue)


def _of_study(uncertainty: Uncertainty | None) -> list[str]:
    if uncertainty is None:
        return []
    inside = f" ({' + '.join(uncertainty.studies)})" if uncertainty.studies else ""
    told = [
        f"the noise is the numerical uncertainty{inside} of {uncertainty.gait}, taken for all gaits of the "
        "sweeps"
    ]
    if uncertainty.not_studied:
        told.append(
            f"not studied: {', '.join(uncertainty.not_studied)}; figures whose uncertainty lacks that have "
            "no bound, and no difference of theirs is called one"
        )
    return told
