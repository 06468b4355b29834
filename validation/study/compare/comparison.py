"""Walks side by side, by the metrics of their stored runs; so any planners and controllers can be compared.

A difference counts if it is larger than the doubt: the numerical uncertainty by a convergence study, or,
without one, the share by which the presets' values change at half the time step.
"""

import math
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, zip_longest
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, Unpack

import numpy as np

from ampm.brief import Brief
from ampm.exceptions import InputError
from ampm.files import absolute, quoted
from validation.judge.compare import PARTS
from validation.judge.margins import SATURATED
from validation.judge.metrics import METRICS, SIZES, added_metrics, cost_entry, display_unit, size_in_si
from validation.judge.uncertainty import Uncertainty, load_uncertainty, matching, rounding
from validation.show.cost_table import COSTS, cost_limit, cost_unit
from validation.store.environment import parameter_values
from validation.store.json import json_ready
from validation.store.saved import SavedRun, load_saved_run
from validation.study.many import Execution, Task, keep_run, study_folder, walk_many
from validation.study.robustness.study import Robustness, load_robustness
from validation.table import USED, Table, Tabled, format_share, format_value, short_unit, with_uncertainty
from validation.trial.outcome import OutcomeName
from validation.trial.plan import Request, load_request, plan_walk
from validation.trial.users import UsersError

SHARE = 0.4
"""Assumed numerical change of a value without a convergence study [1].

At half the time step, judged errors of the presets change by 39 % of the smaller value at most (L_y in
``pitch-low``; RMS errors of the ZMP 13 %, largest errors 32 %). ``costs.csv`` has those of costs.
"""
JUDGED, COST, OWN = "judged metrics", "cost", "own metrics without a limit"
_ZMP_ERRORS = frozenset(f"zmp_{place}{axis}_rmse" for place in ("", "foot_") for axis in "xy")
_OF_RUN = ("disturbance.", "sensors.")  # disturbances by keys of the run, which its study has, too


@dataclass(frozen=True)
class Side(Brief):
    """One of the walks."""

    label: str  # name in tables
    run: SavedRun  # the finished run
    study: Uncertainty | None = None  # convergence study of its gait; None if none is known
    robustness: Robustness | None = None  # of the same gait and walker; None if none is known

    def __post_init__(self) -> None:
        """Refuse a robustness study of another gait, planner, body or controller; settings may differ."""
        if (study := self.robustness) is None:
            return
        run = self.run.parameters
        own = self.run.summary["gait"], run.gait.planner, run.body.source, run.controller.name
        its = study.gait.partition(", ")[0], study.planner, study.body, study.controller
        if own != its:
            raise InputError(
                f"--robustness of {self.label} is of {', '.join(its)}, and the walk is of {', '.join(own)} "
                "(gait, planner, body, controller); give the study of each walk, in their order, or none."
            )

    @property
    def outcome(self) -> str:
        """Name of the outcome."""
        return str(self.run.summary["outcome"])

    def number(self, name: str, key: str = "value") -> float:
        """Value or tolerance of a metric in SI units; NaN if the walk has none."""
        summary = self.run.summary
        if name not in COSTS:
            found = summary["metrics"].get(name, {}).get(key)
        elif key == "tolerance":
            found = cost_limit(summary, name)
        else:
            found = cost_entry(summary, METRICS[name])
            found = found["value"] if isinstance(found, Mapping) else found
        return math.nan if found is None else float(found)

    def doubt(self, name: str, unit: str) -> float:
        """Change of a metric for numerical reasons, in SI units; infinite without a bound."""
        value, known = self.number(name), self.studied(name)
        if math.isnan(known):
            cost = COSTS.get(name)
            share, least = (float(cost["change"]), float(cost["least"])) if cost else (SHARE, 0.0)
            known = max(share * abs(value), least)
        return max(known, float(rounding(value, unit)))

    def studied(self, name: str) -> float:
        """Numerical uncertainty of a metric by the study, in SI units; NaN if it is not known."""
        return math.nan if self.study is None else self.study.values.get(name, math.nan)


