"""Why a trial fails: it is repeated with one layer made ideal at a time.

A layer is a part of the trial: sensors, motors, floor, planner and so on. ``layers.csv`` has a row for every
change that is tried; a layer that is ideal already is not walked. The *excess* of a walk is the sum of what
its metrics exceed their limits by, as shares of the limits; that of a fall is larger, and the larger the
earlier it falls.
"""

import math
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from heapq import nlargest
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Unpack
from xml.etree import ElementTree

from ampm.exceptions import InputError, RefusedGait
from ampm.parameters import FIELDS, KEYS, NO_PLAN, OPEN_KEYS, RunParameters
from ampm.planner.step_planners import STEP_PLANNERS
from validation.judge.margins import SATURATED
from validation.judge.profiles import PUSHED, own_profile
from validation.judge.verdict import VerdictName
from validation.run.judge_log import judge_run
from validation.run.walk import walk_planned
from validation.store.folders import names_folder
from validation.store.json import json_ready, write_json
from validation.store.saved import read_summary
from validation.study.many import Execution, Task, study_folder, walk_many
from validation.study.row_file import Row
from validation.table import Table, Tabled, format_value, package_rows
from validation.trial.disturbances import Disturbance, Recorded
from validation.trial.files import RunFile
from validation.trial.outcome import OutcomeName
from validation.trial.plan import Body, Request, complete, gait_title, load_request, plan_walk

TIGHTER, STRONGER = 2.0, 10.0
"""COM stiffness of a tighter controller, and torque limits of ideal motors, over those of the trial [1]."""
_MOST = 0.5  # share of the excess that a change leaves at most to be named, if nothing restores the pass [1]
BOTH = "planner and feet"
REPLACED = frozenset({"contact law", "controller", "planner", "gait", "feet", "posture", BOTH})
"""Layers of which another one is tried; the others are made ideal."""
_FALL, _MOST_USED = 1e4, 100.0  # excess of a fall; most that a limit counts as used [1]
_LEAST_GAIN = 0.01  # share of a limit or of the excess that a change takes to be named [1]
_SHOWN = 3  # keys of a change that are named

Values = Mapping[str, Any]


@dataclass(frozen=True)
class Change:
    """One layer made ideal, or another one in its place: a row of ``layers.csv``."""

    layer: str  # its name
    text: str  # what is changed; "it passes" may follow
    keys: str  # that change, and sections, separated by spaces
    value: str  # `default`, a factor such as `x0.5`, `another`, `found` by a search, or the value itself

    def values(self, run: RunParameters) -> Values:
        """New values by key, of a run."""
        wanted = self.keys.split()
        changed = [key for key in FIELDS if key in wanted or key.partition(".")[0] in wanted]
        if self.value == "another":  # the project's controller with its settings for the body, else tighter
            usual = _usual(run)
            values = {key: usual.value(key) for key in KEYS if key.startswith("controller.")}
            values |= {"controller.frequency": run.controller.frequency, "controller.options": {}}
            if any(run.value(key) != value for key, value in values.items()):
                return values
            factors = {"controller.com_stiffness": TIGHTER, "controller.com_damping": math.sqrt(TIGHTER)}
            return {key: factor * run.value(key) for key, factor in factors.items()}
        if self.value == "drake":
            return dict.fromkeys(changed if find_spec("pydrake") else [], self.value)
        if self.value == "default":
            return {key: RunParameters().value(key) for key in changed}
        if self.value.startswith("x"):
            return {key: float(self.value[1:]) * run.value(key) for key in changed}
        return dict.fromkeys(changed, float(self.value))


CHANGES = tuple(Change(**row) for row in package_rows("study/layers.csv"))
"""Every change that is tried."""


