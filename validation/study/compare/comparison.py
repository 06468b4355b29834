"""Walks side by side, by the metrics of their stored runs; so any planners and controllers can be compared.

A difference counts if it is larger than the values change for numerical reasons: by a convergence study, or,
without one, by the share that the presets show at most.
"""

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from ampm.brief import Brief
from validation.judge.metrics import METRICS, added_metrics, cost_entry, display_unit
from validation.judge.uncertainty import Uncertainty, rounding
from validation.show.cost_table import COSTS, LARGER_IS_BETTER, cost_unit
from validation.show.text import format_value
from validation.store.environment import parameter_values
from validation.store.json import json_ready
from validation.store.saved import SavedRun
from validation.table import Table, Tabled, format_number, short_unit
from validation.trial.outcome import OutcomeName

SHARE, SHARE_OF_EXTREMES = 0.1, 0.4
"""Assumed numerical change of a value, and of a largest value, without a convergence study [1].

At half the time step, judged RMSEs of the presets change by 9.5 % at most (``momentum``), largest errors by
38 % (``pitch``).
"""
JUDGED, COST, OWN = "judged metrics", "cost", "own metrics without a limit"


@dataclass(frozen=True)
class Side(Brief):
    """One of the walks."""

    label: str  # name in tables
    run: SavedRun  # the finished run
    study: Uncertainty | None = None  # convergence study of its gait; None if none is known

    @property
    def outcome(self) -> str:
        """Name of the outcome."""
        return str(self.run.summary["outcome"])

    @property
    def ending(self) -> str:
        """How the walk ended, in words."""
        if self.outcome == OutcomeName.COMPLETED:
            return "walked to the end"
        return f"did not walk to the end ({self.outcome} after {self.run.summary['end']['time']:.2f} s)"

    @property
    def basis(self) -> str:
        """Where :meth:`change` comes from."""
        if self.study is not None:
            return "their numerical uncertainties, added"
        return f"{100 * SHARE:g} % ({100 * SHARE_OF_EXTREMES:g} % of largest values)"

    @property
    def weight(self) -> float:
        """Of the body [N]."""
        return float(self.run.summary["scales"]["body_weight"])

    @property
    def planner(self) -> str:
        """Name of the planner."""
        return str(self.run.summary.get("planner") or "ampm")

    def entry(self, name: str) -> Mapping[str, Any]:
        """What ``summary.json`` says of a metric; empty if it says nothing."""
        if name in METRICS and METRICS[name].section:
            found = cost_entry(self.run.summary, METRICS[name])
            return found if isinstance(found, Mapping) else {"value": found}
        return dict(self.run.summary["metrics"].get(name, {}))

    def value(self, name: str) -> float:
        """Value of a metric in SI units, NaN if the walk has none."""
        value = self.entry(name).get("value")
        return math.nan if value is None else float(value)

    def change(self, name: str, unit: str) -> float:
        """Change of a metric for numerical reasons, in SI units; infinite without a bound."""
        value = self.value(name)
        is_extreme = name in METRICS and METRICS[name].nature == "extreme"
        change = (SHARE_OF_EXTREMES if is_extreme else SHARE) * abs(value)
        if self.study is not None and name in self.study.values:
            change = self.study.values[name]
        return max(change, float(rounding(value, unit)))


class MetricRow(NamedTuple):
    """One metric of all sides, in SI units."""

    group: str  # heading that it stands under
    name: str  # of the metric
    label: str  # in words
    unit: str  # SI unit
    values: tuple[float, ...]  # of the sides, NaN where one has none
    # difference above which it counts: the change of the smallest value, or the sum of the two largest
    # uncertainties by studies
    least: float
    limit: float | None = None  # tolerance; None if it is not judged

    @property
    def differs(self) -> bool:
        """Whether all values are known and the largest difference counts."""
        return not any(map(math.isnan, self.values)) and max(self.values) - min(self.values) > self.least

    @property
    def better(self) -> int | None:
        """The side with the best value; None if its lead does not count."""
        best, second = sorted(self.values, reverse=self.name in LARGER_IS_BETTER)[:2]
        return self.values.index(best) if self.differs and abs(second - best) > self.least else None

    @property
    def share(self) -> float:
        """Largest difference as a share of the limit [1]."""
        return (max(self.values) - min(self.values)) / self.limit if self.limit else math.inf


