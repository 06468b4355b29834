"""A robustness study: cells climbed side by side, level after level, on dask."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ampm.geometry import Array
from ampm.parameters import RunParameters
from ampm.planner.capture import Reach, largest_velocity_change, push_instant
from ampm.run_file import dump_run
from validation.judge import profiles
from validation.progress import Progress
from validation.store.folders import output_file
from validation.store.identity import code_hash
from validation.store.json import write_json
from validation.study.resumable import Journal, processes, study_folder, work_off
from validation.study.robustness.cells import (
    DURATION,
    PUSH_STEP,
    PUSHES,
    REPLICAS,
    Cell,
    chosen,
    needed,
    other_cells,
    push_cells,
)  # fmt: skip
from validation.study.robustness.result import CellResult, Robustness
from validation.study.robustness.walks import (
    Level,
    LevelResult,
    Runner,
    as_row,
    from_row,
    walk_level,
)  # fmt: skip
from validation.trial.plan import PlannedWalk, load_request, plan_walk

RESULT, JOURNAL = "robustness.json", "levels.jsonl"
MARKDOWN = "robustness.md"
PICTURES = ("robustness.svg", "robustness.png")
FILES = (RESULT, MARKDOWN, *PICTURES, JOURNAL)


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
    force: bool = False,
    progress: Progress | None = None,
    runner: Runner = walk_level,
) -> Robustness:
    """Find what a gait survives with its body and controller.

    Args:
        run: parameters, preset or TOML file.
        settings: ``key=value`` texts, for a preset or file.
        quick: a small subset on a coarse grid.
        only: kinds of disturbance, see :func:`validation.study.robustness.cells.chosen`.
        replicas: walks of each value; four fifths have to survive.
        profile: name of the tolerances; the preset's own by default.
        workers: processes, None for one a core; one walks in this very process.
        scheduler: address of a dask scheduler that is running already.
        out: folder of results, see :data:`FILES`; None writes nothing.
        resume: go on with what is in ``out``.
        force: replace an earlier study there.
        progress: where to report it.
        runner: what walks one level.

    Raises:
        InputError, RefusedGait: the request cannot be met, or ``out`` holds something else.
    """
    needed(replicas), processes(workers)
    chosen([*push_cells(), *other_cells()], only)  # refuse before anything is planned
    progress = progress or Progress()
    target = study_folder(out, FILES, JOURNAL, what="robustness study", resume=resume, force=force)
    request = load_request(run, settings)
    limits = profiles.own_profile(request.name) if profile is None else profiles.profile(profile)
    planned = plan_walk(replace(request, run=request.run.replace({"gait.steps": PUSH_STEP + 2})), progress)
    text = dump_run(planned.run)
    cells = chosen([*push_cells(quick), *other_cells(_segments(planned), quick)], only)
    identity = {
        "run": text, "profile": limits.name, "replicas": replicas, "quick": quick, "code": code_hash(),
        "cells": hashlib.sha256(repr(cells).encode()).hexdigest(),
    }  # fmt: skip
    path = None if target is None else target / JOURNAL
    with Journal(path, identity, resume=resume) as journal:
        done = dict(map(from_row, journal.rows))

        def following(cell: Cell) -> Level | None:
            """The next value that is not walked yet; None at the end, or after one that was not survived."""
            for value in cell.values:
                result = done.get((cell.name, value))
                if result is None:
                    return Level(cell, value, text, request.name, limits.name, replicas)
                if result.walked < needed(replicas):
                    break
            return None

        waiting = [item for cell in cells if (item := following(cell)) is not None]
        with progress.stage(f"{request.name}: robustness", "disturbances") as stage:
            stage.advance(len(cells) - len(waiting), len(cells))

            def kept(item: Level, result: LevelResult) -> Level | None:
                done[item.cell.name, item.value] = result
                journal.keep(as_row(item, result))
                stage.advance(sum(following(cell) is None for cell in cells), len(cells))
                return following(item.cell)

            work_off(waiting, runner, kept, workers=workers, scheduler=scheduler, report=progress.say)
    bounds = _bounds(cells, planned)
    levels = [[(v, done[cell.name, v]) for v in cell.values if (cell.name, v) in done] for cell in cells]
    found = Robustness(
        gait=request.title,
        body=planned.run.body.source,
        controller=planned.run.controller.name,
        replicas=replicas,
        cells=tuple(
            CellResult(cell, tuple(tried), replicas, bounds.get(cell.name))
            for cell, tried in zip(cells, levels, strict=True)
        ),
        quick=quick,
    )
    if target is not None:
        write(found, target)
    return found


def _segments(planned: PlannedWalk) -> list[str]:
    """Segments of one side, as the other one mirrors them."""
    model = planned.body.model.compile()
    names = [model.body(i).name for i in range(1, model.nbody)]
    return [name for name in names if not name.startswith("right_")]


def _bounds(cells: Sequence[Cell], planned: PlannedWalk) -> dict[str, float]:
    """What legs can capture, by name of the cell [m/s]."""
    plan, description = planned.plan, planned.body.model.description
    middle = 0.5 * plan.duration
    height = float(plan.sample([middle]).com[0, 2])
    reach = Reach.of(description, height)
    lever = _lever(planned, plan.posture.sample([middle]).q[0])
    found = {}
    for cell in cells:
        if cell.key == PUSHES:
            push = push_instant(plan.contacts, cell.direction, cell.phase, PUSH_STEP, DURATION)
            arm = lever if cell.height == "chest" else 0.0
            found[cell.name] = largest_velocity_change(plan, push, reach, DURATION, max(arm, 0.0))
    return found


def _lever(planned: PlannedWalk, q: Array) -> float:
    """Height of the trunk's centre of mass over the body's, in a configuration [m]."""
    import pinocchio as pin  # slow to load

    model = planned.body.robot.model
    data = model.createData()
    trunk = model.frames[model.getFrameId(planned.body.model.description.trunk_segment)].parentJoint
    com = pin.centerOfMass(model, data, q)
    return float((data.oMi[trunk] * model.inertias[trunk].lever)[2] - com[2])


def write(found: Robustness, out: Path) -> None:
    """Write table, pictures and, last, ``robustness.json``, which marks a complete study."""
    from validation.study.robustness.picture import draw  # imported here because matplotlib is slow to load
    from validation.study.robustness.text import markdown

    (out / RESULT).unlink(missing_ok=True)
    with output_file(out / MARKDOWN, force=True) as path:
        path.write_text(markdown(found), encoding="utf-8")
    if found.pushes:
        for name in PICTURES:
            draw(found, out / name)
    with output_file(out / RESULT, force=True) as path:
        write_json(path, found.as_dict())
