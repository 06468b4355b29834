"""Three instruments under one interface: true values of their channels, and the ZMP from readings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ampm.description import BodyDescription, LegDescription
from ampm.exceptions import InputError
from ampm.geometry import Array
from validation.measure.instruments.chain import Chain, random_stream
from validation.measure.instruments.model import (
    Acquisition,
    Channel,
    FootForceTorque,
    ForcePlate,
    Imu,
    Instrument,
)
from validation.measure.measure import (
    LEAST_SUPPORT,
    centre_of_pressure,
    floor_height,
    foot_contact,
    foot_wrenches,
)
from validation.trial.bridge import pinocchio_model, to_pinocchio
from validation.trial.record import FEET, SimulationRecord, support_height

Body = Callable[[], tuple[mujoco.MjModel, BodyDescription]]

KINEMATICS, TILT = "kinematics", "tilt"
_WRENCH = {
    "force_x": "force_xy", "force_y": "force_xy", "force_z": "force_z",
    "moment_x": "moment_xy", "moment_y": "moment_xy", "moment_z": "moment_z",
}  # fmt: skip
_TILT_STREAM = 4
_BOUNCE = 0.15
"""A loss of contact shorter than this is no step [s]."""


class Estimate(NamedTuple):
    """Quantities computed from readings; K rows, world frame.

    Attributes:
        zmp: NaN where the instrument detects no contact, shape (K, 2) [m].
        force: net ground force, shape (K, 3) [N].
    """

    zmp: Array
    force: Array


def usable_rows(record: SimulationRecord) -> int:
    """Number of leading steps whose numbers are finite; a walk that diverged ends with others."""
    fine = np.isfinite(record.point_force).all(axis=(1, 2))
    fine &= np.isfinite(record.q[1:]).all(axis=1) & np.isfinite(record.qd[1:]).all(axis=1)
    return record.steps if fine.all() else int(np.argmin(fine))


class Rig:
    """An instrument on a body that walks; K usable steps, row k for step k, world frame.

    Attributes:
        record: of the walk.
        time: t_k, shape (K,) [s].
        foot_force: of the floor on each foot, left first, shape (K, 2, 3) [N].
        foot_torque: its moment about the world origin, shape (K, 2, 3) [N m].
        contact: the foot carries force, shape (K, 2), bool.
        zmp: shape (K, 2) [m]; NaN where fewer than :data:`LEAST_SUPPORT` of the weight are carried.
        names, units: of the channels.
        chain: its channels.
        signals: readings of ideal channels, shape (K, C).
        effects: that it has.
        drawn: further constants that were drawn, by name.

    Args:
        instrument: which.
        record: of the walk, of two usable steps or more.
        key: of the run, for the draws.
        channels: name, unit and specifications of each.
        cross_talk: bound of the coupling, relative to the ranges [1].

    Raises:
        InputError: the record lacks what the instrument needs.
    """

    signals: Array

    def __init__(
        self, instrument: Instrument, record: SimulationRecord, key: str,
        channels: Sequence[tuple[str, str, Channel]], cross_talk: float = 0.0,
    ) -> None:  # fmt: skip
        rows = usable_rows(record)
        self.record, self.time = record, record.time[:rows]
        self.foot_force, self.foot_torque = (values[:rows] for values in foot_wrenches(record))
        self.contact = foot_contact(record)[:rows]
        self.least = LEAST_SUPPORT * record.mass * record.gravity
        self.floor, net = floor_height(record)[:rows], self.foot_force.sum(axis=1)
        self.zmp = centre_of_pressure(net, self.foot_torque.sum(axis=1), self.least, self.floor)
        self.names, self.units, figures = zip(*channels, strict=True)
        self.chain = Chain(
            figures, instrument.acquisition, instrument.seed, key, self.time, record.time_step, cross_talk
        )
        self.effects = self.chain.effects
        self.drawn: Mapping[str, float] = {}

    def estimate(self, readings: Array, effects: Set[str]) -> Estimate:
        """ZMP and force computed from readings.

        Args:
            readings: shape (K, C).
            effects: those that act on data other than the readings.
        """
        raise NotImplementedError


class _WrenchRig(Rig):
    """Six channels for each foot, and a ZMP from the wrenches that count as loaded."""

    def __init__(self, instrument: ForcePlate | FootForceTorque, record: SimulationRecord, key: str) -> None:
        channels = [
            (f"{foot}_{name}", instrument.groups[group], getattr(instrument, group))
            for foot in FEET
            for name, group in _WRENCH.items()
        ]
        super().__init__(instrument, record, key, channels, instrument.cross_talk)
        self.threshold = instrument.threshold

    def _net(self, force: Array, torque: Array) -> Estimate:
        """Net force and ZMP of both feet's force and moment about the world origin, each (K, 2, 3)."""
        if self.threshold > 0.0:
            loaded = force[:, :, 2:] >= self.threshold
            force, torque = np.where(loaded, force, 0.0), np.where(loaded, torque, 0.0)
        net = force.sum(axis=1)
        return Estimate(centre_of_pressure(net, torque.sum(axis=1), self.least, self.floor), net)


