"""Why a trial fails: it is repeated with one layer made ideal at a time.

A layer is a part of the trial: sensors, motors, floor, planner and so on. :data:`CHANGES` has a row for each
change that is tried. A layer that is ideal already is not walked.

The *excess* of a walk is the sum of what its failed metrics exceed their limits by, as shares of the limits.
That of a fall is larger than any other, and the larger the earlier it falls.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, MutableMapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from importlib.util import find_spec
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np

from ampm.brief import Brief
from ampm.description import Passive
from ampm.exceptions import InputError
from ampm.parameters import HUMAN, OPEN_KEYS, OPTION_TABLES, RunParameters, keys
from ampm.presets import PRESETS
from ampm.run_file import load_run
from validation.judge import profiles
from validation.judge.margins import SATURATED
from validation.run.walk import walk_planned
from validation.show.explanation import explanation_table
from validation.store.folders import output_file
from validation.store.json import json_ready, write_json
from validation.store.saved import EXPLANATION, RUN_FILE, load_saved_run
from validation.study.many import Search, Task, study_folder, walk_many
from validation.study.walk_options import users_classes
from validation.table import Table, Tabled
from validation.trial.bridge import passive_joints
from validation.trial.disturbances import Recorded
from validation.trial.outcome import OutcomeName
from validation.trial.plan import Body, PlannedWalk, Request, load_request, make_body, plan_walk
from validation.trial.scene import body_xml
from validation.trial.shapes import Shapes, make_robot

if TYPE_CHECKING:
    from models.scene import BodyModel
    from validation.progress import Progress
    from validation.run.trial import Trial
    from validation.study.row_file import Row
    from validation.trial.disturbances import Disturbance

STEPS = 10
"""Walking steps that are repeated, unless the trial fails later."""
AMPLE = 2.0
"""Friction of a floor on which no foot slides [1]."""
SOFTER, TIGHTER = 1.5, 2.0
"""Time constant of a softer contact, and COM stiffness of a tighter controller, over those of the trial."""
STRONG = 10.0
"""Torque limits of ideal motors, over those of the trial."""
MOST = 0.5
"""Share of the excess that a change leaves at most to be named, if none restores the pass."""
BEST = 3
"""Number of changes of which pairs are walked."""
RESIDUAL = 1e-3
"""Contradiction within a plan, or between plan and posture, from which it is named [m]."""
_SAMPLES = 500  # instants of a plan that are checked
_SHOWN = 3  # keys of a change that are named
_FALL = 1e3

_BODY = (
    "disturbance.mass_segment",
    "disturbance.mass_change",
    "disturbance.joint_damping",
    "disturbance.joint_friction",
)
"""What planner and controller do not know of the body."""

Values = Mapping[str, Any]
ValuesOf = Callable[[RunParameters], Values]


# ---------------------------------------------------------------------------------------------- the layers


@dataclass(frozen=True)
class Change:
    """One layer made ideal, or another one in its place.

    Attributes:
        layer: its name.
        text: what is changed, to stand before "it passes".
        values: new values by key, from the run.
        lifts: whether torque limits are lifted.
        tells: whether planner and controller get the simulated masses and dampers.
        drops: which of a user's ``controller``, ``planner``, ``estimator`` and ``pushes`` are left out.
    """

    layer: str
    text: str
    values: ValuesOf = lambda run: {}
    lifts: bool = False
    tells: bool = False
    drops: tuple[str, ...] = ()


def _usual(*names: str) -> ValuesOf:
    """Defaults of some keys, or of all keys of a section."""
    wanted = [key for key in keys() if key in names or key.partition(".")[0] in names]
    return lambda run: {key: RunParameters().value(key) for key in wanted}


def _differs(run: RunParameters, values: ValuesOf) -> bool:
    return any(run.value(key) != value for key, value in values(run).items())


def _contact(factor: float) -> ValuesOf:
    """A contact that takes longer by a factor, in MuJoCo at least two time steps."""

    def values(run: RunParameters) -> Values:
        if run.simulation.engine == "drake":
            return {"drake.stiffness": run.drake.stiffness / factor**2}
        least = 2.0 * run.simulation.time_step
        return {"contact.time_constant": max(factor * run.contact.time_constant, least)}

    return values


def _drake(run: RunParameters) -> Values:
    """The other engine where it is installed, from MuJoCo's usual contact only."""
    only_mujoco = _usual("contact", "simulation.integrator", "disturbance.softness_factor")
    return {} if _differs(run, only_mujoco) or not find_spec("pydrake") else {"simulation.engine": "drake"}


