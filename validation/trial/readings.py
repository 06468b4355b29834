"""Sensors of the simulated body: true values of the log, with delay, noise and bias."""

import math
from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ampm.body.robot import Robot
from ampm.compiled import bound, compiled
from ampm.exceptions import SolverError
from ampm.geometry import Array
from ampm.parameters import RunParameters
from ampm.sensor_parameters import WRENCH
from ampm.sensors.readings import Estimator, Readings
from ampm.sensors.soles import SoleForces
from ampm.vectors import cross, from_quaternion, minus, plus, times, turned, vector
from ampm.walk import State, Touch
from validation.trial.coordinates import to_pinocchio
from validation.trial.log import RunLog, StepLog
from validation.trial.plan import Body
from validation.trial.users import ESTIMATOR, UsersCode, real_numbers
from validation.trial.watch import BLOW_UP

_HINGES = 6  # velocities of the free root come first
_DRAWN = 64  # ticks whose noise is drawn at once
_UNIT = 1e-3  # largest error of the norm of a quaternion [1]


@compiled
def read_true(
    log: StepLog, gravity: float, time_step: float, i: int, first: int, wrenches: bool, values: Array
) -> None:
    """Add the true readings of step i to values: angles, rates, gyro, accelerometer, forces.

    The acceleration is the mean since the step ``first``, and forces are those of the step before: of sole
    points, or with wrenches of the feet, and then their moments, in world axes.
    """
    record = log.record
    q, v, points, hinges = record.q, record.qd, record.point_force, record.tick_torque.shape[1]
    turn = np.empty((3, 3))
    for j in range(hinges):
        values[j] += q[i, 7 + j]
        values[hinges + j] += v[i, 6 + j]
    for axis in range(3):
        values[2 * hinges + axis] += v[i, 3 + axis]
    for k in range(first, max(i, 1)):
        push = 0.0, 0.0, gravity
        if i:
            change = minus(vector(v[k + 1]), vector(v[k]))
            push = plus(push, times(1.0 / time_step, change))
        from_quaternion(q[k, 4], q[k, 5], q[k, 6], q[k, 3], turn)
        push = turned(turn.T, push)
        for axis in range(3):
            values[2 * hinges + 3 + axis] += push[axis] / (max(i, 1) - first)
    if i and wrenches:
        for p in range(points.shape[1]):
            foot = 2 * p // points.shape[1]
            sole, at = vector(record.foot_position[i - 1, foot]), vector(record.point_position[i - 1, p])
            force, moments = vector(points[i - 1, p]), values[2 * hinges + 12 :]
            moment = cross(minus(at, sole), force)
            for axis in range(3):
                values[2 * hinges + 6 + 3 * foot + axis] += force[axis]
                moments[3 * foot + axis] += moment[axis]
    elif i:
        for p in range(points.shape[1]):
            values[2 * hinges + 6 + p] += points[i - 1, p, 2]


class DivergedEstimate(SolverError):
    """An estimator of the project has lost the body."""


