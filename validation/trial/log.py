"""Log of a running walk: the record's own arrays, filled step by step."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from ampm.compiled import Bundle, compiled
from ampm.vectors import put, vector
from validation.trial import spill
from validation.trial.record import INTEGERS, SHAPES, shape_of, support_height
from validation.trial.watch import zmp_gap

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.walk import ControlOutput

    Array = NDArray[np.float64]


def _contact_views(data: mujoco.MjData) -> list[NDArray[Any]]:
    """Geoms, address of the forces, frame, place and distance of contacts.

    MuJoCo's own views have one row per present contact, so they would have to be taken at every step.
    Contacts lie at the beginning of the simulation's arena; these views have as many rows as it can hold.
    """
    contact, views = data.contact, []
    for name in ("geom", "efc_address", "frame", "pos", "dist"):
        present = getattr(contact, name)
        shape = (data.narena // present.strides[0], *present.shape[1:])
        views.append(np.lib.stride_tricks.as_strided(present, shape, present.strides, writeable=False))
    return views


@compiled
def read_touch(own: Any, contacts: int) -> None:
    """Read which sole points are in contact, after ``mj_step1``; arguments as in :func:`keep_step`."""
    geom, of_geom, touching = own.geom, own.of_geom, own.touching
    touching[:] = False
    for i in range(contacts):
        point = max(of_geom[geom[i, 0]], of_geom[geom[i, 1]])
        if point >= 0:
            touching[point] = True


@compiled
def keep_instant(own: Any, k: int) -> None:
    """Copy the places of sole points and soles, COM and angular momentum at t_k.

    Arguments as in :func:`keep_step`.
    """
    points = own.point_place.shape[1]
    for i in range(points):  # a row copied as an array takes ten times as long
        put(own.point_place[k, i], vector(own.site_place[own.sites[i]]))
    for i in range(2):
        sole = own.sites[points + i]
        put(own.foot_position[k, i], vector(own.site_place[sole]))
        for axis in range(3):
            own.foot_forward[k, i, axis] = own.site_rotation[sole, 3 * axis]
    put(own.com[k], vector(own.sensed_com))
    put(own.angular_momentum[k], vector(own.sensed_momentum))


@compiled
def keep_step(own: Any, k: int, contacts: int, efc_force: Array) -> None:
    """Copy places, contacts and torques of step k, and the state after it.

    Args:
        own: arrays of the simulation, and of the log by step, under the names of a record. Others:
            ``geom``, both geoms of the contacts: MuJoCo sorts them by type, a floor that is a plane comes
            first, a box last; ``of_geom``, sole point of every geom, -1 for none: a sphere, with one contact
            at most; ``address`` of the contacts' first force, along the normal, -1 for none: two along the
            tangents follow; ``frame`` of the contacts, normal and tangents; ``place`` [m]; ``distance``,
            negative where they overlap [m]; ``normal_force`` [N] and ``touching`` by sole point; ``sites`` of
            sole points and, last, of the two soles; ``sensed_com`` [m], ``sensed_momentum`` [N m s].
        k: step.
        contacts: how many there are.
        efc_force: forces of all constraints.
    """
    keep_instant(own, k)
    of_geom, geom, address, frame = own.of_geom, own.geom, own.address, own.frame
    point_force, point_position = own.point_force, own.point_position
    normal_force, distance = own.normal_force, own.distance
    for p in range(len(normal_force)):
        put(point_position[k, p], vector(own.point_place[k, p]))
    own.torque[k] = own.ctrl
    normal_force[:] = 0.0
    for i in range(contacts):
        p, first = max(of_geom[geom[i, 0]], of_geom[geom[i, 1]]), address[i]
        if p >= 0 and first >= 0:
            side = 1.0 if of_geom[geom[i, 1]] >= 0 else -1.0  # the force acts on the second geom
            for axis in range(3):
                point_force[k, p, axis] = side * (
                    efc_force[first] * frame[i, axis]
                    + efc_force[first + 1] * frame[i, 3 + axis]
                    + efc_force[first + 2] * frame[i, 6 + axis]
                )
                if distance[i] < 0.0:
                    point_position[k, p, axis] = own.place[i, axis]
            own.point_penetration[k, p] = -distance[i]
            normal_force[p] = efc_force[first]
    own.q[k + 1] = own.qpos
    own.qd[k + 1] = own.qvel


@compiled
def keep_command(
    own: Any, k: int, com: Array, rate: Array, zmp: Array, force: Array, momentum: Array, status: int,
    residual: float, iterations: int, seconds: float,
) -> None:  # fmt: skip
    """Copy the command of the tick at step k; ``own`` as in :func:`keep_step`."""
    for i in range(k, min(k + own.substeps, len(own.torque))):
        put(own.command_com[i], vector(com))
        own.command_zmp[i, 0], own.command_zmp[i, 1] = zmp[0], zmp[1]
        put(own.command_force[i], vector(force))
        put(own.command_angular_momentum[i], vector(momentum))
    tick = k // own.substeps
    for j in range(own.torque_rate.shape[1]):
        own.torque_rate[tick, j] = rate[j]
    own.qp_status[tick], own.qp_residual[tick] = status, residual
    own.qp_iterations[tick], own.qp_time[tick] = iterations, seconds


@compiled
def gap_of(own: Any, k: int) -> float:
    """Distance of the ZMP of the step before k from the commanded one [m]; see :func:`keep_step`."""
    return zmp_gap(own.normal_force, own.point_position[k - 1], own.command_zmp[k - 1])


class SolePoints:
    """Sole points and soles in a compiled model.

    Args:
        model: that is stepped.
        names: of the sites of the P sole points; each has a geom of its name.
        sole_names: of the sites of both soles.
    """

    def __init__(self, model: mujoco.MjModel, names: tuple[str, ...], sole_names: tuple[str, ...]) -> None:
        self.names, self.sole_names = names, sole_names
        self.sites = np.array([model.site(name).id for name in (*names, *sole_names)], dtype=np.intp)
        self.of_geom = np.full(model.ngeom, -1, dtype=np.intp)  # sole point of every geom, -1 for none
        self.of_geom[[model.geom(name).id for name in names]] = np.arange(len(names))


class RunLog:
    """The arrays of a :class:`validation.trial.record.SimulationRecord`, under its names, of K steps at most.

    Rows beyond the steps done have no meaning. Memory is allocated when it is written.

    Args:
        steps: K.
        model: that is stepped.
        data: its state, of which views are kept.
        points: the P sole points, and both soles.
        substeps: steps of a control tick.
    """

    q: Array
    qd: Array
    torque: Array
    torque_rate: Array
    point_force: Array
    point_position: Array
    point_penetration: Array
    point_place: Array
    com: Array
    angular_momentum: Array
    foot_position: Array
    foot_forward: Array
    command_com: Array
    command_zmp: Array
    command_force: Array
    command_angular_momentum: Array
    qp_status: NDArray[np.int8]
    qp_residual: Array
    qp_iterations: NDArray[np.int32]
    qp_time: Array

    def __init__(
        self,
        steps: int,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        points: SolePoints,
        substeps: int,
    ) -> None:
        self.model, self.substeps = model, substeps
        self.metadata: dict[str, str] = {}
        sizes = {
            "K": steps,
            "K+1": steps + 1,
            "T": -(-steps // substeps),
            "P": len(points.names),
            "F": 2,
            "nq": model.nq,
            "nv": model.nv,
            "nu": model.nu,
        }
        for name in RunLog.__annotations__:
            setattr(self, name, spill.zeros(shape_of(name, sizes), INTEGERS.get(name, np.float64)))
        self.external: dict[str, Array] = {}
        # All that is read and written at every step, as views that are taken once.
        geom, address, frame, place, distance = _contact_views(data)
        self.touching = np.zeros(len(points.names), dtype=bool)
        self.normal_force = np.zeros(len(points.names))
        recorded = {name: getattr(self, name) for name in RunLog.__annotations__}
        self.own = Bundle(
            **recorded,
            geom=geom,
            address=address,
            frame=frame,
            place=place,
            distance=distance,
            of_geom=points.of_geom,
            normal_force=self.normal_force,
            touching=self.touching,
            ctrl=data.ctrl,
            qpos=data.qpos,
            qvel=data.qvel,
            site_place=data.site_xpos,
            site_rotation=data.site_xmat,
            sites=points.sites,
            sensed_com=data.sensor("com").data,
            sensed_momentum=data.sensor("angular_momentum").data,
            substeps=substeps,
        )
        self._unknown = np.full(max(model.nu, 3), np.nan)

    def start(self, data: mujoco.MjData) -> None:
        """Copy the state from which the first step starts."""
        self.q[0], self.qd[0] = data.qpos, data.qvel

    def command(self, k: int, output: ControlOutput) -> Iterable[Array]:
        """Rate, ZMP, force and angular momentum of the tick at step k, NaN where there is none.

        A controller's ZMP is on z = 0; this is that on the plane of the last step's contacts.
        """
        rate, zmp, force, momentum = output.rate, output.zmp, output.force, output.angular_momentum
        if self.metadata and zmp is not None:
            height = self.point_position[max(k - 1, 0), :, 2]
            floor = support_height(self.metadata, height, self.normal_force)
            zmp = None if force is None else np.asarray(zmp) + floor * np.asarray(force[:2]) / force[2]
        return [self._unknown if part is None else part for part in (rate, zmp, force, momentum)]

    def keep_pushes(self, k: int, pushes: Mapping[str, Array]) -> None:
        """Copy force, moment and point of every segment that is pushed in step k, shape (9,)."""
        for segment, push in pushes.items():
            self.external.setdefault(segment, spill.zeros((len(self.torque), 9)))[k] = push

    def close(self, done: int, data: mujoco.MjData) -> dict[str, Any]:
        """Add the instant at which the last step ends, and return the record's arrays.

        Args:
            done: whole steps.
            data: set to their end.

        Returns:
            Name to array, read-only and without a copy: ``done + 1`` rows of instants, ``done`` of steps, and
            the ticks that began in them. An incomplete step has no tick either.
        """
        # The same whatever ended the walk: no push, the last torques, and no warm start.
        data.qpos[:], data.qvel[:] = self.q[done], self.qd[done]
        data.xfrc_applied[:], data.qacc_warmstart[:] = 0.0, 0.0
        data.ctrl[:] = self.torque[done - 1] if done else 0.0
        mujoco.mj_forward(self.model, data)
        keep_instant(self.own, done)
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
        return result