def _controller(run: RunParameters) -> Values:
    """The project's controller with the settings that it has for the body; from these on, a tighter one."""
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
    """The AMPM in place of another planner; in place of the AMPM's gait the nearest preset, or the body's own."""
    ampm = {"gait.planner": "ampm", "planner.options": {}}
    if run.gait.planner != "ampm" or run.footsteps:
        return ampm
    shape = ("gait.step_length", "gait.switching_velocity", "gait.c_s", "gait.c_y")

    def away(preset: str) -> float:
        return math.dist(*([gait.value(key) for key in shape] for gait in (run, load_run(preset))))

    if run.body.source == HUMAN:
        other = load_run(min((name for name in PRESETS if name != "ipm"), key=away))
    else:
        other = load_request(None, body=run.body.source).run
    return ampm | {key: other.value(key) for key in {*shape, *OPEN_KEYS}}


CHANGES = (
    Change("sensing", "with exact sensing", _usual("sensors"), drops=("estimator",)),
    Change(
        "motors",
        "with motors without limit, delay and bias",
        _usual("disturbance.actuation_delay", "disturbance.torque_bias"),
        lifts=True,
    ),
    Change("body", "with the body known to planner and controller", tells=True),
    Change(
        "friction",
        "with ample friction",
        lambda run: {"disturbance.friction_factor": AMPLE / run.contact.friction},
    ),
    Change(
        "floor",
        "on a level floor of the nominal stiffness",
        _usual(
            *(f"disturbance.{key}" for key in ("floor_height", "step_height", "slope_along", "slope_across")),
            "disturbance.softness_factor",
        ),
    ),
    Change("contact law", "with the usual contact", _usual("contact", "drake")),
    Change("contact law", "with a softer contact", _contact(SOFTER)),
    Change("contact law", "with a harder contact", _contact(1.0 / SOFTER)),
    Change("contact law", "in Drake", _drake),
    Change(
        "numerics",
        "with half the time step",
        lambda run: {"simulation.time_step": 0.5 * run.simulation.time_step},
    ),
    Change("controller", "with another controller", _controller, drops=("controller",)),
    Change("planner", "with another plan", _planner, drops=("planner",)),
    Change(
        "pushes",
        "without pushes",
        _usual(*(f"disturbance.{key}" for key in ("push_x", "push_y", "push_z", "start_velocity"))),
        drops=("pushes",),
    ),
)
"""Every change that is tried. A layer may have several."""


@dataclass(frozen=True)
class Case:
    """A trial as it is walked.

    Attributes:
        request: gait, body, world, complete.
        profile: name of the tolerances.
        users: classes of a user, see :func:`validation.study.walk_options.users_classes`.
        pushes: forces on the body beside those of the run.
        strained: motor that reached its limit, empty if none did.
        lifted: whether torque limits are lifted.
        told: whether planner and controller know the simulated body.
    """

    request: Request
    profile: str
    users: Values
    pushes: tuple[Disturbance, ...] = ()
    strained: str = ""
    lifted: bool = False
    told: bool = False

    @property
    def run(self) -> RunParameters:
        """All parameters."""
        return self.request.run

    def changed(self, change: Change) -> Case:
        """With a change; equal if the layer is ideal already.

        Raises:
            InputError: the change does not fit the rest of the run.
        """
        values = {
            key: value for key, value in change.values(self.run).items() if self.run.value(key) != value
        }
        run = self.run.replace(values) if values else self.run
        if change.layer == "planner" and values:  # feet and posture are found for it
            run = run.giving(run.given - set(OPEN_KEYS) | {key for key in keys() if key.startswith("gait.")})
        return replace(
            self,
            request=replace(self.request, run=run) if values else self.request,
            users={name: user for name, user in self.users.items() if name not in change.drops},
            pushes=() if "pushes" in change.drops else self.pushes,
            lifted=self.lifted or (change.lifts and bool(self.strained)),
            told=self.told or (change.tells and _differs(self.run, _usual(*_BODY))),
        )


