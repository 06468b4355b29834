"""Log of a running walk: the record's own arrays, filled step by step."""

from collections import namedtuple
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from ampm.compiled import compiled, refer
from ampm.vectors import put, vector
from validation.trial import spill
from validation.trial.record import INTEGERS, SHAPES, shape_of
from validation.trial.watch import zmp_gap

Array = NDArray[np.float64]


class Contacts(NamedTuple):
    """MuJoCo's contacts, as many rows as its memory can hold.

    Attributes:
        geom: both geoms. MuJoCo sorts them by type: a floor that is a plane comes first, a box last.
        address: of the contact's first force, along the normal, -1 for none: two along the tangents follow.
        frame: normal and tangents.
        place: [m].
        distance: negative where they overlap [m].
        point_of_geom: sole point of every geom, -1 for none: a sphere, with one contact at most.
    """

    geom: NDArray[np.int32]
    address: NDArray[np.int32]
    frame: Array
    place: Array
    distance: Array
    point_of_geom: NDArray[np.intp]


class SimulatedData(NamedTuple):
    """Views of MuJoCo's data; sensors of COM [m] and angular momentum [N m s]."""

    qpos: Array
    qvel: Array
    ctrl: Array
    site_place: Array
    site_rotation: Array
    com: Array
    angular_momentum: Array


class Log(NamedTuple):
    """What compiled functions keep of a run.

    Attributes:
        record: arrays of :class:`RunLog` under their names.
        simulated: by MuJoCo.
        contacts: by MuJoCo.
        sites: of sole points and, last, of the two soles.
        normal_force: of every sole point in the last step, shape (P,) [N].
        touching: sole points that touch, shape (P,).
        levels: heights of the floor's surfaces if there are several [m].
        substeps: steps of a control tick.
    """

    record: Any
    simulated: SimulatedData
    contacts: Contacts
    sites: NDArray[np.intp]
    normal_force: Array
    touching: NDArray[np.bool_]
    levels: Array
    substeps: int