@dataclass(frozen=True)
class Case:
    """A trial as it is walked."""

    request: Request  # complete
    profile: str  # name of the tolerances
    pushes: tuple[Disturbance, ...] = ()  # forces on the body beside those of the run
    strained: str = ""  # motor that reaches its limit; empty if none does
    lifted: bool = False  # whether the motors have no limits

    def changed(self, change: Change) -> "Case":
        """With a change; equal if the layer is ideal already, InputError if it does not fit the run."""
        old = self.request.run
        if change.value == "found":
            searched = old.gait.planner in STEP_PLANNERS and not old.footsteps
            return self.found_anew(change.keys) if searched else self
        values = {key: value for key, value in change.values(old).items() if old.value(key) != value}
        run = old.replace(values) if values else old
        if change.layer == BOTH and values:
            run = run.giving(run.given - {key for key in OPEN_KEYS if not key.startswith("gait.")})
        unpushed = change.layer == "pushes"
        own = unpushed and self.profile == PUSHED.name  # judges a recovery, of which there is none
        return replace(
            self,
            request=complete(replace(self.request, run=run)),
            profile=own_profile(run).name if own else self.profile,
            pushes=() if unpushed else self.pushes,
            lifted=self.lifted or (change.layer == "motors" and bool(self.strained)),
        )

    def found_anew(self, section: str) -> "Case":
        """With the open values of a section found, from the usual ones; RefusedGait if nothing is found."""
        run, usual = self.request.run, _usual(self.request.run)
        keys = {key for key in OPEN_KEYS if key.startswith(section)}
        opened = run.replace({key: usual.value(key) for key in keys}).giving(run.given - keys)
        return replace(self, request=complete(replace(self.request, run=opened)))

    def text(self, change: Change, changed: "Case") -> str:
        """What a change changes, with the keys whose values differ most."""
        old, new = self.request.run, changed.request.run
        pairs = {key: (old.value(key), new.value(key)) for key in FIELDS if old.value(key) != new.value(key)}
        if change.layer == "motors" and not pairs:
            return f"without torque limits ({self.strained.replace('_', ' ')} needs most)"
        most = nlargest(_SHOWN, pairs, key=lambda key: _difference(*pairs[key]))
        shown = [f"{key} {' to '.join(map(format_value, pairs[key]))}" for key in most]
        shown += [f"{len(pairs) - _SHOWN} more"] if len(pairs) > _SHOWN else []
        return f"{change.text} ({', '.join(shown)})" if shown else change.text


def _difference(old: Any, new: Any) -> float:
    """Of two values, as a share of the larger; 1 of what are no finite numbers [1]."""
    numbers = isinstance(old, int | float) and isinstance(new, int | float)
    return abs(new - old) / max(abs(new), abs(old)) if numbers and math.isfinite(new - old) else 1.0


def walk_case(case: Case) -> Row:
    """Walk a case, on a worker.

    Returns:
        ``outcome``, ``cause``, ``verdict``, ``passed``, ``excess``; ``motor``, the hardest used, and whether
        it was ``strained``; ``tightest``, the largest used share of a limit; ``metrics``: of those measured
        ``label``, ``text`` of its value, with ``used``, its share of the limit, 2 of an exceeded limit of 0.
    """
    planned = plan_walk(case.request)
    if case.lifted:
        planned = replace(planned, body=_stronger(planned.body))
    trial = walk_planned(planned, case.profile, disturbances=case.pushes)
    end, torque = trial.record.outcome, trial.comparison.costs["margins"]["torque"]
    if end.name == OutcomeName.INTERRUPTED:
        raise KeyboardInterrupt
    metrics = dict[str, Values]()
    for item in trial.verdict.judged:
        if math.isnan(item.value):
            continue
        used = min(item.value / item.tolerance if item.tolerance else 2.0 * (item.value > 0.0), _MOST_USED)
        text = f"{item} ({100 * used:.0f} %)" if item.tolerance else item.against
        metrics[item.name] = {"label": item.label, "text": text, "used": used}
    shares = [item["used"] for item in metrics.values()]
    excess = sum((max(share - 1.0, 0.0) for share in shares), 0.0)
    if not end.completed:
        excess = _FALL * (2.0 - end.time / planned.plan.duration)
    return {
        "outcome": str(end.name),
        "cause": end.cause,
        "verdict": str(trial.verdict.name),
        "passed": trial.verdict.passed,
        "excess": excess,
        "tightest": max(shares, default=0.0),
        "motor": torque.where,
        "strained": torque.value >= SATURATED,
        "metrics": metrics,
    }


def _usual(run: RunParameters) -> RunParameters:
    """The project's own settings for the body of a run."""
    return load_request(None, sections={"body": {"source": run.body.source}}).run


def _stronger(body: Body) -> Body:
    """The body with motors whose limits no walk reaches, which the controller knows."""
    root = ElementTree.fromstring(body.model.xml)
    for motor in root.iterfind("actuator/motor"):
        for key in ("ctrlrange", "forcerange"):
            motor.set(key, " ".join(repr(STRONGER * float(text)) for text in motor.get(key, "").split()))
    return Body.of(replace(body.model, xml=ElementTree.tostring(root, encoding="unicode")), body.shapes)


