"""Step the physics again from a recorded start with the recorded torques, measure, and compare every bit.

The controller is not used: a replay tests that the record holds everything that the physics depends on. The
solver's warm start is not needed: a walk begins with that of new data, zero. Steps are logged and measured by
the functions of the walk itself, so that what was measured is compared as exactly as the states.
"""

import json
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ampm.compiled import bound
from ampm.exceptions import InputError
from ampm.geometry import Array
from models.scene import BodyModel
from validation.judge.compare import PARTS
from validation.judge.metrics import METRICS
from validation.judge.signals import kept_rows, measured_columns
from validation.measure.equations import Equations, check_equations
from validation.measure.measure import MeasuredGait, measure
from validation.progress import Progress
from validation.store.environment import describe_environment
from validation.store.record import stored_columns
from validation.store.saved import ENVIRONMENT_FILE, SavedRun, load_saved_run
from validation.store.signals import SIGNALS_FILE, Signals
from validation.trial.bridge import passive_joints, to_pinocchio
from validation.trial.log import RunLog
from validation.trial.physics import Physics, quiet_mujoco
from validation.trial.plan import Body
from validation.trial.record import JOINTS_FILE, STORED, SimulationRecord
from validation.trial.step import keep_step

_Table = tuple[str, list[str], Array, NDArray[Any], NDArray[Any]]
_LIMIT = METRICS["equations_defect_median"].tolerances["default"]
_CONSTANTS = ("mass", "gravity", "time_step", "friction")
_ROUNDING = 1e-12  # of the sum of the parts of the ZMP error [m], or in shares of their size


@dataclass(frozen=True)
class Replay:
    """Result of a replay."""

    steps: int  # simulation steps that were recorded
    file: str | None = None  # file in which something differs; None if nothing does
    signal: str | None = None  # its first column that differs
    time: float = math.inf  # time of the first difference [s]
    recorded: float = math.nan  # the recorded value
    replayed: float = math.nan  # the value of the replay
    note: str = ""  # a likely reason for a difference, empty if none is known
    # the equations of motion of all repeated steps; None if they were not asked for
    equations: Equations | None = None

    @property
    def identical(self) -> bool:
        """Whether every bit agrees."""
        return self.signal is None

    @property
    def passed(self) -> bool:
        """Whether every bit agrees, and the median defect of the equations is within its limit."""
        found = self.equations
        return self.identical and (found is None or not found.steps or found.median <= _LIMIT * found.change)

    def __str__(self) -> str:
        if self.identical:
            return f"identical ({self.steps} steps, every bit of states, contacts and measured signals)"
        return (
            f"{self.signal} of {self.file} differs first, at {self.time:.6g} s: recorded {self.recorded!r}, "
            f"replayed {self.replayed!r}"
        )


def replay(directory: str | Path, *, equations: bool = False, progress: Progress | None = None) -> Replay:
    """Replay the folder of a finished run.

    Args:
        directory: the folder.
        equations: also hold every step to the equations of motion by Pinocchio.
        progress: where to report stages.

    Raises:
        InputError: a file is missing, damaged, or not what the run wrote; ``equations`` of a body with dry
            friction in its joints, whose force is not recorded.
    """
    saved, progress = load_saved_run(directory), progress or Progress()
    saved.model()  # refuses a model of another body
    if saved.record.point_sites != tuple(site for _, _, site in saved.body.sole_points()):
        raise InputError(f"{directory} has sole points of two bodies; give the folder of one run.")
    physics = Physics(Body.of(BodyModel(saved.model_xml, saved.body)), saved.parameters)
    passive, twin = passive_joints(physics.model), physics.robot.model
    if equations and passive.friction.any():
        raise InputError(
            "the equations of motion cannot be checked: joints of this body have dry friction, whose "
            "force is not recorded; replay without --equations."
        )
    with progress.stage("replay", "steps") as stage:
        again = step_again(physics, saved.record, stage.advance)
    with progress.stage("measurement"):
        measured = measure(again, twin, to_pinocchio)
        found = _first_difference(saved, again, measured)
        if equations:
            steps = np.arange(again.steps)
            found = replace(found, equations=check_equations(again, twin, passive, to_pinocchio, steps))
    return found if found.identical else replace(found, note=_note(saved.directory / ENVIRONMENT_FILE))


def step_again(
    physics: Physics, record: SimulationRecord, advance: Callable[[int, int], None] | None = None
) -> SimulationRecord:
    """Step the physics with recorded torques, up to the first recorded state of which a bit differs.

    The record has start, torques and external forces; ``advance`` is called with steps done and steps in all.

    Returns:
        The repeated steps, without what a controller would add.
    """
    data, body, done = physics.data, physics.body, 0
    data.qpos[:], data.qvel[:] = record.q[0], record.qd[0]
    log, segments = RunLog(record.steps, physics), record.external_segments
    keep = bound(keep_step, (log.handle,), 0, 0, data.efc_force)
    pushed = [physics.model.body(name).id for name in segments]
    log.external = {name: np.zeros((record.steps, 9)) for name in segments}
    with quiet_mujoco():
        for row, (start, end) in enumerate(pairwise(record.state_rows.tolist()), 1):
            for k, torque in enumerate(record.torque_at(range(start, end)), start):
                physics.engine.step1()
                data.ctrl[:] = torque
                if pushed:
                    push = np.hstack([record.external_force[k], record.external_moment[k]])
                    data.xfrc_applied[pushed] = push
                    acts = push.any(axis=1) | record.external_position[k].any(axis=1)
                    here = np.hstack([push, data.xipos[pushed]])
                    log.keep_pushes(k, {segments[i]: here[i] for i in np.flatnonzero(acts)})
                physics.engine.step2()
                keep(k, data.ncon, data.efc_force)
            done = end
            recorded = np.concatenate([record.q[row], record.qd[row]])
            if _differ(recorded, np.concatenate([body.qpos, body.qvel])).any():
                break
            if row % 50 == 0 and advance is not None:
                advance(end, record.steps)
    said = {name: getattr(record, name) for name in ("floor", "changes", "controller", "disturbances")}
    again = log.close(done, record.outcome)
    ticks = slice(len(again.tick_time))
    said |= {name: getattr(record, name)[ticks] for name in ("tick_torque", "torque_rate")}
    return replace(again, **said)