class Sensors:
    """From the simulated body to the state that a controller gets, made by the estimator.

    Without one it is the true state of the root, with joints, gyro and contacts as they are read.
    """

    def __init__(self, run: RunParameters, log: RunLog, estimator: Estimator | None) -> None:
        self._log, self._estimator = log, estimator
        self._users_code = UsersCode("estimator", estimator, walking=True)
        self.parameters = sensors = run.sensors
        self._time_step = dt = run.simulation.time_step
        self._late, self._apart = run.count("sensors.delay"), run.count("sensors.rate")
        self._span = max(log.substeps, self._apart)  # of the mean acceleration
        self._steps_per_fix = log.substeps * run.count("sensors.fix_rate")
        hinges, points = log.physics.robot.nu, log.record.point_force.shape[1]
        self._wrenches = sensors.force_sensor == WRENCH
        forces = {"force": 6, "moment": 6} if self._wrenches else {"force": points}
        sizes = {"angle": hinges, "rate": hinges, "gyro": 3, "accelerometer": 3} | forces
        self._parts = [slice(*ends) for ends in pairwise(np.cumsum([0, *sizes.values()]).tolist())]

        def spread(kind: str) -> Array:
            values = [getattr(sensors, f"{name}_{kind}", 0.0) for name in sizes]
            return np.repeat(values, list(sizes.values()))

        noise, random = spread("noise"), np.random.default_rng([sensors.seed, 3])
        self._bias = spread("bias") * random.choice([-1.0, 1.0], noise.size)
        scale = random.choice([-1.0, 1.0], 2 if self._wrenches else points)
        scale = np.tile(scale.repeat(3), 2) if self._wrenches else scale  # forces, then moments
        self._scale = 1.0 + sensors.force_scale_bias * scale
        self._imu = pin.exp3(sensors.imu_angle_bias * random.choice([-1.0, 1.0], 3)).T  # from the root's axes
        self._distorted = self._wrenches or sensors.force_scale_bias or sensors.imu_angle_bias
        self._noise = self._drawn(noise, np.random.default_rng([sensors.seed, 0]))
        drift = spread("drift")
        self._drift = self._drawn(drift, np.random.default_rng([sensors.seed, 5])) if drift.any() else None
        self._fixes = np.random.default_rng([sensors.seed, 4])
        self._robot = log.physics.robot
        self._true = bound(read_true, (), log.handle, self._robot.gravity, dt, 0, 0, True, noise)
        self._soles = SoleForces(self._robot, run) if self._wrenches else None
        self._held: tuple[int, Array] = -1, noise  # step and values of the last readings
        self._closed = np.zeros(points, dtype=bool)

    @staticmethod
    def _drawn(noise: Array, random: np.random.Generator) -> Iterator[Array]:
        """Errors of one tick after the other; drawn for many at once, as every call takes its time."""
        noisy = np.flatnonzero(noise)
        while True:
            errors = np.zeros((_DRAWN, noise.size))
            errors[:, noisy] = noise[noisy] * random.standard_normal((_DRAWN, noisy.size))
            yield from errors

    def sampled(self, k: int) -> int:
        """Step at whose begin the readings of step k were sampled."""
        i = max(k - self._late, 0)
        return i - i % self._apart if self._apart else i

    def read(self, k: int) -> Readings:
        """Readings for the control tick of step k, from the true values of the log."""
        i = self.sampled(k)
        if not self._apart or i != self._held[0]:
            self._held = i, self._sampled(i)
        values = self._held[1].copy()  # an estimator may write
        angles, rates, gyro, accelerometer, force, *moment = [values[part] for part in self._parts]
        position = None
        if self._steps_per_fix and k % self._steps_per_fix == 0:
            position = self._log.record.q[i, :3] + self.parameters.fix_noise * self._fixes.standard_normal(3)
        return Readings(
            time=k * self._time_step,
            age=(k - i) * self._time_step,
            angles=angles,
            rates=rates,
            gyro=gyro,
            accelerometer=accelerometer,
            force=np.zeros(len(self._closed)) if moment else np.maximum(force, 0.0, out=force),
            contact=self._switches(i, k, force),
            position=position,
            wrench=np.hstack([force.reshape(2, 3), moment[0].reshape(2, 3)]) if moment else None,
        )

    def _sampled(self, i: int) -> Array:
        """All numbers that are read at the begin of step i, one part after the other."""
        values, first = self._bias.copy(), max(i - self._span, 0)
        self._true(self._log.handle, self._robot.gravity, self._time_step, i, first, self._wrenches, values)
        if self._distorted:
            values = self._bias + self._distort(i, values - self._bias)
        values += next(self._noise)
        if self._drift is not None:
            steps = i - max(self._held[0], 0)
            self._bias += math.sqrt(steps * self._time_step) * next(self._drift)
        if step := self.parameters.angle_resolution:
            angles = values[self._parts[0]]
            angles[:] = step * np.rint(angles / step)
        return values

    def _distort(self, i: int, values: Array) -> Array:
        """True values of step i as sensors that are turned, or of another scale, read them."""
        for part in self._parts[2:4]:
            values[part] = self._imu @ values[part]
        if self._wrenches:
            body = self._robot.rigid_body
            body.place(to_pinocchio(self._log.record.q[max(i - 1, 0)], self._log.record.qd[0])[0])
            turns = body.places(body.soles)[1]
            for part in self._parts[4:]:
                values[part] = np.einsum("fij,fi->fj", turns, values[part].reshape(2, 3)).ravel()
        values[self._parts[4].start :] *= self._scale
        return values

    def _switches(self, i: int, k: int, force: Array) -> NDArray[np.bool_]:
        """Which sole points touch at step k, by the readings of step i; none with wrenches."""
        if self._wrenches:
            return np.zeros(len(self._closed), dtype=bool)
        if least := self.parameters.contact_threshold:
            self._closed = force > np.where(self._closed, 0.5, 1.0) * least
            return self._closed
        return self._log.record.point_penetration[i] > 0.0 if i < k else self._log.touching.copy()

    def update(self, k: int, commanded: Array | None) -> tuple[State, Touch]:
        """State and touch for the control tick of step k, by the true values of the log.

        The accelerations commanded at the last tick are those of :class:`~ampm.sensors.readings.Estimator`.
        """
        readings = self.read(k)
        if self._estimator is None:
            return self._state(k, readings)
        with self._users_code:
            match self._estimator.update(readings, commanded):
                case (State() as state, Touch() as touch):
                    pass
                case _:
                    raise TypeError("it must return a State and a Touch")
            if (name := self.parameters.estimator) in ESTIMATOR.known and not (
                np.linalg.norm(state.v[:3]) <= BLOW_UP and math.isfinite(state.q.sum() + state.v.sum())
            ):
                raise DivergedEstimate(f"the estimate of {name} diverged")
            _check(state, touch, self._robot, readings)
        return state, touch

    def _state(self, k: int, readings: Readings) -> tuple[State, Touch]:
        """The true state of the root, and the rest as read; the state does not tell their delay."""
        i = self.sampled(k)
        q, v = to_pinocchio(self._log.record.q[i], self._log.record.qd[i])
        q[_HINGES + 1 :], v[_HINGES:], v[3:_HINGES] = readings.angles, readings.rates, readings.gyro
        contact, force = readings.contact, readings.force
        if self._soles is not None and readings.wrench is not None:
            force, contact = self._soles.update(q, readings.wrench)
        touch = Touch(contact, force, self._time_step, self.parameters.contact_threshold)
        return State(readings.time, q, v, 0.5 * self._time_step), touch