class MetricRow(NamedTuple):
    """One metric of all sides."""

    group: str  # heading that it stands under
    name: str  # of the metric
    label: str  # in words
    unit: str  # of all numbers, as tables show it
    values: tuple[float, ...]  # of the sides, NaN where one has none
    # difference from which it counts: the largest uncertainty by studies, or the change that is assumed of
    # the smallest value
    doubt: float
    limits: tuple[float, ...] = ()  # of the sides, NaN where there is none
    known: tuple[float, ...] = ()  # uncertainties of the values by studies, NaN without one

    @property
    def differs(self) -> bool:
        """Whether all values are known and the largest difference counts."""
        return self.known_of_all and max(self.values) - min(self.values) > self.doubt

    @property
    def known_of_all(self) -> bool:
        """Whether every side has a value."""
        return not any(map(math.isnan, self.values))

    @property
    def better(self) -> int | None:
        """The side with the best value; None if its lead does not count."""
        larger_is_better = bool(COSTS.get(self.name, {}).get("larger_is_better"))
        best, second = sorted(self.values, reverse=larger_is_better)[:2]
        return self.values.index(best) if self.differs and abs(second - best) > self.doubt else None

    @property
    def used(self) -> list[float]:
        """Shares of the limits, NaN where there is none, infinite beyond a limit of zero."""
        pairs = zip(self.values, self.limits, strict=True)
        return [value / limit if limit else value and value * math.inf for value, limit in pairs]


