"""Why a trial fails: it is repeated with one layer made ideal at a time.

A layer is a part of the trial: sensors, motors, floor, planner and so on. A layer that is ideal already is
not walked. The *excess* of a walk is the sum of what its metrics exceed their limits by, as shares of the
limits. That of a fall is larger than any other, and the larger the earlier it falls.
"""

import math
from collections.abc import Callable, Iterator, Mapping, MutableMapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from importlib.util import find_spec
from itertools import combinations
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from ampm.brief import Brief
from ampm.exceptions import InputError
from ampm.parameters import HUMAN, OPEN_KEYS, OPTION_TABLES, RunParameters, keys
from ampm.planner.newton import newton_residual
from ampm.presets import PRESETS
from ampm.run_file import load_run
from validation.judge import profiles
from validation.judge.margins import SATURATED
from validation.progress import Progress
from validation.run.walk import walk_planned
from validation.show.explanation import explanation_table
from validation.store.folders import output_file
from validation.store.json import json_ready, write_json
from validation.store.saved import EXPLANATION, RUN_FILE, load_saved_run
from validation.study.many import Search, Task, study_folder, walk_many
from validation.study.row_file import Row
from validation.study.walk_options import users_classes
from validation.table import Table, Tabled
from validation.trial.disturbances import Disturbance, Recorded
from validation.trial.outcome import OutcomeName
from validation.trial.plan import Body, PlannedWalk, Request, load_request, plan_walk
from validation.trial.shapes import make_robot

STEPS = 10
"""Walking steps that are repeated, unless the trial fails later."""
AMPLE = 2.0
"""Friction of a floor on which no foot slides [1]."""
SOFTER, TIGHTER, STRONGER = 1.5, 2.0, 10.0
"""Time constant of a softer contact, COM stiffness of a tighter controller, torque limits of motors without
limit: over those of the trial [1]."""
MOST = 0.5
"""Share of the excess that a change leaves at most to be named, if nothing restores the pass [1]."""
BEST = 3
"""Number of layers of which pairs are walked."""
RESIDUAL = 1e-3
"""Contradiction within a plan, or of plan and posture, from which it is told [m]."""
_FALL, _MOST_USED = 1e4, 100.0  # excess of a fall; most that a limit counts as used [1]
_SAMPLES, _SHOWN = 500, 3  # instants of a plan that are checked; keys of a change that are named

Values = Mapping[str, Any]
ValuesOf = Callable[[RunParameters], Values]

# ---------------------------------------------------------------------------------------------- the layers


def _usual(*names: str) -> ValuesOf:
    """Defaults of some keys, or of all keys of a section."""
    wanted = [key for key in keys() if key in names or key.partition(".")[0] in names]
    return lambda run: {key: RunParameters().value(key) for key in wanted}


def _disturbance(*names: str) -> ValuesOf:
    return _usual(*(f"disturbance.{name}" for name in names))


def _contact(factor: float) -> ValuesOf:
    """A contact that takes longer by a factor, in MuJoCo at least two time steps."""

    def values(run: RunParameters) -> Values:
        if run.simulation.engine == "drake":
            return {"drake.stiffness": run.drake.stiffness / factor**2}
        least = 2.0 * run.simulation.time_step
        return {"contact.time_constant": max(factor * run.contact.time_constant, least)}

    return values


def _controller(run: RunParameters) -> Values:
    """The project's controller with its settings for the body; from these on, a tighter one."""
    usual = load_request(None, body=run.body.source).run
    values = {key: usual.value(key) for key in keys() if key.startswith("controller.")}
    values |= {"controller.frequency": run.controller.frequency, "controller.options": {}}
    if any(run.value(key) != value for key, value in values.items()):
        return values
    stiffness, damping = run.controller.com_stiffness, run.controller.com_damping
    return {
        "controller.com_stiffness": TIGHTER * stiffness,
        "controller.com_damping": math.sqrt(TIGHTER) * damping,
    }


