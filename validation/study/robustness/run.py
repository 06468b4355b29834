"""A robustness study: cells climbed side by side, level after level, on dask."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ampm.exceptions import InputError
from ampm.parameters import RunParameters
from ampm.planner.capture import Reach, largest_velocity_change, push_instant
from validation.judge import profiles
from validation.progress import Progress, Stage
from validation.store.folders import check_target, output_file
from validation.store.identity import code_hash
from validation.store.json import write_json
from validation.store.machine import cores
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
from validation.study.robustness.journal import FILE as JOURNAL
from validation.study.robustness.journal import Journal
from validation.study.robustness.result import Robustness, results
from validation.study.robustness.walks import Level, LevelResult, Runner, as_text, walk_level
from validation.trial.plan import Request, load_request, own_gait, plan_walk

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from validation.study.sweep.workers import WorkerPool
    from validation.trial.plan import PlannedWalk

    Array = NDArray[np.float64]

RESULT = "robustness.json"
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
    needed(replicas)
    progress, target = progress or Progress(), None if out is None else Path(out)
    if resume and target is None:
        raise InputError("--resume needs the folder of a study; give --out DIR.")
    if target is not None:
        way_out = "resume (--resume) to go on with its study, or force (--force) to replace it"
        check_target(
            target, FILES, force=force or resume, what="robustness study", marks={JOURNAL}, way_out=way_out
        )
    if isinstance(run, RunParameters):
        request = Request("walk", own_gait(run))
    else:
        request = load_request(run, settings)
    limits = profiles.own_profile(request.name) if profile is None else profiles.profile(profile)
    planned = plan_walk(replace(request, run=request.run.replace({"gait.steps": PUSH_STEP + 2})), progress)
    text = as_text(planned.run)
    cells = chosen([*push_cells(quick), *other_cells(_segments(planned), quick)], only)
    identity = {
        "run": text, "profile": limits.name, "replicas": replicas, "quick": quick, "code": code_hash(),
        "cells": hashlib.sha256(repr(cells).encode()).hexdigest(),
    }  # fmt: skip
    path = None if target is None else target / JOURNAL
    with Journal(path, identity, resume=resume) as journal:

        def level(cell: Cell, value: float) -> Level:
            return Level(cell, value, text, request.name, limits.name, replicas)

        with progress.stage(f"{request.name}: robustness", "disturbances") as stage:
            _climb(cells, level, journal, replicas, workers, scheduler, stage, runner, progress)
    found = Robustness(
        gait=request.title,
        body=planned.run.body.source,
        controller=planned.run.controller.name,
        replicas=replicas,
        cells=results(cells, journal.done, replicas, _bounds(cells, planned)),
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


def _climb(
    cells: Sequence[Cell],
    level: Callable[[Cell, float], Level],
    journal: Journal,
    replicas: int,
    workers: int | None,
    scheduler: str | None,
    stage: Stage,
    runner: Runner,
    progress: Progress,
) -> None:
    """Walk every cell's values upward until one is not survived."""
    ended = 0

    def following(cell: Cell) -> Level | None:
        """The next level of a cell that is not walked yet; None at its end."""
        for value in cell.values:
            result = journal.done.get((cell.name, value))
            if result is None:
                return level(cell, value)
            if result.walked < needed(replicas):
                break
        return None

    waiting = [item for cell in cells if (item := following(cell)) is not None]
    ended = len(cells) - len(waiting)
    stage.advance(ended, len(cells))

    def kept(item: Level, result: LevelResult) -> Level | None:
        nonlocal ended
        journal.keep(item, result)
        further = following(item.cell)
        if further is None:
            ended += 1
            stage.advance(ended, len(cells))
        return further

    count = cores() if workers is None else workers
    if count < 1:
        raise InputError(f"--workers {count}: at least one process has to walk.", value=count)
    if scheduler is None and count == 1:
        while waiting:
            item = waiting.pop(0)
            if further := kept(item, runner(item)):
                waiting.insert(0, further)
        return
    if not waiting:
        return
    from distributed import as_completed  # imported here because dask is slow to load

    from validation.study.sweep.workers import local_pool, remote_pool

    pools: AbstractContextManager[WorkerPool] = (
        local_pool(min(count, len(waiting))) if scheduler is None else remote_pool(scheduler, progress.say)
    )
    with pools as pool:
        flying: dict[Any, Level] = {pool.client.submit(runner, item, pure=False): item for item in waiting}
        running = as_completed(list(flying), loop=pool.client.loop)
        for future in running:
            if further := kept(flying.pop(future), future.result()):
                new = pool.client.submit(runner, further, pure=False)
                flying[new] = further
                running.add(new)


def write(found: Robustness, out: Path) -> None:
    """Write table, pictures and, last, ``robustness.json``, which marks a complete study."""
    from validation.study.robustness.picture import draw  # imported here because matplotlib is slow to load
    from validation.study.robustness.text import markdown

    (out / RESULT).unlink(missing_ok=True)
    with output_file(out / MARKDOWN, force=True) as path:
        path.write_text(markdown(found), encoding="utf-8")
    if found.pushes:
        for name in PICTURES:
            with output_file(out / name, force=True) as path:
                draw(found, path)
    with output_file(out / RESULT, force=True) as path:
        write_json(path, found.as_dict())
