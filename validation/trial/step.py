"""Compiled parts of a step of the simulation: what lies between MuJoCo's calls and the controller."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ampm.compiled import compiled
from ampm.vectors import put, turned, vector
from validation.trial.log import Log, keep_command, keep_step, read_touch, zmp_gap_before
from validation.trial.watch import stands

Array = NDArray[np.float64]


class Simulated(NamedTuple):
    """The body of this step.

    Attributes:
        q: Pinocchio configuration, written by :func:`sense`, shape (nq,).
        v: its velocity, shape (nv,).
        root_rotation: axes of the root to world, shape (3, 3).
        com: shape (3,) [m].
        trunk: its long axis in world, shape (3,).
        warnings: MuJoCo's counts of states that it could not step, shape (...).
        torque_limit: shape (nu,) [N m].
        scale: size of the body, of which 1.70 m is one [1].
        time_step: [s].
    """

    q: Array
    v: Array
    root_rotation: Array
    com: Array
    trunk: Array
    warnings: NDArray[np.int32]
    torque_limit: Array
    scale: float
    time_step: float


class Command(NamedTuple):
    """What a controller commands at a tick; NaN where it says nothing.

    Attributes:
        torque: shape (nu,) [N m].
        rate: at which the torques go on, NaN holds them, shape (nu,) [N m/s].
        force: of the ground, shape (3,) [N].
        zmp: shape (2,) [m].
        angular_momentum: about the COM, shape (3,) [N m s].
        com: of the reference that it follows, shape (3,) [m].
        trunk: of the same, to world, shape (3, 3).
        soles: reference points of the same, shape (2, 3) [m].
    """

    torque: Array
    rate: Array
    force: Array
    zmp: Array
    angular_momentum: Array
    com: Array
    trunk: Array
    soles: Array


@compiled
def sense(body: Simulated, log: Log, contacts: int) -> None:
    """Read which sole points touch, and the state in Pinocchio's coordinates, after ``mj_step1``."""
    read_touch(log, contacts)
    qpos, qvel, q, v = log.simulated.qpos, log.simulated.qvel, body.q, body.v
    q[:] = qpos
    q[3], q[4], q[5], q[6] = qpos[4], qpos[5], qpos[6], qpos[3]
    v[:] = qvel
    put(v[0:3], turned(body.root_rotation.T, vector(qvel[0:3])))


@compiled
def first_unusable(command: Command) -> int:
    """Index of the first torque that is not finite, nu more for a rate, 2 nu for the COM; -1 for none."""
    torque, rate, count = command.torque, command.rate, len(command.torque)
    for j in range(count):
        if not math.isfinite(torque[j]):
            return j
        if math.isinf(rate[j]) or math.isnan(rate[j]) != math.isnan(rate[0]):
            return count + j
    for axis in range(3):
        if not math.isfinite(command.com[axis]):
            return 2 * count
    return -1


@compiled
def act(
    body: Simulated,
    command: Command,
    log: Log,
    k: int,
    status: int,
    residual: float,
    iterations: int,
    seconds: float,
) -> tuple[int, float]:
    """Let the torque of a tick act, within the motors' limits, and keep its command.

    Args:
        body: of this step.
        command: of the tick.
        log: of the run.
        k: step.
        status: of the tick, as the three that follow see :class:`~ampm.walk.ControlOutput`.
        residual: of its optimisation.
        iterations: of its optimisation.
        seconds: of its optimisation [s].

    Returns:
        See :func:`first_unusable`: then nothing acts. Distance of the ZMP of the step before from its
        command [m].
    """
    unusable = first_unusable(command)
    if unusable >= 0:
        return unusable, 0.0
    torque, limit, ctrl = command.torque, body.torque_limit, log.simulated.ctrl
    for j in range(len(limit)):
        ctrl[j] = torque[j] = min(max(torque[j], -limit[j]), limit[j])
    tick = k // log.substeps
    keep_command(log, k, command.com, command.zmp, command.force, command.angular_momentum)
    log.record.torque_rate[tick] = command.rate
    log.record.qp_status[tick], log.record.qp_residual[tick] = status, residual
    log.record.qp_iterations[tick], log.record.qp_time[tick] = iterations, seconds
    return -1, zmp_gap_before(log, k)


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


@compiled
def end_step(body: Simulated, command: Command, log: Log, k: int, contacts: int, efc_force: Array) -> bool:
    """Keep a step, and set the torques of the next one if no tick does.

    Args:
        body: of this step.
        command: of the last tick.
        log: of the run.
        k: step.
        contacts: how many there are.
        efc_force: forces of all constraints.

    Returns:
        Whether the walk may go on: the body stands, and MuJoCo has warned of nothing.
    """
    keep_step(log, k, contacts, efc_force)
    since = (k + 1) % log.substeps
    if since:
        time = since * body.time_step
        carry_on(command.torque, command.rate, body.torque_limit, log.simulated.ctrl, time)
    for warning in body.warnings:  # MuJoCo has reset the state instead of stepping it
        if warning != 0:
            return False
    if k % log.substeps == 0:  # is watched by the tick
        return True
    soles, axis = log.record.foot_position[k], command.trunk[:, 2]
    return stands(body.com, body.trunk, soles, command.com, axis, command.soles, body.scale)
