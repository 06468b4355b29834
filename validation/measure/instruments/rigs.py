"""Three instruments under one interface: what their channels truly are, and what a user makes of readings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from validation.measure.instruments.chain import Chain, RandomStreams
from validation.measure.instruments.model import (
    Acquisition,
    Channel,
    FootForceTorque,
    ForcePlate,
    Imu,
    Instrument,
)
from validation.measure.instruments.truth import (
    Ankle,
    Inertial,
    Truth,
    ankles,
    chest_motion,
    pelvis_motion,
    plate_origins,
    true_gait,
)
from validation.measure.measure import centre_of_pressure
from validation.trial.bridge import pinocchio_model, to_pinocchio

if TYPE_CHECKING:
    import mujoco
    from numpy.typing import NDArray

    from ampm.description import BodyDescription
    from validation.trial.record import SimulationRecord

    Array = NDArray[np.float64]
    Body = Callable[[], tuple[mujoco.MjModel, BodyDescription]]

FEET = ("left", "right")
KINEMATICS, TILT = "kinematics", "tilt"
_WRENCH = ("force_x", "force_y", "force_z", "moment_x", "moment_y", "moment_z")
_GROUPS = ("force_xy", "force_xy", "force_z", "moment_xy", "moment_xy", "moment_z")
_TILT_STREAM = 4


@dataclass(frozen=True)
class Estimate:
    """Quantities computed from readings; K rows, world frame.

    Attributes:
        zmp: NaN where the instrument sees no contact, shape (K, 2) [m].
        force: net ground force, shape (K, 3) [N].
    """

    zmp: Array
    force: Array


class Rig:
    """An instrument on a body that walks.

    Attributes:
        truth: of the walk.
        chain: its channels.
        names: of the channels.
        units: of the channels.
        signals: what faultless channels read, shape (K, C).
        drawn: further constants that were drawn, by name.
    """

    signals: Array

    def __init__(
        self, instrument: Instrument, truth: Truth, key: str, channels: Sequence[tuple[str, str, Channel]],
        cross_talk: float = 0.0,
    ) -> None:  # fmt: skip
        self.truth = truth
        self.names, self.units, figures = zip(*channels, strict=True)
        self.drawn: Mapping[str, float] = {}
        streams, time, dt = RandomStreams(instrument.seed, key), truth.time, truth.time_step
        self.chain = Chain(figures, instrument.acquisition, streams, time, dt, cross_talk)

    def effects(self) -> tuple[str, ...]:
        """Effects that it has."""
        return self.chain.effects()

    def estimate(self, readings: Array, effects: Set[str]) -> Estimate:
        """ZMP and force as the user of the readings computes them.

        Args:
            readings: shape (K, C).
            effects: those that act on what the user knows beside the readings.
        """
        raise NotImplementedError


class _WrenchRig(Rig):
    """Six channels for each foot, and a ZMP from the wrenches that count as loaded."""

    def __init__(self, instrument: ForcePlate | FootForceTorque, truth: Truth, key: str) -> None:
        channels = [
            (f"{foot}_{name}", "N" if name.startswith("force") else "N m", getattr(instrument, group))
            for foot in FEET
            for name, group in zip(_WRENCH, _GROUPS, strict=True)
        ]
        super().__init__(instrument, truth, key, channels, instrument.cross_talk)
        self.threshold = instrument.threshold

    def _net(self, force: Array, torque: Array) -> Estimate:
        """Net force and ZMP of both feet's force and moment about the world origin, each (K, 2, 3)."""
        if self.threshold > 0.0:
            loaded = force[:, :, 2:] >= self.threshold
            force, torque = np.where(loaded, force, 0.0), np.where(loaded, torque, 0.0)
        net = force.sum(axis=1)
        return Estimate(centre_of_pressure(net, torque.sum(axis=1), self.truth.least), net)


