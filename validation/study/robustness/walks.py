"""The walks of one value of one cell; runs in a worker and returns numbers only."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ampm.exceptions import AmpmError
from ampm.planner.capture import push_instant
from ampm.run_file import load_run
from ampm.section import parse_toml
from validation.judge.profiles import profile as find_profile
from validation.study.robustness.cells import (
    AFTER,
    DURATION,
    PUSH_STEP,
    PUSHES,
    SHIFTS,
    START,
    STEPS,
    Cell,
    needed,
)  # fmt: skip
from validation.trial.plan import Request, plan_walk

if TYPE_CHECKING:
    from models.scene import BodyModel
    from validation.trial.plan import PlannedWalk
    from validation.trial.record import SimulationRecord
    from validation.trial.shapes import Shapes

CROSSED = "the legs met"
_EVERY = 0.01  # time between two looks at the distance of the legs [s]


@dataclass(frozen=True)
class Level:
    """One value of a cell, to be walked.

    Attributes:
        cell: kind of disturbance.
        value: of its key, or velocity change of the push [m/s].
        run: as TOML, all values found.
        gait: its name.
        profile: name of the tolerances.
        replicas: walks, fewer if too many have failed.
    """

    cell: Cell
    value: float
    run: str
    gait: str
    profile: str
    replicas: int


@dataclass(frozen=True)
class LevelResult:
    """What became of them.

    Attributes:
        walked: replicas that walked to the end.
        passed: of these, those within the profile's tolerances.
        causes: how the others ended.
        zmp: largest RMSE of the ZMP along x and y over those that walked [m], NaN if none did.
    """

    walked: int
    passed: int
    causes: tuple[str, ...]
    zmp: tuple[float, float]


def as_row(level: Level, result: LevelResult) -> dict[str, Any]:
    """Row of a journal."""
    return {"cell": level.cell.name, "value": level.value, **asdict(result)}


def from_row(row: Mapping[str, Any]) -> tuple[tuple[str, float], LevelResult]:
    """Cell, value and result of a row."""
    zmp = tuple(math.nan if value is None else value for value in row["zmp"])
    result = LevelResult(row["walked"], row["passed"], tuple(row["causes"]), (zmp[0], zmp[1]))
    return (row["cell"], row["value"]), result


def walk_level(level: Level) -> LevelResult:
    """Walk one value until its replicas are done, or too many have failed to be survived."""
    walked, passed, causes = 0, 0, []
    zmp = [math.nan, math.nan]
    for replica in range(level.replicas):
        try:
            walk = walk_replica(level, replica)
        except AmpmError as error:
            causes.append(str(error))
        else:
            if walk.cause:
                causes.append(walk.cause)
            else:
                walked += 1
                passed += walk.passed
                zmp = np.fmax(walk.zmp, zmp).tolist()
        if len(causes) > level.replicas - needed(level.replicas):
            break
    return LevelResult(walked, passed, tuple(causes), (zmp[0], zmp[1]))


class Replica(NamedTuple):
    """One walk.

    Attributes:
        cause: of its end, empty if it walked to the end and its legs did not meet.
        passed: whether it kept the tolerances; a pushed walk is not judged.
        zmp: RMSE along x and y [m], NaN if it is not judged.
    """

    cause: str
    passed: bool = False
    zmp: tuple[float, float] = (math.nan, math.nan)


def walk_replica(level: Level, replica: int) -> Replica:
    """Walk one replica: the first as planned, the others with an error at the start and a shifted push.

    Raises:
        AmpmError: there is no such walk.
    """
    from validation.run.walk import walk_planned  # loads the simulator
    from validation.trial.disturbances import Push
    from validation.trial.simulate import simulate

    cell = level.cell
    pushed = cell.key == PUSHES
    planned = _planned(level.run, level.gait, PUSH_STEP + 1 + AFTER if pushed else STEPS)
    start = {} if replica == 0 else {"disturbance.start_velocity": START}
    run = planned.run.replace({**cell.settings(level.value), **start, "disturbance.seed": replica})
    if pushed:
        instant = push_instant(
            planned.plan.contacts, cell.direction, cell.phase, PUSH_STEP + replica % 2, DURATION,
            SHIFTS[replica % len(SHIFTS)],
        )  # fmt: skip
        x, y = planned.plan.mass * level.value / DURATION * instant.direction
        push = Push(cell.height, (float(x), float(y), 0.0), instant.time, DURATION)
        record = simulate(planned.plan, run, planned.body.model, disturbances=[push])
        return Replica(cause_of(record, planned))
    trial = walk_planned(
        replace(planned, request=replace(planned.request, run=run)), find_profile(level.profile)
    )
    found = [float(trial.metrics[f"zmp_{axis}_rmse"].value) for axis in "xy"]
    return Replica(cause_of(trial.record, planned), trial.verdict.passed, (found[0], found[1]))


def cause_of(record: SimulationRecord, planned: PlannedWalk) -> str:
    """Why a walk does not count as survived; empty if it does. A hand may touch, but legs must not meet."""
    end = record.outcome
    if not end.completed:
        return f"{end.name}: {end.cause}"
    every = max(1, round(_EVERY / record.time_step))
    gap = _legs(planned.body.model).recorded_gaps(record.q[::every]).distance.min()
    return CROSSED if gap < 0.0 else ""


@lru_cache(maxsize=4)
def _legs(body: BodyModel) -> Shapes:
    """Shapes of the legs, made once in a process."""
    from validation.trial.shapes import Shapes  # loads the simulator

    return Shapes(body.compile(), only_legs=True)


@lru_cache(maxsize=4)
def _planned(text: str, gait: str, steps: int) -> PlannedWalk:
    """The plan of a complete run, made once in a process."""
    return plan_walk(
        Request(gait, load_run(None, **parse_toml(text, "the run")).replace({"gait.steps": steps}))
    )


Runner = Callable[[Level], LevelResult]
"""Function that walks one level; tests replace it."""