@dataclass(frozen=True)
class WalkComparison(Tabled):
    """Walks side by side."""

    sides: Sequence[Side]  # the walks, two or more

    @cached_property
    def rows(self) -> list[MetricRow]:
        """Judged metrics, costs, and users' own without a limit; checks of the measurement are left out."""
        entries: dict[str, Mapping[str, Any]] = {
            name: {"label": METRICS[name].label, "unit": METRICS[name].unit, "kind": "cost"} for name in COSTS
        }
        # This process may not know users' metrics, but the summaries say all.
        for side in reversed(self.sides):
            entries |= side.run.summary["metrics"]
        every = [self._row(*item) for item in entries.items() if item[1]["kind"] != "instrument"]
        built_in = METRICS.keys() - {metric.name for metric in added_metrics()}
        rows = [row for row in every if row.group != OWN or row.name not in built_in]
        return sorted(rows, key=lambda row: (JUDGED, COST, OWN).index(row.group))

    def _row(self, name: str, entry: Mapping[str, Any]) -> MetricRow:
        """One metric by its entry in a summary."""
        shown = [self.shown(name, entry["unit"], side) for side in self.sides]
        pairs = [(side, scale) for side, (scale, _) in zip(self.sides, shown, strict=True)]
        values = tuple(scale * side.number(name) for side, scale in pairs)
        limits = tuple(scale * side.number(name, "tolerance") for side, scale in pairs)
        group = COST if name in COSTS else OWN if all(map(math.isnan, limits)) else JUDGED
        doubts = [scale * side.doubt(name, entry["unit"]) for side, scale in pairs]
        known = tuple(scale * side.studied(name) for side, scale in pairs)
        doubt = min(doubts) if any(map(math.isnan, known)) else max(doubts)
        return MetricRow(group, name, entry["label"], shown[0][1], values, doubt, limits, known)

    @property
    def title(self) -> str:
        """All labels."""
        return listed([side.label for side in self.sides])

    @property
    def basis(self) -> str:
        """What the doubt is."""
        if all(side.study for side in self.sides):
            return "the numerical uncertainty"
        shares = {
            "the smaller value": SHARE,
            "torque, work and other margins": float(COSTS["margin_torque"]["change"]),
            "friction": float(COSTS["margin_friction"]["change"]),
            "feedback": float(COSTS["effort_zmp_x"]["change"]),
            "the measured ZMP margin": float(COSTS["margin_measured_polygon"]["change"]),
        }
        texts = [f"{100.0 * share:g} % of {what}" for what, share in shares.items()]
        return f"{', '.join(texts)}; near zero what half the time step changes"

    @property
    def parameters(self) -> dict[str, tuple[Any, ...]]:
        """Key to the values of all sides, of every parameter in which they differ."""
        values = [parameter_values(side.run.parameters) for side in self.sides]
        rows = {key: tuple(item.get(key) for item in values) for item in values for key in item}
        return {key: row for key, row in rows.items() if any(value != row[0] for value in row)}

    @property
    def sentence(self) -> str:
        """The conclusion in two sentences: who tracks the ZMP better; at which cost, and how near to limits.

        Of walks that did not complete, one that says so.
        """
        if all(side.outcome == OutcomeName.COMPLETED for side in self.sides):
            return f"{self._tracking()}. {self._spending()}; {self._limits()}."
        said = []
        for side in self.sides:
            ended = f"did not walk to the end ({side.outcome} after {side.run.summary['end']['time']:.2f} s)"
            said.append(f"{side.label} {'walked to the end' if side.outcome == 'completed' else ended}")
        return f"{', '.join(said)}."

    def _tracking(self) -> str:
        """Who tracks the ZMP best, with the errors."""
        rows = [row for row in self.rows if row.name in _ZMP_ERRORS and row.known_of_all]
        if not rows:
            return "No error of the ZMP is judged in every walk"
        where: dict[str, list[str]] = {}
        for row in sorted(rows, key=lambda row: not row.differs):
            pairs = list(zip([side.label for side in self.sides], row.values, strict=True))
            leaders = [label for label, value in pairs if value - min(row.values) <= row.doubt]
            said = f"{listed(leaders)} {'tracks' if len(leaders) == 1 else 'track'} the ZMP best"
            values = ", ".join(f"{label} {_shown(value)}" for label, value in pairs)
            said = said if row.differs else "the difference is within the doubt"
            where.setdefault(said, []).append(f"along {row.name[-6]} ({values} {row.unit})")
        equal = "" if any(row.differs for row in rows) else f"{self.title} track the ZMP equally well: "
        return equal + ", ".join(f"{said} {listed(axes)}" for said, axes in where.items())

    def _spending(self) -> str:
        """Who spends more, of the costs that differ."""
        spent: dict[str, list[str]] = {}
        rows = [row for row in self.rows if COSTS.get(row.name, {}).get("verb") and row.known_of_all]
        if not rows:
            return "No cost is known of all"
        for row in rows:
            cost = COSTS[row.name]
            if row.differs and min(row.values) > 0.0:
                ratio = max(row.values) / min(row.values)
                least, most = (self.sides[row.values.index(end(row.values))].label for end in (min, max))
                more, than = (f"{100 * ratio - 100:.0f} % more", "than")
                if ratio >= 2.0:
                    more, than = (f"{ratio:.1f} times as much", "as")
                spent.setdefault(most, []).append(f"{cost['verb']} {more} {cost['noun']} {than} {least}")
        if not spent:
            return f"No difference in {listed([COSTS[row.name]['noun'] for row in rows])} exceeds the doubt"
        return ", ".join(f"{label} {listed(words)}" for label, words in spent.items())

    def _limits(self) -> str:
        """How much of their limits the walks use."""
        said: dict[tuple[str, str], list[tuple[str, str]]] = {}
        profiles = [side.run.summary["profile"] for side in self.sides]
        for k, side in enumerate(self.sides):
            used = [(row.used[k], row.label) for row in self.rows if not math.isnan(row.used[k])]
            share, label = max(used, default=(math.nan, "no limit is known"))
            measured = side.run.summary["verdict"] not in ("not_measured", "partial")
            kept = "reached a limit" if share >= SATURATED else "stayed below every limit"
            kept = kept if measured else "was not measured by every limit"
            if over := sum(item[0] > 1.0 + 1e-9 for item in used):  # not by rounding, as of used up friction
                kept = f"exceeded {over} of {len(used)} limits"
            kept += f" of the profile {profiles[k]}" * (len(set(profiles)) > 1)
            said.setdefault((kept, label), []).append((side.label, format_share(share, 1.0)))
        return ", ".join(
            f"{listed([who for who, _ in items])} {kept} ({label}, {listed([share for _, share in items])})"
            for (kept, label), items in said.items()
        )

    def best(self, row: MetricRow) -> int | None:
        """The better side, if its lead counts and it walked to the end."""
        best = row.better
        return None if best is None or self.sides[best].outcome != OutcomeName.COMPLETED else best

    def cells(self, row: MetricRow) -> tuple[str, ...]:
        """Label, all values, each with its share of a limit, unit, doubt and the better side, for tables."""
        best = self.best(row)
        better = "" if best is None else self.sides[best].label
        values = [_shown(value, known) for value, known in zip(row.values, row.known, strict=True)]
        if row.group != OWN:
            shares = map(format_share, row.used, (limit and 1.0 for limit in row.limits))  # none of a limit 0
            values = list(chain(*zip(values, shares, strict=True)))
        return row.label, *values, row.unit, _shown(row.doubt), better

    def tables(self) -> list[Table]:
        """What differs, the metrics group by group, the causes of the ZMP error, and robustness."""
        labels = [side.label for side in self.sides]
        notes = [
            f"A difference counts if it is larger than the doubt: {self.basis}. Smaller is better, except "
            "for margins, distances and flexion.",
            "The first step of a plan is left out, unless it begins at rest. Each walk is compared with its "
            "own plan.",
        ]
        if self.unlike:
            notes.append(
                "The bodies differ in size or weight: lengths are shares of the foot, forces of the weight, "
                "momenta of m√(gL³) with the length L of the foot. A gait of another shape still differs."
            )
        tables = [Table("the walks", ["", *(f">{label}" for label in labels)], list(self._facts()), notes)]
        for group in (JUDGED, COST, OWN):
            shown = [] if group == OWN else [USED]
            columns = ["", *(item for label in labels for item in (f">{label}", *shown))]
            known = [row for row in self.rows if row.group == group and not np.isnan(row.values).all()]
            best = "better" if len(labels) == 2 else "best"
            tables.append(Table(group, [*columns, "unit", ">doubt", best], list(map(self.cells, known))))
        return [table for table in (*tables, self._causes(), *self._robustness()) if table.rows]

    def _causes(self) -> Table:
        """Causes of the ZMP error, RMS, of all walks."""
        columns = ["cause", *(f">{side.label}, {axis}" for axis in "xy" for side in self.sides), "unit"]
        shown, rows = [self.shown("", "m", side) for side in self.sides], []
        for part, label in PARTS.items():
            values = [side.run.summary["zmp_error_split"]["rmse"][part] for side in self.sides]
            both = np.array(values, dtype=float).T * [scale for scale, _ in shown]
            if not np.isnan(both).all():
                rows.append((label, *map(_shown, both.ravel()), shown[0][1]))
        return Table("causes of the ZMP error, RMS", columns, rows)

    def _robustness(self) -> Iterator[Table]:
        """Largest disturbance that the gait of each walk survives, where it was studied."""
        studies = {side.label: side.robustness for side in self.sides if side.robustness}
        units = {item.cell.name: item.row()[1] for study in studies.values() for item in study.cells}
        rows = [(key, unit, *(one.survived(key) for one in studies.values())) for key, unit in units.items()]
        if rows:
            notes = [f"{label}: {study.title}." for label, study in studies.items()]
            yield Table("robustness", ("survived", "unit", *(f">{label}" for label in studies)), rows, notes)

    def shown(self, name: str, unit: str, side: Side) -> tuple[float, str]:
        """Factor from a metric's SI unit, and the unit in which tables show it: a share if bodies differ."""
        scales = side.run.summary["scales"]
        if self.unlike and unit in SIZES:
            size, share = SIZES[unit]
            return 100.0 / float(size_in_si(size, scales)), short_unit(share)
        weight = scales["body_weight"]
        scale, unit = cost_unit(METRICS[name], weight) if name in COSTS else display_unit(unit, weight)
        return scale, short_unit(unit)

    @property
    def unlike(self) -> bool:
        """Whether the bodies differ in size or weight, so that values are compared as shares of it."""
        scales = [side.run.summary["scales"] for side in self.sides]
        sizes = np.array([(scale["body_weight"], scale["foot_length"]) for scale in scales])
        return bool((sizes.max(axis=0) > 1.01 * sizes.min(axis=0)).any())

    def _facts(self) -> Iterator[tuple[str, ...]]:
        """How the walks ended, and in what they differ; a walk from Python may have more than its keys."""
        summaries = [side.run.summary for side in self.sides]
        for name in ("outcome", "verdict", "profile"):
            yield name, *(str(summary[name]).replace("_", " ") for summary in summaries)
        more = {
            "planner": [summary.get("planner") or "ampm" for summary in summaries],
            "controller": [summary.get("controller", "ampm") for summary in summaries],
            "disturbances": ["; ".join(summary.get("disturbances", ["none"])) for summary in summaries],
            "steps completed": [str(summary["steps_completed"]) for summary in summaries],
        }
        for name, values in more.items():
            if len(set(values)) > 1:
                yield name, *values
        timing = [side.run.planned_timing for side in self.sides]
        for name in dict.fromkeys(name for found in timing for name in found):
            yield name, *(_shown(found.get(name, math.nan)) for found in timing)
        for key, row in self.parameters.items():
            # The steps stand above: a planner may use no gait.steps.
            if not key.startswith(("gait.planner", "gait.steps", "controller.name", "disturbance.")):
                shown = [f"{len(value or ())} footsteps" if key == "footsteps" else value for value in row]
                yield key, *map(format_value, shown)

    def as_dict(self) -> dict[str, Any]:
        """Everything, as plain data; lists have one entry for each walk."""
        walks = [
            {
                "label": side.label,
                "study": side.study,
                "robustness": side.robustness,
                "planned": side.run.planned_timing,
            }
            | {key: side.run.summary[key] for key in ("outcome", "verdict", "profile", "steps_completed")}
            for side in self.sides
        ]
        metrics = {row.name: {**row._asdict(), "better": self.best(row)} for row in self.rows}
        found = {"sentence": self.sentence, "differences_count_from": self.basis, "walks": walks}
        return dict(json_ready(found | {"parameters": self.parameters, "metrics": metrics}))


