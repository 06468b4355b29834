"""Step the physics again from a recorded start with the recorded torques, measure, and compare every bit.

The controller is not used: a replay tests that the record holds everything that the physics depends on. The
solver's warm start is not needed: a walk begins with that of new data, zero. Steps are logged and measured by
the functions of the walk itself, so that what was measured is compared as exactly as the states.
"""

import math
from collections.abc import Callable, Iterator, Mapping
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
from validation.judge.signals import columns_of, kept_rows
from validation.measure.measure import MeasuredGait, measure
from validation.progress import Progress
from validation.store.environment import describe_environment
from validation.store.record import record_tables
from validation.store.saved import SavedRun, load_saved_run
from validation.store.signals import Signals
from validation.trial.disturbances import Plant, Recorded, release
from validation.trial.files import RunFile
from validation.trial.log import RunLog, keep_step
from validation.trial.physics import Physics, quiet_mujoco
from validation.trial.plan import Body
from validation.trial.record import SimulationRecord

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

    @property
    def identical(self) -> bool:
        """Whether every bit agrees."""
        return self.signal is None

    def __str__(self) -> str:
        if self.identical:
            return f"identical ({self.steps} steps, every bit of states, contacts and measured signals)"
        return (
            f"{self.signal} of {self.file} differs first, at {self.time:.6g} s: recorded {self.recorded!r}, "
            f"replayed {self.replayed!r}"
        )


def replay(directory: str | Path, *, progress: Progress | None = None) -> Replay:
    """Step a finished run again; ``identical`` of the result says whether every bit agrees.

    Raises :class:`InputError` if a file is missing, damaged, or not what the run wrote.
    """
    saved, progress = load_saved_run(directory), progress or Progress()
    saved.model()  # refuses a model of another body
    if saved.record.point_sites != tuple(site for _, _, site in saved.body.sole_points()):
        raise InputError(f"{directory} has sole points of two bodies; give the folder of one run.")
    physics = Physics(Body.of(BodyModel(saved.model_xml, saved.body)), saved.parameters)
    with progress.stage("replay", "steps") as stage:
        again = step_again(physics, saved.record, stage.advance)
    with progress.stage("measurement"):
        found = _first_difference(saved, again, measure(again, physics.robot.model))
    return found if found.identical else replace(found, note=_note(saved.summary["environment"]))


def step_again(
    physics: Physics, record: SimulationRecord, advance: Callable[[int, int], None] | None = None
) -> SimulationRecord:
    """Step the physics with recorded torques, up to the first recorded state of which a bit differs.

    The record has start, torques and external forces; ``advance`` is called with steps done and steps in all.
    What a controller would add is not repeated.
    """
    data, body, done = physics.data, physics.body, 0
    data.qpos[:], data.qvel[:] = record.q[0], record.qd[0]
    log, pushes = RunLog(record.steps, physics), Recorded(record)
    keep = bound(keep_step, (log.handle,), 0, 0, data.efc_force)
    plant = Plant(physics)
    log.external = {name: np.zeros((record.steps, 9)) for name in record.external_segments}
    with quiet_mujoco():
        for row, (start, end) in enumerate(pairwise(record.state_rows.tolist()), 1):
            for k, torque in enumerate(record.torque_at(range(start, end)), start):
                physics.engine.step1()
                data.ctrl[:] = torque
                if record.external_segments:
                    release(plant)
                    pushes.apply(k * record.time_step, plant)
                    log.keep_pushes(k, plant.pushes)
                physics.engine.step2()
                keep(k, data.ncon, data.efc_force)
            done = end
            recorded = np.concatenate([record.q[row], record.qd[row]])
            if _differ(recorded, np.concatenate([body.qpos, body.qvel])).any():
                break
            if row % 50 == 0 and advance is not None:
                advance(end, record.steps)
    again = log.close(done, record.outcome)
    ticks = slice(len(again.tick_time))
    said = {name: getattr(record, name)[ticks] for name in ("tick_torque", "torque_rate")}
    return replace(again, floor=record.floor, changes=record.changes, controller=record.controller, **said)


