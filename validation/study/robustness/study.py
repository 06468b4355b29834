"""Robustness study of a gait: what it survives with its body and controller."""

import math
from collections.abc import Callable, Mapping, MutableMapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from ampm.brief import Brief
from ampm.geometry import Array
from ampm.parameters import RunParameters
from ampm.planner.capture import DIRECTIONS, PUSH_PHASES, Reach, largest_velocity_change, push_instant
from models.scene import BodyModel
from validation.judge import profiles
from validation.progress import Progress
from validation.run.walk import walk_planned
from validation.show.text import ABSENT
from validation.store.folders import output_file
from validation.store.json import json_ready, write_json
from validation.study.many import Search, Task, study_folder, walk_many
from validation.study.robustness.cells import (
    AFTER,
    DURATION,
    PUSH_STEP,
    REPLICAS,
    SHIFTS,
    START,
    STEPS,
    Cell,
    chosen,
    needed,
    other_cells,
    push_cells,
)
from validation.study.row_file import Row, crash_notes
from validation.study.walk_options import users_classes
from validation.table import Table, markdown_page
from validation.trial.plan import PlannedWalk, Request, load_request, plan_walk
from validation.trial.record import SimulationRecord
from validation.trial.shapes import Shapes
from validation.trial.simulate import simulate

RESULT, MARKDOWN = "robustness.json", "robustness.md"
PICTURES = ("robustness.svg", "robustness.png")
PHASE_NAMES = {
    "early": "12 % of single support",
    "mid": "50 % of single support",
    "late": "85 % of single support",
    "double": "mid double support",
}
"""When a push begins."""
CROSSED = "the legs met"
_EVERY = 0.01  # time between two looks at the distance of the legs [s]


# ------------------------------------------------------------------------------------------- on a worker


def walk_replica(request: Request, profile: str | None, controller: Any = None, planner: Any = None) -> Row:
    """Walk once.

    Args:
        request: complete, with its disturbances.
        profile: name of the tolerances; None to leave the walk unmeasured.
        controller: a user's, see :func:`validation.study.walk_options.users_classes`.
        planner: likewise.

    Returns:
        ``outcome`` and ``cause``, which is empty for a walk that survived; ``passed``, whether it kept the
        tolerances; ``zmp``, the RMSE along x and y [m], NaN if it is not measured.
    """
    name, run = request.name, request.run.undisturbed
    planned = _planned(name, run) if planner is None else plan_walk(Request(name, run), planner=planner)
    passed, zmp = False, [math.nan, math.nan]
    if profile is None:
        record = simulate(planned.plan, request.run, planned.body.model, controller=controller)
    else:
        disturbed = replace(planned, request=request)
        trial = walk_planned(disturbed, profiles.profile(profile), controller=controller)
        record, passed = trial.record, trial.verdict.passed
        zmp = [trial.metrics[f"zmp_{axis}_rmse"].value for axis in "xy"]
    cause = cause_of(record, planned.body.model)
    outcome = CROSSED if cause == CROSSED else str(record.outcome.name)
    return {"outcome": outcome, "cause": cause, "passed": passed, "zmp": zmp}


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


# ------------------------------------------------------------------------------------------- the search


@dataclass(frozen=True)
class CellResult:
    """What a cell showed.

    Attributes:
        cell: the disturbance.
        bound: of a push, what legs can capture [m/s]; None for all else.
        survived: largest value survived with all smaller ones; None if there is none.
        within: largest value that kept the tolerances with all smaller ones; None if there is none.
        zmp: largest RMSE of the ZMP along x and y at ``survived`` [m]; NaN if there is none.
        cause: how a walk of the first value that was not survived ended; empty if there is none.
    """

    cell: Cell
    bound: float | None = None
    survived: float | None = None
    within: float | None = None
    zmp: tuple[float, float] = (math.nan, math.nan)
    cause: str = ""

    @property
    def complete(self) -> bool:
        """Whether all values were survived, so that the limit is not known."""
        return self.survived == self.cell.values[-1]

    def push_text(self) -> str:
        """Survived of the bound, and the share of it; ``>`` where the end of the ladder was survived."""
        survived = f"{'> ' if self.complete else ''}{self.survived or 0.0:.2f}"
        if not self.bound:
            return survived
        return f"{survived} of {self.bound:.2f} ({100.0 * (self.survived or 0.0) / self.bound:.0f} %)"

    def cells(self) -> tuple[str, ...]:
        """Row of :meth:`Robustness.others_table`."""
        is_angle = self.cell.kind in ("slope_along", "slope_across")
        unit, scale = ("degrees", 180.0 / math.pi) if is_angle else (self.cell.unit, 1.0)

        def shown(value: float | None) -> str:
            return "none" if value is None else f"{scale * value:.4g}"

        zmp = ABSENT if math.isnan(self.zmp[0]) else ", ".join(f"{1e3 * value:.1f}" for value in self.zmp)
        more = " (all tried)" if self.complete else ""
        cause = self.cause.partition("; ")[0].partition(" at ")[0]
        return self.cell.name, unit, shown(self.survived) + more, shown(self.within), zmp, cause


