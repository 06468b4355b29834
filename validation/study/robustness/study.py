"""Robustness study of a gait: what it survives with its body and controller, and the table of it."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from operator import methodcaller
from pathlib import Path
from typing import Any, Unpack

from ampm.exceptions import InputError
from ampm.parameters import FIELDS, NO_PLAN, RunParameters
from models.scene import BodyModel
from validation.progress import Progress
from validation.store.json import json_ready, read_json, write_json
from validation.study.many import Execution, Task, study_folder, walk_many
from validation.study.pool import attempt
from validation.study.robustness.cells import DURATION, Cell, chosen, other_cells, push_cells, push_instant
from validation.study.row_file import Row
from validation.table import Table, Tabled
from validation.trial.engine import ONLY_MUJOCO
from validation.trial.outcome import OutcomeName
from validation.trial.plan import PlannedWalk, Request, load_request, plan_walk
from validation.trial.record import SimulationRecord
from validation.trial.shapes import Shapes
from validation.trial.simulate import simulate
from validation.trial.users import PLANNER

ROBUSTNESS_FILE = "robustness.json"
_NEEDED = 0.8  # share of the replicas that has to survive
STEPS = 14
"""Walked with a disturbance other than a push."""
PUSH_STEP = 4
"""Single support in which, or after which, the body is pushed; one later in every other replica."""
AFTER = 8
"""Steps walked after that one."""
REPLICAS = 5
START = 0.01
"""Error of the root's velocity at the start of all replicas but the first, see ``disturbance.start_velocity``
[m/s]."""
_SHIFTS = (0.0, 0.03, -0.03, 0.06, -0.06)  # shift of a push in the replicas, as share of its phase [1]
CROSSED = "the legs met"
gait_and_body = methodcaller("model_dump", mode="json", include={"gait", "body"}, exclude={"gait": {"steps"}})
"""Parameters that all runs of one gait and body share."""
_OWN = "gait.steps", "disturbance.push_", "disturbance.seed", "disturbance.start_velocity", "sensors.seed"
_EVERY = 0.01  # time between two looks at the distance of the legs [s]


@dataclass(frozen=True)
class CellResult:
    """What a cell showed; values in its unit."""

    cell: Cell  # the disturbance
    survived: float | None = None  # worst value survived with all milder ones; None if there is none
    cause: str = ""  # how a walk of the first value that was not survived ended; empty if there is none

    def row(self) -> tuple[str, ...]:
        """Row of the table; angles in degrees."""
        unit = self.cell.unit
        value = self.cell.values[0] if self.survived is None else self.survived
        if unit == "rad":
            value, unit = math.degrees(value), "degrees"
        shown = f"none from {value:.4g} on" if self.survived is None else f"{value:.4g}"
        every = " (all tried)" if self.survived == self.cell.values[-1] else ""
        return self.cell.name, unit, shown + every, self.cause.partition("; ")[0].partition(" at ")[0]


@dataclass(frozen=True)
class Robustness(Tabled):
    """A robustness study."""

    gait: str  # its name
    planner: str  # its name
    body: str  # its name
    controller: str  # its name
    replicas: int  # of each value
    cells: tuple[CellResult, ...]  # results
    # runs that an error of program or machine ended, with its cause; they count as not survived
    crashes: tuple[str, ...] = ()
    walked: Mapping[str, Any] = field(default_factory=dict)  # see `gait_and_body`

    @property
    def title(self) -> str:
        """Gait, planner, body and controller, and how many walks have to survive."""
        rule = f"survived by {needed(self.replicas)} of {self.replicas} walks"
        walker = f"planner {self.planner}, body {self.body}, controller {self.controller}"
        return f"{self.gait}, {walker}: {rule}"

    def survived(self, name: str) -> str:
        """Largest value of a disturbance that was survived, for tables; empty if it was not studied."""
        return next((item.row()[2] for item in self.cells if item.cell.name == name), "")

    def as_dict(self) -> dict[str, Any]:
        """Everything, as plain values; those of a cell in the unit of its key, of pushes in m/s."""
        return dict(json_ready(vars(self)))

    def tables(self) -> list[Table]:
        """Largest value survived of every disturbance."""
        note = f"Pushes of {DURATION:g} s: the velocity change. A value counts with all milder ones."
        columns = ("disturbance", "unit", "survived", "first failure")
        return [Table(self.title, columns, [item.row() for item in self.cells], (note, *self.crashes))]


def needed(replicas: int) -> int:
    """Replicas that have to survive; an InputError for less than one."""
    if replicas < 1:
        raise InputError(f"--replicas {replicas}: at least one walk is needed.", value=replicas)
    return math.ceil(_NEEDED * replicas - 1e-9)


def load_robustness(path: Path) -> Robustness:
    """Read ``robustness.json``, or that of a folder; InputError if there is none, or it is damaged."""
    file = path / ROBUSTNESS_FILE if path.is_dir() else path
    return read_json(file, Robustness, f"give a {ROBUSTNESS_FILE} of 'ampm robustness --out'")[1]


def walk_cell(cell: Cell, request: Request, replicas: int) -> Row:
    """Walk a complete request with the rising values of a cell, on a worker; see :func:`climb`."""
    run = request.run.replace({"gait.steps": PUSH_STEP + 1 + AFTER if cell.is_push else STEPS})
    is_known, undisturbed = run.gait.planner in PLANNER.known, run.undisturbed

    def walk(value: float, replica: int) -> Row:
        name = request.name
        planned = _planned(name, undisturbed) if is_known else plan_walk(Request(name, undisturbed))
        disturbed = run.replace(disturbance_of(cell, value, replica, planned))
        return attempt(walk_replica, {"planned": planned, "run": disturbed})

    return climb(cell, replicas, walk)


def climb(cell: Cell, replicas: int, walk: Callable[[float, int], Row]) -> Row:
    """Walk rising values of a cell up to the first that is not survived, by a function of value and replica.

    Replicas of a value are not walked once too many have failed.

    Returns:
        ``outcome``: completed, or crashed if an error ended a walk; ``survived`` and ``cause`` of
        :class:`CellResult`; ``crashes``: the causes of such errors.
    """
    least, crashes = needed(replicas), list[str]()
    found: Row = {"survived": None, "cause": ""}
    for value in cell.values:
        rows, failed = list[Row](), list[Row]()
        while len(rows) < replicas and len(failed) <= replicas - least:
            rows.append(walk(value, len(rows)))
            failed = [row for row in rows if row["cause"]]
        crashes += [f"{value:g}: {row['cause']}" for row in failed if row["outcome"] == "crashed"]
        if len(rows) - len(failed) < least:
            found["cause"] = failed[0]["cause"]
            break
        found["survived"] = value
    return {"outcome": "crashed" if crashes else "completed", **found, "crashes": crashes}


def walk_replica(planned: PlannedWalk, run: RunParameters) -> Row:
    """Walk a plan once, disturbed as the run says; ``cause`` is empty for a walk that survived."""
    record = simulate(replace(planned, request=Request(planned.name, run)))
    if record.outcome.name == OutcomeName.INTERRUPTED:
        raise KeyboardInterrupt
    return {"outcome": str(record.outcome.name), "cause": cause_of(record, planned.body.model)}


def cause_of(record: SimulationRecord, body: BodyModel) -> str:
    """Why a walk does not count as survived; empty if it does. A hand may touch, but legs must not meet."""
    end = record.outcome
    if not end.completed:
        return f"{end.name}: {end.cause}"
    every = max(1, round(_EVERY / record.time_step))
    gap = _legs(body).recorded_gaps(record.q[::every]).distance.min()
    return CROSSED if gap < 0.0 else ""


@lru_cache(maxsize=4)
def _legs(body: BodyModel) -> Shapes:
    """Shapes of the legs, made once in a process."""
    return Shapes(body.compile(), only_legs=True)


@lru_cache(maxsize=2)
def _planned(name: str, run: RunParameters) -> PlannedWalk:
    """The plan of the project's own planner, made once in a process."""
    return plan_walk(Request(name, run))