class PlateRig(_WrenchRig):
    """Force plates: moments are read about the middle of each plate's surface."""

    def __init__(self, instrument: ForcePlate, record: SimulationRecord, key: str, body: Body) -> None:
        del body  # plates have no body model
        super().__init__(instrument, record, key)
        self.origins = self._plate_origins()
        moment = self.foot_torque - np.cross(self.origins, self.foot_force)
        self.signals = np.concatenate([self.foot_force, moment], axis=2).reshape(-1, 12)

    def estimate(self, readings: Array, effects: Set[str]) -> Estimate:
        """See :class:`Rig`: moments are carried to the world's origin."""
        force, moment = np.split(readings.reshape(-1, 2, 6), 2, axis=2)
        return self._net(force, moment + np.cross(self.origins, force))

    def _plate_origins(self) -> Array:
        """Centre of the plate under each foot, level with the floor there, shape (K, 2, 3) [m].

        Every stance has a plate of its own, centred under the sole's mean position while it was loaded. The
        next plate is used from the middle of the swing, when both are unloaded.
        """
        rows = len(self.time)
        origins = np.zeros((rows, 2, 3))
        for foot in (0, 1):
            contact, place = self.contact[:, foot], self.record.foot_position[:rows, foot, :2]
            origins[:, foot, :2] = place.mean(axis=0)
            stances = _stances(contact, round(_BOUNCE / self.record.time_step))
            ends = [(last + first) // 2 for (_, last), (first, _) in pairwise(stances)]
            for (first, last), begin, end in zip(stances, [0, *ends], [*ends, rows], strict=bool(stances)):
                loaded = place[first:last][contact[first:last]]
                origins[begin:end, foot, :2] = loaded.mean(axis=0)
                load = self.record.point_force[first:last, :, 2] * (self.record.point_foot == foot)
                height = self.record.point_position[first:last, :, 2]
                surface = support_height(self.record.metadata, height, load)
                origins[begin:end, foot, 2] = surface[contact[first:last]].mean()
        return origins


def _stances(contact: NDArray[np.bool_], bounce: int) -> list[tuple[int, int]]:
    """First row and row after the last of every stance; gaps shorter than ``bounce`` rows are bridged."""
    if not contact.any():
        return []
    edges = np.flatnonzero(np.diff(np.r_[False, contact, False].astype(np.int8)))
    first, last = edges[::2], edges[1::2]
    apart = first[1:] - last[:-1] >= bounce
    return list(zip(first[np.r_[True, apart]].tolist(), last[np.r_[apart, True]].tolist(), strict=True))


class Ankles(NamedTuple):
    """True state of the feet and of the sensors at their ankles, left first; K rows, world frame.

    Attributes:
        position: of the sensors, shape (K, 2, 3) [m].
        rotation: of the sensors, foot to world, shape (K, 2, 3, 3).
        weight: of what is below the sensors, upwards, shape (1, 2, 3) [N].
        com: of what is below the sensors, shape (K, 2, 3) [m].
        inertial_force: its mass times its acceleration, shape (K, 2, 3) [N].
        inertial_moment: rate of its angular momentum about the sensor, shape (K, 2, 3) [N m].
    """

    position: Array
    rotation: Array
    weight: Array
    com: Array
    inertial_force: Array
    inertial_moment: Array


class FootRig(_WrenchRig):
    """Sensors in the ankles: they measure the floor's force less weight and inertial force of the foot."""

    def __init__(self, instrument: FootForceTorque, record: SimulationRecord, key: str, body: Body) -> None:
        super().__init__(instrument, record, key)
        model, description = body()
        if record.q.shape[1] != model.nq:
            raise InputError(
                f"the record has {record.q.shape[1]} coordinates, the model {model.nq}; "
                "give the folder of a run that one version wrote"
            )
        self.compensation = instrument.compensation
        sides = [_ankle(record, len(self.time), model, leg, i) for i, leg in enumerate(description.legs)]
        self.feet = feet = Ankles(*(np.stack(pair, axis=1) for pair in zip(*sides, strict=True)))
        # Force from foot to leg, in the sensor's axes.
        force = self.foot_force - (feet.inertial_force + feet.weight)
        moment = self.foot_torque - np.cross(feet.position, self.foot_force) - feet.inertial_moment
        moment = moment - np.cross(feet.com - feet.position, feet.weight)
        felt = [_to_local(feet.rotation, vector) for vector in (force, moment)]
        self.signals = np.concatenate(felt, axis=2).reshape(-1, 12)
        if instrument.pose == "encoders":
            names = [name for leg in description.legs for name in leg.joints[:-1]]  # toes are beyond it
            self.columns = [int(model.jnt_qposadr[model.joint(name).id]) for name in names]
            # Read with the pelvis's pose, at the same instant.
            figures = [instrument.encoder] * len(names)
            self.encoders = replace(
                self.chain, channels=figures, acquisition=Acquisition(), cross_talk=0.0, number=1
            )
            self.effects = self.effects | {KINEMATICS}
            self.pin_model = pinocchio_model(model)
            self.frames = [self.pin_model.getFrameId(leg.foot_segment) for leg in description.legs]

    def estimate(self, readings: Array, effects: Set[str]) -> Estimate:
        """See :class:`Rig`: readings are rotated to world by the estimated pose."""
        feet = self.feet
        place, rotation = self._encoded() if KINEMATICS in effects else (feet.position, feet.rotation)
        both = readings.reshape(-1, 2, 6)
        force, moment = _to_world(rotation, both[:, :, :3]), _to_world(rotation, both[:, :, 3:])
        if self.compensation != "none":
            arm = _to_local(feet.rotation, feet.com - feet.position)
            moment = moment + np.cross(_to_world(rotation, arm), feet.weight)
            force = force + feet.weight
        if self.compensation == "inertia":
            force, moment = force + feet.inertial_force, moment + feet.inertial_moment
        return self._net(force, moment + np.cross(place, force))

    def _encoded(self) -> tuple[Array, Array]:
        """Sensor poses (K, 2, 3) and (K, 2, 3, 3), by the pelvis's true pose and the encoders."""
        q = self.record.q[: len(self.time)].copy()
        q[:, self.columns] = self.encoders.read(q[:, self.columns], self.encoders.effects)
        configurations, _ = to_pinocchio(q, np.zeros((len(q), self.pin_model.nv)))
        data = self.pin_model.createData()
        place, rotation = np.empty((len(q), 2, 3)), np.empty((len(q), 2, 3, 3))
        for row, configuration in enumerate(configurations):
            pin.forwardKinematics(self.pin_model, data, configuration)
            for foot, frame in enumerate(self.frames):
                pose = pin.updateFramePlacement(self.pin_model, data, frame)
                place[row, foot], rotation[row, foot] = pose.translation, pose.rotation
        return place, rotation


def _ankle(
    record: SimulationRecord, rows: int, model: mujoco.MjModel, leg: LegDescription, foot: int
) -> tuple[Array, ...]:
    """Values of :class:`Ankles` of one foot.

    Accelerations are differences of the segments' velocities over the step in which the logged force acts, as
    in :mod:`validation.measure.measure`; the velocities themselves are differences of their places.
    """
    dt = record.time_step
    site = model.site(leg.sole_frame)
    heel = model.body(leg.foot_segment).id
    sole = _rotation(record.foot_rotation[: rows + 1, foot])
    turned = sole * _rotation(site.quat).inv()  # of the foot segment
    origin = record.foot_position[: rows + 1, foot] - turned.apply(site.pos)
    parts = [(heel, turned, origin)]
    if leg.toe is not None:
        # The toe's frame: placed in the foot, then turned about its hinge.
        toe, hinge = model.body(leg.toe_segment).id, model.joint(leg.toe)
        angle = record.q[: rows + 1, int(model.jnt_qposadr[hinge.id])]
        bend = Rotation.from_rotvec(angle[:, None] * model.jnt_axis[hinge.id])
        toe_base = turned * _rotation(model.body_quat[toe])
        toe_turned = toe_base * bend
        anchor = model.jnt_pos[hinge.id]
        toe_origin = (
            origin + turned.apply(model.body_pos[toe]) + toe_base.apply(anchor) - toe_turned.apply(anchor)
        )
        parts.append((toe, toe_turned, toe_origin))
    sensor = origin[:rows]

    mass = np.array([model.body_mass[body] for body, *_ in parts])
    weighted, force, moment = np.zeros((3, rows, 3))
    for body, rotation, place in parts:
        com = place + rotation.apply(model.body_ipos[body])
        push = model.body_mass[body] * _from_second(np.diff(com, n=2, axis=0) / dt**2)
        # Angular momentum about the COM between the instants, from the principal axes.
        axes = rotation * _rotation(model.body_iquat[body])
        rate = (axes[:-1].inv() * axes[1:]).as_rotvec() / dt
        spin = axes[:-1].apply(model.body_inertia[body] * rate)
        force += push
        moment += np.cross(com[:rows] - sensor, push) + _from_second(np.diff(spin, axis=0) / dt)
        weighted += model.body_mass[body] * com[:rows]
    weight = np.array([[0.0, 0.0, float(mass.sum()) * record.gravity]])
    return sensor, turned.as_matrix()[:rows], weight, weighted / mass.sum(), force, moment


def _rotation(wxyz: Array) -> Rotation:
    return Rotation.from_quat(np.roll(wxyz, -1, axis=-1))


def _from_second(later: Array) -> Array:
    """Rates (K, 3) in all steps from those in the second and later ones; the first step has the second's."""
    return np.concatenate([later[:1], later])


def _to_world(rotation: Array, vector: Array) -> Array:
    return np.asarray(np.einsum("...ij,...j->...i", rotation, vector))


def _to_local(rotation: Array, vector: Array) -> Array:
    return np.asarray(np.einsum("...ji,...j->...i", rotation, vector))


class ImuRig(Rig):
    """Gyroscope and accelerometer; the ZMP is that of a point mass at the COM accelerated as the IMU."""

    def __init__(self, instrument: Imu, record: SimulationRecord, key: str, body: Body) -> None:
        del body  # the record has the motion
        channels = [(f"gyroscope_{axis}", "rad/s", instrument.gyroscope) for axis in "xyz"]
        channels += [(f"accelerometer_{axis}", "m/s^2", instrument.accelerometer) for axis in "xyz"]
        super().__init__(instrument, record, key, channels)
        motion = _pelvis_motion if instrument.mount == "pelvis" else _chest_motion
        self.signals, self.rotation = motion(record, len(self.time))
        draws = random_stream(instrument.seed, key, _TILT_STREAM)
        self.lean = instrument.tilt * draws.uniform(-1.0, 1.0, 2)
        if instrument.tilt > 0.0:
            self.effects = self.effects | {TILT}
            self.drawn = {f"{TILT}_{axis}": float(v) for axis, v in zip("xy", self.lean, strict=True)}

    def estimate(self, readings: Array, effects: Set[str]) -> Estimate:
        """See :class:`Rig`: COM and orientation are taken as known, except the tilt error."""
        rotation = self.rotation
        if TILT in effects:
            rotation = Rotation.from_rotvec([*self.lean, 0.0]).as_matrix() @ rotation
        felt, com, mass = (
            _to_world(rotation, readings[:, 3:]),
            self.record.com[: len(self.time)],
            self.record.mass,
        )
        vertical = np.where(felt[:, 2] >= self.least / mass, felt[:, 2], np.nan)
        zmp = com[:, :2] - (com[:, 2:] - self.floor[:, None]) * felt[:, :2] / vertical[:, None]
        return Estimate(zmp, mass * felt)


def _pelvis_motion(record: SimulationRecord, rows: int) -> tuple[Array, Array]:
    """Readings of an ideal IMU in the pelvis (K, 6) [rad/s, m/s^2] and its axes to world (K, 3, 3).

    From the recorded state: the acceleration is that of the step.
    """
    rotation = _rotation(record.q[:rows, 3:7]).as_matrix()
    pull = np.diff(record.qd[: rows + 1, :3], axis=0) / record.time_step + [0.0, 0.0, record.gravity]
    return np.concatenate([record.qd[:rows, 3:6], _to_local(rotation, pull)], axis=1), rotation


def _chest_motion(record: SimulationRecord, rows: int) -> tuple[Array, Array]:
    """The same of the simulator's own inertial sensors.

    Raises:
        InputError: the record has none.
    """
    names = ("imu_gyro", "imu_accelerometer", "imu_orientation")
    missing = [name for name in names if name not in record.sensors]
    if missing:
        raise InputError(f"the record has no sensor {missing[0]!r}; use mount = 'pelvis'.")
    gyro, pull, wxyz = (record.sensors[name][:rows] for name in names)
    return np.concatenate([gyro, pull], axis=1), _rotation(wxyz).as_matrix()


RIGS: Mapping[type[Instrument], Callable[..., Rig]] = {
    ForcePlate: PlateRig,
    FootForceTorque: FootRig,
    Imu: ImuRig,
}
"""What attaches an instrument to a walk: called with instrument, record, key and body."""