@dataclass(frozen=True)
class Explanation(Tabled):
    """Why a trial fails, or what costs most of its margin."""

    title: str  # gait, and what was changed in it
    named: str  # the layer that is to blame; empty if the trial passes, or if no layer helps
    said: str  # the sentence
    trial: Row  # the trial itself, see `walk_case`
    changes: tuple[Row, ...]  # walk of every change likewise, with its `layer` and its `text`

    @property
    def sentence(self) -> str:
        """The answer."""
        return self.said

    def as_dict(self) -> dict[str, Any]:
        """Contents of ``explain.json``, with the table that a report shows."""
        return dict(json_ready({**vars(self), "table": self.tables()[0]}))

    def tables(self) -> list[Table]:
        """The one table: every change, with its verdict and the failed metrics before and after."""
        rows = [
            (row["layer"], row["text"], _verdict(row), _failed(self.trial, row))
            for row in ({"layer": "", "text": "the trial", **self.trial}, *self.changes)
        ]
        failed = "metrics that failed before or fail then, with their share of the limit"
        columns = ("layer", "change", "verdict", failed)
        return [Table(f"{self.title}: layers changed one at a time", columns, rows)]


def _verdict(row: Row) -> str:
    name = row["verdict"] if row["outcome"] == OutcomeName.COMPLETED else row["outcome"]
    return "FAIL" if name == VerdictName.FAIL else str(name).replace("_", " ")


def _failed(before: Row, row: Row) -> str:
    """What failed before or fails then; of a walk that did not complete the cause."""
    if row["outcome"] != OutcomeName.COMPLETED:
        return str(row["cause"]).partition(";")[0]
    failed = [
        f"{item['label']} {item['text']}"
        for name, item in row["metrics"].items()
        if max(item["used"], before["metrics"].get(name, item)["used"]) > 1.0
    ]
    return "; ".join(failed)


def answer(trial: Row, changes: Sequence[Row]) -> tuple[str, str]:
    """The layer that is to blame, and the sentence that says so.

    Of the changes that restore the pass the one counts whose tightest limit is used least; a layer made ideal
    before one in whose place another came, and one before two. If none does, it is the change that leaves the
    least excess.
    """
    walked = [row for row in changes if "metrics" in row]
    if not walked:
        return "", "No change could be walked."
    if trial["passed"]:
        walked = [row for row in walked if row["layer"] != "pushes"]  # another profile has other limits
        best = min(walked, key=lambda row: (not row["passed"], row["tightest"]), default=trial)
        before, after = trial["tightest"], best["tightest"]
        if not best["passed"] or after > before - _LEAST_GAIN:
            return "", "It passes, and no layer costs margin."
        shares = f"{100 * after:.0f} % of the tightest limit is used instead of {100 * before:.0f} %"
        return "", f"It passes. Most of the margin is lost to the {best['layer']}: {best['text']} {shares}."
    if not trial["excess"]:
        return "", "No limit is broken; too little was measured."

    def rank(row: Row) -> tuple[Any, ...]:
        """Walks that pass come first, and of them layers that are made ideal."""
        passed = row["passed"]
        replaced = passed * ((row["layer"] in REPLACED) + (row["layer"] == BOTH))
        return not passed, replaced, row["excess"], row["tightest"]

    best = min(walked, key=rank)
    layer, text = best["layer"], best["text"]
    if best["passed"]:
        return layer, f"The {layer}: {text} it passes."
    left = best["excess"] / trial["excess"]
    if left > 1.0 - _LEAST_GAIN:
        return "", f"Nothing restores the pass, or takes {100 * _LEAST_GAIN:.0f} % of the excess."
    rest = f"{100 * left:.0f} % of the excess is left"
    if best["outcome"] == OutcomeName.COMPLETED != trial["outcome"]:
        rest = f"it is completed, with the verdict {_verdict(best)}"
    said = f"Nothing restores the pass; {text} {rest}."
    return (layer, f"The {layer}. {said}") if left <= _MOST else ("", said)


