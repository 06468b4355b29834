"""Walks side by side, by the metrics of their stored runs; so any planners and controllers can be compared.

A difference counts if it is larger than the values change for numerical reasons: by a convergence study, or,
without one, by the share that the presets show at most.
"""

import json
import math
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, Unpack

from ampm.brief import Brief
from ampm.exceptions import InputError
from validation.judge.metrics import METRICS, added_metrics, cost_entry, display_unit
from validation.judge.profiles import own_profile
from validation.judge.uncertainty import Uncertainty, load_uncertainty, matching, rounding
from validation.show.cost_table import COSTS, LARGER_IS_BETTER, cost_unit
from validation.show.text import format_value
from validation.store.environment import parameter_values
from validation.store.json import json_ready
from validation.store.saved import SavedRun, load_saved_run
from validation.study.many import Execution, Task, open_study, walk_many
from validation.study.row_file import Row
from validation.study.walk_options import users_classes, walk_request
from validation.table import Table, Tabled, format_number, short_unit
from validation.trial.outcome import OutcomeName
from validation.trial.plan import Request, load_request, plan_walk
from validation.trial.users import CONTROLLER, PLANNER, SUFFIXES, UsersError

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


CHOICES = {
    "planner": "gait.planner",
    "body": "body.source",
    "controller": "controller.name",
    "engine": "simulation.engine",
}
"""Options of which one may be given for each walk, and their keys."""


def compare_runs(
    folders: Sequence[str | Path], labels: Sequence[str] = (), uncertainty: Sequence[Path] = ()
) -> WalkComparison:
    """Compare two or more finished runs.

    Args:
        folders: of the runs.
        labels: names in tables; those of the folders by default.
        uncertainty: ``convergence.json`` of all gaits; a bound takes the place of an assumed change.

    Raises:
        InputError: a folder cannot be used, or no study is of one of the gaits.
    """
    known = [load_uncertainty(file) for file in uncertainty]
    labels = _distinct(labels or [Path(folder).resolve().name for folder in folders])
    sides = []
    for label, folder in zip(labels, folders, strict=True):
        run = load_saved_run(folder)
        study = matching(known, Request(label, run.parameters)) if known else None
        sides.append(Side(label, run, study))
    return comparison_of(sides)


def compare_gaits(
    gaits: Sequence[str] = (),
    settings: Sequence[str] = (),
    *,
    choices: Mapping[str, Sequence[str]] = MappingProxyType({}),
    as_is: bool = False,
    uncertainty: Sequence[Path] = (),
    **execution: Unpack[Execution],
) -> WalkComparison:
    """Walk two or more gaits and compare them.

    Args:
        gaits: presets or TOML files. A single one is compared with `ipm`, or walked with every value of the
            option that has several; if none, it is `normal` or the own gait of another body.
        settings: ``key=value`` texts for all gaits; options of planner and controller for those that take
            them.
        choices: option of :data:`CHOICES` to its value for all walks, or to one value for each.
        as_is: find nothing that the gaits leave open.
        uncertainty: as in :func:`compare_runs`.
        execution: workers and folder, see :class:`validation.study.many.Execution`.

    Raises:
        InputError, MathematicalRefusal, BodilyRefusal: a gait cannot be walked.
        StudyStopped: a full disk, or workers that cannot work; finished runs are kept.
        KeyboardInterrupt: Ctrl-C; finished runs are kept.
        UsersError: a user's class failed.
        RuntimeError: a walk crashed.
    """
    folder, pool = open_study(execution)
    texts: list[str | None] = list(gaits) or [None]
    varied = _varied(choices, len(texts))
    if len(texts) == 1:
        texts = texts * len(choices[varied]) if varied else [*texts, "ipm"]
    chosen_ones = [
        {name: given[min(place, len(given) - 1)] for name, given in choices.items() if given}
        for place in range(len(texts))
    ]
    fitting = _fitting(settings, chosen_ones)
    requests, labels = [], []
    for text, chosen, changes in zip(texts, chosen_ones, fitting, strict=True):
        own = [f"{CHOICES[name]}={json.dumps(_absolute(value))}" for name, value in chosen.items()]
        request = load_request(text, [*changes, *own], as_is=as_is)
        # With the values that are found; a refused gait is named before the first walk.
        requests.append(plan_walk(request, pool.get("progress")).request)
        labels.append(f"{request.name}, {varied} {Path(chosen[varied]).name}" if varied else request.name)
    known = [load_uncertainty(file) for file in uncertainty]
    for request in requests if known else ():
        matching(known, request)
    with nullcontext(folder) if folder else tempfile.TemporaryDirectory(prefix="ampm-compare-") as home:
        place = Path(home).resolve()
        folders = [str(place / f"walk-{number}") for number in range(1, len(requests) + 1)]
        titles = {path: request.title for path, request in zip(folders, requests, strict=True)}
        tasks = [
            Task(path, walk_gait, {"request": request, "folder": path, **users_classes(request.run)})
            for path, request in zip(folders, requests, strict=True)
        ]
        for row in walk_many(tasks, place, **pool):
            if "reason" in row:
                kinds = {"refused": InputError, UsersError.__name__: UsersError}
                kind = kinds.get(row["outcome"], kinds.get(row["reason"], RuntimeError))
                raise kind(f"{titles[row['key']]}: {row['cause']}")
        return compare_runs(folders, labels, uncertainty)


def _distinct(labels: Sequence[str]) -> Sequence[str]:
    """Labels with their numbers, unless all differ."""
    if len(set(labels)) == len(labels):
        return labels
    return [f"{label} ({number})" for number, label in enumerate(labels, start=1)]


def _varied(choices: Mapping[str, Sequence[str]], walks: int) -> str:
    """The option that has a value for each walk; empty if there is none.

    Raises:
        InputError: there are two, or it has not one value for each of several walks.
    """
    several = {option: len(values) for option, values in choices.items() if len(values) > 1}
    if len(several) > 1 or (walks > 1 and any(count != walks for count in several.values())):
        times = ", ".join(f"--{option} is given {count} times" for option, count in several.items())
        of = f" of the {walks} walks" if walks > 1 else " walk"
        raise InputError(f"{times}; give one option once for each{of}, and any other once, for all.")
    return next(iter(several), "")


def _fitting(settings: Sequence[str], walks: Sequence[Mapping[str, str]]) -> list[list[str]]:
    """Settings of every walk: an option of a planner or controller only where the chosen one takes it.

    An option that none takes stays, so that it is refused.
    """

    def takes(setting: str, chosen: Mapping[str, str]) -> bool:
        for role in (PLANNER, CONTROLLER):
            key = setting.partition("=")[0].strip()
            if key.startswith(f"{role.options}.") and role.name in chosen:
                text = chosen[role.name]
                return Path(text).suffix not in SUFFIXES and role.takes(text, key.rpartition(".")[2])
        return True

    common = {text for text in settings if not any(takes(text, chosen) for chosen in walks)}
    return [[text for text in settings if text in common or takes(text, chosen)] for chosen in walks]


def _absolute(value: str) -> str:
    """The value of an option; a file's path is absolute."""
    return str(Path(value).resolve()) if Path(value).is_file() else value


def walk_gait(request: Request, folder: str, **users: Any) -> Row:
    """Walk one gait, on a worker, and keep the run in a folder."""
    trial = walk_request(request, own_profile(request.name, request.run), **users)
    trial.save(folder, force=True, recording=False)
    return {"outcome": str(trial.record.outcome.name)}