def climb(
    start: CellResult,
    replicas: int,
    task: Callable[[Cell, float, int], Task],
    results: MutableMapping[str, CellResult],
) -> Search:
    """Walk rising values of a cell up to the first that is not survived, and store the result.

    Args:
        start: the cell and its bound.
        replicas: of each value; the rest of them is not walked once too many have failed.
        task: makes the walk of a cell, a value and a replica.
        results: where to store, by name of the cell.
    """
    cell, least, kept, found = start.cell, needed(replicas), True, start
    for value in cell.values:
        rows: list[Row] = []
        causes: list[str] = []
        while len(rows) < replicas and len(causes) <= replicas - least:
            rows.append((yield task(cell, value, len(rows))))
            causes = [row["cause"] for row in rows if row["cause"]]
        walked = [row for row in rows if not row["cause"]]
        if len(walked) < least:
            found = replace(found, cause=causes[0])
            break
        kept = kept and sum(row["passed"] for row in walked) >= least
        x, y = np.fmax.reduce([row["zmp"] for row in walked]).tolist()
        found = replace(found, survived=value, within=value if kept else found.within, zmp=(x, y))
    results[cell.name] = found


@dataclass(frozen=True)
class Robustness(Brief):
    """A robustness study.

    Attributes:
        gait: its name.
        body: its name.
        controller: its name.
        replicas: of each value.
        cells: results.
        crashes: runs that an error of program or machine ended, with its cause; they count as not survived.
    """

    gait: str
    body: str
    controller: str
    replicas: int
    cells: tuple[CellResult, ...]
    crashes: tuple[str, ...] = ()

    @property
    def pushes(self) -> tuple[CellResult, ...]:
        """Those of pushes."""
        return tuple(item for item in self.cells if item.cell.is_push)

    @property
    def others(self) -> tuple[CellResult, ...]:
        """All others."""
        return tuple(item for item in self.cells if not item.cell.is_push)

    @property
    def title(self) -> str:
        """Gait, body, controller and the rule."""
        rule = f"survived by {needed(self.replicas)} of {self.replicas} walks"
        return f"{self.gait}, body {self.body}, controller {self.controller}: {rule}"

    def as_dict(self) -> dict[str, Any]:
        """Everything, as plain values; those of a cell in the unit of its key, of pushes in m/s."""
        return dict(json_ready(vars(self)))

    def tables(self) -> list[Table]:
        """The table of pushes and that of all others, without an empty one."""
        return [table for table in (self.pushes_table(), self.others_table()) if table.rows]

    def pushes_table(self) -> Table:
        """Velocity change survived, of the bound, by height, phase and direction."""
        texts = {
            (item.cell.height, item.cell.phase, item.cell.direction): item.push_text() for item in self.pushes
        }
        rows = [
            (height, PHASE_NAMES[phase], *(texts[height, phase, direction] for direction in DIRECTIONS))
            for height in dict.fromkeys(height for height, _, _ in texts)
            for phase in PUSH_PHASES
            if (height, phase, DIRECTIONS[0]) in texts
        ]
        columns = ("push at", "begins at", *(f"{name} [m/s]" for name in DIRECTIONS))
        notes = (f"Pushes of {DURATION:g} s, survived with all smaller ones; of the bound.", *self.crashes)
        return Table(self.title, columns, rows, notes)

    def others_table(self) -> Table:
        """Largest value survived, and that within the tolerances, of every other disturbance."""
        columns = "disturbance", "unit", "survived", "within tolerance", "ZMP RMSE x, y [mm]", "first failure"
        return Table(self.title, columns, [item.cells() for item in self.others], self.crashes)


# ------------------------------------------------------------------------------------------- the study