def listed(words: Sequence[str]) -> str:
    """Words as a list in a sentence."""
    *others, last = words
    return f"{', '.join(others)} and {last}" if others else last


def _shown(value: float, known: float = math.nan) -> str:
    """A value for a table, with its uncertainty where it is known: rounding errors are 0."""
    return "0" if abs(value) < 1e-8 else with_uncertainty(value, known)


def compare_runs(
    folders: Sequence[str | Path],
    labels: Sequence[str] = (),
    uncertainty: Sequence[Path] = (),
    robustness: Sequence[Path] = (),
) -> WalkComparison:
    """Compare two or more finished runs; their labels are the names of their folders by default.

    ``uncertainty`` has ``convergence.json`` of all gaits, ``robustness`` one ``robustness.json`` for each
    walk, or none. Raises :class:`InputError` if a folder cannot be used, or no study is of one of the gaits.
    """
    known = [load_uncertainty(file) for file in uncertainty]
    labels = labels or [Path(folder).resolve().name for folder in folders]
    if len(set(labels)) < len(labels):
        labels = [f"{label} ({number})" for number, label in enumerate(labels, start=1)]
    sides, survived = [], _survived(robustness, len(labels))
    for label, folder, robust in zip_longest(labels, folders, survived):
        run = load_saved_run(folder)
        pushed = [text for text in run.summary.get("disturbances", ()) if not text.startswith(_OF_RUN)]
        if known and pushed:
            raise InputError(f"--uncertainty holds for no walk with {pushed[0]}; leave it out.")
        study = matching(known, Request(label, run.parameters)) if known else None
        sides.append(Side(label, run, study, robust))
    return WalkComparison(sides)