class PlateRig(_WrenchRig):
    """Force plates: moments are read about the middle of each plate's surface."""

    def __init__(self, instrument: ForcePlate, truth: Truth, key: str) -> None:
        super().__init__(instrument, truth, key)
        self.origins = plate_origins(truth)
        moment = truth.foot_torque - np.cross(self.origins, truth.foot_force)
        self.signals = np.concatenate([truth.foot_force, moment], axis=2).reshape(len(moment), 12)

    def estimate(self, readings: Array, effects: Set[str]) -> Estimate:
        """See :class:`Rig`: moments are carried to the world's origin."""
        both = readings.reshape(-1, 2, 6)
        force, moment = both[:, :, :3], both[:, :, 3:]
        return self._net(force, moment + np.cross(self.origins, force))


class FootRig(_WrenchRig):
    """Sensors in the ankles: they feel the floor less what the foot below them weighs and resists."""

    def __init__(
        self, instrument: FootForceTorque, truth: Truth, key: str, record: SimulationRecord, body: Body
    ) -> None:
        super().__init__(instrument, truth, key)
        self.instrument = instrument
        model, description = body()
        self.feet = ankles(record, model, description)
        rows = len(truth.time)
        wrenches = [self._felt(foot, index) for index, foot in enumerate(self.feet)]
        self.signals = np.concatenate(wrenches, axis=1).reshape(rows, 12)
        self.encoders: Chain | None = None
        if instrument.pose == "encoders":
            self.joints = [leg.joints[:-1] for leg in description.legs]  # the toe is beyond the sensor
            names = [name for leg in self.joints for name in leg]
            self.columns = [int(model.jnt_qposadr[model.joint(name).id]) for name in names]
            figures = [instrument.encoder] * len(names)
            at_once = Acquisition()  # read with the pelvis's pose, at the same instant
            streams, time, dt = self.chain.streams, truth.time, truth.time_step
            self.encoders = Chain(figures, at_once, streams, time, dt, number=1)
            self.q = record.q[:rows]
            self.pin_model = pinocchio_model(model)
            self.frames = [self.pin_model.getFrameId(leg.foot_segment) for leg in description.legs]

    def effects(self) -> tuple[str, ...]:
        """Effects that it has."""
        return (*super().effects(), KINEMATICS) if self.encoders is not None else super().effects()

    def _felt(self, foot: Ankle, index: int) -> Array:
        """True reading (K, 6) in the sensor's axes: what the foot passes on to the leg."""
        truth = self.truth
        own = foot.inertial_force + np.array([0.0, 0.0, foot.weight])
        force = truth.foot_force[:, index] - own
        moment = truth.foot_torque[:, index] - np.cross(foot.position, truth.foot_force[:, index])
        moment = moment - foot.inertial_moment - np.cross(foot.com - foot.position, [0.0, 0.0, foot.weight])
        turned = [np.einsum("kji,kj->ki", foot.rotation, vector) for vector in (force, moment)]
        return np.concatenate(turned, axis=1)

    def estimate(self, readings: Array, effects: Set[str]) -> Estimate:
        """See :class:`Rig`: readings are turned into the world by the pose that the user has."""
        both = readings.reshape(-1, 2, 6)
        poses = [(foot.position, foot.rotation) for foot in self.feet]
        if KINEMATICS in effects and self.encoders is not None and len(both):
            poses = self._encoded(effects)
        forces, torques = [], []
        for index, (foot, (place, rotation)) in enumerate(zip(self.feet, poses, strict=True)):
            force = np.einsum("kij,kj->ki", rotation, both[:, index, :3])
            moment = np.einsum("kij,kj->ki", rotation, both[:, index, 3:])
            if self.instrument.compensation != "none":
                weight = np.array([0.0, 0.0, foot.weight])
                arm = np.einsum("kji,kj->ki", foot.rotation, foot.com - foot.position)
                moment = moment + np.cross(np.einsum("kij,kj->ki", rotation, arm), weight)
                force = force + weight
            if self.instrument.compensation == "inertia":
                force, moment = force + foot.inertial_force, moment + foot.inertial_moment
            forces.append(force)
            torques.append(moment + np.cross(place, force))
        return self._net(np.stack(forces, axis=1), np.stack(torques, axis=1))

    def _encoded(self, effects: Set[str]) -> list[tuple[Array, Array]]:
        """Sensor poses (K, 3) and (K, 3, 3) of both feet, by the pelvis's true pose and the encoders."""
        if self.encoders is None:
            raise TypeError("the sensor's pose does not come from encoders")
        angles = self.encoders.read(self.q[:, self.columns], set(self.encoders.effects()))
        q = self.q.copy()
        q[:, self.columns] = angles
        configurations, _ = to_pinocchio(q, np.zeros((len(q), self.pin_model.nv)))
        data = self.pin_model.createData()
        poses = [(np.empty((len(q), 3)), np.empty((len(q), 3, 3))) for _ in FEET]
        for row, configuration in enumerate(configurations):
            pin.forwardKinematics(self.pin_model, data, configuration)
            for frame, (place, rotation) in zip(self.frames, poses, strict=True):
                pose = pin.updateFramePlacement(self.pin_model, data, frame)
                place[row], rotation[row] = pose.translation, pose.rotation
        return poses


