"""Result of comparing two walks, read from their stored runs; the plan too, so any planner can be compared.

A difference counts if it is larger than both values change for numerical reasons: by a convergence study, by
a second walk at half the time step, or, of a finished run, by the share that the presets show at most.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from ampm.brief import Brief
from ampm.exceptions import InputError
from ampm.parameters import RunParameters
from validation.judge.metrics import METRICS, display_unit
from validation.judge.uncertainty import Uncertainty
from validation.show.text import format_value
from validation.store.identity import parameter_values
from validation.store.json import json_ready
from validation.store.saved import load_saved_run
from validation.study.compare.metrics import (
    JUDGED,
    PLAN,
    SWITCH,
    Quantity,
    metric_entry,
    metric_quantities,
    plan_values,
    rounding,
    switch_values,
)
from validation.table import Table, Tabled, format_number, short_unit
from validation.trial.outcome import OutcomeName

SHARE, SHARE_OF_EXTREMES = 0.1, 0.4
"""Assumed change of a value, and of a largest value, at half the time step [1].

Of the presets, judged RMSEs change by 9.5 % at most (``momentum``), largest errors by 38 % (``pitch``).
"""


@dataclass(frozen=True)
class Side(Brief):
    """One of the two walks.

    Attributes:
        label: name in tables.
        folder: of the run.
        parameters: of the run.
        summary: ``summary.json``.
        values: name of a quantity to its value in SI units, NaN if it has none.
        halved: the same at half the time step; empty if that was not walked.
        study: convergence study of the gait.
    """

    label: str
    folder: Path
    parameters: RunParameters
    summary: Mapping[str, Any]
    values: Mapping[str, float]
    halved: Mapping[str, float]
    study: Uncertainty | None

    @property
    def outcome(self) -> str:
        """Name of the outcome."""
        return str(self.summary["outcome"])

    @property
    def ending(self) -> str:
        """How the walk ended, in words."""
        if self.outcome == OutcomeName.COMPLETED:
            return "walked to the end"
        return f"did not walk to the end ({self.outcome} after {self.summary['end']['time']:.2f} s)"

    @property
    def basis(self) -> str:
        """Where :meth:`change` of a judged metric comes from."""
        if self.study is not None:
            return "their numerical uncertainty"
        if self.halved:
            return "their own changes at half the time step"
        return f"{100 * SHARE:g} % ({100 * SHARE_OF_EXTREMES:g} % of largest values)"

    def change(self, item: Quantity) -> float:
        """Change of a value for numerical reasons, in SI units; infinite without a bound."""
        value, halved = self.values[item.name], self.halved.get(item.name, math.nan)
        change = (SHARE_OF_EXTREMES if item.extreme else SHARE) * abs(value)
        if self.study is not None and item.name in self.study.bounds:
            change = self.study.bounds[item.name]
        elif math.isfinite(halved):
            change = abs(value - halved)
        return max(change, float(rounding(value, item.unit)))


class Row(NamedTuple):
    """One quantity of both sides, in SI units.

    Attributes:
        of: the quantity.
        a: value of the first side, NaN if it has none.
        b: of the second side.
        least: difference above which it counts.
        limit: tolerance; None if it is not judged.
    """

    of: Quantity
    a: float
    b: float
    least: float
    limit: float | None = None

    @property
    def better(self) -> str:
        """``a`` or ``b``; empty if a value is missing, or the difference does not count."""
        return ("a" if self.a < self.b else "b") if abs(self.a - self.b) > self.least else ""

    @property
    def share(self) -> float:
        """Difference as a share of the limit [1]."""
        return abs(self.a - self.b) / self.limit if self.limit else math.inf


@dataclass(frozen=True)
class Pair(Brief, Tabled):
    """Both sides and all their compared quantities.

    Attributes:
        a: first side.
        b: second side.
        rows: quantities, group by group.
    """

    a: Side
    b: Side
    rows: tuple[Row, ...]

    @property
    def title(self) -> str:
        """Both labels."""
        return f"{self.a.label} and {self.b.label}"

    @property
    def parameters(self) -> dict[str, tuple[Any, Any]]:
        """Key to the values of both sides, of every parameter in which they differ."""
        one, two = (parameter_values(side.parameters) for side in (self.a, self.b))
        keys = dict.fromkeys((*one, *two))
        return {key: (one.get(key), two.get(key)) for key in keys if one.get(key) != two.get(key)}

    @property
    def sentence(self) -> str:
        """The result in one sentence."""
        a, b = self.a, self.b
        if {a.outcome, b.outcome} != {OutcomeName.COMPLETED}:
            return f"{a.label} {a.ending}, {b.label} {b.ending}."
        basis = a.basis if a.basis == b.basis else "what can be told"
        judged = [row for row in self.rows if row.of.group == JUDGED]
        counted = [row for row in judged if row.better]
        if not counted:
            return f"{self.title} agree: no judged metric differs by more than {basis}."
        numbers = [
            (side.label, sum(row.better == name for row in counted)) for side, name in ((a, "a"), (b, "b"))
        ]
        better = ", ".join(f"{label} is better in {number}" for label, number in numbers if number)
        label, one, two, unit, *_ = self.cells(max(counted, key=lambda row: row.share))
        values = f"{one} and {two} {unit}".rstrip()
        return (
            f"{better} of {len(judged)} judged metrics by more than {basis}; they differ most in {label}: "
            f"{values}."
        )

    def cells(self, row: Row) -> tuple[str, ...]:
        """Label, both values, unit, least difference that counts, and the better side, for tables."""
        factor, unit = display_unit(row.of.unit, float(self.a.summary["scales"]["body_weight"]))
        a, b, least = (_shown(factor * value) for value in (row.a, row.b, row.least))
        better = {"a": self.a.label, "b": self.b.label, "": ""}[row.better]
        return row.of.label, a, b, short_unit(unit), least, better

    def tables(self) -> list[Table]:
        """What differs, and the quantities group by group."""
        a, b = self.a, self.b
        heads = ["", f">{a.label}", f">{b.label}"]
        facts = [
            (name, str(a.summary[name]), str(b.summary[name])) for name in ("outcome", "verdict", "profile")
        ]
        facts += [(key, format_value(one), format_value(two)) for key, (one, two) in self.parameters.items()]
        bases = a.basis if a.basis == b.basis else f"{a.basis} ({a.label}) plus {b.basis} ({b.label})"
        notes = [
            f"Smaller is better. A difference counts if it exceeds {bases}.",
            "The first step is left out. Measured values are compared with the own plan of each walk.",
        ]
        if a.study or b.study:
            notes.append(
                "What a convergence study lacks counts from its change at half the time step, or, of a "
                f"finished run, from {100 * SHARE:g} % ({100 * SHARE_OF_EXTREMES:g} % of largest values)."
            )
        columns = [*heads, "unit", ">counts from", "better"]
        groups = dict.fromkeys(row.of.group for row in self.rows)
        return [
            Table("both walks", heads, facts, notes),
            *(
                Table(group, columns, [self.cells(row) for row in self.rows if row.of.group == group])
                for group in groups
            ),
        ]

    def as_dict(self) -> dict[str, Any]:
        """Everything, as plain data in SI units."""
        sides: dict[str, Any] = {
            name: {"label": side.label, "differences_count_from": side.basis}
            | {key: side.summary[key] for key in ("outcome", "verdict", "profile", "steps_completed")}
            for name, side in (("a", self.a), ("b", self.b))
        }
        quantities = {
            row.of.name: {"group": row.of.group, "label": row.of.label, "unit": row.of.unit}
            | {"a": row.a, "b": row.b, "counts_from": row.least, "better": row.better}
            for row in self.rows
        }
        found = {"sentence": self.sentence, **sides, "parameters": self.parameters, "quantities": quantities}
        return dict(json_ready(found))


def _shown(value: float) -> str:
    """A value for a table: rounding errors are 0."""
    return "0" if abs(value) < 1e-9 else format_number(value, 3)


def load_side(label: str, folder: Path, half: Path | None = None, study: Uncertainty | None = None) -> Side:
    """Read a run.

    Args:
        label: name in tables.
        folder: of the run.
        half: of the same walk at half the time step.
        study: convergence study of the gait.

    Raises:
        InputError: a folder cannot be used.
    """
    run = load_saved_run(folder)
    halved = {} if half is None else _values(half)
    return Side(label, folder, run.parameters, run.summary, _values(folder), halved, study)


def _values(folder: Path) -> dict[str, float]:
    """All quantities of a run, in SI units."""
    run = load_saved_run(folder, check=False)
    if len(run.signals) < 2:
        raise InputError(f"the run in {folder} ended before its first instant; there is nothing to compare.")
    metrics = {name: metric_entry(run.summary, name).get("value") for name in METRICS}
    return {
        **plan_values(run.signals, run.record.mass),
        **switch_values(run.signals, run.record),
        **{name: math.nan if value is None else value for name, value in metrics.items()},
    }


def pair_of(a: Side, b: Side) -> Pair:
    """All quantities of two walks; judged metrics first."""
    limits: dict[str, float] = {}
    for side in (b, a):  # of two limits the first side's counts
        entries = {name: metric_entry(side.summary, name).get("tolerance") for name in METRICS}
        limits |= {name: limit for name, limit in entries.items() if limit is not None}
    metrics = metric_quantities(set(limits))
    judged = [item for item in metrics if item.group == JUDGED]
    rows = [
        Row(
            item,
            a.values[item.name],
            b.values[item.name],
            a.change(item) + b.change(item),
            limits.get(item.name),
        )
        for item in (*judged, *PLAN, *SWITCH, *metrics[len(judged) :])
    ]
    return Pair(a, b, tuple(rows))
