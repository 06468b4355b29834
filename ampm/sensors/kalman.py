"""State of a walking body from joints, IMU and soles."""

import numpy as np
from numpy.typing import NDArray

from ampm.body.rigid_body import Link
from ampm.body.robot import Robot
from ampm.compiled import bound, records, refer, zeros_of
from ampm.geometry import Array
from ampm.parameters import RunParameters
from ampm.sensor_parameters import WRENCH
from ampm.sensors.filters import LEVER_ERROR, POINTS, Filter, Known, Layout, Read, turn_root, update
from ampm.sensors.readings import Readings
from ampm.sensors.soles import soles_of
from ampm.vectors import ZERO
from ampm.walk import State, Touch

_LEAST = (1e-5, 1e-3, 1e-3, 1e-5)  # standard deviations of angles, rates, gyro and fixes, in SI units
_START = np.repeat([1e-3, 5e-3, 5e-4, 2e-4, 1e-3], 3)
"""Standard deviation at the start, as after standing still: place [m], velocity [m/s], attitude [rad], biases
of gyro [rad/s] and accelerometer [m/s^2]."""
_WALK = np.repeat([0.0, 0.0, 0.0, 1e-4, 1e-4], 3)
"""Random walk of the same in a second; velocity and attitude get errors of the sensors instead."""
_ACCELERATION_ERROR = 0.02
"""Standard deviation of the acceleration at a tick from its mean over the tick [m/s^2]."""
_CREEP = (1.36e-3, 0.88e-3, 1e-3)
"""Random walk in a second of a point that bears a quarter of the weight, (3,) [m]."""
_ERRORS = {"root_linear": 0.0, "root_angular": 0.0, "legs": 0.6, "trunk": 0.1, "arms": 0.03}
_TOE_ERROR = 2.0
"""Least errors of commanded accelerations by group of hinges, about those of the presets [rad/s^2]."""
_NOT_COMMANDED = 30.0
"""The same with a controller that does not say its accelerations [rad/s^2]."""
_FIX_FACTOR = 5.0
"""By how much fixes count as less certain: feedback of the COM makes 6 mm of ZMP from 1 mm that a fix moves
the place, and they need only hold a drift of millimetres in a second."""


