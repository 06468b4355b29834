"""Compiled parts of a step of the simulation: what lies between MuJoCo's calls and the controller."""

import math

import numpy as np
from numpy.typing import NDArray

from ampm.compiled import compiled
from ampm.geometry import Array
from ampm.vectors import put, turned, vector
from validation.trial.log import StepLog, keep_instant
from validation.trial.watch import stands


@compiled
def point_of(geoms: NDArray[np.int32], of_geom: NDArray[np.intp]) -> int:
    """Sole point of a contact by its two geoms, -1 for none."""
    return max(of_geom[geoms[0]], of_geom[geoms[1]])


@compiled
def sense(log: StepLog, contacts: int) -> None:
    """Read which sole points touch, and the state in Pinocchio's coordinates, after ``mj_step1``."""
    body, touching = log.body, log.touching
    touching[:] = False
    for i in range(contacts):
        point = point_of(body.contact_geom[i], body.point_of_geom)
        if point >= 0:
            touching[point] = True
    qpos, qvel, q, v = body.qpos, body.qvel, body.q, body.v
    q[:] = qpos
    q[3], q[4], q[5], q[6] = qpos[4], qpos[5], qpos[6], qpos[3]
    v[:] = qvel
    put(v[0:3], turned(body.root_rotation.T, vector(qvel[0:3])))


@compiled
def act(log: StepLog, k: int, status: int, residual: float, iterations: int, seconds: float) -> bool:
    """Let the torque of a tick act, within the motors' limits, and keep its command from step k on.

    Status, residual, iterations and seconds are those of :class:`~ampm.walk.ControlOutput`. False if nothing
    acts, as a torque, a rate or the COM of the reference is not finite.
    """
    command, record = log.command, log.record
    torque, rate, limit, ctrl = command.torque, command.rate, log.body.torque_limit, log.body.ctrl
    held = math.isnan(rate[0])
    for j in range(len(limit)):
        if not math.isfinite(torque[j]) or math.isinf(rate[j]) or math.isnan(rate[j]) != held:
            return False
    for axis in range(3):
        if not math.isfinite(command.com[axis]):
            return False
    for j in range(len(limit)):
        ctrl[j] = torque[j] = min(max(torque[j], -limit[j]), limit[j])
    for i in range(k, min(k + log.substeps, len(record.command_com))):
        put(record.command_com[i], vector(command.com))
        record.command_zmp[i, 0], record.command_zmp[i, 1] = command.zmp[0], command.zmp[1]
        put(record.command_force[i], vector(command.force))
        put(record.command_angular_momentum[i], vector(command.angular_momentum))
    tick = k // log.substeps
    record.tick_torque[tick], record.torque_rate[tick] = torque, rate
    record.qp_status[tick], record.qp_residual[tick] = status, residual
    record.qp_iterations[tick], record.qp_time[tick] = iterations, seconds
    return True


@compiled
def keep_step(log: StepLog, k: int, contacts: int, efc_force: Array) -> None:
    """Copy places and contacts of step k, and the state after it."""
    keep_instant(log, k)
    record, body, normal_force = log.record, log.body, log.normal_force
    of_geom, frame = body.point_of_geom, body.contact_frame
    force, position, place = record.point_force[k], record.point_position[k], record.point_place[k]
    for p in range(len(place)):
        put(position[p], vector(place[p]))
    normal_force[:] = 0.0
    for i in range(contacts):
        p, first = point_of(body.contact_geom[i], of_geom), body.contact_address[i]
        if p >= 0 and first >= 0:
            side = 1.0 if of_geom[body.contact_geom[i, 1]] >= 0 else -1.0  # it acts on the second geom
            for axis in range(3):
                force[p, axis] = side * (
                    efc_force[first] * frame[i, axis]
                    + efc_force[first + 1] * frame[i, 3 + axis]
                    + efc_force[first + 2] * frame[i, 6 + axis]
                )
            distance = body.contact_distance[i]
            if distance < 0.0:
                put(position[p], vector(body.contact_place[i]))
            record.point_penetration[k, p] = -distance
            normal_force[p] = efc_force[first]
    record.q[k + 1] = body.qpos
    record.qd[k + 1] = body.qvel


@compiled
def end_step(log: StepLog, k: int, contacts: int, efc_force: Array) -> bool:
    """Keep a step, and set the torques of the next one if no tick does.

    False if the walk ends: the body does not stand, or MuJoCo has warned of something.
    """
    keep_step(log, k, contacts, efc_force)
    body, command = log.body, log.command
    torque, rate, limit, ctrl = command.torque, command.rate, body.torque_limit, body.ctrl
    since = (k + 1) % log.substeps
    if since:
        for j in range(len(torque)):
            if np.isnan(rate[j]):
                ctrl[j] = torque[j]
            else:
                ctrl[j] = min(max(torque[j] + since * body.time_step * rate[j], -limit[j]), limit[j])
    for warning in body.warnings:  # MuJoCo has reset the state instead of stepping it
        if warning != 0:
            return False
    if k % log.substeps == 0:  # is watched by the tick
        return True
    return stands(log.stance, body.scale)