class ImuRig(Rig):
    """Gyroscope and accelerometer; a ZMP as of a point mass at the COM that accelerates as the IMU does."""

    def __init__(self, instrument: Imu, truth: Truth, key: str, felt: Inertial) -> None:
        channels = [(f"gyroscope_{axis}", "rad/s", instrument.gyroscope) for axis in "xyz"]
        channels += [(f"accelerometer_{axis}", "m/s^2", instrument.accelerometer) for axis in "xyz"]
        super().__init__(instrument, truth, key, channels)
        self.tilt, self.rotation = instrument.tilt, felt.rotation
        self.signals = np.concatenate([felt.angular_velocity, felt.specific_force], axis=1)
        self.lean = instrument.tilt * self.chain.streams.stream(_TILT_STREAM).uniform(-1.0, 1.0, 2)
        self.drawn = {
            f"{TILT}_{axis}": float(v) for axis, v in zip("xy", self.lean, strict=True) if instrument.tilt
        }

    def effects(self) -> tuple[str, ...]:
        """Effects that it has."""
        return (*self.chain.effects(), TILT) if self.tilt > 0.0 else self.chain.effects()

    def estimate(self, readings: Array, effects: Set[str]) -> Estimate:
        """See :class:`Rig`: COM and orientation are taken as known, but for the tilt."""
        rotation = self.rotation
        if TILT in effects:
            rotation = Rotation.from_rotvec([*self.lean, 0.0]).as_matrix() @ rotation
        truth = self.truth
        felt = np.einsum("kij,kj->ki", rotation, readings[:, 3:])
        least = truth.least / truth.mass
        vertical = np.where(felt[:, 2] >= least, felt[:, 2], np.nan)
        zmp = truth.com[:, :2] - truth.com[:, 2:] * felt[:, :2] / vertical[:, None]
        return Estimate(zmp, truth.mass * felt)


def make_rig(instrument: Instrument, record: SimulationRecord, key: str, body: Body) -> Rig:
    """Attach an instrument to a walk.

    Args:
        instrument: which.
        record: of the walk.
        key: of the run, for the draws.
        body: gives the compiled model and its description, if they are needed.

    Raises:
        InputError: the record lacks what the instrument needs.
    """
    truth = true_gait(record)
    if isinstance(instrument, ForcePlate):
        return PlateRig(instrument, truth, key)
    if isinstance(instrument, FootForceTorque):
        return FootRig(instrument, truth, key, record, body)
    if isinstance(instrument, Imu):
        felt = pelvis_motion(record) if instrument.mount == "pelvis" else chest_motion(record)
        return ImuRig(instrument, truth, key, felt)
    raise TypeError(f"{type(instrument).__name__} is no kind of instrument")