def _check(state: State, touch: Touch, robot: Robot, readings: Readings) -> None:
    """Refuse what no controller can use, with the name of its field."""
    shapes = {"q": (robot.nq,), "v": (robot.nv,)}
    shapes |= dict.fromkeys(("contact", "normal_force"), robot.point_group.shape)
    for what, values in (("state", state._asdict()), ("touch", touch._asdict())):
        for name, value in values.items():
            real_numbers(f"'{name}' of its {what}", value, shapes.get(name, ()), finite=True)
            if name in ("velocity_lag", "age", "threshold") and value < 0.0:
                raise ValueError(f"'{name}' of its {what} is {value:g} and must be at least 0")
    if not abs(norm := float(np.linalg.norm(state.q[3:7])) - 1.0) < _UNIT:
        raise ValueError(f"'q' of its state has a quaternion of norm {1.0 + norm:.3g} and not 1")
    if not readings.time - readings.age - 1e-6 <= state.time <= readings.time + 1e-6:
        raise ValueError(f"'time' of its state is {state.time:g} s, and that of the tick {readings.time:g} s")


def make_estimator(run: RunParameters, body: Body, start: State) -> Estimator | None:
    """The estimator of a walk that is planned to start in a state; None for ``exact``.

    Raises :class:`InputError` if there is none that the run names, or it cannot be made.
    """
    factory = ESTIMATOR.find(*ESTIMATOR.named(run))
    if factory is None:
        return None
    informed = run.undisturbed.model_copy(update={"sensors": run.sensors.known})
    with UsersCode("estimator", factory):
        return factory(body.own_robot(), informed, start, **run.sensors.options)
