"""Robustness study of a gait: what it survives with its body and controller."""

import math
from collections.abc import Callable, MutableMapping, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any, Unpack

from ampm.exceptions import InputError
from ampm.parameters import NO_PLAN, RunParameters
from models.scene import BodyModel
from validation.judge import profiles
from validation.run.walk import walk_planned
from validation.study.many import Execution, Search, Task, study_folder, walk_many, write_study
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
    push_instant,
)
from validation.study.robustness.result import RESULT, CellResult, Robustness
from validation.study.row_file import Row
from validation.trial.plan import PlannedWalk, Request, load_request, plan_walk
from validation.trial.record import SimulationRecord
from validation.trial.shapes import Shapes
from validation.trial.simulate import simulate
from validation.trial.users import PLANNER

CROSSED = "the legs met"
_EVERY = 0.01  # time between two looks at the distance of the legs [s]


def walk_replica(request: Request, profile: str | None) -> Row:
    """Walk a complete request once; without a profile the walk is not measured.

    Returns:
        ``outcome`` and ``cause``, which is empty for a walk that survived; ``passed``, whether it kept the
        tolerances; ``zmp``, the RMSE along x and y [m], NaN if it is not measured.
    """
    name, run = request.name, request.run.undisturbed
    planned = _planned(name, run) if run.gait.planner in PLANNER.known else plan_walk(Request(name, run))
    disturbed = replace(planned, request=request)
    passed, zmp = False, [math.nan, math.nan]
    if profile is None:
        record = simulate(disturbed)
    else:
        trial = walk_planned(disturbed, profiles.profile(profile))
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


def climb(
    cell: Cell,
    replicas: int,
    task: Callable[[Cell, float, int], Task],
    results: MutableMapping[str, CellResult],
) -> Search:
    """Walk rising values of a cell up to the first that is not survived, and store the result by its name.

    Replicas of a value are not walked once too many have failed. ``task`` makes the walk of a cell, a value
    and a replica.
    """
    least, kept, found = needed(replicas), True, CellResult(cell)
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
        found = replace(found, survived=value, within=value if kept else found.within)
    results[cell.name] = found


def robustness(
    run: Request | RunParameters | str | None = "normal",
    settings: Sequence[str] = (),
    *,
    quick: bool = False,
    only: Sequence[str] = (),
    replicas: int = REPLICAS,
    profile: str | None = None,
    **execution: Unpack[Execution],
) -> Robustness:
    """Find what a gait survives with its body and controller.

    Args:
        run: parameters, preset or TOML file.
        settings: ``key=value`` texts, for a preset or file.
        quick: a small subset on a coarse grid.
        only: kinds of disturbance, see :func:`validation.study.robustness.cells.chosen`.
        replicas: walks of each value; four fifths have to survive.
        profile: name of the tolerances; the preset's own by default.
        execution: workers and folder, see :class:`validation.study.many.Execution`.

    Raises:
        InputError, RefusedGait: the request cannot be met, or ``out`` is used otherwise.
        StudyStopped: see :func:`validation.study.many.walk_many`.
    """
    needed(replicas)
    cells = chosen([*push_cells(quick), *other_cells(quick)], only)
    folder = study_folder(execution)
    request = load_request(run, settings)
    if request.run.gait.planner == NO_PLAN and any(cell.is_push for cell in cells):
        kinds = ", ".join(sorted({cell.kind for cell in other_cells(quick)}))
        raise InputError(
            "gait.planner = none plans no steps, so that a push has no phase of a step; study other "
            f"disturbances with --only: {kinds}."
        )
    limits = profiles.own_profile(request.name, request.run) if profile is None else profiles.profile(profile)
    short = replace(request, run=request.run.replace({"gait.steps": PUSH_STEP + 2}))
    planned = plan_walk(short, execution.get("progress"))
    task = partial(replica_task, planned=planned, profile=limits.name)
    results: dict[str, CellResult] = {}
    searches = [climb(cell, replicas, task, results) for cell in cells]
    rows = walk_many(searches, label=f"{request.name}: robustness", unit="disturbances", **execution)
    crashes = tuple(
        f"{row['key']}: {row['cause']}" for row in rows if row["outcome"] == "crashed" and "reason" in row
    )
    found = Robustness(
        gait=request.title,
        body=planned.run.body.source,
        controller=planned.run.controller.name,
        replicas=replicas,
        cells=tuple(results[cell.name] for cell in cells),
        crashes=crashes,
    )
    if folder is not None:
        write_study(found, folder / RESULT)
    return found


def replica_task(cell: Cell, value: float, replica: int, planned: PlannedWalk, profile: str) -> Task:
    """The walk of one replica: the first as planned, others with an error at the start, and a shift.

    The plan has at least ``PUSH_STEP + 2`` steps. Walks with a push are not judged.
    """
    settings: dict[str, Any] = {
        "disturbance.seed": replica,
        "sensors.seed": replica,
        "disturbance.start_velocity": START if replica else 0.0,
        "gait.steps": PUSH_STEP + 1 + AFTER if cell.is_push else STEPS,
    }
    if cell.is_push:
        shift, step = SHIFTS[replica % len(SHIFTS)], PUSH_STEP + replica % 2
        time, direction = push_instant(planned.plan.contacts, cell.direction, cell.phase, step, shift)
        x, y = (planned.plan.mass * value / DURATION * direction).tolist()
        settings |= {
            "disturbance.push_segment": cell.height,
            "disturbance.push_x": x,
            "disturbance.push_y": y,
            "disturbance.push_at": time,
            "disturbance.push_duration": DURATION,
        }
    else:
        settings[cell.key] = value
    request = Request(planned.name, planned.run.as_is().replace(settings))
    options = {"request": request, "profile": None if cell.is_push else profile}
    return Task(f"{cell.name} {value:g}, replica {replica}", walk_replica, options)