def _contacts(data: mujoco.MjData, point_of_geom: NDArray[np.intp]) -> Contacts:
    """Views of MuJoCo's contacts that hold for the whole walk.

    MuJoCo's own views have one row per present contact, so they would have to be taken at every step.
    Contacts lie at the beginning of the simulation's arena; these views have as many rows as it can hold.
    """

    def view(present: NDArray[Any]) -> NDArray[Any]:
        shape = (data.narena // present.strides[0], *present.shape[1:])
        return np.lib.stride_tricks.as_strided(present, shape, present.strides, writeable=False)

    contact = data.contact
    return Contacts(
        geom=view(contact.geom),
        address=view(contact.efc_address),
        frame=view(contact.frame),
        place=view(contact.pos),
        distance=view(contact.dist),
        point_of_geom=point_of_geom,
    )


@compiled
def point_of(geoms: NDArray[np.int32], of_geom: NDArray[np.intp]) -> int:
    """Sole point of a contact by its two geoms, -1 for none."""
    return max(of_geom[geoms[0]], of_geom[geoms[1]])


@compiled
def read_touch(log: Log, contacts: int) -> None:
    """Read which sole points are in contact, after ``mj_step1``."""
    touching, geom, of_geom = log.touching, log.contacts.geom, log.contacts.point_of_geom
    touching[:] = False
    for i in range(contacts):
        point = point_of(geom[i], of_geom)
        if point >= 0:
            touching[point] = True


@compiled
def keep_instant(log: Log, k: int) -> None:
    """Copy the places of sole points and soles, COM and angular momentum at t_k."""
    record, sites, place = log.record, log.sites, log.simulated.site_place
    point_place, foot_position = record.point_place[k], record.foot_position[k]
    points = len(point_place)
    for i in range(points):  # a row copied as an array takes ten times as long
        put(point_place[i], vector(place[sites[i]]))
    for i in range(2):
        put(foot_position[i], vector(place[sites[points + i]]))
        rotation = log.simulated.site_rotation[sites[points + i]]
        put(record.foot_forward[k, i], (rotation[0], rotation[3], rotation[6]))
    put(record.com[k], vector(log.simulated.com))
    put(record.angular_momentum[k], vector(log.simulated.angular_momentum))


@compiled
def keep_step(log: Log, k: int, contacts: int, efc_force: Array) -> None:
    """Copy places, contacts and torques of step k, and the state after it.

    Args:
        log: of the run.
        k: step.
        contacts: how many there are.
        efc_force: forces of all constraints.
    """
    keep_instant(log, k)
    record, touch, normal_force = log.record, log.contacts, log.normal_force
    geom, of_geom, address, frame = touch.geom, touch.point_of_geom, touch.address, touch.frame
    force, position, place = record.point_force[k], record.point_position[k], record.point_place[k]
    for p in range(len(place)):
        put(position[p], vector(place[p]))
    record.torque[k] = log.simulated.ctrl
    normal_force[:] = 0.0
    for i in range(contacts):
        p, first = point_of(geom[i], of_geom), address[i]
        if p >= 0 and first >= 0:
            side = 1.0 if of_geom[geom[i, 1]] >= 0 else -1.0  # the force acts on the second geom
            for axis in range(3):
                force[p, axis] = side * (
                    efc_force[first] * frame[i, axis]
                    + efc_force[first + 1] * frame[i, 3 + axis]
                    + efc_force[first + 2] * frame[i, 6 + axis]
                )
            distance = touch.distance[i]
            if distance < 0.0:
                put(position[p], vector(touch.place[i]))
            record.point_penetration[k, p] = -distance
            normal_force[p] = efc_force[first]
    record.q[k + 1] = log.simulated.qpos
    record.qd[k + 1] = log.simulated.qvel


@compiled
def floor_height(log: Log, k: int) -> float:
    """Height of the floor under the contacts of the step before k, averaged by their loads [m].

    Each contact counts as one on the surface nearest to it; the lowest one where there is no load.
    """
    load = height = 0.0
    for p in range(len(log.normal_force)):
        place, nearest = log.record.point_position[max(k - 1, 0), p, 2], log.levels[0]
        for level in log.levels:
            if abs(place - level) < abs(place - nearest):
                nearest = level
        load += log.normal_force[p]
        height += log.normal_force[p] * nearest
    return height / load if load > 0.0 else log.levels[0]


@compiled
def keep_command(log: Log, k: int, com: Array, zmp: Array, force: Array, momentum: Array) -> None:
    """Copy the command of the tick at step k.

    A controller's ZMP is on z = 0. On a floor of several levels, that on the plane of the last step's
    contacts is kept.
    """
    record, height = log.record, 0.0
    if len(log.levels) > 1:
        height = floor_height(log, k)
    for i in range(k, min(k + log.substeps, len(record.torque))):
        put(record.command_com[i], vector(com))
        for axis in range(2):
            record.command_zmp[i, axis] = zmp[axis]
            if height != 0.0:
                record.command_zmp[i, axis] += height * force[axis] / force[2]
        put(record.command_force[i], vector(force))
        put(record.command_angular_momentum[i], vector(momentum))


@compiled
def zmp_gap_before(log: Log, k: int) -> float:
    """Distance of the ZMP of the step before k from the commanded one [m]."""
    place, command = log.record.point_position[k - 1], log.record.command_zmp[k - 1]
    return zmp_gap(log.normal_force, place, command)


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


def point_forces(data: mujoco.MjData, points: SolePoints) -> tuple[Array, Array]:
    """Forces of the floor on the sole points in the last step, and where they act, shape (P, 3) [N], [m].

    Points without a force have a place of zero.
    """
    force, place = np.zeros((2, len(points.names), 3))
    for contact in data.contact:
        point, first = int(points.of_geom[contact.geom].max()), contact.efc_address
        if point >= 0 and first >= 0:
            side = 1.0 if points.of_geom[contact.geom[1]] >= 0 else -1.0  # it acts on the second geom
            force[point] = side * contact.frame.reshape(3, 3).T @ data.efc_force[first : first + 3]
            place[point] = contact.pos
    return force, place


class RunLog:
    """The arrays of a :class:`validation.trial.record.SimulationRecord`, under its names, of K steps at most.

    Rows beyond the steps done have no meaning. Memory is allocated when it is written.

    Args:
        steps: K.
        model: that is stepped.
        data: its state, of which views are kept.
        points: the P sole points, and both soles.
        substeps: steps of a control tick.
        levels: heights of the floor's surfaces [m].
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
        levels: Sequence[float] = (0.0,),
    ) -> None:
        self.model, self.substeps, self._made_with = model, substeps, (data, points, substeps, levels)
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
        self.touching, self.normal_force = np.zeros(sizes["P"], dtype=bool), np.zeros(sizes["P"])
        self.log = Log(
            record=Recorded(*(getattr(self, name) for name in RunLog.__annotations__)),
            simulated=SimulatedData(
                qpos=data.qpos,
                qvel=data.qvel,
                ctrl=data.ctrl,
                site_place=data.site_xpos,
                site_rotation=data.site_xmat,
                com=data.sensor("com").data,
                angular_momentum=data.sensor("angular_momentum").data,
            ),
            contacts=_contacts(data, points.of_geom),
            sites=points.sites,
            normal_force=self.normal_force,
            touching=self.touching,
            levels=np.array(levels),
            substeps=substeps,
        )
        self.handle = refer(self.log)

    def start(self, data: mujoco.MjData) -> None:
        """Copy the state from which the first step starts."""
        self.q[0], self.qd[0] = data.qpos, data.qvel

    def keep_pushes(self, k: int, pushes: Mapping[str, Array]) -> None:
        """Copy force, moment and point of every segment that is pushed in step k, shape (9,)."""
        for segment, push in pushes.items():
            self.external.setdefault(segment, spill.zeros((len(self.torque), 9)))[k] = push

    def extended(self, steps: int, done: int) -> "RunLog":
        """The log with room for more steps, twice as many as now or more.

        Args:
            steps: to make room for.
            done: steps that are kept, and what there is of the next one.
        """
        log = RunLog(max(steps, 2 * len(self.torque)), self.model, *self._made_with)
        for name in RunLog.__annotations__:
            rows = done + 2 if SHAPES[name].startswith("K") else done // self.substeps + 1
            getattr(log, name)[:rows] = getattr(self, name)[:rows]
        for name in ("command_com", "command_zmp", "command_force", "command_angular_momentum"):
            rows = min(done + self.substeps, len(self.torque))
            getattr(log, name)[:rows] = getattr(self, name)[:rows]
        log.touching[:], log.normal_force[:] = self.touching, self.normal_force
        for segment, push in self.external.items():
            log.external[segment] = spill.zeros((len(log.torque), 9))
            log.external[segment][: done + 1] = push[: done + 1]
        return log

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
        keep_instant(self.handle, done)
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


Recorded: Any = namedtuple("Recorded", list(RunLog.__annotations__))  # type: ignore[misc]
"""Arrays of a record. Code for a class of a function would be compiled by every process."""