def _survived(files: Sequence[Path], walks: int) -> list[Robustness]:
    """The robustness studies of all walks, or of none."""
    if len(files) not in (0, walks):
        raise InputError(f"--robustness names {len(files)} of {walks} studies; give it once for each walk.")
    return [load_robustness(file) for file in files]


def compare_gaits(
    gaits: Sequence[str] = (),
    settings: Sequence[str] = (),
    *,
    choices: Mapping[str, Sequence[str]] = MappingProxyType({}),
    as_is: bool = False,
    uncertainty: Sequence[Path] = (),
    robustness: Sequence[Path] = (),
    **execution: Unpack[Execution],
) -> WalkComparison:
    """Walk two or more gaits and compare them.

    Args:
        gaits: presets or TOML files, one for all walks or one for each. If none, it is `normal` or the own
            gait of another body. A single walk is compared with the one without its planner, controller and
            engine; without these with `ipm`.
        settings: ``key=value`` texts for all walks.
        choices: key to its value for all walks, or to one value for each; behind a comma a planner or
            controller has its own options, ``mine:Planner,gain=2``.
        as_is: find nothing that the gaits leave open.
        uncertainty: as in :func:`compare_runs`.
        robustness: likewise.
        execution: workers and folder, see :class:`validation.study.many.Execution`.

    Raises:
        InputError, RefusedGait: a gait cannot be walked.
        UsersError: a user's class failed.
        RuntimeError: a walk crashed.
        StudyStopped: see :func:`validation.study.many.walk_many`.
    """
    folder = study_folder(execution)
    given: dict[str, Sequence[str | None]] = {"WALK": gaits or [None], **choices}
    count = max(map(len, given.values()))
    if count == 1:
        count = 2
        if [*choices] == ["body.source"]:  # the preset ipm is the human's
            choices = {**choices, "gait.planner": ["ipm"]}
        changed = {key: [None, *values] for key, values in choices.items() if key != "body.source"}
        given |= changed or {"WALK": [*given["WALK"], "ipm"]}
    if {*map(len, given.values())} - {1, count}:
        times = ", ".join(f"{name} {len(values)} times" for name, values in given.items() if len(values) > 1)
        raise InputError(f"{times}: give each one once, or {count} times, once for each walk.")
    alike, requests, labels = len(set(given["WALK"])) == 1, [], []
    for walk in range(count):
        text, *chosen = (values[walk % len(values)] for values in given.values())
        named = zip(choices, chosen, strict=True)
        own = [f"{key}={quoted(absolute(name))}" for key, name in named if name is not None]
        request = load_request(text, [*own, *settings], as_is=as_is)
        # With the values that are found; a refused gait is named before the first walk.
        requests.append(plan_walk(request, execution.get("progress")).request)
        several = [key for key in choices if alike and len(given[key]) > 1]
        varied = [Path(str(requests[-1].run.value(key))).name for key in several]
        labels.append(", ".join(varied) or request.name)
    known = [load_uncertainty(file) for file in uncertainty]
    _survived(robustness, count)  # refused before the first walk
    for request in requests if known else ():
        matching(known, request)
    with nullcontext(folder) if folder else tempfile.TemporaryDirectory(prefix="ampm-compare-") as home:
        place = Path(home).resolve()
        walks = {str(place / f"walk-{number}"): request for number, request in enumerate(requests, start=1)}
        tasks = [Task(at, keep_run, {"folder": at, "request": request}) for at, request in walks.items()]
        for row in walk_many(tasks, **execution):
            if "reason" in row:
                kinds = {"refused": InputError, UsersError.__name__: UsersError}
                kind = kinds.get(row["outcome"], kinds.get(row["reason"], RuntimeError))
                raise kind(f"{walks[row['key']].title}: {row['cause']}")
        return compare_runs(list(walks), labels, uncertainty, robustness)
