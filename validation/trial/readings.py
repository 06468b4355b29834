"""Sensors of the simulated body: true values of the log, with delay, noise and bias."""

import math
from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from ampm.body.robot import Robot
from ampm.compiled import bound, compiled
from ampm.geometry import Array
from ampm.parameters import RunParameters
from ampm.sensors.readings import Estimator, EstimatorFactory, Readings
from ampm.vectors import from_quaternion, minus, plus, times, turned, vector
from ampm.walk import State, Touch
from validation.trial.bridge import to_pinocchio
from validation.trial.log import RunLog, StepLog
from validation.trial.users import ESTIMATOR, UsersCode

_HINGES = 6  # velocities of the free root come first
_DRAWN = 64  # ticks whose noise is drawn at once


@compiled
def read_true(log: StepLog, gravity: float, time_step: float, i: int, values: Array) -> None:
    """Add the true readings of step i to values: angles, rates, gyro, accelerometer, normal forces.

    The acceleration is the mean of a tick before the step, and forces are those of the step before.
    """
    q, v, hinges, points = log.record.q, log.record.qd, log.record.torque.shape[1], log.record.point_force
    turn = np.empty((3, 3))
    for j in range(hinges):
        values[j] += q[i, 7 + j]
        values[hinges + j] += v[i, 6 + j]
    for axis in range(3):
        values[2 * hinges + axis] += v[i, 3 + axis]
    first = max(i - log.substeps, 0)
    for k in range(first, max(i, 1)):
        push = 0.0, 0.0, gravity
        if i:
            change = minus(vector(v[k + 1]), vector(v[k]))
            push = plus(push, times(1.0 / time_step, change))
        from_quaternion(q[k, 4], q[k, 5], q[k, 6], q[k, 3], turn)
        push = turned(turn.T, push)
        for axis in range(3):
            values[2 * hinges + 3 + axis] += push[axis] / (max(i, 1) - first)
    if i:
        for p in range(points.shape[1]):
            values[2 * hinges + 6 + p] += points[i - 1, p, 2]


class Sensors:
    """From the simulated body to the state that a controller gets.

    Args:
        run: its section ``sensors``.
        log: of the walk.
        gravity: [m/s^2].
        estimator: that makes the state; None for the true state, but for what is read.
    """

    def __init__(self, run: RunParameters, log: RunLog, gravity: float, estimator: Estimator | None) -> None:
        self._estimator, self._users_code = estimator, UsersCode("estimator", estimator)
        self.parameters = sensors = run.sensors
        self._time_step = run.simulation.time_step
        self._late = sensors.steps_late(self._time_step)
        self._steps_per_fix = log.substeps * sensors.ticks_per_fix(run.controller.frequency)
        hinges, points = log.record.torque.shape[1], log.record.point_force.shape[1]
        sizes = {"angle": hinges, "rate": hinges, "gyro": 3, "accelerometer": 3, "force": points}
        ends = np.cumsum([0, *sizes.values()]).tolist()
        self._parts = [slice(start, end) for start, end in pairwise(ends)]

        def spread(kind: str) -> Array:
            values = [np.full(size, getattr(sensors, f"{name}_{kind}")) for name, size in sizes.items()]
            return np.concatenate(values)

        noise, signs = spread("noise"), np.random.default_rng([sensors.seed, 3])
        self._bias = spread("bias") * signs.choice([-1.0, 1.0], noise.size)
        self._noise = self._drawn(noise, np.random.default_rng([sensors.seed, 0]))
        self._fixes = np.random.default_rng([sensors.seed, 4])
        self._true = bound(read_true, (), log.handle, gravity, self._time_step, 0, noise)
        self._gravity = gravity

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
        return max(k - self._late, 0)

    def read(self, log: RunLog, k: int) -> Readings:
        """Readings for the control tick of step k, from the true values of the log."""
        i, values = self.sampled(k), self._bias.copy()
        self._true(log.handle, self._gravity, self._time_step, i, values)
        values += next(self._noise)
        angles, rates, gyro, accelerometer, force = [values[part] for part in self._parts]
        position = None
        if self._steps_per_fix and k % self._steps_per_fix == 0:
            position = log.record.q[i, :3] + self.parameters.fix_noise * self._fixes.standard_normal(3)
        return Readings(
            time=k * self._time_step,
            age=(k - i) * self._time_step,
            angles=angles,
            rates=rates,
            gyro=gyro,
            accelerometer=accelerometer,
            force=np.maximum(force, 0.0, out=force),
            contact=log.record.point_penetration[i] > 0.0 if i < k else log.touching.copy(),
            position=position,
        )

    def update(self, log: RunLog, k: int, commanded: Array | None) -> tuple[State, Touch]:
        """State and touch for the control tick of step k.

        Args:
            log: keeps the true values.
            k: step.
            commanded: accelerations of the last tick, see :class:`~ampm.sensors.readings.Estimator`.
        """
        readings = self.read(log, k)
        if self._estimator is None:
            return self._state(log, k, readings)
        with self._users_code:
            match self._estimator.update(readings, commanded):
                case (State() as state, Touch() as touch):
                    pass
                case _:
                    raise TypeError("it returned no State with a Touch")
            for name, size in (("q", log.record.q.shape[1]), ("v", log.record.qd.shape[1])):
                value = np.asarray(getattr(state, name), dtype=np.float64)
                if value.shape != (size,) or not math.isfinite(value @ value):
                    raise ValueError(f"'{name}' of its state must be {size} finite numbers")
        return state, touch

    def _state(self, log: RunLog, k: int, readings: Readings) -> tuple[State, Touch]:
        """The true state of the root, and the rest as read; of their delay nothing is known."""
        i = self.sampled(k)
        q, v = to_pinocchio(log.record.q[i], log.record.qd[i])
        q[_HINGES + 1 :], v[_HINGES:], v[3:_HINGES] = readings.angles, readings.rates, readings.gyro
        touch = Touch(readings.contact, readings.force, self._time_step)
        return State(readings.time, q, v, 0.5 * self._time_step), touch


def make_estimator(
    run: RunParameters, robot: Robot, start: State, factory: EstimatorFactory | None = None
) -> Estimator | None:
    """The estimator of a walk; None for ``exact``.

    Args:
        run: its section ``sensors``.
        robot: the body, as the estimator knows it.
        start: state in which the walk is planned to start.
        factory: makes it; the one that the run names by default.

    Raises:
        InputError: there is none, or it cannot be made.
    """
    factory = factory or ESTIMATOR.find(run.sensors.estimator, run.sensors.options)
    if factory is None:
        return None
    informed = run.undisturbed.model_copy(update={"sensors": run.sensors.known})
    with UsersCode("estimator", factory):
        return factory(robot, informed, start, **run.sensors.options)