def robustness(
    run: RunParameters | str | None = "normal",
    settings: Sequence[str] = (),
    *,
    quick: bool = False,
    only: Sequence[str] = (),
    replicas: int = REPLICAS,
    profile: str | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    out: str | Path | None = None,
    resume: bool = False,
    progress: Progress | None = None,
) -> Robustness:
    """Find what a gait survives with its body and controller.

    Args:
        run: parameters, preset or TOML file.
        settings: ``key=value`` texts, for a preset or file.
        quick: a small subset on a coarse grid.
        only: kinds of disturbance, see :func:`validation.study.robustness.cells.chosen`.
        replicas: walks of each value; four fifths have to survive.
        profile: name of the tolerances; the preset's own by default.
        workers: processes; None for one a core, 0 for this very process.
        scheduler: address of a dask scheduler that is running already.
        out: folder of every walk, ``robustness.json``, tables and pictures; None writes nothing.
        resume: go on with what is in ``out``.
        progress: where to report it.

    Raises:
        InputError, RefusedGait: the request cannot be met, or ``out`` is used otherwise.
        StudyStopped: see :func:`validation.study.many.walk_many`.
    """
    needed(replicas)
    cells = chosen([*push_cells(quick), *other_cells(quick)], only)
    folder = study_folder(out, resume=resume)
    request = load_request(run, settings)
    users = users_classes(request.run)
    limits = profiles.own_profile(request.name) if profile is None else profiles.profile(profile)
    short = replace(request, run=request.run.replace({"gait.steps": PUSH_STEP + 2}))
    planned = plan_walk(short, progress, planner=users.get("planner"))
    task = partial(replica_task, planned=planned, profile=limits.name, users=users)
    results: dict[str, CellResult] = {}
    searches = [climb(start, replicas, task, results) for start in _with_bounds(cells, planned)]
    label = f"{request.name}: robustness"
    rows = walk_many(searches, folder, workers=workers, scheduler=scheduler, label=label, progress=progress)
    crashes = tuple(crash_notes(rows))
    found = Robustness(
        gait=request.title,
        body=planned.run.body.source,
        controller=planned.run.controller.name,
        replicas=replicas,
        cells=tuple(results[cell.name] for cell in cells),
        crashes=crashes,
    )
    if folder is not None:
        write(found, folder)
    return found


def replica_task(
    cell: Cell,
    value: float,
    replica: int,
    planned: PlannedWalk,
    profile: str,
    users: Mapping[str, Any],
) -> Task:
    """The walk of one replica: the first as planned, others with an error at the start, and a shift.

    Args:
        cell: the disturbance.
        value: of the cell.
        replica: its number, from 0.
        planned: the gait, with at least ``PUSH_STEP + 2`` steps.
        profile: name of the tolerances, by which walks with a push are not judged.
        users: see :func:`validation.study.walk_options.users_classes`.
    """
    settings: dict[str, Any] = {
        "disturbance.seed": replica,
        "disturbance.start_velocity": START if replica else 0.0,
        "gait.steps": PUSH_STEP + 1 + AFTER if cell.is_push else STEPS,
    }
    if cell.is_push:
        shift, step = SHIFTS[replica % len(SHIFTS)], PUSH_STEP + replica % 2
        instant = push_instant(planned.plan.contacts, cell.direction, cell.phase, step, DURATION, shift)
        x, y = (planned.plan.mass * value / DURATION * instant.direction).tolist()
        settings |= {
            "disturbance.push_segment": cell.height,
            "disturbance.push_x": x,
            "disturbance.push_y": y,
            "disturbance.push_at": instant.time,
            "disturbance.push_duration": DURATION,
        }
    else:
        settings[cell.key] = value
    request = Request(planned.name, planned.run.as_is().replace(settings))
    options = {"request": request, "profile": None if cell.is_push else profile, **users}
    return Task(f"{cell.name} {value:g}, replica {replica}", walk_replica, options)


def _with_bounds(cells: Sequence[Cell], planned: PlannedWalk) -> list[CellResult]:
    """Cells that were not walked yet, those of pushes with what legs can capture."""
    plan, description = planned.plan, planned.body.model.description
    middle = 0.5 * plan.duration
    reach = Reach.of(description, float(plan.sample([middle]).com[0, 2]))
    lever = {"chest": max(_lever(planned, plan.posture.sample([middle]).q[0]), 0.0), "com": 0.0}
    found = []
    for cell in cells:
        bound = None
        if cell.is_push:
            push = push_instant(plan.contacts, cell.direction, cell.phase, PUSH_STEP, DURATION)
            bound = largest_velocity_change(plan, push, reach, DURATION, lever[cell.height])
        found.append(CellResult(cell, bound))
    return found


def _lever(planned: PlannedWalk, q: Array) -> float:
    """Height of the trunk's centre of mass over the body's, in a configuration [m]."""
    import pinocchio as pin  # slow to load

    model = planned.body.robot.model
    data = model.createData()
    trunk = model.frames[model.getFrameId(planned.body.model.description.trunk_segment)].parentJoint
    com = pin.centerOfMass(model, data, q)
    return float((data.oMi[trunk] * model.inertias[trunk].lever)[2] - com[2])


def write(found: Robustness, folder: Path) -> None:
    """Write tables, pictures and, last, ``robustness.json``, which marks a complete study."""
    from validation.study.robustness.picture import draw  # loads matplotlib

    (folder / RESULT).unlink(missing_ok=True)
    with output_file(folder / MARKDOWN) as path:
        path.write_text(markdown_page(found.tables()), encoding="utf-8")
    for name in PICTURES if found.pushes else ():
        draw(found, folder / name)
    with output_file(folder / RESULT) as path:
        write_json(path, found.as_dict())
