"""State of a walking body from joints, IMU and soles."""

import numpy as np

from ampm.body.rigid_body import LINK, frames_of, tree_of
from ampm.body.robot import Robot
from ampm.compiled import bound, records, refer
from ampm.parameters import RunParameters
from ampm.sensors.filters import POINTS, Filter, update
from ampm.sensors.readings import Readings
from ampm.vectors import Array, from_quaternion
from ampm.walk import State, Touch

_LEAST = (1e-5, 1e-3, 1e-3, 1e-5)  # standard deviations of angles, rates, gyro and fixes, in SI units
_START = np.repeat([1e-3, 5e-3, 5e-4, 2e-4, 1e-2], 3)
"""Standard deviation at the start, as after standing still: place [m], velocity [m/s], attitude [rad], biases
of gyro [rad/s] and accelerometer [m/s^2]."""
_ERRORS = {"root_linear": 0.0, "root_angular": 0.0, "legs": 2.0, "trunk": 0.3, "arms": 0.1}
_TOE_ERROR = 6.0
"""Errors of commanded accelerations by group of hinges [rad/s^2], three times those of the presets."""
_NOT_COMMANDED = 30.0
"""The same with a controller that does not say its accelerations [rad/s^2]."""


class Kalman:
    """Filters of hinges and root, and prediction over the delay of the readings.

    Args:
        robot: the body.
        run: standard deviations of the sensors, footsteps, control frequency and time step.
        start: state at the start.

    Attributes:
        filter: state and covariance at the time of the last readings.
    """

    def __init__(self, robot: Robot, run: RunParameters, start: State) -> None:
        sensors, nu, points = run.sensors, robot.nu, len(robot.point_frames)
        read = sensors.angle_noise, sensors.rate_noise, sensors.gyro_noise, sensors.fix_noise
        ticks = 2 + int(sensors.delay * run.controller.frequency + 1.0)
        errors = robot.by_group(_ERRORS)
        errors[robot.toe_joints] = _TOE_ERROR
        self.filter = f = Filter(
            q=np.array(start.q),
            joint_rate=np.array(start.v[6:]),
            velocity=np.zeros(3),
            rate=np.array(start.v[3:6]),
            gyro_bias=np.zeros(3),
            accelerometer_bias=np.zeros(3),
            place=np.zeros((points, 3)),
            loaded=np.zeros(points, dtype=bool),
            touched=np.ones(points, dtype=bool),
            quiet=np.zeros(1),
            joint_covariance=np.tile([1e-8, 0.0, 1e-4], (nu, 1)),
            rate_variance=np.full(1, 1e-4),
            covariance=np.diag(np.append(_START**2, np.ones(3 * points))),
            change=np.zeros(POINTS + 3 * points),
            turn=np.zeros((3, 3)),
            tree=tree_of(robot.model),
            link=records(robot.model.njoints - 1, LINK),
            points=frames_of(robot.model, robot.point_frames),
            joint_error=errors[6:],
            variance=np.maximum(read, _LEAST) ** 2,
            levels=np.array(sorted({step.z for step in run.footsteps}) or [0.0]),
            angles=np.zeros(nu),
            rates=np.zeros(nu),
            gyro=np.zeros(3),
            accelerometer=np.zeros(3),
            force=np.zeros(points),
            contact=np.zeros(points, dtype=bool),
            position=np.zeros(3),
            commanded=np.zeros((ticks, robot.nv)),
            begin=np.full(ticks + 1, start.time),
            weight=robot.mass * robot.gravity,
            gravity=robot.gravity,
            lag=start.velocity_lag,
        )
        from_quaternion(start.q[3], start.q[4], start.q[5], start.q[6], f.turn)
        f.velocity[:] = f.turn @ start.v[:3]
        self._q, self._v = np.array(start.q), np.array(start.v)
        self._update = bound(update, (refer(f),), 0.0, 0.0, 0.0, True, self._q, self._v)
        self._read = start.time

    def update(self, readings: Readings, commanded: Array | None) -> tuple[State, Touch]:
        """See :class:`~ampm.sensors.readings.Estimator`."""
        f, now, age = self.filter, readings.time, readings.age
        f.commanded[:-1], f.begin[:-1] = f.commanded[1:], f.begin[1:]
        f.commanded[-1], f.begin[-1] = 0.0 if commanded is None else commanded, now
        if commanded is None and now > f.begin[-2]:
            f.joint_error[:], f.quiet[0] = _NOT_COMMANDED, 0.0
        f.angles[:], f.rates[:], f.gyro[:] = readings.angles, readings.rates, readings.gyro
        f.accelerometer[:] = readings.accelerometer
        f.force[:], f.contact[:] = readings.force, readings.contact
        has_fix = readings.position is not None
        if has_fix:
            f.position[:] = readings.position
        self._update(self._read, now, age, has_fix, self._q, self._v)
        self._read = now - age
        touch = Touch(readings.contact, readings.force, 2.0 * f.lag + age)
        return State(now, self._q, self._v, f.lag), touch