def _first_difference(saved: SavedRun, again: SimulationRecord, measured: MeasuredGait) -> Replay:
    """The earliest number on disk that the repeated steps do not have."""
    first = Replay(saved.record.steps)
    for file, columns, times, recorded, replayed in _tables(saved, again, measured):
        differ = np.argwhere(_differ(recorded, replayed))
        if len(differ) and times[differ[0, 0]] < first.time:
            at = tuple(differ[0])
            values = float(times[at[0]]), float(recorded[at]), float(replayed[at])
            first = Replay(saved.record.steps, file, columns[at[1]], *values)
    return first


def _differ(recorded: NDArray[Any], replayed: NDArray[Any]) -> NDArray[np.bool_]:
    """Where the bit patterns differ, not the values: -0 is not 0, and a NaN is itself."""
    one, two = (np.ascontiguousarray(item, dtype=np.float64) for item in (recorded, replayed))
    return (one.view(np.int64) != two.view(np.int64)) & ~(np.isnan(one) & np.isnan(two))


def _tables(saved: SavedRun, again: SimulationRecord, measured: MeasuredGait) -> Iterator[_Table]:
    """All that is on disk and was repeated, up to where the replay ends.

    Yields:
        A file, names of m columns, times of n rows [s], and recorded and replayed numbers, shape (n, m).
    """
    record, stored = saved.record, saved.signals
    then, now = (np.array([[getattr(item, name) for name in _CONSTANTS]]) for item in (record, again))
    yield JOINTS_FILE, list(_CONSTANTS), np.zeros(1), then, now
    pushes = ("external_force", "external_moment", "external_position") if record.external_segments else ()
    stored_as = stored_columns(vars(record))
    for name in ("q", "qd", "point_force", "point_position", *pushes):
        file, columns = STORED[name], stored_as[name][0]
        recorded, replayed = getattr(record, name), getattr(again, name)
        rows = np.arange(record.steps) if name in pushes else record.state_rows
        rows = rows[rows < len(replayed)]
        shape = len(rows), len(columns)
        recorded, replayed = recorded[: len(rows)].reshape(shape), replayed[rows].reshape(shape)
        yield file, columns, again.time[rows], recorded, replayed
    every = kept_rows(record.steps, record.time_step)
    if len(stored) != (count := len(range(record.steps)[every])):
        raise InputError(f"{SIGNALS_FILE} is damaged: it should have {count} rows; walk the gait again.")
    time = measured.time[every]
    held = measured_columns(measured, every)
    recorded = np.column_stack([stored[name][: len(time)].astype(np.float64) for name in held])
    yield SIGNALS_FILE, list(held), time, recorded, np.column_stack(list(held.values()))
    if not record.changes:
        total, error = (item[: len(time)] for item in _zmp_error(stored))
        yield SIGNALS_FILE, ["sum of zmp_error_x", "sum of zmp_error_y"], time, total, error


def _zmp_error(stored: Signals) -> tuple[Array, Array]:
    """The recorded parts of the ZMP error in sum, and what they add up to, shape (N, 2) [m].

    They are given as equal where they agree to rounding. They need not where the plan moved: between two
    instants of a plan that was kept, ZMP and force go on along lines of their own.
    """
    parts = np.array([stored.vector(f"zmp_error_{part}", "xy") for part in PARTS])
    total, size = parts.sum(axis=0), np.maximum(np.abs(parts).sum(axis=0), 1.0)
    error = stored.vector("measured_zmp", "xy") - stored.vector("plan_zmp", "xy")
    error = np.where(np.isfinite(stored.vector("measured_zmp_momentum", "xy")), error, np.nan)
    return total, np.where(np.abs(total - error) <= _ROUNDING * size, total, error)


def _note(path: Path) -> str:
    """A sentence if the run was recorded with another engine's version or on another processor."""
    try:
        then, now = json.loads(path.read_text(encoding="utf-8")), describe_environment()
        pairs = {"processor": (then["processor"], now["processor"])}
        for name in ("MuJoCo", "Drake"):
            pairs[name] = tuple(item["versions"].get(name.lower()) for item in (then, now))
    except (OSError, ValueError, KeyError, TypeError):
        return ""
    differences = [f"{what} {a} then, {b} now" for what, (a, b) in pairs.items() if a != b]
    return f"the environment has changed: {'; '.join(differences)}." if differences else ""
