"""True values for instruments: wrenches and motion of feet and pelvis, from the record alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from ampm.exceptions import InputError
from validation.measure.measure import LEAST_SUPPORT, centre_of_pressure, foot_contact, foot_wrenches

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.description import BodyDescription, LegDescription
    from validation.trial.record import SimulationRecord

    Array = NDArray[np.float64]

_BOUNCE = 0.15
"""A foot that leaves the floor for less than this has made no step [s]."""


@dataclass(frozen=True)
class Truth:
    """True quantities, row k for step k ([t_k, t_(k+1)]); world frame, floor at z = 0; K rows.

    Attributes:
        time: t_k, shape (K,) [s].
        time_step: dt [s].
        foot_force: of the floor on each foot, left first, shape (K, 2, 3) [N].
        foot_torque: its moment about the world origin, shape (K, 2, 3) [N m].
        zmp: shape (K, 2) [m]; NaN where fewer than :data:`LEAST_SUPPORT` of the weight are carried.
        foot_contact: the foot carries force, shape (K, 2), bool.
        foot_position: reference points of the soles at t_k, shape (K, 2, 3) [m].
        com: shape (K, 3) [m].
        mass: [kg].
        gravity: [m/s^2].
    """

    time: Array
    time_step: float
    foot_force: Array
    foot_torque: Array
    zmp: Array
    foot_contact: NDArray[np.bool_]
    foot_position: Array
    com: Array
    mass: float
    gravity: float

    @property
    def least(self) -> float:
        """Least vertical force of a ZMP [N]."""
        return LEAST_SUPPORT * self.mass * self.gravity


def usable_rows(record: SimulationRecord) -> int:
    """Number of leading steps whose numbers are finite: a walk that diverged has a tail that is not."""
    steps = record.steps
    fine = np.isfinite(record.point_force).all(axis=(1, 2))
    fine &= np.isfinite(record.q[1:]).all(axis=1) & np.isfinite(record.qd[1:]).all(axis=1)
    return steps if fine.all() else int(np.argmin(fine))


def true_gait(record: SimulationRecord) -> Truth:
    """Wrenches and ZMP of a record, as :func:`validation.measure.measure.measure` finds them, without
    its model.
    """
    rows = usable_rows(record)
    foot_force, foot_torque = (values[:rows] for values in foot_wrenches(record))
    least = LEAST_SUPPORT * record.mass * record.gravity
    return Truth(
        time=record.time[:rows],
        time_step=record.time_step,
        foot_force=foot_force,
        foot_torque=foot_torque,
        zmp=centre_of_pressure(foot_force.sum(axis=1), foot_torque.sum(axis=1), least),
        foot_contact=foot_contact(record)[:rows],
        foot_position=record.foot_position[:rows],
        com=record.com[:rows],
        mass=record.mass,
        gravity=record.gravity,
    )


def plate_origins(truth: Truth) -> Array:
    """Centre of the plate under each foot, shape (K, 2, 3) [m]; z = 0.

    Every stance has a plate of its own, centred under the sole's mean position while it was loaded. The next
    plate takes over in the middle of the swing, when both read nothing.
    """
    origins = np.zeros((len(truth.time), 2, 3))
    for foot in (0, 1):
        contact, place = truth.foot_contact[:, foot], truth.foot_position[:, foot, :2]
        stances = _stances(contact, round(_BOUNCE / truth.time_step))
        begin = 0
        for index, (first, last) in enumerate(stances):
            end = len(contact) if index + 1 == len(stances) else (last + stances[index + 1][0]) // 2
            loaded = place[first:last][contact[first:last]]
            origins[begin:end, foot, :2] = loaded.mean(axis=0)
            begin = end
        if not stances and len(place):
            origins[:, foot, :2] = place.mean(axis=0)
    return origins


def _stances(contact: NDArray[np.bool_], bounce: int) -> list[tuple[int, int]]:
    """First row and row after the last of every stance; gaps shorter than ``bounce`` rows are bridged."""
    edges = np.flatnonzero(np.diff(np.r_[False, contact, False].astype(np.int8)))
    found: list[tuple[int, int]] = []
    for first, last in edges.reshape(-1, 2).tolist():
        if found and first - found[-1][1] < bounce:
            found[-1] = (found[-1][0], last)
        else:
            found.append((first, last))
    return found


@dataclass(frozen=True)
class Ankle:
    """True state of one foot and of the sensor at its ankle; K rows, world frame.

    Attributes:
        position: of the sensor, shape (K, 3) [m].
        rotation: of the sensor, foot to world, shape (K, 3, 3).
        weight: of what is below the sensor [N].
        com: of what is below the sensor, shape (K, 3) [m].
        inertial_force: its mass times its acceleration, shape (K, 3) [N].
        inertial_moment: rate of its angular momentum about the sensor, shape (K, 3) [N m].
    """

    position: Array
    rotation: Array
    weight: float
    com: Array
    inertial_force: Array
    inertial_moment: Array


def ankles(
    record: SimulationRecord, model: mujoco.MjModel, description: BodyDescription
) -> tuple[Ankle, Ankle]:
    """Sensor frames and inertial forces of both feet.

    Accelerations are differences of the segments' velocities over the very step on which the logged force
    acts, as in :mod:`validation.measure.measure`; the velocities themselves are differences of their places.

    Args:
        record: the run.
        model: the compiled body.
        description: which segments the feet are.

    Raises:
        InputError: the record is of another body.
    """
    if record.q.shape[1] != model.nq:
        raise InputError(
            f"the record has {record.q.shape[1]} coordinates, the model {model.nq}; "
            "give the folder of a run that one version wrote"
        )
    left, right = (_ankle(record, model, leg, i) for i, leg in enumerate(description.legs))
    return left, right


def _ankle(record: SimulationRecord, model: mujoco.MjModel, leg: LegDescription, foot: int) -> Ankle:
    rows, dt = usable_rows(record), record.time_step
    site = model.site(leg.sole_frame)
    heel, toe, hinge = model.body(leg.foot_segment).id, model.body(leg.toe_segment).id, model.joint(leg.toe)
    sole = Rotation.from_quat(np.roll(record.foot_rotation[: rows + 1, foot], -1, axis=-1))
    turned = sole * _rotation(site.quat).inv()  # of the foot segment
    origin = record.foot_position[: rows + 1, foot] - turned.apply(site.pos)
    # The toe's frame: placed in the foot, then turned about its hinge.
    angle = record.q[: rows + 1, int(model.jnt_qposadr[hinge.id])]
    bend = Rotation.from_rotvec(angle[:, None] * model.jnt_axis[hinge.id])
    toe_base = turned * _rotation(model.body_quat[toe])
    toe_turned = toe_base * bend
    anchor = model.jnt_pos[hinge.id]
    toe_origin = (
        origin + turned.apply(model.body_pos[toe]) + toe_base.apply(anchor) - toe_turned.apply(anchor)
    )
    sensor = origin[:rows]

    mass = np.array([model.body_mass[heel], model.body_mass[toe]])
    weighted, force, moment = np.zeros((3, rows, 3))
    for body, rotation, place in ((heel, turned, origin), (toe, toe_turned, toe_origin)):
        com = place + rotation.apply(model.body_ipos[body])
        push = model.body_mass[body] * _rates(np.diff(com, n=2, axis=0) / dt**2, rows)
        spin = _angular_momentum(rotation * _rotation(model.body_iquat[body]), model.body_inertia[body], dt)
        force += push
        moment += np.cross(com[:rows] - sensor, push) + _rates(np.diff(spin, axis=0) / dt, rows)
        weighted += model.body_mass[body] * com[:rows]
    return Ankle(
        position=sensor,
        rotation=turned.as_matrix()[:rows],
        weight=float(mass.sum()) * record.gravity,
        com=weighted / mass.sum(),
        inertial_force=force,
        inertial_moment=moment,
    )


def _rotation(wxyz: Array) -> Rotation:
    return Rotation.from_quat(np.roll(wxyz, -1))


def _rates(later: Array, rows: int) -> Array:
    """Rates (K, 3) in all steps from those in the second and later ones; the first step has the second's."""
    return np.concatenate([later[:1], later]) if rows > 1 else np.zeros((rows, 3))


