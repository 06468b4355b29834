"""Step the physics again from a recorded start with the recorded torques, and compare every bit.

The controller is not used: a replay tests that the record holds everything that the physics depends on. The
solver's warm start is none of it: a walk begins with that of new data, zero.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import mujoco
import numpy as np

from ampm.exceptions import InputError
from ampm.geometry import Array
from ampm.physics_parameters import DrakeParameters
from ampm.run_file import load_run
from validation.measure.equations import Equations, Steps, defects, summarize, velocity_names
from validation.progress import Progress
from validation.store.environment import describe_environment
from validation.store.record import StoredRecord, state_names
from validation.store.saved import ENVIRONMENT_FILE, RUN_FILE, check_files
from validation.trial.bridge import passive_joints, pinocchio_model, to_pinocchio
from validation.trial.engine import drake_of, make_engine
from validation.trial.physics import SolePoints, point_forces, quiet_mujoco
from validation.trial.record import SimulationRecord

_BLOCK = 1024  # steps whose equations are checked at a time


@dataclass(frozen=True)
class Replay:
    """Result of a replay.

    Attributes:
        steps: simulation steps that were stepped again.
        signal: first column that differs, as in ``joints.parquet``; None if none does.
        time: time of the first difference [s].
        recorded: the recorded value.
        replayed: the value of the replay.
        note: a likely reason for a difference, empty if none is known.
        equations: the equations of motion of all steps; None if they were not asked for.
    """

    steps: int
    signal: str | None = None
    time: float = float("nan")
    recorded: float = float("nan")
    replayed: float = float("nan")
    note: str = ""
    equations: Equations | None = None

    @property
    def identical(self) -> bool:
        """Whether every bit agrees."""
        return self.signal is None

    def __str__(self) -> str:
        if self.signal is None:
            return f"identical ({self.steps} steps, every bit of q and qd)"
        return (
            f"{self.signal} differs first, at {self.time:.6g} s: recorded {self.recorded!r}, "
            f"replayed {self.replayed!r}"
        )


def replay(directory: str | Path, *, equations: bool = False, progress: Progress | None = None) -> Replay:
    """Replay a run folder.

    Args:
        directory: of a finished run.
        equations: also hold every step to the equations of motion by Pinocchio.
        progress: where to report stages.

    Raises:
        InputError: a file is missing, damaged, or not what the run wrote; ``equations`` of a body with dry
            friction in its joints, whose force is not recorded.
    """
    directory = Path(directory)
    if not directory.is_dir():
        raise InputError(f"there is no folder {directory}; give the folder of a run.")
    record = StoredRecord(directory)
    check_files(directory)
    model, drake = record.model(), drake_of(load_run(directory / RUN_FILE, ()))
    check = EquationCheck(model, record) if equations else None
    with (progress or Progress()).stage("replay", "steps") as stage:
        found = step_again(model, record, stage.advance, check, drake)
    return found if found.identical else replace(found, note=_note(directory / ENVIRONMENT_FILE))


def step_again(
    model: mujoco.MjModel,
    record: SimulationRecord | StoredRecord,
    advance: Callable[[int, int], None] | None = None,
    check: "EquationCheck | None" = None,
    drake: DrakeParameters | None = None,
) -> Replay:
    """Step the physics with recorded torques, up to the first recorded state of which a bit differs.

    Args:
        model: the model that was simulated.
        record: start state, torques and external forces.
        advance: called with steps done and steps in all.
        check: of the equations of motion.
        drake: contact if Drake stepped the run, None if MuJoCo did.
    """
    data = mujoco.MjData(model)
    engine = make_engine(model, data, drake)
    data.qpos[:], data.qvel[:] = record.q[0], record.qd[0]
    pushed = [model.body(name).id for name in record.external_segments]
    with quiet_mujoco():
        for row, (start, end) in enumerate(pairwise(record.state_rows.tolist()), 1):
            for k, torque in enumerate(record.torque_at(range(start, end)), start):
                data.ctrl[:] = torque
                if pushed:
                    push = record.external_force[k], record.external_moment[k]
                    data.xfrc_applied[pushed] = np.hstack(push)
                if check is not None:
                    check.begin(data)
                engine.step1()
                engine.step2()
                if check is not None:
                    check.end(k, data)
            recorded = np.concatenate([record.q[row], record.qd[row]])
            replayed = np.concatenate([data.qpos, data.qvel])
            # Bit patterns, not values: -0 is not 0, and a NaN is itself.
            differ = np.flatnonzero(recorded.view(np.int64) != replayed.view(np.int64))
            if differ.size:
                i = int(differ[0])
                values = float(recorded[i]), float(replayed[i])
                return Replay(record.steps, state_names(record)[i], end * record.time_step, *values)
            if advance is not None and row % 50 == 0:
                advance(end, record.steps)
    return Replay(record.steps, equations=None if check is None else check.result())


class EquationCheck:
    """Holds steps of a replay to the equations of motion.

    Contact forces are the recorded ones where they are on disk, every 10 ms, and those of the replayed steps
    between them, whose states are the recorded ones to the bit.

    Args:
        model: the model that was simulated.
        record: of the run.

    Raises:
        InputError: a joint has dry friction.
    """

    def __init__(self, model: mujoco.MjModel, record: StoredRecord) -> None:
        self.passive = passive_joints(model)
        if self.passive.friction.any():
            raise InputError(
                "the equations of motion cannot be checked: joints of this body have dry friction, whose "
                "force is not recorded; replay without --equations."
            )
        self.model, self.record, self.twin = model, record, pinocchio_model(model)
        self.contacts = SolePoints(model, record.point_sites, ())
        self.rows = {int(k): row for row, k in enumerate(record.state_rows[:-1])}
        self.segments = [*record.point_sites, *record.external_segments]
        self.waiting: list[tuple[Array, ...]] = []  # steps to check, in the order of the fields of Steps
        self.defect: list[Array] = []
        self.change: list[Array] = []

    def begin(self, data: mujoco.MjData) -> None:
        """Copy the state at the start of a step, and what acts in it."""
        self.start = data.qpos.copy(), data.qvel.copy()
        self.torque = data.ctrl.copy()

    def end(self, k: int, data: mujoco.MjData) -> None:
        """Compare the change of velocity in step k."""
        record = self.record
        if k in self.rows:
            force, place = record.point_force[self.rows[k]], record.point_position[self.rows[k]]
        else:
            force, place = point_forces(data, self.contacts)
        moment = np.zeros_like(force)
        if record.external_segments:
            force = np.concatenate([force, record.external_force[k]])
            moment = np.concatenate([moment, record.external_moment[k]])
            place = np.concatenate([place, record.external_position[k]])
        change = data.qvel - self.start[1]
        self.waiting.append((*to_pinocchio(*self.start), change, self.torque, force, moment, place))
        if len(self.waiting) == _BLOCK:
            self._check()

    def _check(self) -> None:
        """Check the steps that wait."""
        steps = Steps(*map(np.array, zip(*self.waiting, strict=True)))
        self.waiting.clear()
        self.change.append(steps.change)
        self.defect.append(defects(self.twin, self.passive, self.record.time_step, self.segments, steps))

    def result(self) -> Equations:
        """Median and largest defect of all steps."""
        if self.waiting:
            self._check()
        time = np.arange(self.record.steps, dtype=np.float64) * self.record.time_step
        names = velocity_names(self.record.joint_names)
        return summarize(np.concatenate(self.defect), np.concatenate(self.change), time, names)


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