class Kalman:
    """Filters of hinges and root, and prediction over the delay of the readings.

    Args:
        robot: the body.
        run: how large the errors of the sensors are, footsteps, control frequency and time step.
        start: state at the start.

    Attributes:
        filter: state and covariance at the time of the last readings.
    """

    def __init__(self, robot: Robot, run: RunParameters, start: State) -> None:
        sensors, points = run.sensors, len(robot.point_frames)
        oldest = sensors.delay + (1.0 / sensors.rate if sensors.rate else 0.0)
        ticks = 2 + int(oldest * run.controller.frequency + 1.0)
        worn, moves = _hinges(robot, sensors.angle_bias > 0.0)
        imu = np.full(3 if sensors.imu_angle_bias else 0, sensors.imu_angle_bias)
        constant = np.append(np.full(len(worn), sensors.angle_bias), imu)
        wrenches = sensors.force_sensor == WRENCH
        spin = np.full(3 if wrenches and len(worn) else 0, robot.mass * robot.gravity)
        biases = np.repeat([0.0, 0.0, 0.0, sensors.gyro_bias, sensors.accelerometer_bias], 3)
        start_errors = np.concatenate([np.maximum(_START, biases), np.ones(3 * points), constant, spin])
        walk = np.concatenate([_WALK, np.tile(_CREEP, points), np.zeros(len(constant)), LEVER_ERROR * spin])
        size = len(walk)
        layout = Layout(
            worn=worn,
            moves=moves,
            offsets=POINTS + 3 * points,
            imu=size - len(spin) - 3 if len(imu) else 0,
            momentum=size - 3 if len(spin) else 0,
        )
        sizes = {"nq": robot.nq, "nv": robot.nv, "nu": robot.nu, "P": points, "X": size}
        sizes |= {"N": ticks, "N + 1": ticks + 1}
        self.filter = f = zeros_of(
            Filter,
            sizes,
            covariance=np.diag(start_errors**2),
            link=records(robot.model.njoints - 1, Link),
            soles=soles_of(robot, run),
            read=zeros_of(Read, sizes),
            layout=layout,
            known=_known(robot, run, walk, start.velocity_lag),
        )
        self._q, self._v, self._none = np.array(start.q), np.array(start.v), np.zeros(robot.nv)
        handle = refer(f)
        self._update = bound(update, (handle,), self._none, 0.0, 0.0, True, self._q, self._v)
        self._turn_root = bound(turn_root, (handle,), ZERO)
        self._constant = np.r_[9:15, layout.offsets : size - len(spin)]
        self._start = start_errors**2
        self._threshold = sensors.contact_threshold
        self._hinge = max(1e-8, sensors.angle_bias**2), 0.0, 1e-4
        self.begin(start)

    def begin(self, start: State) -> None:
        """Go on from a state as known as the first one, with what was found of the sensors."""
        f = self.filter
        f.q[:], f.rate[:], f.joint_rate[:] = start.q, start.v[3:6], start.v[6:]
        f.joint_covariance[:], f.rate_variance[:] = self._hinge, 1e-4
        f.rate_error[:], f.angle_error[:] = 0.0, 0.0
        self._turn_root(ZERO)
        f.x[0:3], f.x[3:6] = start.q[:3], f.turn @ start.v[:3]
        kept, found = np.diag(self._start), np.ix_(self._constant, self._constant)
        kept[found] = f.covariance[found]
        f.covariance[:] = kept
        f.loaded[:], f.touched[:] = False, True
        f.commanded[:], f.begin[:], f.read.time[0] = 0.0, start.time, start.time

    def update(self, readings: Readings, commanded: Array | None) -> tuple[State, Touch]:
        """See :class:`~ampm.sensors.readings.Estimator`."""
        f, now, age, fix = self.filter, readings.time, readings.age, readings.position
        if commanded is None:
            commanded = self._none
            if now > f.begin[-1]:
                f.known.joint_error[:] = _NOT_COMMANDED
        read, soles = f.read, f.soles
        read.angles[:], read.rates[:], read.gyro[:] = readings.angles, readings.rates, readings.gyro
        read.accelerometer[:] = readings.accelerometer
        soles.force[:], soles.contact[:] = readings.force, readings.contact
        if readings.wrench is not None:
            soles.wrench[:] = readings.wrench
        if fix is not None:
            read.position[:] = fix
        self._update(commanded, now, age, fix is not None, self._q, self._v)
        touch = Touch(soles.contact.copy(), soles.force.copy(), 2.0 * f.known.lag + age, self._threshold)
        return State(now, self._q.copy(), self._v.copy(), f.known.lag), touch  # which a user's class may keep


def _known(robot: Robot, run: RunParameters, walk: Array, lag: float) -> Known:
    """What is known of body, floor and sensors; ``walk`` is the random walk of x in a second."""
    sensors, frequency = run.sensors, run.controller.frequency
    read = sensors.angle_noise, sensors.rate_noise, sensors.gyro_noise, sensors.fix_noise
    variance = np.maximum(read, _LEAST) ** 2
    variance[3] *= _FIX_FACTOR**2
    growth = walk**2 / frequency
    growth[9:15] += np.repeat([sensors.gyro_drift, sensors.accelerometer_drift], 3) ** 2 / frequency
    growth[3:6] = (_ACCELERATION_ERROR**2 + sensors.accelerometer_noise**2) / frequency**2
    growth[6:9] = variance[2] / frequency**2
    commanded = robot.by_group(_ERRORS)
    commanded[robot.toe_joints] = _TOE_ERROR
    return Known(
        tree=robot.rigid_body.tree,
        armature=robot.rigid_body.armature,
        weight=robot.mass * robot.gravity,
        gravity=robot.gravity,
        levels=np.array(sorted({step.z for step in run.footsteps}) or [0.0]),
        slope=np.array(run.gait.slopes),
        wrenches=sensors.force_sensor == WRENCH,
        joint_error=commanded[6:],
        variance=variance,
        growth=growth,
        lag=lag,
    )


def _hinges(robot: Robot, worn: bool) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Hinges between root and soles whose encoders are worn, (H,); whether they move each point, (P, H)."""
    model = robot.model
    joints = [set(model.supports[model.frames[frame].parentJoint]) for frame in robot.point_frames]
    hinges = sorted(set().union(*joints) - {0, 1}) if worn else []
    moves = np.array([[joint in support for joint in hinges] for support in joints], dtype=bool)
    return np.array(hinges, dtype=np.intp) - 2, moves