def _planner(run: RunParameters) -> Values:
    """The AMPM for another planner; for the AMPM's gait the nearest preset, or the own gait of the body."""
    other = {"gait.planner": "ampm", "planner.options": {}}
    if run.gait.planner != "ampm" or run.footsteps:
        return other
    shape = ("gait.step_length", "gait.switching_velocity", "gait.c_s", "gait.c_y")

    def distance(preset: RunParameters) -> float:
        return math.dist([run.value(key) for key in shape], [preset.value(key) for key in shape])

    gaits = [load_run(name) for name in PRESETS if name != "ipm"]
    nearest = (
        min(gaits, key=distance) if run.body.source == HUMAN else load_request(None, body=run.body.source).run
    )
    return other | {key: nearest.value(key) for key in (*shape, *OPEN_KEYS)}


@dataclass(frozen=True)
class Change:
    """One layer made ideal, or another one in its place.

    Attributes:
        layer: its name.
        text: what is changed; "it passes" may follow.
        values: new values by key, of a run.
        drops: which of a user's ``controller``, ``planner``, ``estimator`` and ``pushes`` is left out.
    """

    layer: str
    text: str
    values: ValuesOf
    drops: str = ""


CHANGES = (
    Change("sensing", "with exact sensing", _usual("sensors"), "estimator"),
    Change("motors", "with ideal motors", _disturbance("actuation_delay", "torque_bias")),
    Change(
        "body",
        "with the body that the controller knows",
        _disturbance("mass_segment", "mass_change", "joint_damping", "joint_friction"),
    ),
    Change(
        "friction",
        "with ample friction",
        lambda run: {"disturbance.friction_factor": AMPLE / run.contact.friction},
    ),
    Change(
        "floor",
        "on the nominal floor",
        _disturbance("floor_height", "step_height", "slope_along", "slope_across", "softness_factor"),
    ),
    Change("contact law", "with the usual contact", _usual("contact", "drake")),
    Change("contact law", "with a softer contact", _contact(SOFTER)),
    Change("contact law", "with a harder contact", _contact(1.0 / SOFTER)),
    Change(
        "contact law", "in Drake", lambda run: {"simulation.engine": "drake"} if find_spec("pydrake") else {}
    ),
    Change(
        "numerics",
        "with half the time step",
        lambda run: {"simulation.time_step": 0.5 * run.simulation.time_step},
    ),
    Change("controller", "with another controller", _controller, "controller"),
    Change("planner", "with another plan", _planner, "planner"),
    Change(
        "pushes", "without pushes", _disturbance("push_x", "push_y", "push_z", "start_velocity"), "pushes"
    ),
)
"""Every change that is tried."""


@dataclass(frozen=True)
class Case:
    """A trial as it is walked.

    Attributes:
        request: everything but the rest; complete.
        profile: name of the tolerances.
        users: classes of a user, see :func:`validation.study.walk_options.users_classes`.
        pushes: forces on the body beside those of the run.
        strained: motor that reaches its limit; empty if none does, or if limits are lifted.
        lifted: whether they are.
    """

    request: Request
    profile: str
    users: Values
    pushes: tuple[Disturbance, ...] = ()
    strained: str = ""
    lifted: bool = False

    def changed(self, change: Change) -> "Case":
        """With a change; equal if the layer is ideal already.

        Raises:
            InputError: the change does not fit the rest of the run.
        """
        old, lifts = self.request.run, change.layer == "motors" and bool(self.strained)
        values = {key: value for key, value in change.values(old).items() if old.value(key) != value}
        run = old.replace(values) if values else old
        if change.layer == "planner" and values:  # feet and posture are found for the other plan
            run = run.giving(run.given - {key for key in OPEN_KEYS if not key.startswith("gait.")})
        return replace(
            self,
            request=replace(self.request, run=run),
            users={role: users for role, users in self.users.items() if role != change.drops},
            pushes=() if change.drops == "pushes" else self.pushes,
            strained="" if lifts else self.strained,
            lifted=self.lifted or lifts,
        )

    def text(self, change: Change) -> str:
        """What is changed, with the keys if they are few."""
        old, new = self.request.run, self.changed(change).request.run
        changed = [key for key in (*keys(), *OPTION_TABLES) if old.value(key) != new.value(key)]
        if self.strained and change.layer == "motors" and not changed:
            return f"without the limit of {self.strained}"
        shown = ", ".join(f"{key} {_said(old.value(key))} to {_said(new.value(key))}" for key in changed)
        return f"{change.text} ({shown})" if 0 < len(changed) <= _SHOWN else change.text