# ------------------------------------------------------------------------------------------- on a worker


def walk_case(case: Case) -> Row:
    """Walk a case on a worker, see :func:`row_of`."""
    trial = walked(case)
    if trial.record.outcome.name == OutcomeName.INTERRUPTED:
        raise KeyboardInterrupt
    return row_of(trial)


def walked(case: Case) -> Trial:
    """Walk a case.

    Raises:
        InputError, MathematicalRefusal, BodilyRefusal: it cannot be walked.
    """
    planned = plan_case(case)
    if case.lifted:
        planned = replace(planned, body=_body_of(_stronger(planned.body.model)))
    return walk_planned(
        planned,
        profiles.profile(case.profile),
        controller=case.users.get("controller"),
        estimator=case.users.get("estimator"),
        disturbances=case.pushes,
    )


def plan_case(case: Case) -> PlannedWalk:
    """Plan a case, with the simulated body if it is told.

    Raises:
        InputError, MathematicalRefusal, BodilyRefusal: there is no such walk.
    """
    request, body = case.request, None
    if case.told:
        nominal = make_body(case.run).model
        body = _body_of(replace(nominal, xml=body_xml(nominal, case.run.disturbance)))
        request = replace(
            request, run=case.run.replace({**_usual(*_BODY)(case.run), "body.mass": body.robot.mass})
        )
    return plan_walk(request, planner=case.users.get("planner"), body=body)


def _body_of(model: BodyModel) -> Body:
    """The body of a changed model; its description has the passive joints of the model."""
    compiled = model.compile()
    joints = passive_joints(compiled)
    columns = (joints.damping, joints.stiffness, joints.rest, joints.friction)
    names = [compiled.joint(k).name for k in range(1, compiled.njnt)]
    values = zip(names, *(column[6:].tolist() for column in columns), strict=True)
    description = replace(model.description, passive=tuple(Passive(*row) for row in values if any(row[1:])))
    shapes = Shapes(compiled)
    return Body(replace(model, description=description), make_robot(compiled, description, shapes), shapes)


def _stronger(body: BodyModel) -> BodyModel:
    """The body with motors whose limits no walk reaches."""
    root = ElementTree.fromstring(body.xml)
    for motor in root.iterfind("actuator/motor"):
        for key in ("ctrlrange", "forcerange"):
            limits = (STRONG * float(text) for text in motor.get(key, "").split())
            motor.set(key, " ".join(map(repr, limits)))
    return replace(body, xml=ElementTree.tostring(root, encoding="unicode"))


def row_of(trial: Trial) -> Row:
    """What is kept of a walk.

    Returns:
        ``outcome``, ``cause``, ``passed``; ``left``, the share of the steps that were not walked; ``strained``,
        the motor that reached its limit; ``metrics``: for every judged one the ``label``, the ``text`` of its
        value, and ``used``, its share of the limit, 2 where the limit is zero and exceeded.
    """
    end, torque = trial.record.outcome, trial.comparison.costs["margins"]["torque"]
    metrics = {}
    for item in trial.verdict.judged:
        used = item.value / item.tolerance if item.tolerance else 2.0 * (item.value > 0.0)
        metrics[item.name] = {"label": item.label, "text": str(item), "used": used if item.judged else None}
    return {
        "outcome": str(end.name),
        "cause": end.cause,
        "passed": trial.verdict.passed,
        "left": 0.0 if end.completed else 1.0 - end.steps_completed / trial.plan.contacts.steps,
        "strained": torque.where if torque.value >= SATURATED else "",
        "metrics": metrics,
    }


# ---------------------------------------------------------------------------------------------- the result