def _angular_momentum(axes: Rotation, inertia: Array, dt: float) -> Array:
    """Angular momentum about its COM between the instants, from principal axes (K + 1); shape (K, 3)."""
    if len(axes) < 2:
        return np.zeros((0, 3))
    rate = (axes[:-1].inv() * axes[1:]).as_rotvec() / dt
    return np.asarray(axes[:-1].apply(inertia * rate))


@dataclass(frozen=True)
class Inertial:
    """Readings of an ideal IMU; K rows.

    Attributes:
        angular_velocity: in its own axes, shape (K, 3) [rad/s].
        specific_force: acceleration less gravity, in its own axes, shape (K, 3) [m/s^2].
        rotation: its axes to world, shape (K, 3, 3).
    """

    angular_velocity: Array
    specific_force: Array
    rotation: Array


def pelvis_motion(record: SimulationRecord) -> Inertial:
    """The pelvis's motion from the recorded state: the acceleration is that of the very step."""
    rows = usable_rows(record)
    turned = Rotation.from_quat(np.roll(record.q[:rows, 3:7], -1, axis=-1)) if rows else None
    rotation = turned.as_matrix() if turned is not None else np.zeros((0, 3, 3))
    pull = np.diff(record.qd[: rows + 1, :3], axis=0) / record.time_step + [0.0, 0.0, record.gravity]
    felt = np.einsum("kji,kj->ki", rotation, pull)
    return Inertial(record.qd[:rows, 3:6].copy(), felt, rotation)


def chest_motion(record: SimulationRecord) -> Inertial:
    """The simulator's own inertial sensors.

    Raises:
        InputError: the record has none.
    """
    names = ("imu_gyro", "imu_accelerometer", "imu_orientation")
    missing = [name for name in names if name not in record.sensors]
    if missing:
        raise InputError(f"the record has no sensor {missing[0]!r}; use mount = 'pelvis'.")
    rows = usable_rows(record)
    gyro, pull, wxyz = (record.sensors[name][:rows] for name in names)
    turned = Rotation.from_quat(np.roll(wxyz, -1, axis=-1)).as_matrix() if rows else np.zeros((0, 3, 3))
    return Inertial(gyro.copy(), pull.copy(), turned)