def robustness(
    run: Request | RunParameters | str | None = "normal",
    settings: Sequence[str] = (),
    *,
    quick: bool = False,
    only: Sequence[str] = (),
    replicas: int = REPLICAS,
    **execution: Unpack[Execution],
) -> Robustness:
    """Find what a gait survives with its body and controller, without a push of its own.

    Args:
        run: parameters, preset or TOML file.
        settings: ``key=value`` texts, for a preset or file.
        quick: a small subset on a coarse grid.
        only: kinds of disturbance, see :func:`validation.study.robustness.cells.chosen`.
        replicas: walks of each value; four fifths have to survive.
        execution: workers and folder, see :class:`validation.study.many.Execution`.

    Raises:
        InputError, RefusedGait: the request cannot be met, or ``out`` is used otherwise.
        StudyStopped: see :func:`validation.study.many.walk_many`.
    """
    needed(replicas)
    request = load_request(run, settings)
    asked, every = request.run, [*push_cells(quick), *other_cells(quick)]
    without = {"pushes", "step_height"} if asked.gait.planner == NO_PLAN else set[str]()
    without |= {*ONLY_MUJOCO} if asked.simulation.engine == "drake" else set()
    cells = chosen([cell for cell in every if not without & {cell.key, cell.kind}], only)
    folder = study_folder(execution)
    if own := [key for key in FIELDS if key.startswith(_OWN) and asked.value(key) != FIELDS[key].default]:
        says = execution.get("progress") or Progress()
        says.say(f"{request.name}: a robustness study has its own, and does not use: {', '.join(own)}")
    run = asked.replace({} if asked.footsteps else {"gait.steps": PUSH_STEP + 2}).giving(asked.given)
    planned = plan_walk(replace(request, run=run), execution.get("progress"))
    if any(cell.is_push for cell in cells):
        push_instant(planned.plan.contacts, "forward", "early", PUSH_STEP + 1)
    run = planned.run.as_is().replace({f"disturbance.push_{axis}": 0.0 for axis in "xyz"})
    if cause := walk_replica(planned, run)["cause"]:
        said = f"{request.title} does not walk without a further disturbance ({cause.partition(';')[0]})"
        raise InputError(f"{said}; ampm explain says why.")
    options = {"request": Request(request.name, run), "replicas": replicas}
    tasks = [Task(cell.name, walk_cell, {"cell": cell, **options}) for cell in cells]
    label = f"{request.name}: robustness"
    rows = {row["key"]: row for row in walk_many(tasks, label=label, unit="disturbances", **execution)}
    results, crashes = [], list[str]()
    for cell in cells:
        row = rows[cell.name]
        results.append(CellResult(cell, row.get("survived"), row["cause"]))
        crashes += [f"{cell.name} {cause}" for cause in row.get("crashes", [row["cause"]])]
    found = Robustness(
        gait=request.title,
        planner=run.gait.planner,
        body=run.body.source,
        controller=run.controller.name,
        replicas=replicas,
        cells=tuple(results),
        crashes=tuple(crashes),
        walked=gait_and_body(run),
    )
    if folder is not None:
        write_json(folder / ROBUSTNESS_FILE, found.as_dict())
    return found


def disturbance_of(cell: Cell, value: float, replica: int, planned: PlannedWalk) -> dict[str, Any]:
    """Keys and values of one replica: the first as planned, others with an error at the start, and a shift.

    Of a push the plan has at least ``PUSH_STEP + 2`` steps.
    """
    settings: dict[str, Any] = {
        "disturbance.seed": replica,
        "sensors.seed": replica,
        "disturbance.start_velocity": START if replica else 0.0,
    }
    if not cell.is_push:
        return settings | {cell.key: value}
    shift, step = _SHIFTS[replica % len(_SHIFTS)], PUSH_STEP + replica % 2
    time, direction = push_instant(planned.plan.contacts, cell.direction, cell.phase, step, shift)
    x, y = (planned.plan.mass * value / DURATION * direction).tolist()
    return settings | {
        "disturbance.push_segment": cell.height,
        "disturbance.push_x": x,
        "disturbance.push_y": y,
        "disturbance.push_at": time,
        "disturbance.push_duration": DURATION,
    }