def _first_difference(saved: SavedRun, again: SimulationRecord, measured: MeasuredGait) -> Replay:
    """The earliest number on disk that the repeated steps do not have."""
    first = Replay(saved.record.steps)
    for file, recorded, replayed in _tables(saved, again, measured):
        rows = len(replayed["time"])  # up to where the replay ends
        for name, values in recorded.items():
            differ = np.flatnonzero(_differ(values[:rows], replayed[name]))
            if differ.size and (time := float(replayed["time"][differ[0]])) < first.time:
                one, other = float(values[differ[0]]), float(replayed[name][differ[0]])
                first = Replay(saved.record.steps, file, name, time, one, other)
    return first


def _differ(recorded: NDArray[Any], replayed: NDArray[Any]) -> NDArray[np.bool_]:
    """Where the bit patterns differ, not the values: -0 is not 0, and a NaN is itself."""
    one, two = (np.ascontiguousarray(item, dtype=np.float64) for item in (recorded, replayed))
    return (one.view(np.int64) != two.view(np.int64)) & ~(np.isnan(one) & np.isnan(two))


def _tables(
    saved: SavedRun, again: SimulationRecord, measured: MeasuredGait
) -> Iterator[tuple[str, Mapping[str, NDArray[Any]], Mapping[str, NDArray[Any]]]]:
    """A file with recorded and replayed columns (N,), for all that is on disk and was repeated."""
    record, stored = saved.record, saved.signals
    then, now = ({name: np.array([getattr(item, name)]) for name in _CONSTANTS} for item in (record, again))
    yield RunFile.JOINTS, then, {"time": np.zeros(1), **now}
    repeated = record_tables(again)
    for file, table in record_tables(record).items():
        if file != RunFile.TICKS:  # are of the controller
            yield file, table, repeated[file]
    every = kept_rows(record.steps, record.time_step)
    if len(stored) != (count := len(range(record.steps)[every])):
        raise InputError(f"{RunFile.SIGNALS} is damaged: it should have {count} rows; walk the gait again.")
    held = columns_of({"measured": measured}, every)
    yield RunFile.SIGNALS, {name: stored[name] for name in held if name in stored}, held
    time, names = held["time"], ("sum of zmp_error_x", "sum of zmp_error_y")
    total, error = (dict(zip(names, item[: len(time)].T, strict=True)) for item in _zmp_error(stored))
    yield RunFile.SIGNALS, total, {"time": time, **error}


def _zmp_error(stored: Signals) -> tuple[Array, Array]:
    """Sum of the recorded parts of the ZMP error, and the error by the recorded ZMPs, shape (N, 2) [m].

    Where both agree to rounding, the sum stands for both.
    """
    parts = np.array([stored.vector(f"zmp_error_{part}", "xy") for part in PARTS])
    total, size = parts.sum(axis=0), np.maximum(np.abs(parts).sum(axis=0), 1.0)
    error = stored.vector("measured_zmp", "xy") - stored.vector("plan_zmp", "xy")
    error = np.where(np.isfinite(stored.vector("measured_zmp_momentum", "xy")), error, np.nan)
    return total, np.where(np.abs(total - error) <= _ROUNDING * size, total, error)


def _note(then: Mapping[str, Any]) -> str:
    """A sentence if the run was recorded with another engine's version or on another processor."""
    now = describe_environment()
    pairs = {"processor": (then["processor"], now["processor"])}
    for name in ("MuJoCo", "Drake"):
        pairs[name] = tuple(item["versions"].get(name.lower()) for item in (then, now))
    differences = [f"{what} {a} then, {b} now" for what, (a, b) in pairs.items() if a != b]
    return f"the environment has changed: {'; '.join(differences)}." if differences else ""