def explain(
    run: Request | RunParameters | str | Path | None = "normal",
    settings: Sequence[str] = (),
    *,
    disturbances: Sequence[Disturbance] = (),
    **execution: Unpack[Execution],
) -> Explanation:
    """Find the layer that makes a trial fail, or that costs most of its margin.

    Args:
        run: parameters, preset, TOML file, or the folder of a finished run, which gets the explanation.
        settings: ``key=value`` texts, for a preset or file.
        disturbances: external forces beside those of the run; those of a folder act again as recorded.
        execution: workers and folder, see :class:`validation.study.many.Execution`.

    Raises:
        InputError, RefusedGait: the trial cannot be walked, or ``out`` is used otherwise.
        StudyStopped: see :func:`validation.study.many.walk_many`.
    """
    folder = Path(run) if isinstance(run, str | Path) and names_folder(run) else None
    target = study_folder(execution)
    if folder is None:
        request = load_request(str(run) if isinstance(run, Path) else run, settings)
        given = Case(request, own_profile(request.run, disturbances).name, tuple(disturbances))
    elif settings or disturbances:
        raise InputError(f"{folder} is repeated as it was walked; for changes give {folder / RunFile.RUN}.")
    else:
        given = _saved_case(folder)
    planned = plan_walk(given.request, execution.get("progress"))
    case = replace(given, request=planned.request)
    trial = walk_case(case)
    if folder is not None:
        was, used = read_summary(folder), {name: item["used"] for name, item in trial["metrics"].items()}
        margins = {name: was["metrics"].get(name, {}).get("margin") for name in used}
        shares = {name: min(1.0 - of, _MOST_USED) for name, of in margins.items() if isinstance(of, float)}
        moved = [name for name, share in shares.items() if abs(used[name] - share) > _LEAST_GAIN]
        if moved or was["verdict"] != trial["verdict"]:
            now = trial["verdict"] + ", with another " * bool(moved) + ", ".join(moved)
            now = f"had the verdict {was['verdict']}, and its repeat has {now}"
            raise InputError(f"{folder} {now}: a class, file or metric has changed; walk it anew.")
    case = replace(case, strained=trial["motor"] if trial["strained"] else "")
    changes = possible(case)
    tasks = [Task(case.text(change, new), walk_case, {"case": new}) for change, new in changes]
    again = Task("the trial again", walk_case, {"case": case})  # last: a process may keep state
    label = f"{planned.name}: layers"
    walked = {row["key"]: row for row in walk_many([*tasks, again], label=label, unit="changes", **execution)}
    if any(trial[key] != walked[again.key].get(key) for key in ("outcome", "excess", "metrics")):
        raise InputError(
            f"{planned.name} cannot be explained: its walk does not repeat, so no layer can be blamed. Give "
            "your classes a seed and no state that outlives a walk, and use no workers of another machine."
        )
    rows = []
    for (change, new), task in zip(changes, tasks, strict=True):
        row = walked[task.key]
        # Without limits the motor shows that needs more than its own.
        text = replace(case, strained=row.get("motor", case.strained)).text(change, new)
        rows.append({"layer": change.layer, "text": text, **row})
    title = gait_title(planned.name, planned.request.changed, planned.planner)
    result = Explanation(title, *answer(trial, rows), trial, tuple(rows))
    for place in filter(None, (target, folder)):
        write_json(place / RunFile.EXPLANATION, result.as_dict())
    return result


def _saved_case(folder: Path) -> Case:
    """The trial of a run's folder, with its recorded external forces, the run's own push among them."""
    saved = judge_run(folder)  # refused if one of its metrics is not known
    if not os.access(folder, os.W_OK):
        raise InputError(f"{folder} gets the explanation and cannot be written; copy it to another place.")
    request, record = load_request(str(folder / RunFile.RUN)), saved.record
    if saved.is_log:
        raise InputError(f"{folder} is a log, which cannot be walked again; give the folder of a run.")
    if record.outcome.name is OutcomeName.INTERRUPTED:
        raise InputError(f"{folder} was interrupted; walk it to its end.")
    if record.outcome.name is OutcomeName.CRASHED:
        raise InputError(f"{folder} cannot be explained. {record.outcome.ending} Correct that class.")
    if saved.summary["verdict"] == VerdictName.UNDECIDED:
        raise InputError(
            f"{folder} is undecided, not failed: its numerical uncertainty exceeds the distance to a limit; "
            "walk it with a shorter simulation.time_step."
        )
    if not record.external_segments:
        return Case(request, saved.summary["profile"])
    run = request.run.replace({f"disturbance.push_{axis}": 0.0 for axis in "xyz"})
    return Case(replace(request, run=run), saved.summary["profile"], (Recorded(record),))


def possible(case: Case) -> list[tuple[Change, Case]]:
    """The changes that change anything and fit the run, and the cases with them."""
    pairs = []
    for change in CHANGES:
        if case.request.run.gait.planner == NO_PLAN and change.layer in ("controller", "planner", BOTH):
            continue  # another one is asked for another walk
        with suppress(InputError, RefusedGait):
            pairs.append((change, case.changed(change)))
    known = [case, *(new for _, new in pairs)]  # one may come to what another does
    return [pair for k, pair in enumerate(pairs, start=1) if pair[1] not in known[:k]]