def _said(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def walk_case(case: Case) -> Row:
    """Walk a case, on a worker.

    Returns:
        ``outcome``, ``cause``, ``passed`` and ``excess``; ``strained``, the motor that reached its limit;
        ``tightest``, the largest used share of a limit, None of a fall; ``metrics``: of every judged one the
        ``label``, the ``text`` of its value, and ``used``, its share of the limit, 2 of a limit of zero that
        is exceeded.
    """
    planned = plan_walk(case.request, planner=case.users.get("planner"))
    if case.lifted:
        planned = replace(planned, body=_stronger(planned.body))
    users = {role: case.users.get(role) for role in ("controller", "estimator")}
    judge = profiles.profile(case.profile)
    trial = walk_planned(planned, judge, disturbances=case.pushes, **users)
    end, torque = trial.record.outcome, trial.comparison.costs["margins"]["torque"]
    if end.name == OutcomeName.INTERRUPTED:
        raise KeyboardInterrupt
    metrics = {}
    for item in trial.verdict.judged:
        used = item.value / item.tolerance if item.tolerance else 2.0 * (item.value > 0.0)
        metrics[item.name] = {"label": item.label, "text": str(item), "used": min(used, _MOST_USED)}
    shares = [item["used"] for item in metrics.values() if item["used"] == item["used"]]
    excess = sum(max(share - 1.0, 0.0) for share in shares)
    if not end.completed:
        excess = _FALL * (2.0 - end.steps_completed / planned.plan.contacts.steps)
    return {
        "outcome": str(end.name),
        "cause": end.cause,
        "passed": trial.verdict.passed,
        "excess": excess,
        "tightest": max(shares, default=0.0) if end.completed else None,
        "strained": torque.where if torque.value >= SATURATED else "",
        "metrics": metrics,
    }


def _stronger(body: Body) -> Body:
    """The body with motors whose limits no walk reaches, which the controller knows."""
    root = ElementTree.fromstring(body.model.xml)
    for motor in root.iterfind("actuator/motor"):
        for key in ("ctrlrange", "forcerange"):
            motor.set(key, " ".join(repr(STRONGER * float(text)) for text in motor.get(key, "").split()))
    model = replace(body.model, xml=ElementTree.tostring(root, encoding="unicode"))
    return Body(model, make_robot(model.compile(), model.description, body.shapes), body.shapes)


def residuals_of(planned: PlannedWalk) -> dict[str, float]:
    """What a plan contradicts, in its first ten seconds [m].

    Returns:
        ``plan``, see :func:`ampm.planner.newton.newton_residual`; ``motion``, the largest distance of COM and
        soles of the planned posture from the plan, 0 of a posture that stays in place, whose joints are found
        while walking.
    """
    plan, robot = planned.plan, planned.body.robot
    times = np.linspace(0.0, min(plan.duration, 10.0), _SAMPLES, endpoint=False)
    sample, q, off = plan.sample(times), plan.posture.sample(times).q, 0.0
    if np.ptp(q[:, :2], axis=0).any():
        feet = np.stack([foot.position for foot in plan.feet.sample(times)], axis=1)
        terms = [robot.jacobian(row) for row in q]
        away = [[term.com, *term.sole] for term in terms] - np.concatenate(
            [sample.com[:, None], feet], axis=1
        )
        off = float(np.linalg.norm(away, axis=-1).max())
    return {"plan": newton_residual(plan, times).size, "motion": off}


# ---------------------------------------------------------------------------------------------- the answer


@dataclass(frozen=True)
class Explanation(Brief, Tabled):
    """Why a trial fails, or what costs most of its margin.

    Attributes:
        title: gait, and what was changed in it.
        named: layers that are to blame; none if the trial passes, or if no layer helps.
        said: the sentence.
        trial: the trial itself, see :func:`walk_case`.
        changes: the same of every change and pair, with its ``layers`` and its ``text``.
        residuals: see :func:`residuals_of`.
    """

    title: str
    named: tuple[str, ...]
    said: str
    trial: Row
    changes: tuple[Row, ...]
    residuals: Mapping[str, float]

    @property
    def sentence(self) -> str:
        """The answer."""
        return self.said

    def as_dict(self) -> dict[str, Any]:
        """Contents of ``explain.json``."""
        return dict(json_ready(vars(self)))

    def table(self) -> Table:
        """Every change, with the verdict and the failed metrics before and after."""
        return explanation_table(self.as_dict())

    def tables(self) -> list[Table]:
        """The one table."""
        return [self.table()]


def answer(trial: Row, changes: Sequence[Row], residuals: Mapping[str, float]) -> tuple[tuple[str, ...], str]:
    """The layers that are to blame, and the sentence that says so.

    Of the changes that restore the pass the one counts with the least used share of its tightest limit. If
    none does, it is a contradiction within the plan, and then the change that leaves the least excess.
    """
    walked = [row for row in changes if "metrics" in row]
    best = min(
        walked, key=lambda row: (not row["passed"], len(row["layers"]), row["excess"], row["tightest"] or 0.0)
    )
    layers, text = tuple(best["layers"]), best["text"]
    said = f"The {' and the '.join(layers)}: {text}"
    if trial["passed"]:
        before, after = trial["tightest"], best["tightest"]
        if not best["passed"] or after >= before:
            return (), "It passes, and no layer costs margin."
        shares = f"{after:.0%} of the tightest limit is used instead of {before:.0%}"
        return (), f"It passes. The {layers[0]} costs most of the margin: {text} {shares}."
    off = {name: f" {_OFF[name].format(1e3 * size)}" for name, size in residuals.items() if size > RESIDUAL}
    notes, left = "".join(off.values()), best["excess"] / trial["excess"]
    if best["passed"]:
        return layers, f"{said} it passes.{notes}"
    if off:
        layer = "planner" if "plan" in off else "motion"
        return (layer,), f"The {layer}: no other layer restores the pass.{notes}"
    if left <= MOST:
        return layers, f"{said} {left:.0%} of the excess is left. Nothing restores the pass."
    return (), f"Nothing restores the pass; {text} {left:.0%} of the excess is left."


_OFF = {
    "plan": "The plan contradicts Newton's law by {:.3g} mm of its ZMP.",
    "motion": "COM or soles of the planned posture are up to {:.3g} mm off the plan.",
}


# ----------------------------------------------------------------------------------------------- the study


def explain(
    run: RunParameters | str | Path | None = "normal",
    settings: Sequence[str] = (),
    *,
    disturbances: Sequence[Disturbance] = (),
    workers: int | None = None,
    out: str | Path | None = None,
    progress: Progress | None = None,
) -> Explanation:
    """Find the layer that makes a trial fail, or that costs most of its margin.

    Args:
        run: parameters, preset, TOML file, or the folder of a finished run, which gets the explanation.
        settings: ``key=value`` texts, for a preset or file.
        disturbances: external forces beside those of the run; those of a folder act again as recorded.
        workers: processes; None for one a core, 0 for this very process.
        out: folder of every walk and ``explain.json``.
        progress: where to report it.

    Raises:
        InputError, RefusedGait: the trial cannot be walked, or ``out`` is used otherwise.
        StudyStopped: see :func:`validation.study.many.walk_many`.
    """
    folder = Path(run) if isinstance(run, str | Path) and Path(run).is_dir() else None
    target = study_folder(out, resume=False)
    if folder is not None:
        if settings or disturbances:
            way_out = f"for changes give {folder / RUN_FILE} instead"
            raise InputError(f"{folder} is repeated as it was walked; {way_out}.")
        request, pushes, profile = _saved_trial(folder)
    else:
        request = load_request(str(run) if isinstance(run, Path) else run, settings)
        pushes, profile = tuple(disturbances), ""
    profile = profile or profiles.own_profile(request.name, request.run, pushed=bool(pushes)).name
    planned = plan_walk(request, progress)
    case, trial = _failing(Case(planned.request, profile, users_classes(request.run), pushes))
    changes, found = list(_possible(case)), dict[tuple[Change, ...], Row]()
    searches = [_search(case, trial, changes, change, found) for change in changes]
    label = f"{planned.name}: layers"
    for _ in walk_many(searches, target, workers=workers, label=label, unit="changes", progress=progress):
        pass
    order = sorted(found, key=lambda both: (len(both), *map(changes.index, both)))
    rows = [
        {"layers": [item.layer for item in both], "text": " and ".join(map(case.text, both)), **found[both]}
        for both in order
    ]
    residuals = residuals_of(planned)
    result = Explanation(
        planned.request.title, *answer(trial, rows, residuals), trial, tuple(rows), residuals
    )
    for place in filter(None, (target, folder)):
        with output_file(place / EXPLANATION) as path:
            write_json(path, result.as_dict())
    return result


def _saved_trial(folder: Path) -> tuple[Request, tuple[Disturbance, ...], str]:
    """The trial of a run's folder, its recorded external forces, and the name of its profile."""
    saved = load_saved_run(folder)
    if saved.is_log:
        raise InputError(f"{folder} is a log, which cannot be walked again; give the folder of a run.")
    request, record, made = load_request(str(folder / RUN_FILE)), saved.record, saved.summary.get("planner")
    if request.run.gait.planner == "ampm" and made not in (
        None,
        "footsteps" if request.run.footsteps else "",
    ):
        raise InputError(
            f"{folder} does not hold its planner {made}, an object; name its class by gait.planner."
        )
    pushes = list[Disturbance]()
    if record.external_segments:  # the run's own push is among them
        force, moment = record.external_force, record.external_moment
        pushes.append(Recorded(tuple(record.external_segments), force, moment, record.time_step))
        unpushed = request.run.replace({f"disturbance.push_{axis}": 0.0 for axis in "xyz"})
        request = replace(request, run=unpushed)
    return request, tuple(pushes), str(saved.summary["profile"])


def _failing(case: Case) -> tuple[Case, Row]:
    """The case with :data:`STEPS` steps if it fails in them, else with all of its own, and its walk."""
    steps = case.request.run.gait.steps
    for count in sorted({min(STEPS, steps), steps}):
        run = case.request.run.replace({"gait.steps": count})
        some = replace(case, request=replace(case.request, run=run))
        try:
            trial = walk_case(some)
        except InputError:  # a push or a raised footstep comes later
            if count == steps:
                raise
            continue
        if not trial["passed"]:
            break
    return replace(some, strained=trial["strained"]), trial


def _possible(case: Case) -> Iterator[Change]:
    """The changes that change anything and fit the run."""
    for change in CHANGES:
        try:
            if case.changed(change) != case:
                yield change
        except InputError:
            continue


def _search(
    case: Case,
    trial: Row,
    changes: Sequence[Change],
    change: Change,
    found: MutableMapping[tuple[Change, ...], Row],
) -> Search:
    """Walk with one change. The last one goes on with pairs of the best, if none restores the pass."""

    def task(*both: Change) -> Task:
        return Task(" and ".join(map(case.text, both)), walk_case, {"case": reduce(Case.changed, both, case)})

    found[(change,)] = yield task(change)
    if len(found) < len(changes) or trial["passed"] or any(row.get("passed") for row in found.values()):
        return
    ranked = sorted(found, key=lambda both: found[both].get("excess", math.inf))
    best = {both[0].layer: both[0] for both in reversed(ranked)}
    for pair in combinations(list(reversed(best.values()))[:BEST], 2):
        found[pair] = yield task(*pair)
