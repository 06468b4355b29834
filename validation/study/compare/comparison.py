"""Result of comparing walks, read from their stored runs; the plan too, so any planner can be compared.

A difference counts if it is larger than the values change for numerical reasons: by a convergence study, by
a second walk at half the time step, or, of a finished run, by the share that the presets show at most.
"""

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from string import ascii_lowercase
from typing import Any, NamedTuple

from ampm.brief import Brief
from ampm.exceptions import InputError
from ampm.parameters import RunParameters
from validation.judge.metrics import METRICS, display_unit
from validation.judge.uncertainty import Uncertainty, rounding
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
    own_metrics,
    plan_values,
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
    """One of the walks.

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

    @property
    def planner(self) -> str:
        """Name of the planner."""
        return str(self.summary.get("planner") or "ampm")

    def value(self, item: Quantity) -> float:
        """Value of a quantity in SI units, NaN if the walk has none."""
        return self.values.get(item.name, math.nan)

    def change(self, item: Quantity) -> float:
        """Change of a value for numerical reasons, in SI units; infinite without a bound."""
        value, halved = self.value(item), self.halved.get(item.name, math.nan)
        change = (SHARE_OF_EXTREMES if item.extreme else SHARE) * abs(value)
        if self.study is not None and item.name in self.study.values:
            change = self.study.values[item.name]
        elif math.isfinite(halved):
            change = abs(value - halved)
        return max(change, float(rounding(value, item.unit)))


class Row(NamedTuple):
    """One quantity of all sides, in SI units.

    Attributes:
        of: the quantity.
        values: of the sides, NaN where one has none.
        least: difference above which it counts: the sum of the two largest changes of the sides.
        limit: tolerance; None if it is not judged.
    """

    of: Quantity
    values: tuple[float, ...]
    least: float
    limit: float | None = None

    @property
    def differs(self) -> bool:
        """Whether all values are known and the largest difference counts."""
        return not any(map(math.isnan, self.values)) and max(self.values) - min(self.values) > self.least

    @property
    def better(self) -> int | None:
        """The side with the smallest value; None if its lead does not count."""
        best, second = sorted(self.values)[:2]
        return self.values.index(best) if self.differs and second - best > self.least else None

    @property
    def share(self) -> float:
        """Largest difference as a share of the limit [1]."""
        return (max(self.values) - min(self.values)) / self.limit if self.limit else math.inf


@dataclass(frozen=True)
class WalkComparison(Brief, Tabled):
    """Walks and all their compared quantities.

    Attributes:
        sides: the walks, two or more.
        rows: quantities, group by group.
    """

    sides: tuple[Side, ...]
    rows: tuple[Row, ...]

    @property
    def title(self) -> str:
        """All labels."""
        *others, last = (side.label for side in self.sides)
        return f"{', '.join(others)} and {last}"

    @property
    def parameters(self) -> dict[str, tuple[Any, ...]]:
        """Key to the values of all sides, of every parameter in which they differ."""
        values = [parameter_values(side.parameters) for side in self.sides]
        rows = {key: tuple(item.get(key) for item in values) for key in dict.fromkeys(chain(*values))}
        return {key: row for key, row in rows.items() if any(value != row[0] for value in row)}

    @property
    def basis(self) -> str:
        """What a difference of a judged metric has to exceed."""
        bases = {side.basis for side in self.sides}
        return bases.pop() if len(bases) == 1 else "what can be told"

    @property
    def sentence(self) -> str:
        """The result in one sentence."""
        if {side.outcome for side in self.sides} != {OutcomeName.COMPLETED}:
            return f"{', '.join(f'{side.label} {side.ending}' for side in self.sides)}."
        judged = [row for row in self.rows if row.of.group == JUDGED]
        counted = [row for row in judged if row.differs]
        if not counted:
            return f"{self.title} agree: no judged metric differs by more than {self.basis}."
        label, *values, unit, _, _ = self.cells(max(counted, key=lambda row: row.share))
        most = f"they differ most in {label}: {', '.join(values[:-1])} and {values[-1]} {unit}".rstrip()
        if len(self.sides) > 2:
            found = [f"{self.title} differ in {len(counted)}"]
        else:
            wins = Counter(row.better for row in counted)
            found = [f"{side.label} is better in {wins[k]}" for k, side in enumerate(self.sides) if wins[k]]
        return f"{', '.join(found)} of {len(judged)} judged metrics by more than {self.basis}; {most}."

    def cells(self, row: Row) -> tuple[str, ...]:
        """Label, all values, unit, least difference that counts, and the better side, for tables."""
        factor, unit = display_unit(row.of.unit, float(self.sides[0].summary["scales"]["body_weight"]))
        *values, least = (_shown(factor * value) for value in (*row.values, row.least))
        better = "" if row.better is None else self.sides[row.better].label
        return row.of.label, *values, short_unit(unit), least, better

    def tables(self) -> list[Table]:
        """What differs, and the quantities group by group."""
        heads = ["", *(f">{side.label}" for side in self.sides)]
        bases = list(dict.fromkeys(side.basis for side in self.sides))
        if len(bases) > 1:
            bases = [f"{side.basis} ({side.label})" for side in self.sides]
        notes = [
            f"Smaller is better. A difference counts if it exceeds {' plus '.join(bases)}.",
            "The first step is left out. Measured values are compared with the own plan of each walk.",
        ]
        if any(side.study for side in self.sides):
            notes.append(
                "What a convergence study lacks counts from its change at half the time step, or, of a "
                f"finished run, from {100 * SHARE:g} % ({100 * SHARE_OF_EXTREMES:g} % of largest values)."
            )
        columns = [*heads, "unit", ">counts from", "better" if len(self.sides) == 2 else "best"]
        groups = dict.fromkeys(row.of.group for row in self.rows)
        return [
            Table("the walks", heads, list(self._facts()), notes),
            *(
                Table(group, columns, [self.cells(row) for row in self.rows if row.of.group == group])
                for group in groups
            ),
        ]

    def _facts(self) -> Iterator[tuple[str, ...]]:
        """How the walks ended, and in what they differ; a walk from Python may have more than its keys."""
        for name in ("outcome", "verdict", "profile"):
            yield name, *(str(side.summary[name]) for side in self.sides)
        more = {
            "planner": [side.planner for side in self.sides],
            "controller": [side.summary.get("controller", "ampm") for side in self.sides],
            "disturbances": ["; ".join(side.summary.get("disturbances", ["none"])) for side in self.sides],
        }
        for name, values in more.items():
            if len(set(values)) > 1:
                yield name, *values
        for key, row in self.parameters.items():
            if key not in ("gait.planner", "controller.name") and not key.startswith("disturbance."):
                shown = [f"{len(value or ())} footsteps" if key == "footsteps" else value for value in row]
                yield key, *map(format_value, shown)

    def as_dict(self) -> dict[str, Any]:
        """Everything, as plain data in SI units; sides are ``a``, ``b`` and so on."""
        sides: dict[str, Any] = {
            name: {"label": side.label, "differences_count_from": side.basis}
            | {key: side.summary[key] for key in ("outcome", "verdict", "profile", "steps_completed")}
            for name, side in zip(ascii_lowercase, self.sides, strict=False)
        }
        quantities = {
            row.of.name: {"group": row.of.group, "label": row.of.label, "unit": row.of.unit}
            | dict(zip(ascii_lowercase, row.values, strict=False))
            | {"counts_from": row.least, "better": "" if row.better is None else ascii_lowercase[row.better]}
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
    names = (*METRICS, *own_metrics([run.summary]))
    metrics = {name: metric_entry(run.summary, name).get("value") for name in names}
    return {
        **plan_values(run.signals, run.record.mass),
        **switch_values(run.signals, run.record),
        **{name: math.nan if value is None else value for name, value in metrics.items()},
    }


def comparison_of(sides: Sequence[Side]) -> WalkComparison:
    """All quantities of two or more walks; judged metrics first."""
    limits: dict[str, float] = {}
    own = own_metrics([side.summary for side in sides])
    for side in reversed(sides):  # of several limits the first side's counts
        entries = {name: metric_entry(side.summary, name).get("tolerance") for name in (*METRICS, *own)}
        limits |= {name: limit for name, limit in entries.items() if limit is not None}
    metrics = metric_quantities(set(limits), own)
    judged = [item for item in metrics if item.group == JUDGED]
    rows = [
        Row(
            item,
            tuple(side.value(item) for side in sides),
            sum(sorted(side.change(item) for side in sides)[-2:]),
            limits.get(item.name),
        )
        for item in (*judged, *PLAN, *SWITCH, *metrics[len(judged) :])
    ]
    return WalkComparison(tuple(sides), tuple(rows))