@dataclass(frozen=True)
class Repeat:
    """A walk with changes.

    Attributes:
        changes: one, or a pair.
        row: of the walk, see :func:`row_of`; of one that was refused its reason.
    """

    changes: tuple[Change, ...]
    row: Row

    @property
    def layers(self) -> tuple[str, ...]:
        """That were changed."""
        return tuple(change.layer for change in self.changes)

    @property
    def text(self) -> str:
        """What was changed."""
        return " and ".join(change.text for change in self.changes)

    @property
    def passed(self) -> bool:
        """Whether all tolerances are met."""
        return bool(self.row.get("passed"))

    @property
    def excess(self) -> float:
        """See the module; 0 of a pass, infinite of a walk that was refused."""
        if "metrics" not in self.row:
            return math.inf
        if self.row["outcome"] != "completed":
            return _FALL * (1.0 + self.row["left"])
        return sum(max(used - 1.0, 0.0) for used in _used(self.row))

    @property
    def tightest(self) -> float:
        """Largest used share of a limit [1]; infinite of a walk that did not complete."""
        return max(_used(self.row), default=math.inf) if self.excess < _FALL else math.inf

    def as_dict(self) -> dict[str, Any]:
        """For ``explain.json``."""
        return {"layers": self.layers, "change": self.text, "excess": self.excess, **self.row}


def _used(row: Row) -> list[float]:
    """Used shares of the limits that were judged."""
    return [item["used"] for item in row["metrics"].values() if item["used"] is not None]


@dataclass(frozen=True)
class Explanation(Brief, Tabled):
    """Why a trial failed, or what costs most of its margin.

    Attributes:
        title: gait, body and controller.
        trial: the trial itself, without changes.
        repeats: with one layer changed, then pairs.
        residuals: what the plan leaves of Newton's law, and the posture of COM and feet [m]; see
            :func:`residuals_of`.
        named: layers that are to blame, none if the trial passes.
        sentence: the answer.
    """

    title: str
    trial: Repeat
    repeats: tuple[Repeat, ...]
    residuals: Mapping[str, float]
    named: tuple[str, ...]
    said: str

    @property
    def sentence(self) -> str:
        """The answer."""
        return self.said

    def as_dict(self) -> dict[str, Any]:
        """Contents of ``explain.json``."""
        found = {
            **vars(self),
            "sentence": self.said,
            "trial": self.trial.as_dict(),
            "repeats": [item.as_dict() for item in self.repeats],
        }
        return dict(json_ready(found))

    def table(self) -> Table:
        """Every change, with what it makes of the verdict and of the failed metrics."""
        return explanation_table(self.as_dict())

    def tables(self) -> list[Table]:
        """The one table."""
        return [self.table()]


def residuals_of(planned: PlannedWalk) -> dict[str, float]:
    """What a plan contradicts, over its first ten seconds [m].

    Returns:
        ``newton``: largest distance of the planned ZMP from that of the planned force and moment; ``motion``:
        largest distance of COM and soles of the planned posture from the plan, 0 of a posture that stays in
        place, whose joints are found while walking.
    """
    plan, robot = planned.plan, planned.body.robot
    times = np.linspace(0.0, min(plan.duration, 10.0), _SAMPLES, endpoint=False)
    sample, q = plan.sample(times), plan.posture.sample(times).q
    height, force = (sample.com[:, 2] - sample.floor)[:, None], sample.force
    moment = np.column_stack([sample.moment[:, 1], -sample.moment[:, 0]])
    zmp = sample.com[:, :2] - (height * force[:, :2] + moment) / force[:, 2:]
    away = [np.linalg.norm(zmp - sample.zmp, axis=1).max()]
    if np.ptp(q[:, :2], axis=0).any():
        terms = [robot.jacobian(row) for row in q]
        feet = np.stack([foot.position for foot in plan.feet.sample(times)], axis=1)
        away += [np.linalg.norm([term.com for term in terms] - sample.com, axis=-1).max()]
        away += [np.linalg.norm([term.sole for term in terms] - feet, axis=-1).max()]
    return {"newton": float(away[0]), "motion": float(max(away[1:], default=0.0))}


# ---------------------------------------------------------------------------------------------- the answer


