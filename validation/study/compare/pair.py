"""Result of comparing two walks, read from their stored runs; the plan too, so any planner can be compared.

A difference counts if it is larger than both values change for numerical reasons: by a convergence study, by
a second walk at half the time step, or, of a finished run, by the share that the presets show at most.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from ampm.brief import Brief
from ampm.exceptions import InputError
from ampm.parameters import RunParameters
from validation.judge.uncertainty import Uncertainty
from validation.show.text import BODY_WEIGHT, format_number, format_value
from validation.store.identity import parameter_values
from validation.store.json import json_ready
from validation.store.saved import load_saved_run
from validation.study.compare.metrics import (
    JUDGED,
    OTHER,
    PLAN,
    SWITCH,
    Quantity,
    metric_limit,
    metric_quantities,
    metric_values,
    plan_values,
    rounding,
    switch_values,
)
from validation.table import Table
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
        values: name of a quantity to its value as shown, NaN if it has none.
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
    def weight(self) -> float:
        """Of the body [N]."""
        return float(self.summary["scales"]["body_weight"])

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
        """Where :meth:`change` comes from."""
        if self.study is not None:
            return "their numerical uncertainty"
        if self.halved:
            return "their own changes at half the time step"
        return f"{100 * SHARE:g} % ({100 * SHARE_OF_EXTREMES:g} % of largest values)"

    def change(self, item: Quantity) -> float:
        """Change of a value for numerical reasons, as shown; infinite without a bound."""
        factor, unit = item.si_unit(self.weight)
        value, halved = self.values[item.name], self.halved.get(item.name, math.nan)
        change = (SHARE_OF_EXTREMES if item.extreme else SHARE) * abs(value)
        if self.study is not None and item.studied_name in self.study.bounds:
            change = self.study.bounds[item.studied_name] / factor
        elif math.isfinite(halved):
            change = abs(value - halved)
        return max(change, float(rounding(factor * value, unit)) / factor)


class Row(NamedTuple):
    """One quantity of both sides.

    Attributes:
        of: the quantity.
        a: value of the first side as shown, NaN if it has none.
        b: of the second side.
        least: difference above which it counts.
        limit: tolerance as shown; None if it is not judged.
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
class Pair(Brief):
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
        numbers = {
            side.label: sum(row.better == name for row in counted) for name, side in (("a", a), ("b", b))
        }
        parts = [f"{label} is better in {number}" for label, number in numbers.items() if number]
        most = max(counted, key=lambda row: row.share)
        values = f"{_shown(most.a)} and {_shown(most.b)} {most.of.unit}".rstrip()
        return (
            f"{', '.join(parts)} of {len(judged)} judged metrics by more than {basis}; they differ most in "
            f"{most.of.label}: {values}."
        )

    def tables(self) -> list[Table]:
        """What differs, and the quantities group by group."""
        a, b = self.a, self.b
        heads = ["", f">{a.label}", f">{b.label}"]
        facts = [
            (name, *(str(side.summary[name]) for side in (a, b)))
            for name in ("outcome", "verdict", "profile")
        ]
        facts += [(key, format_value(one), format_value(two)) for key, (one, two) in self.parameters.items()]
        names = {"a": a.label, "b": b.label, "": ""}
        groups: dict[str, list[Sequence[str]]] = {}
        for row in self.rows:
            unit = row.of.unit.replace("% of body weight", BODY_WEIGHT)
            numbers = (_shown(row.a), _shown(row.b), unit, _shown(row.least), names[row.better])
            groups.setdefault(row.of.group, []).append((row.of.label, *numbers))
        bases = a.basis if a.basis == b.basis else f"{a.basis} ({a.label}) plus {b.basis} ({b.label})"
        notes = [
            f"Smaller is better. A difference counts if it exceeds {bases}.",
            "The first step is left out. Measured values are compared with the own plan of each walk.",
        ]
        columns = [*heads, "unit", ">counts from", "better"]
        return [
            Table("both walks", heads, facts, notes),
            *(Table(group, columns, rows) for group, rows in groups.items()),
        ]

    def as_dict(self) -> dict[str, Any]:
        """Everything, as plain data."""
        sides: dict[str, Any] = {
            name: {"label": side.label, "differences_count_from": side.basis}
            | {key: side.summary[key] for key in ("outcome", "verdict", "profile", "steps_completed")}
            for name, side in (("a", self.a), ("b", self.b))
        }
        quantities = {
            row.of.name: {key: getattr(row.of, key) for key in ("group", "label", "unit")}
            | {"a": row.a, "b": row.b, "counts_from": row.least, "better": row.better}
            for row in self.rows
        }
        return dict(
            json_ready(
                {"sentence": self.sentence, **sides, "parameters": self.parameters, "quantities": quantities}
            )
        )


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
    """All quantities of a run, as shown."""
    run = load_saved_run(folder, check=False)
    if len(run.signals) < 2:
        raise InputError(f"the run in {folder} ended before its first instant; there is nothing to compare.")
    record = run.record
    return {
        **plan_values(run.signals, record.mass),
        **switch_values(run.signals, record),
        **metric_values(run.summary, record.mass * record.gravity),
    }


def pair_of(a: Side, b: Side) -> Pair:
    """All quantities of two walks; judged metrics first."""
    metrics = metric_quantities(a.weight, a.summary, b.summary)
    judged, costs = ([item for item in metrics if item.group == group] for group in (JUDGED, OTHER))
    rows = []
    for item in (*judged, *PLAN, *SWITCH, *costs):
        limits = [metric_limit(side.summary, item.name) for side in (a, b) if item.group == JUDGED]
        limit = next((limit for limit in limits if limit is not None), None)
        rows.append(
            Row(item, a.values[item.name], b.values[item.name], a.change(item) + b.change(item), limit)
        )
    return Pair(a, b, tuple(rows))
