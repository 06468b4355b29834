"""The physics stepped again from recorded states with recorded torques.

A walk has more numbers than a disk should hold, but they follow from few: the torques of every control tick,
and a state now and then. Stepping from state to state gives every contact force and position again: with the
same bits on the same processor, and on another one with the rounding of a hundredth of a second.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Protocol

import mujoco
import numpy as np

from ampm.compiled import compiled
from validation.trial.log import RunLog, SolePoints

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


_STEPS = 4096  # whose torques are read at once


@compiled
def carry_on(torque: Array, rate: Array, limit: Array, ctrl: Array, since: float) -> None:
    """Let the torque go on with its rate, within the motors' limits.

    Args:
        torque: of the tick, shape (nu,) [N m].
        rate: NaN holds the torque, shape (nu,) [N m/s].
        limit: of the motors, shape (nu,) [N m].
        ctrl: written, shape (nu,) [N m].
        since: time since the tick [s].
    """
    for j in range(len(torque)):
        if np.isnan(rate[j]):
            ctrl[j] = torque[j]
        else:
            ctrl[j] = min(max(torque[j] + since * rate[j], -limit[j]), limit[j])


@contextlib.contextmanager
def quiet_mujoco() -> Iterator[None]:
    """Keep MuJoCo from printing and from writing MUJOCO_LOG.TXT into the working folder."""
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(None)


class Inputs(Protocol):
    """All that the physics of a walk depends on beside the model: K steps, T ticks, C restarts.

    Attributes:
        substeps: steps of a control tick.
        every: steps from one restart to the next.
        q: ``qpos`` at every restart and at the end, shape (C + 1, nq).
        qd: ``qvel`` likewise, shape (C + 1, nv).
        warmstart: ``qacc_warmstart`` at every restart, shape (C, nv).
        point_sites, sole_sites: of the sole points and the soles.
        external_segments: segments that were pushed, S names.
        external_force, external_moment: on them, shape (K, S, 3) [N], [N m].
    """

    substeps: int
    every: int
    q: Array
    qd: Array
    warmstart: Array
    point_sites: tuple[str, ...]
    sole_sites: tuple[str, ...]
    external_segments: tuple[str, ...]
    external_force: Array
    external_moment: Array

    def torque_at(self, rows: Sequence[int] | NDArray[np.intp]) -> Array:
        """Torques of some steps, shape (n, nu) [N m]."""
        ...


class Restart:
    """Steps to any row of a recorded walk.

    Args:
        model: that was simulated.
        inputs: of the walk.
    """

    def __init__(self, model: mujoco.MjModel, inputs: Inputs) -> None:
        self.model, self.data, self.inputs = model, mujoco.MjData(model), inputs
        self.points = SolePoints(model, inputs.point_sites, inputs.sole_sites)
        self.pushed = [model.body(name).id for name in inputs.external_segments]
        self.at = -1  # step that begins in the state of the data

    def log(self, rows: NDArray[np.intp]) -> RunLog:
        """Log of these steps, in ascending order: contacts, places, states and sensors of each."""
        data, inputs = self.data, self.inputs
        log = RunLog(len(rows), self.model, data, self.points, inputs.substeps)
        if not len(rows):
            data.qpos[:], data.qvel[:] = inputs.q[0], inputs.qd[0]
            log.start(data)
        steps, kept = self._steps(rows), 0
        self.at = -1  # until all are taken
        with quiet_mujoco():
            for start in range(0, len(steps), _STEPS):
                part = steps[start : start + _STEPS]
                for k, torque in zip(part, inputs.torque_at(part), strict=True):
                    self._begin(k, torque)
                    here = k == rows[kept]
                    if here and kept == 0:
                        log.start(data)
                    mujoco.mj_step2(self.model, data)
                    if here:
                        log.keep(kept, data)
                        kept += 1
        self.at = steps[-1] + 1 if steps else -1
        return log

    def _steps(self, rows: NDArray[np.intp]) -> list[int]:
        """Steps to take, to these rows from where the data are or from the last restart before."""
        at, steps = self.at, list[int]()
        for row in rows.tolist():
            near = row - row % self.inputs.every
            steps += range(at if near < at <= row else near, row + 1)
            at = row + 1
        return steps

    def _begin(self, k: int, torque: Array) -> None:
        """First half of a step, from the recorded state if there is one."""
        data, inputs = self.data, self.inputs
        restart, since = divmod(k, inputs.every)
        if since == 0:
            data.qpos[:], data.qvel[:] = inputs.q[restart], inputs.qd[restart]
            data.qacc_warmstart[:] = inputs.warmstart[restart]
        data.ctrl[:] = torque
        if self.pushed:
            data.xfrc_applied[self.pushed] = np.hstack([inputs.external_force[k], inputs.external_moment[k]])
        mujoco.mj_step1(self.model, data)
