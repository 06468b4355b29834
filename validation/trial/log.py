"""Log of a running walk: the record's own arrays, filled step by step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from validation.trial.record import INTEGERS, SHAPES, shape_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.walk import ControlOutput, Reference

    Array = NDArray[np.float64]

_FRICTION_ROWS = np.arange(3)  # of a contact of a point on the floor: normal and two tangents
_UNKNOWN = float("nan")


class RunLog:
    """The arrays of a :class:`validation.trial.record.SimulationRecord`, under its names, of K steps at most.

    Rows beyond the steps done have no meaning. Memory is allocated when it is written.

    Args:
        steps: K.
        model: that is stepped.
        points, soles: numbers of the sites of the P sole points, and of both soles.
        substeps: steps of a control tick.
    """

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

    def __init__(
        self,
        steps: int,
        model: mujoco.MjModel,
        points: NDArray[np.intp],
        soles: Sequence[int],
        substeps: int,
    ) -> None:
        self.sites, self.substeps = np.concatenate([points, soles]), substeps
        self.time_step = float(model.opt.timestep)
        sizes = {
            "K": steps, "K+1": steps + 1, "T": -(-steps // substeps), "P": len(points), "F": 2,
            "nq": model.nq, "nv": model.nv, "nu": model.nu,
        }  # fmt: skip
        for name in RunLog.__annotations__:
            setattr(self, name, np.zeros(shape_of(name, sizes), INTEGERS.get(name, np.float64)))
        self.places = np.zeros((steps + 1, self.sites.size, 3))
        self.rotation = np.zeros((steps + 1, 2, 9))
        self.external: dict[str, Array] = {}
        self._make_sensors(model, steps)

    def _make_sensors(self, model: mujoco.MjModel, steps: int) -> None:
        """Arrays for readings; those of a joint's position or rate are views of the states."""
        joints = {
            int(mujoco.mjtSensor.mjSENS_JOINTPOS): ("q", model.jnt_qposadr),
            int(mujoco.mjtSensor.mjSENS_JOINTVEL): ("qd", model.jnt_dofadr),
        }
        read: list[int] = []
        columns: dict[str, tuple[str, int, int]] = {}
        for i in range(model.nsensor):
            start, size = int(model.sensor_adr[i]), int(model.sensor_dim[i])
            state, addresses = joints.get(int(model.sensor_type[i]), ("", None))
            if state and model.sensor_cutoff[i] == 0.0:
                columns[model.sensor(i).name] = state, int(addresses[model.sensor_objid[i]]), 1
            else:
                columns[model.sensor(i).name] = "readings", len(read), size
                read += range(start, start + size)
        self.read = np.array(read, dtype=np.intp)
        self.readings = np.zeros((steps + 1, len(read)))
        self.sensors = {
            name: getattr(self, source)[:, at : at + size] for name, (source, at, size) in columns.items()
        }

    def keep_state(self, k: int, data: mujoco.MjData) -> None:
        """Copy the state from which step k starts, before ``mj_step1``."""
        self.q[k], self.qd[k] = data.qpos, data.qvel
        self.warmstart[k] = data.qacc_warmstart

    def keep_places(self, k: int, data: mujoco.MjData) -> None:
        """Copy the places of sole points and soles at t_k, after ``mj_step1``."""
        data.site_xpos.take(self.sites, axis=0, out=self.places[k], mode="clip")
        data.site_xmat.take(self.sites[-2:], axis=0, out=self.rotation[k], mode="clip")

    def keep_command(self, k: int, output: ControlOutput, reference: Reference) -> None:
        """Copy the command of the tick at step k; it is valid until the next one."""
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
        """Copy force, moment and point of every segment that is pushed in step k, shape (9,)."""
        for segment, push in pushes.items():
            self.external.setdefault(segment, np.zeros((len(self.torque), 9)))[k] = push

    def keep_contacts(self, k: int, data: mujoco.MjData, point: NDArray[np.intp]) -> Array:
        """Copy contacts and sensors of step k.

        Args:
            k: step.
            data: after ``mj_step2``.
            point: sole point of every contact, -1 for none.

        Returns:
            The sole points' normal forces, shape (P,) [N].
        """
        data.sensordata.take(self.read, out=self.readings[k], mode="clip")
        normal = np.zeros(self.sites.size - 2)
        if data.ncon:
            contact = data.contact
            found = [point, contact.efc_address, contact.frame, contact.pos, contact.dist]
            mine = (point >= 0) & (found[1] >= 0)
            if not mine.all():
                found = [array[mine] for array in found]
            point, address, frame, place, distance = found  # a point is a sphere: one contact at most
            local = data.efc_force.take(address[:, None] + _FRICTION_ROWS)
            self.point_force[k, point] = np.einsum("ck,ckj->cj", local, frame.reshape(-1, 3, 3))
            self.point_penetration[k, point] = -distance
            self.point_position[k, point] = place
            normal[point] = local[:, 0]
        return normal

    def close(self, done: int, data: mujoco.MjData) -> dict[str, Any]:
        """Add the instant at which the last step ends, and return the record's arrays.

        Args:
            done: whole steps.
            data: at their end.

        Returns:
            Name to array, read-only and without a copy: ``done + 1`` rows of instants, ``done`` of steps, and
            the ticks that began in them. An incomplete step has no tick either.
        """
        self.q[done], self.qd[done] = data.qpos, data.qvel
        self.keep_places(done, data)
        data.sensordata.take(self.read, out=self.readings[done], mode="clip")
        steps, instants = slice(0, done), slice(0, done + 1)
        places = self.places[instants, :-2]
        self.foot_position[instants] = self.places[instants, -2:]
        self.point_velocity[steps] = np.diff(places, axis=0) / self.time_step
        above = self.point_penetration[steps, :, None] <= 0.0
        np.copyto(self.point_position[steps], places[:-1], where=above)
        xyzw = Rotation.from_matrix(self.rotation[instants].reshape(-1, 3, 3)).as_quat()
        self.foot_rotation[instants] = xyzw.reshape(-1, 2, 4)[..., [3, 0, 1, 2]]
        rows = {"K+1": done + 1, "K": done, "T": -(-done // self.substeps)}
        result: dict[str, Any] = {}
        for name in RunLog.__annotations__:
            array = getattr(self, name)
            array.setflags(write=False)
            result[name] = array[: rows[SHAPES[name].split()[0]]]
        if self.external:
            pushes = np.stack([push[:done] for push in self.external.values()], axis=1)
            parts = {"force": pushes[..., :3], "moment": pushes[..., 3:6], "position": pushes[..., 6:]}
            result |= {f"external_{name}": part for name, part in parts.items()}
            result["external_segments"] = tuple(self.external)
        for array in (self.readings, *self.sensors.values()):
            array.setflags(write=False)
        result["sensors"] = {name: array[instants] for name, array in self.sensors.items()}
        return result
