"""Log of a running walk: the record's own arrays, and the compiled parts of a step that fill them."""

import math
from collections import namedtuple
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ampm.compiled import compiled, refer
from ampm.geometry import Array
from ampm.reference import reference_type
from ampm.vectors import put, turned, vector
from validation.trial.outcome import Outcome
from validation.trial.physics import BodyState, Physics
from validation.trial.record import INTEGERS, LOGGED, SHAPES, SimulationRecord, shape_of
from validation.trial.watch import Stance, stands

# Code for a class of a function would be compiled by every process.
LoggedArrays: Any = namedtuple("LoggedArrays", LOGGED)  # type: ignore[misc]


class Command(NamedTuple):
    """What a controller commands at a tick; NaN where it says nothing."""

    torque: Array  # shape (nu,) [N m]
    rate: Array  # of change of the torques during the tick, NaN holds them, shape (nu,) [N m/s]
    force: Array  # of the ground, shape (3,) [N]
    zmp: Array  # shape (2,) [m]
    angular_momentum: Array  # about the COM, shape (3,) [N m s]
    com: Array  # of the reference that it follows, shape (3,) [m]


class StepLog(NamedTuple):
    """What the compiled functions of a step read and write."""

    record: Any  # arrays of `LOGGED`
    body: BodyState  # of this step
    command: Command  # of the last tick
    stance: Stance  # of body and command
    normal_force: Array  # of every sole point in the last step, shape (P,) [N]
    touching: NDArray[np.bool_]  # sole points that touch, shape (P,)
    substeps: int  # steps of a control tick


@compiled
def keep_instant(log: StepLog, k: int) -> None:
    """Copy the places of sole points and soles, COM and angular momentum at t_k."""
    record, body = log.record, log.body
    sites, place = body.sites, body.site_place
    point_place, foot_position = record.point_place[k], record.foot_position[k]
    points = len(point_place)
    for i in range(points):  # a row copied as an array takes ten times as long
        put(point_place[i], vector(place[sites[i]]))
    for i in range(2):
        put(foot_position[i], vector(place[sites[points + i]]))
        rotation = body.site_rotation[sites[points + i]]
        put(record.foot_forward[k, i], (rotation[0], rotation[3], rotation[6]))
    put(record.com[k], vector(body.com))
    put(record.angular_momentum[k], vector(body.angular_momentum))


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


class RunLog:
    """The arrays of a record of K steps at most. Memory is allocated when it is written.

    Attributes:
        steps: K.
        record: the arrays; rows beyond the steps done have no meaning.
        row: what the controller follows at a tick, see :func:`ampm.reference.reference_type`, shape (1,).
        stands_by: the same, by which the body has fallen or not: of a user's controller the plan.
        command: of the last tick.
        stance: of body and ``stands_by``.
        handle: reference to the :class:`StepLog`, for compiled functions.
    """

    def __init__(self, steps: int, physics: Physics) -> None:
        self.physics, self.substeps, robot = physics, physics.substeps, physics.robot
        self.row, self.stands_by = np.zeros((2, 1), reference_type(robot.nq, robot.nv))
        self.command = Command(
            torque=np.zeros(robot.nu),
            rate=np.zeros(robot.nu),
            force=np.zeros(3),
            zmp=np.zeros(2),
            angular_momentum=np.zeros(3),
            com=self.row["com"][0],
        )
        self.stance = Stance(
            com=physics.body.com,
            trunk=physics.body.trunk,
            soles=physics.soles,
            planned_com=self.stands_by["com"][0],
            planned_trunk=self.stands_by["trunk"][0, :, 2],
            planned_soles=self.stands_by["foot_position"][0],
        )
        self.external: dict[str, Array] = {}  # pushes of every segment that was pushed, shape (K, 9)
        points = len(physics.point_sites)
        self.touching, self.normal_force = np.zeros(points, dtype=bool), np.zeros(points)
        self._allocate(steps)
        self.record.q[0], self.record.qd[0] = physics.data.qpos, physics.data.qvel

    def _allocate(self, steps: int) -> None:
        """Make the arrays for K steps."""
        model, self.steps = self.physics.model, steps
        sizes = {"P": len(self.touching), "F": 2, "nq": model.nq, "nv": model.nv, "nu": model.nu}
        sizes |= self._rows(steps)
        self.record: Any = LoggedArrays(
            *(np.zeros(shape_of(name, sizes), INTEGERS.get(name, np.float64)) for name in LOGGED)
        )
        parts = StepLog(
            record=self.record,
            body=self.physics.body,
            command=self.command,
            stance=self.stance,
            normal_force=self.normal_force,
            touching=self.touching,
            substeps=self.substeps,
        )
        self.handle = refer(parts)

    def _rows(self, steps: int) -> dict[str, int]:
        """Numbers of rows of a walk of some steps, whose states are all kept."""
        return {"K": steps, "R-1": steps, "K+1": steps + 1, "R": steps + 1, "T": -(-steps // self.substeps)}

    def keep_pushes(self, k: int, pushes: Mapping[str, Array]) -> None:
        """Copy force, moment and point of every segment that is pushed in step k, shape (9,)."""
        for segment, push in pushes.items():
            if segment not in self.external:
                self.external[segment] = np.zeros((self.steps, 9))
            self.external[segment][k] = push

    def extend(self, steps: int) -> None:
        """Make room for more steps, twice as many as now or more."""
        record = self.record
        self._allocate(max(steps, 2 * self.steps))
        for array, before in zip(self.record, record, strict=True):
            array[: len(before)] = before
        for segment, push in self.external.items():
            self.external[segment] = np.concatenate([push, np.zeros((self.steps - len(push), 9))])

    def close(self, done: int, outcome: Outcome) -> SimulationRecord:
        """Add the instant at which the last step ends, and return the record without a copy of the arrays.

        It has ``done + 1`` rows of instants, ``done`` of steps, and the ticks that began in them. An
        incomplete step has no tick either.
        """
        physics, data, record = self.physics, self.physics.data, self.record
        data.qpos[:], data.qvel[:] = record.q[done], record.qd[done]
        physics.engine.step1()
        keep_instant(self.handle, done)
        rows, kept = self._rows(done), dict[str, Any]()
        for name, array in zip(LOGGED, record, strict=True):
            array.setflags(write=False)
            kept[name] = array[: rows[SHAPES[name].split()[0]]]
        if self.external:
            pushes = np.stack([push[:done] for push in self.external.values()], axis=1)
            kept["external_force"] = pushes[..., :3]
            kept["external_moment"] = pushes[..., 3:6]
            kept["external_position"] = pushes[..., 6:]
            kept["external_segments"] = tuple(self.external)
        dt, robot = physics.time_step, physics.robot
        return SimulationRecord(
            time=np.arange(done + 1, dtype=np.float64) * dt,
            point_foot=robot.point_foot,
            point_group=robot.point_group,
            state_rows=np.arange(done + 1),
            tick_time=np.arange(rows["T"], dtype=np.float64) * (self.substeps * dt),
            outcome=outcome,
            mass=robot.mass,
            gravity=robot.gravity,
            time_step=dt,
            friction=float(physics.model.geom("floor").friction[0]),
            torque_limit=robot.torque_limit,
            joint_range=np.stack([robot.lower, robot.upper], axis=1),
            joint_names=robot.joint_names,
            point_sites=physics.point_sites,
            **kept,
        )
