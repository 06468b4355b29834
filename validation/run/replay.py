"""Steps MuJoCo again from a recorded start with the recorded torques, and compares every bit.

The controller takes no part: what is shown is that the record holds all that the physics depended on.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from ampm.exceptions import InputError
from validation.progress import Progress
from validation.store.environment import describe_environment
from validation.store.record import JOINTS_FILE, load_record, record_columns
from validation.trial.record import SimulationRecord
from validation.trial.simulate import quiet_mujoco

MODEL_FILE = "model.xml"
ENVIRONMENT_FILE = "environment.json"


@dataclass(frozen=True)
class Replay:
    """Result of a replay.

    Attributes:
        steps: simulation steps that were stepped again.
        signal: first column that differs, as in ``joints.parquet``; None if none does.
        time: time of the first difference [s].
        recorded: the value on record.
        replayed: the value found now.
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
        directory: holds ``model.xml`` and the record.
        progress: where to report stages.

    Raises:
        InputError: a file is missing, damaged, or does not belong to the others.
    """
    directory = Path(directory)
    if not directory.is_dir():
        raise InputError(f"there is no folder {directory}; give the folder of a run.")
    record = load_record(directory)
    model = _load_model(directory / MODEL_FILE, record)
    note = _note(directory / ENVIRONMENT_FILE)
    with (progress or Progress()).stage("replay", "steps") as stage:
        q, qd = step_again(model, record, stage.advance)
    return compare(record, q, qd, note)


def step_again(
    model: mujoco.MjModel, record: SimulationRecord, advance: Callable[[int, int], None] | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Step the physics with recorded torques.

    Args:
        model: the model that was simulated.
        record: start state, first warm start, torques and external forces.
        advance: called with steps done and steps in all.

    Returns:
        ``qpos`` (K + 1, nq) and ``qvel`` (K + 1, nv); fewer rows if a state differs from the record, which is
        then the last.
    """
    data = mujoco.MjData(model)
    data.qpos[:] = record.q[0]
    data.qvel[:] = record.qd[0]
    if record.steps:
        data.qacc_warmstart[:] = record.warmstart[0]
    q, qd = np.empty_like(record.q), np.empty_like(record.qd)
    q[0], qd[0] = data.qpos, data.qvel
    pushed = [model.body(name).id for name in record.external_segments]
    pushes = np.concatenate([record.external_force, record.external_moment], axis=2)
    with quiet_mujoco():
        for k in range(record.steps):
            data.ctrl[:] = record.torque[k]
            data.xfrc_applied[pushed] = pushes[k]
            mujoco.mj_step(model, data)
            q[k + 1], qd[k + 1] = data.qpos, data.qvel
            if not (_same_bits(q[k + 1], record.q[k + 1]) and _same_bits(qd[k + 1], record.qd[k + 1])):
                return q[: k + 2], qd[: k + 2]
            if advance is not None and k % 500 == 0:
                advance(k, record.steps)
    return q, qd


def _same_bits(a: NDArray[np.float64], b: NDArray[np.float64]) -> bool:
    """Bit patterns, not values: -0 is not 0, and a NaN is itself."""
    return a.tobytes() == b.tobytes()


def compare(
    record: SimulationRecord, q: NDArray[np.float64], qd: NDArray[np.float64], note: str = ""
) -> Replay:
    """Find the first bit in which a replay, or as much of it as there is, differs from its record."""
    columns = record_columns(record)[JOINTS_FILE]
    names = [name for part in ("q_", "qd_") for name in columns if name.startswith(part)]
    recorded = np.concatenate([record.q[: len(q)], record.qd[: len(qd)]], axis=1)
    replayed = np.concatenate([q, qd], axis=1)
    # Bit patterns, as above.
    rows, places = np.nonzero(recorded.view(np.int64) != replayed.view(np.int64))
    if rows.size == 0:
        return Replay(record.steps)
    row, column = int(rows[0]), int(places[0])
    return Replay(
        steps=record.steps,
        signal=names[column],
        time=float(record.time[row]),
        recorded=float(recorded[row, column]),
        replayed=float(replayed[row, column]),
        note=note,
    )


def _load_model(path: Path, record: SimulationRecord) -> mujoco.MjModel:
    try:
        model = mujoco.MjModel.from_xml_string(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path} cannot be read ({error}); give the folder of a run.") from error
    shape = (model.nq, model.nv, model.nu)
    recorded = (record.q.shape[1], record.qd.shape[1], record.torque.shape[1])
    if shape != recorded:
        raise InputError(
            f"{path} has (nq, nv, nu) = {shape}, the record {recorded}; "
            "the files are of two runs, give the folder of one."
        )
    return model


def _note(path: Path) -> str:
    """A sentence if the run was recorded with another MuJoCo or on another processor."""
    try:
        then = json.loads(path.read_text(encoding="utf-8"))
        now = describe_environment()
        differences = [
            f"{what} {a} then, {b} now"
            for what, a, b in (
                ("MuJoCo", then["versions"]["mujoco"], now["versions"]["mujoco"]),
                ("processor", then["processor"], now["processor"]),
            )
            if a != b
        ]
    except (OSError, ValueError, KeyError, TypeError):
        return ""
    return f"the environment has changed: {'; '.join(differences)}." if differences else ""