def answer(
    trial: Repeat, repeats: Sequence[Repeat], residuals: Mapping[str, float]
) -> tuple[tuple[str, ...], str]:
    """The layers that are to blame, and the sentence that says so.

    Of the changes that restore the pass that one counts which leaves most of every limit, and a pair only if
    no single change does. If nothing restores the pass, a contradiction within the plan counts, then a change
    that leaves at most :data:`MOST` of the excess.
    """
    best = min(
        repeats, key=lambda item: (len(item.changes) > 1 and not item.passed, item.excess, item.tightest)
    )
    left = best.excess / trial.excess if trial.excess else 1.0
    notes = "".join(
        f" {text.format(1e3 * residuals[name])}"
        for name, text in _NOTES.items()
        if residuals[name] > RESIDUAL
    )
    named: tuple[str, ...] = ()
    if trial.passed and best.tightest < trial.tightest:
        share = f"{best.tightest:.0%} of the tightest limit is used instead of {trial.tightest:.0%}"
        return (), f"It passes. The {best.layers[0]} costs most of the margin: {best.text} {share}."
    if trial.passed:
        return (), "It passes, and no layer costs margin."
    if best.passed:
        named, text = best.layers, f"{best.text} it passes."
    elif notes:
        named, text = (
            ("planner",) if residuals["newton"] > RESIDUAL else ("motion",),
            "no other one restores the pass.",
        )
    elif left <= MOST:
        named, text = (
            best.layers,
            f"{best.text} {left:.0%} of the excess is left, and nothing restores the pass.",
        )
    else:
        text = f"No layer restores the pass; {best.text} {left:.0%} of the excess is left."
    return named, f"The {' and the '.join(named)}: {text}{notes}" if named else f"{text}{notes}"


_NOTES = {
    "newton": "The planned ZMP is up to {:.3g} mm off that of the planned force and moment.",
    "motion": "COM and soles of the planned posture are up to {:.3g} mm off the plan.",
}


def residuals_of(planned: PlannedWalk) -> dict[str, float]:
    """What a plan contradicts, over its first ten seconds [m].

    Returns:
        ``newton``: largest distance of the planned ZMP from that of the planned force and moment; ``motion``:
        largest distance of COM and soles of the planned posture from the plan, 0 of a posture that stays in
        place, whose joints are found while walking.
    """
    plan, robot = planned.plan, planned.body.robot
    times = np.linspace(0.0, min(plan.duration, 10.0), _SAMPLES, endpoint=False)
    sample, q = plan.sample(times), plan.posture.sample(times).q
    height, force = (sample.com[:, 2] - sample.floor)[:, None], sample.force
    moment = np.column_stack([sample.moment[:, 1], -sample.moment[:, 0]])
    zmp = sample.com[:, :2] - (height * force[:, :2] + moment) / force[:, 2:]
    off = [np.zeros(1)]
    if np.ptp(q[:, :2], axis=0).any():
        terms = [robot.jacobian(row) for row in q]
        feet = np.stack([foot.position for foot in plan.feet.sample(times)], axis=1)
        off = [np.array([term.com for term in terms]) - sample.com]
        off += [np.array([term.sole for term in terms]) - feet]
    return {
        "newton": float(np.linalg.norm(zmp - sample.zmp, axis=-1).max()),
        "motion": float(max(np.linalg.norm(item, axis=-1).max() for item in off)),
    }


# ----------------------------------------------------------------------------------------------- the study


def explain(
    run: RunParameters | str | Path | None = "normal",
    settings: Sequence[str] = (),
    *,
    disturbances: Sequence[Disturbance] = (),
    profile: str | None = None,
    workers: int | None = None,
    out: str | Path | None = None,
    progress: Progress | None = None,
) -> Explanation:
    """Find the layer that makes a trial fail, or that costs most of its margin.

    Args:
        run: parameters, preset, TOML file, or the folder of a finished run, which gets the explanation.
        settings: ``key=value`` texts, for a preset or file.
        disturbances: external forces beside those of the run; those of a folder act again as recorded.
        profile: name of the tolerances; the preset's own, or those of the folder, by default.
        workers: processes; None for one a core, 0 for this very process.
        out: folder of every walk and ``explain.json``.
        progress: where to report it.

    Raises:
        InputError, RefusedGait: the trial cannot be walked, or ``out`` is used otherwise.
        StudyStopped: see :func:`validation.study.many.walk_many`.
    """
    folder = Path(run) if isinstance(run, str | Path) and Path(run).is_dir() else None
    target = study_folder(out, resume=False)
    if folder is None:
        request, pushes = (
            load_request(run if isinstance(run, RunParameters) else run and str(run), settings),
            tuple(disturbances),
        )
        name = profile or profiles.own_profile(request.name, request.run).name
    elif settings or disturbances:
        raise InputError(
            f"{folder} is repeated as it was walked; for changes give {folder / RUN_FILE} instead."
        )
    else:
        request, pushes, walked_by = saved_trial(folder)
        name = profile or walked_by
    planned = plan_walk(request, progress)
    first = Case(planned.request, profiles.profile(name).name, users_classes(request.run), pushes)
    case, trial = _failing(first)
    changes, found = list(_possible(case)), dict[tuple[Change, ...], Row]()
    for _ in walk_many(
        [_search(case, trial, changes, change, found) for change in changes],
        target,
        workers=workers,
        label=f"{planned.name}: layers",
        unit="changes",
        progress=progress,
    ):
        pass
    repeats = tuple(
        Repeat(key, found[key]) for key in sorted(found, key=lambda key: [len(key), *map(changes.index, key)])
    )
    residuals = residuals_of(planned)
    result = Explanation(planned.request.title, trial, repeats, residuals, *answer(trial, repeats, residuals))
    for place in filter(None, (target, folder)):
        with output_file(place / EXPLANATION) as path:
            write_json(path, result.as_dict())
    return result


