"""Log of a running walk: the record's own arrays, filled step by step.

What MuJoCo gives beyond the record (all sites, contacts as they come, rotation matrices) is kept for a block
of steps only and sorted into those arrays when the block is full, so that a walk needs little more memory
than its record.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from ampm.walk import ControlOutput, Reference

    Array = NDArray[np.float64]

_FRICTION_ROWS = 3  # of a contact of a point on the floor: normal and two tangents
_LIMIT_ROWS = 2  # of a joint at its limits
_JOINT_POSITION = int(mujoco.mjtSensor.mjSENS_JOINTPOS)
_JOINT_VELOCITY = int(mujoco.mjtSensor.mjSENS_JOINTVEL)
_UNKNOWN = float("nan")
_BLOCK = 1024  # steps that are kept as MuJoCo has them; all of a long walk would fill the memory


@dataclass
class _Block:
    """B steps as MuJoCo has them; row B of what belongs to an instant is the next block's first.

    Attributes:
        sites: positions of all sites, (B + 1, nsite, 3) [m].
        rotation: of both soles, (B + 1, 2, 9).
        sensors: all readings, (B + 1, nsensordata).
        point, address: sole point and first constraint row of every contact, -1 for none, (B, P).
        frame, place, distance: of every contact, (B, P, 9), (B, P, 3), (B, P).
        constraint_force: of all constraints, (B, rows) [N].
    """

    sites: Array
    rotation: Array
    sensors: Array
    point: NDArray[np.intp]
    address: NDArray[np.intp]
    frame: Array
    place: Array
    distance: Array
    constraint_force: Array

    @classmethod
    def empty(cls, steps: int, model: mujoco.MjModel, points: int) -> _Block:
        """Room for that many steps."""
        return cls(
            sites=np.empty((steps + 1, model.nsite, 3)),
            rotation=np.empty((steps + 1, 2, 9)),
            sensors=np.empty((steps + 1, model.nsensordata)),
            point=np.full((steps, points), -1, dtype=np.intp),
            address=np.full((steps, points), -1, dtype=np.intp),
            frame=np.zeros((steps, points, 9)),
            place=np.zeros((steps, points, 3)),
            distance=np.zeros((steps, points)),
            constraint_force=np.zeros((steps, _FRICTION_ROWS * points + _LIMIT_ROWS * model.njnt)),
        )


@dataclass
class RunLog:
    """The arrays of a :class:`validation.trial.record.SimulationRecord`, under its names, of K steps at most.

    Rows beyond the steps done have no meaning; what a block holds is not in the arrays yet.

    Attributes:
        point_sites, sole_sites: numbers of the sites of the P sole points, and of both soles.
        substeps: steps of a control tick.
        time_step: dt [s].
        block: the steps that are not sorted yet.
        sensors: name to readings, in the model's order.
        external: segment to force, moment and point of what pushed it, (K, 9).
        sensor_columns: name to the place of those readings that are sorted out of a block.
        sorted: number of steps that are.
    """

    point_sites: NDArray[np.intp]
    sole_sites: Sequence[int]
    substeps: int
    time_step: float
    block: _Block
    q: Array
    qd: Array
    torque: Array
    warmstart: Array
    point_force: Array
    point_position: Array
    point_penetration: Array
    point_velocity: Array
    foot_position: Array
    foot_rotation: Array
    command_com: Array
    command_zmp: Array
    command_force: Array
    command_angular_momentum: Array
    command_point_force: Array
    qp_status: NDArray[np.int8]
    qp_residual: Array
    qp_iterations: NDArray[np.int32]
    qp_time: Array
    sensors: dict[str, Array]
    sensor_columns: dict[str, slice] = field(default_factory=dict)
    external: dict[str, Array] = field(default_factory=dict)
    sorted: int = 0

    @classmethod
    def empty(
        cls,
        steps: int,
        model: mujoco.MjModel,
        point_sites: NDArray[np.intp],
        sole_sites: Sequence[int],
        substeps: int,
    ) -> RunLog:
        """Room for that many steps; memory is taken as it is written to."""
        points, ticks = len(point_sites), -(-steps // substeps)
        columns = {
            model.sensor(i).name: slice(start, start + size)
            for i, (start, size) in enumerate(
                zip(model.sensor_adr.tolist(), model.sensor_dim.tolist(), strict=True)
            )
        }
        q, qd = np.empty((steps + 1, model.nq)), np.empty((steps + 1, model.nv))
        readings = _joint_readings(model, q, qd)
        columns = {name: part for name, part in columns.items() if name not in readings}
        made = {name: np.empty((steps + 1, part.stop - part.start)) for name, part in columns.items()}
        order = [model.sensor(i).name for i in range(model.nsensor)]
        return cls(
            point_sites=point_sites,
            sole_sites=list(sole_sites),
            substeps=substeps,
            time_step=float(model.opt.timestep),
            block=_Block.empty(min(steps, _BLOCK), model, points),
            q=q,
            qd=qd,
            torque=np.empty((steps, model.nu)),
            warmstart=np.empty((steps, model.nv)),
            point_force=np.zeros((steps, points, 3)),
            point_position=np.empty((steps, points, 3)),
            point_penetration=np.zeros((steps, points)),
            point_velocity=np.empty((steps, points, 3)),
            foot_position=np.empty((steps + 1, 2, 3)),
            foot_rotation=np.empty((steps + 1, 2, 4)),
            command_com=np.empty((steps, 3)),
            command_zmp=np.empty((steps, 2)),
            command_force=np.empty((steps, 3)),
            command_angular_momentum=np.empty((steps, 3)),
            command_point_force=np.empty((steps, points, 3)),
            qp_status=np.empty(ticks, dtype=np.int8),
            qp_residual=np.empty(ticks),
            qp_iterations=np.empty(ticks, dtype=np.int32),
            qp_time=np.empty(ticks),
            sensors={name: made[name] if name in made else readings[name] for name in order},
            sensor_columns=columns,
        )

    def keep_state(self, k: int, data: mujoco.MjData) -> None:
        """Copy the state from which step k starts, before ``mj_step1``."""
        self.q[k], self.qd[k] = data.qpos, data.qvel
        self.warmstart[k] = data.qacc_warmstart

    def keep_places(self, k: int, data: mujoco.MjData) -> None:
        """Copy the sites at t_k, after ``mj_step1``."""
        row = k - self.sorted
        self.block.sites[row] = data.site_xpos
        for foot, site in enumerate(self.sole_sites):
            self.block.rotation[row, foot] = data.site_xmat[site]

    def keep_command(self, k: int, output: ControlOutput, reference: Reference) -> None:
        """Copy what the tick at step k decided; it holds until the next one."""
        held, tick = slice(k, k + self.substeps), k // self.substeps
        self.command_com[held] = reference.centre[0]
        self.command_zmp[held] = _UNKNOWN if output.zmp is None else output.zmp
        self.command_force[held] = _UNKNOWN if output.force is None else output.force
        momentum, forces = output.angular_momentum, output.point_force
        self.command_angular_momentum[held] = _UNKNOWN if momentum is None else momentum
        self.command_point_force[held] = _UNKNOWN if forces is None else forces
        self.qp_status[tick], self.qp_residual[tick] = output.status, output.residual
        self.qp_iterations[tick], self.qp_time[tick] = output.iterations, output.seconds

    def keep_pushes(self, k: int, pushes: Mapping[str, Array]) -> None:
        """Copy force, moment and point of every segment that is pushed in step k."""
        for segment, push in pushes.items():
            if segment not in self.external:
                self.external[segment] = np.zeros((len(self.torque), 9))
            self.external[segment][k] = push

    def keep_contacts(self, k: int, data: mujoco.MjData, point: NDArray[np.intp]) -> Array:
        """Copy contacts and sensors of step k as they are; they are sorted out block by block.

        Args:
            k: step.
            data: after ``mj_step2``.
            point: sole point of every contact, -1 for none.

        Returns:
            The sole points' normal forces, shape (P,) [N].
        """
        block = self.block
        if k - self.sorted >= len(block.point):
            self._sort(k)
        row = k - self.sorted
        n, rows = data.ncon, data.nefc
        normal = np.zeros(block.point.shape[1] + 1)
        if n:
            contact = data.contact
            address = contact.efc_address
            block.point[row, :n], block.address[row, :n] = point, address
            block.frame[row, :n], block.place[row, :n] = contact.frame, contact.pos
            block.distance[row, :n] = contact.dist
            block.constraint_force[row, :rows] = data.efc_force
            normal[point] = block.constraint_force[row].take(address)
        block.sensors[row] = data.sensordata
        return normal[:-1]  # the last stands for all that is no sole point

    def close(self, done: int, data: mujoco.MjData) -> dict[str, Any]:
        """Add the instant at which the last step ends, and give the record's arrays away.

        Args:
            done: whole steps.
            data: at their end.

        Returns:
            Name to array, read-only and without a copy: ``done + 1`` rows of instants, ``done`` of steps, and
            the ticks that began in them. A step that was cut short has no tick either.
        """
        self.q[done], self.qd[done] = data.qpos, data.qvel
        self.keep_places(done, data)
        self.block.sensors[done - self.sorted] = data.sensordata
        self._sort(done, last=True)
        result: dict[str, Any] = {}
        for item in fields(self):
            array = getattr(self, item.name)
            if not isinstance(array, np.ndarray) or item.name == "point_sites":
                continue
            array.setflags(write=False)
            if item.name.startswith("qp_"):
                rows = -(-done // self.substeps)
            else:
                rows = done + (item.name in ("q", "qd", "foot_position", "foot_rotation"))
            result[item.name] = array[:rows]
        for array in self.sensors.values():
            array.setflags(write=False)
        if self.external:
            pushes = np.stack([push[:done] for push in self.external.values()], axis=1)
            result["external_segments"] = tuple(self.external)
            parts = {"force": pushes[..., :3], "moment": pushes[..., 3:6], "position": pushes[..., 6:]}
            result |= {f"external_{name}": part for name, part in parts.items()}
        result["sensors"] = {name: array[: done + 1] for name, array in self.sensors.items()}
        return result

    def _sort(self, end: int, *, last: bool = False) -> None:
        """Sort out the block up to but without step ``end``, whose places are known, and clear it.

        Args:
            end: the first step of the next block.
            last: there is none: the instant at which this step would start belongs to this block.
        """
        block, count = self.block, max(end - self.sorted, 0)
        done, instants = slice(self.sorted, self.sorted + count), count + last
        passed = slice(self.sorted, self.sorted + instants)
        sites = block.sites[: count + 1, self.point_sites]
        self.point_velocity[done] = np.diff(sites, axis=0) / self.time_step
        self.foot_position[passed] = block.sites[:instants, self.sole_sites]
        if instants:
            xyzw = Rotation.from_matrix(block.rotation[:instants].reshape(-1, 3, 3)).as_quat()
            self.foot_rotation[passed] = xyzw.reshape(instants, 2, 4)[..., [3, 0, 1, 2]]
        for name, part in self.sensor_columns.items():
            self.sensors[name][passed] = block.sensors[:instants, part]

        position, depth = self.point_position[done], self.point_penetration[done]
        position[:] = sites[:-1]
        step, slot = np.nonzero((block.point[:count] >= 0) & (block.address[:count] >= 0))
        point = block.point[step, slot]
        rows = block.address[step, slot, None] + np.arange(_FRICTION_ROWS)
        local = block.constraint_force[step[:, None], rows]
        # A point is a sphere over a plane: one contact at most.
        frame = block.frame[step, slot].reshape(-1, 3, 3)
        self.point_force[done][step, point] = np.einsum("ck,ckj->cj", local, frame)
        depth[step, point] = -block.distance[step, slot]
        deep = depth[step, point] > 0.0
        position[step[deep], point[deep]] = block.place[step[deep], slot[deep]]

        block.point[:count] = -1
        block.sites[0], block.rotation[0] = block.sites[count], block.rotation[count]
        self.sorted += count


def _joint_readings(model: mujoco.MjModel, q: Array, qd: Array) -> dict[str, Array]:
    """Sensors that read a joint's position or rate, as views of the states: they are the same bits."""
    found = {}
    for i in range(model.nsensor):
        joint, kind = int(model.sensor_objid[i]), int(model.sensor_type[i])
        if model.sensor_cutoff[i] > 0.0:
            continue
        if kind == _JOINT_POSITION:
            address = int(model.jnt_qposadr[joint])
            found[model.sensor(i).name] = q[:, address : address + 1]
        elif kind == _JOINT_VELOCITY:
            address = int(model.jnt_dofadr[joint])
            found[model.sensor(i).name] = qd[:, address : address + 1]
    return found