@dataclass(frozen=True)
class WalkComparison(Tabled):
    """Walks and all their compared metrics."""

    sides: tuple[Side, ...]  # the walks, two or more
    rows: tuple[MetricRow, ...]  # metrics, group by group

    @property
    def title(self) -> str:
        """All labels."""
        *others, last = (side.label for side in self.sides)
        return f"{', '.join(others)} and {last}"

    @property
    def parameters(self) -> dict[str, tuple[Any, ...]]:
        """Key to the values of all sides, of every parameter in which they differ."""
        values = [parameter_values(side.run.parameters) for side in self.sides]
        rows = {key: tuple(item.get(key) for item in values) for item in values for key in item}
        return {key: row for key, row in rows.items() if any(value != row[0] for value in row)}

    @property
    def sentence(self) -> str:
        """The result in one sentence."""
        if {side.outcome for side in self.sides} != {OutcomeName.COMPLETED}:
            return f"{', '.join(f'{side.label} {side.ending}' for side in self.sides)}."
        basis = self.sides[0].basis
        judged = [row for row in self.rows if row.group == JUDGED]
        counted = [row for row in judged if row.differs]
        if not counted:
            return f"{self.title} agree: no judged metric differs by more than {basis}."
        label, *values, unit, _, _ = self.cells(max(counted, key=lambda row: row.share))
        most = f"they differ most in {label}: {', '.join(values[:-1])} and {values[-1]} {unit}".rstrip()
        if len(self.sides) > 2:
            found = [f"{self.title} differ in {len(counted)}"]
        else:
            wins = Counter(row.better for row in counted)
            found = [f"{side.label} is better in {wins[k]}" for k, side in enumerate(self.sides) if wins[k]]
        return f"{', '.join(found)} of {len(judged)} judged metrics by more than {basis}; {most}."

    def cells(self, row: MetricRow) -> tuple[str, ...]:
        """Label, all values, unit, least difference that counts, and the better side, for tables."""
        shown = [
            cost_unit(METRICS[row.name], side.weight)
            if row.group == COST
            else display_unit(row.unit, side.weight)
            for side in self.sides
        ]
        unit, values = shown[0][1], [_shown(shown[k][0] * value) for k, value in enumerate(row.values)]
        least = _shown(shown[0][0] * row.least)
        better = "" if row.better is None else self.sides[row.better].label
        return row.label, *values, short_unit(unit), least, better

    def tables(self) -> list[Table]:
        """What differs, and the metrics group by group."""
        heads = ["", *(f">{side.label}" for side in self.sides)]
        notes = (
            f"A difference counts if it is larger than {self.sides[0].basis}. Smaller is better, except for "
            "margins, distances and flexion.",
            "The first step is left out. Measured values are compared with the own plan of each walk.",
            *self._warnings(),
        )
        columns = [*heads, "unit", ">counts from", "better" if len(self.sides) == 2 else "best"]
        tables = [Table("the walks", heads, list(self._facts()), notes)]
        for group in (JUDGED, COST, OWN):
            rows = [self.cells(row) for row in self.rows if row.group == group]
            if rows:
                tables.append(Table(group, columns, rows))
        return tables

    def _warnings(self) -> Iterator[str]:
        """What makes the values of the walks hard to compare."""
        weights = [side.weight for side in self.sides]
        if max(weights) > 1.01 * min(weights):
            yield "The bodies differ in size, which errors in mm and N m s do not take into account."

    def _facts(self) -> Iterator[tuple[str, ...]]:
        """How the walks ended, and in what they differ; a walk from Python may have more than its keys."""
        summaries = [side.run.summary for side in self.sides]
        for name in ("outcome", "verdict", "profile"):
            yield name, *(str(summary[name]) for summary in summaries)
        more = {
            "planner": [side.planner for side in self.sides],
            "controller": [summary.get("controller", "ampm") for summary in summaries],
            "disturbances": ["; ".join(summary.get("disturbances", ["none"])) for summary in summaries],
        }
        for name, values in more.items():
            if len(set(values)) > 1:
                yield name, *values
        for key, row in self.parameters.items():
            if key not in ("gait.planner", "controller.name") and not key.startswith("disturbance."):
                shown = [f"{len(value or ())} footsteps" if key == "footsteps" else value for value in row]
                yield key, *map(format_value, shown)

    def as_dict(self) -> dict[str, Any]:
        """Everything, as plain data in SI units; lists have one entry for each walk."""
        walks = [
            {"label": side.label, "differences_count_from": side.basis}
            | {key: side.run.summary[key] for key in ("outcome", "verdict", "profile", "steps_completed")}
            for side in self.sides
        ]
        metrics = {row.name: {**row._asdict(), "better": row.better} for row in self.rows}
        found = {"sentence": self.sentence, "walks": walks, "parameters": self.parameters, "metrics": metrics}
        return dict(json_ready(found))


def _shown(value: float) -> str:
    """A value for a table: rounding errors are 0."""
    return "0" if abs(value) < 1e-9 else format_number(value, 3)


def comparison_of(sides: Sequence[Side]) -> WalkComparison:
    """All metrics of two or more walks: judged ones, costs, and users' own without a limit.

    Checks of the measurement itself are left out. Of several limits the first side's counts.
    """
    built_in = METRICS.keys() - {metric.name for metric in added_metrics()}
    rows: dict[str, list[MetricRow]] = {JUDGED: [], COST: [], OWN: []}
    entries: dict[str, Mapping[str, Any]] = {}
    for side in reversed(sides):  # this process may not know users' metrics, but the summaries say all
        entries |= side.run.summary["metrics"]
    for name in COSTS:
        entries.setdefault(name, {"label": METRICS[name].label, "unit": METRICS[name].unit, "kind": "cost"})
    for name, entry in entries.items():
        tolerances = (side.entry(name).get("tolerance") for side in sides)
        limit = next((value for value in tolerances if value is not None), None)
        group = JUDGED if limit is not None else COST if name in COSTS else OWN
        if entry["kind"] == "instrument" or (group == OWN and name in built_in):
            continue
        values = tuple(side.value(name) for side in sides)
        changes = sorted(side.change(name, entry["unit"]) for side in sides)
        studied = all(side.study is not None and name in side.study.values for side in sides)
        least = sum(changes[-2:]) if studied else changes[0]
        rows[group].append(MetricRow(group, name, entry["label"], entry["unit"], values, least, limit))
    return WalkComparison(tuple(sides), tuple(row for group in rows.values() for row in group))