def saved_trial(folder: Path) -> tuple[Request, tuple[Disturbance, ...], str]:
    """The trial of a run's folder: its request, its recorded external forces, and the name of its profile.

    Raises:
        InputError: the folder cannot be used, is a log, or its planner was an object.
    """
    saved = load_saved_run(folder)
    if saved.is_log:
        raise InputError(
            f"{folder} is a log, which cannot be walked again; give a gait or the folder of a run."
        )
    request, record = load_request(str(folder / RUN_FILE)), saved.record
    made = saved.summary.get("planner", "ampm")
    if request.run.gait.planner == "ampm" and made != ("footsteps" if request.run.footsteps else "ampm"):
        raise InputError(
            f"the planner {made} of {folder} was an object, which the folder does not hold; explain a gait with "
            "its class as gait.planner."
        )
    pushes: tuple[Disturbance, ...] = ()
    if record.external_segments:  # the run's own push is among them
        force, moment = record.external_force, record.external_moment
        pushes = (Recorded(tuple(record.external_segments), force, moment, record.time_step),)
        unpushed = request.run.replace({f"disturbance.push_{axis}": 0.0 for axis in "xyz"})
        request = replace(request, run=unpushed)
    return request, pushes, str(saved.summary["profile"])


def _failing(case: Case) -> tuple[Case, Repeat]:
    """The case with :data:`STEPS` steps if it fails in them, else with its own, and its walk."""
    for steps in sorted({min(STEPS, case.run.gait.steps), case.run.gait.steps}):
        some = replace(case, request=replace(case.request, run=case.run.replace({"gait.steps": steps})))
        trial = Repeat((), walk_case(some))
        if not trial.passed:
            break
    return replace(some, strained=trial.row["strained"]), trial


def _possible(case: Case) -> Iterator[Change]:
    """The changes that change anything and fit the run; few keys are added to the text."""
    for change in CHANGES:
        try:
            changed = case.changed(change)
        except InputError:
            continue
        if changed == case:
            continue
        values = [
            f"{key} {case.run.value(key)} to {changed.run.value(key)}"
            for key in (*keys(), *OPTION_TABLES)
            if case.run.value(key) != changed.run.value(key)
        ]
        text = f"without the limit of {case.strained}" if change.lifts and not values else change.text
        yield replace(change, text=f"{text} ({', '.join(values)})" if 0 < len(values) <= _SHOWN else text)


def _search(
    case: Case,
    trial: Repeat,
    changes: Sequence[Change],
    change: Change,
    found: MutableMapping[tuple[Change, ...], Row],
) -> Search:
    """Walk with one change. The last one goes on with pairs of the best, if none restores the pass."""

    def task(*both: Change) -> Task:
        changed = reduce(Case.changed, both, case)
        return Task(" and ".join(item.text for item in both), walk_case, {"case": changed})

    found[(change,)] = yield task(change)
    if len(found) < len(changes) or trial.passed or any(row.get("passed") for row in found.values()):
        return
    ranked = sorted((Repeat(key, row) for key, row in found.items()), key=lambda item: item.excess)
    best: dict[str, Change] = {}
    for item in ranked:
        best.setdefault(item.layers[0], item.changes[0])
    for pair in combinations(list(best.values())[:BEST], 2):
        found[pair] = yield task(*pair)
