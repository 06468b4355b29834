"""Step MuJoCo again from a recorded start with the recorded torques, and compare every bit.

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
from validation.progress import Progress
from validation.store.environment import describe_environment
from validation.store.record import StoredRecord, state_names
from validation.store.saved import ENVIRONMENT_FILE, check_files
from validation.trial.record import SimulationRecord
from validation.trial.simulate import quiet_mujoco


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
    """

    steps: int
    signal: str | None = None
    time: float = float("nan")
    recorded: float = float("nan")
    replayed: float = float("nan")
    note: str = ""

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


def replay(directory: str | Path, *, progress: Progress | None = None) -> Replay:
    """Replay a run folder.

    Args:
        directory: of a finished run.
        progress: where to report stages.

    Raises:
        InputError: a file is missing, damaged, or not what the run wrote.
    """
    directory = Path(directory)
    if not directory.is_dir():
        raise InputError(f"there is no folder {directory}; give the folder of a run.")
    record = StoredRecord(directory)
    check_files(directory)
    model = record.model()
    with (progress or Progress()).stage("replay", "steps") as stage:
        found = step_again(model, record, stage.advance)
    return found if found.identical else replace(found, note=_note(directory / ENVIRONMENT_FILE))


def step_again(
    model: mujoco.MjModel,
    record: SimulationRecord | StoredRecord,
    advance: Callable[[int, int], None] | None = None,
) -> Replay:
    """Step the physics with recorded torques, up to the first recorded state of which a bit differs.

    Args:
        model: the model that was simulated.
        record: start state, torques and external forces.
        advance: called with steps done and steps in all.
    """
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = record.q[0], record.qd[0]
    pushed = [model.body(name).id for name in record.external_segments]
    with quiet_mujoco():
        for row, (start, end) in enumerate(pairwise(record.state_rows.tolist()), 1):
            for k, torque in enumerate(record.torque_at(range(start, end)), start):
                data.ctrl[:] = torque
                if pushed:
                    push = record.external_force[k], record.external_moment[k]
                    data.xfrc_applied[pushed] = np.hstack(push)
                mujoco.mj_step(model, data)
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
    return Replay(record.steps)


def _note(path: Path) -> str:
    """A sentence if the run was recorded with another MuJoCo or on another processor."""
    try:
        then, now = json.loads(path.read_text(encoding="utf-8")), describe_environment()
        pairs = {"processor": (then["processor"], now["processor"])}
        pairs["MuJoCo"] = tuple(item["versions"]["mujoco"] for item in (then, now))
    except (OSError, ValueError, KeyError, TypeError):
        return ""
    differences = [f"{what} {a} then, {b} now" for what, (a, b) in pairs.items() if a != b]
    return f"the environment has changed: {'; '.join(differences)}." if differences else ""
