"""Sensors and estimator between the simulated body and its controller."""

from dataclasses import replace
from functools import cache
from typing import ClassVar

import numpy as np
import pinocchio as pin
import pytest

import validation as val
from ampm.control.controller import TrackingController
from ampm.run_file import load_run
from ampm.sensors.filters import ACCELEROMETER, GYRO, TURN, VELOCITY
from ampm.sensors.kalman import Kalman
from ampm.walk import State, Touch
from tests.records import first_difference
from tests.solved import simulated
from validation.judge.compare import _from_standing_foot
from validation.judge.profiles import own_profile
from validation.study.sweep.design import parse_sweep
from validation.study.walk_options import users_classes
from validation.trial.bridge import to_pinocchio
from validation.trial.readings import Sensors

NOISE = {
    "angle_noise": 1e-4,
    "rate_noise": 0.01,
    "gyro_noise": 5e-3,
    "accelerometer_noise": 0.05,
    "force_noise": 2.0,
    "delay": 0.001,
}
FINE = ("simulation.time_step=0.0005", "sensors.delay=0.001")
GRAVITY = np.array([0.0, 0.0, 9.81])


class Naive:
    """True root of the start, joints as read."""

    def __init__(self, robot, run, start):
        self.start, self.run = start, run

    def update(self, readings, commanded):
        q, v = self.start.q.copy(), self.start.v.copy()
        q[7:], v[6:] = readings.angles, readings.rates
        return State(readings.time, q, v), Touch(readings.contact, readings.force)


class Wrong(Naive):
    """Returns no touch."""

    def update(self, readings, commanded):
        return super().update(readings, commanded)[0], None


class Short(Naive):
    """Lacks velocities."""

    def update(self, readings, commanded):
        state, touch = super().update(readings, commanded)
        return state._replace(v=state.v[:5]), touch


class Mine(Kalman):
    """Ours, which is kept with what it was told."""

    made: ClassVar[list] = []

    def __init__(self, robot, run, start):
        super().__init__(robot, run, start)
        self.run = run
        self.made.append(self)


class Tuned(Kalman):
    """Ours with an option that is needed."""

    def __init__(self, robot, run, start, gain):
        super().__init__(robot, run, start)


@cache
def read(*settings):
    """Record of a walk, and the readings of every tick."""
    readings, plain = [], Sensors.read

    def kept(self, log, k):
        readings.append(plain(self, log, k))
        return readings[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Sensors, "read", kept)
        return simulated(*settings), readings


@cache
def walked(**sensors):
    """Trial of ten steps of `normal`."""
    return val.walk(load_run("normal", gait={"steps": 10}, simulation={"time_step": 1e-3}, sensors=sensors))


def relative(**sensors):
    """ZMP RMSE from the standing foot, x and y [mm]."""
    metrics = walked(**sensors).metrics
    return np.array([1e3 * metrics[f"zmp_foot_{axis}_rmse"].value for axis in "xy"])


def test_readings_integrate_to_the_true_motion():
    record, readings = read(*FINE)
    late, tick = 2, record.substeps
    rows = np.maximum(np.arange(len(readings)) * tick - late, 0)
    q, v = to_pinocchio(record.q[rows], record.qd[rows])
    angles, rates, gyro, push = (
        np.array([getattr(item, name) for item in readings])
        for name in ("angles", "rates", "gyro", "accelerometer")
    )
    np.testing.assert_array_equal(angles, q[:, 7:])
    period = np.diff(rows) * record.time_step
    mean = 0.5 * (rates[1:] + rates[:-1]) + 0.25 * record.time_step * np.diff(rates, axis=0) / period[:, None]
    moved = np.cumsum(mean * period[:, None], axis=0)
    assert np.abs(angles[0] + moved - angles[1:]).max() < 2e-3
    turn = pin.Quaternion(q[0, 3:7]).matrix()
    velocity, worst = turn @ v[0, :3], np.zeros(2)
    for n, span in enumerate(period):
        half = pin.exp3(0.25 * span * (gyro[n] + gyro[n + 1]))
        velocity = velocity + span * (turn @ half @ push[n + 1] - GRAVITY)
        turn = turn @ half @ half
        true = pin.Quaternion(q[n + 1, 3:7]).matrix()
        off = np.linalg.norm(pin.log3(turn @ true.T)), np.linalg.norm(velocity - true @ v[n + 1, :3])
        worst = np.maximum(worst, off)
    assert worst[0] < 1e-3  # [rad]
    assert worst[1] < 1e-2  # [m/s]


def test_readings_are_those_of_the_delayed_step_with_the_noise_and_bias_asked_for():
    record, readings = read(*FINE, "sensors.rate_noise=0.02", "sensors.force_bias=3.0", "sensors.fix_rate=50")
    rows = np.arange(1, len(readings)) * record.substeps - 2
    later = readings[1:]
    off = np.array([item.rates for item in later]) - record.qd[rows, 6:]
    assert off.std() == pytest.approx(0.02, rel=0.02)
    assert abs(off.mean()) < 1e-3
    force = np.array([item.force for item in later])
    loaded = record.point_force[rows - 1, :, 2] > 3.0
    bias = (force - record.point_force[rows - 1, :, 2])[loaded]
    np.testing.assert_allclose(np.abs(bias), 3.0)
    assert force.min() == 0.0
    np.testing.assert_array_equal([item.contact for item in later], record.point_penetration[rows] > 0.0)
    assert {item.age for item in later} == {0.001}
    fixed = [item.position is not None for item in readings]
    assert fixed == [n % 10 == 0 for n in range(len(readings))]


def test_without_errors_of_sensors_a_walk_keeps_its_bits():
    plain = simulated()
    assert first_difference(plain, simulated("sensors.seed=3", "sensors.fix_rate=100")) is None
    noisy = "sensors.angle_noise=1e-4"
    one, same, other = (simulated(noisy, f"sensors.seed={seed}", steps=1) for seed in (0, 0, 1))
    assert first_difference(one, same) is None
    assert (one.q != other.q).any()


def test_a_late_controller_gets_the_true_state_of_before():
    class Spy(TrackingController):
        states: list = []

        def update(self, state, touch, reference):
            self.states.append((state.q.copy(), state.v.copy(), touch.contact.copy()))
            return super().update(state, touch, reference)

    record = simulated("sensors.delay=0.004", controller=Spy, steps=1)
    rows = np.maximum(np.arange(len(Spy.states)) - 2, 0)
    q, v = to_pinocchio(record.q[rows], record.qd[rows])
    for n, (state_q, state_v, contact) in enumerate(Spy.states):
        np.testing.assert_allclose(state_q, q[n], atol=1e-14)
        np.testing.assert_allclose(state_v, v[n], atol=1e-14)
        if n > 2:
            np.testing.assert_array_equal(contact, record.point_penetration[rows[n]] > 0.0)


def test_the_filter_is_consistent(monkeypatch):
    """Normalised squared errors of velocity and attitude, six numbers, by the filter's own covariance."""
    found, plain = [], Kalman.update

    def kept(self, readings, commanded):
        result = plain(self, readings, commanded)
        f, rows = self.filter, np.r_[VELOCITY:GYRO]
        covariance = f.covariance[np.ix_(rows, rows)].copy()
        found.append((readings, f.x[VELOCITY:TURN].copy(), f.turn.copy(), covariance))
        return result

    monkeypatch.setattr(Kalman, "update", kept)
    nees = []
    for seed in range(2):
        found.clear()
        record = walked(estimator="kalman", seed=seed, **NOISE).record
        for readings, velocity, turn, covariance in found[300:]:
            row = round((readings.time - readings.age) / record.time_step)
            q, v = to_pinocchio(record.q[row], record.qd[row])
            true = pin.Quaternion(q[3:7]).matrix()
            error = np.concatenate([true @ v[:3] - velocity, pin.log3(true @ turn.T)])
            nees.append(error @ np.linalg.solve(covariance, error))
            assert np.linalg.eigvalsh(covariance).min() > 0.0
    assert 2.0 < np.mean(nees) < 12.0  # 6 of an exact model
    assert np.quantile(nees, 0.95) < 30.0


def test_a_known_delay_costs_at_most_half_a_millimetre():
    now, late = relative(estimator="kalman"), relative(estimator="kalman", delay=0.002)
    assert np.abs(late - now).max() < 0.5
    assert (relative(delay=0.002) > late + np.array([1.0, 0.5])).all()  # the same delay, unknown


def test_an_estimated_walk_keeps_its_place_relative_to_the_foot_and_with_fixes_in_the_world():
    trial = walked(estimator="kalman", **NOISE)
    assert trial.verdict.profile == "odometry"
    assert trial.verdict.passed, trial.verdict.reason
    assert "zmp_x_rmse" not in {item.name for item in trial.verdict.judged}
    assert (relative(estimator="kalman", **NOISE) < [3.5, 2.0]).all()
    assert 0.2e-3 < trial.metrics["drift_per_step"].value < 1.5e-3
    fixed = walked(estimator="kalman", fix_rate=100, **NOISE)
    assert fixed.verdict.profile == "default"
    assert fixed.metrics["drift_per_step"].value < 0.1e-3
    assert fixed.metrics["zmp_x_rmse"].value < 0.6 * trial.metrics["zmp_x_rmse"].value


def test_biases_of_the_imu_are_found():
    sensors = {"estimator": "tests.test_sensors:Mine", "gyro_bias": 1e-3, "seed": 1, **NOISE}
    walked(**sensors)
    from tests.test_sensors import Mine as Loaded

    found = Loaded.made[-1].filter.x[GYRO:ACCELEROMETER]
    assert np.abs(np.abs(found[:2]) - 1e-3).max() < 0.7e-3


def test_the_zmp_from_the_standing_foot_does_not_depend_on_where_the_walk_is():
    comparison = walked().comparison
    sample, measured, record = comparison.sample, comparison.measured, comparison.record
    feet, forward = comparison.planned.feet, record.foot_forward[:-1]
    here, wanted = _from_standing_foot(comparison.planned, measured, forward)
    turn = pin.utils.rotate("z", 0.3)

    moved = replace(
        measured,
        zmp=measured.zmp @ turn[:2, :2].T + [5.0, -3.0],
        foot_position=measured.foot_position @ turn.T + [5.0, -3.0, 0.0],
    )
    there, same = _from_standing_foot(comparison.planned, moved, forward @ turn.T)
    np.testing.assert_allclose(there, here, atol=1e-12)
    np.testing.assert_array_equal(same, wanted)
    statistics = comparison.signals["zmp_foot_x"]["run"]
    error = (here - wanted)[comparison.inside, 0]
    assert statistics.rmse == pytest.approx(np.sqrt(np.mean(error**2)))
    # Where one foot stands, it is the plain difference.
    row = np.flatnonzero(measured.foot_force[:, 1, 2] <= 0.0)[100]
    foot = measured.foot_position[row, 0, :2] - feet[row, :2]
    np.testing.assert_allclose((here - wanted)[row], (measured.zmp - sample.zmp)[row] - foot, atol=2e-3)


def test_the_profile_of_an_estimated_walk_is_odometry():
    fixed = {"estimator": "kalman", "fix_rate": 100}
    runs = [load_run("pitch", sensors=keys) for keys in ({}, {"estimator": "kalman"}, fixed, NOISE)]
    assert [own_profile("pitch", run).name for run in runs] == ["wide", "odometry", "wide", "wide"]


def test_ones_own_estimator_walks_and_does_not_know_biases_and_seed():
    name = "sensors.estimator=tests.test_sensors:Mine"
    record = simulated(name, "sensors.gyro_bias=1e-4", "sensors.seed=5", "disturbance.push_y=1.0")
    assert record.outcome.completed
    from tests.test_sensors import Mine as Loaded

    known = Loaded.made[-1].run
    assert (known.sensors.gyro_bias, known.sensors.seed, known.disturbance.push_y) == (0.0, 0, 0.0)
    assert known.sensors.estimator == "tests.test_sensors:Mine"
    fell = simulated("sensors.estimator=tests.test_sensors:Naive")
    assert not fell.outcome.completed


def sent(**options):
    name = "tests.test_sensors:Tuned"
    return users_classes(load_run("normal", sensors={"estimator": name, "options": options}))


def test_an_estimator_and_its_options_travel_with_a_study():
    assert sent(gain=1.0)["estimator"].__name__ == "Tuned"


def test_delays_of_a_range_are_whole_steps_of_the_physics():
    sweep = parse_sweep('[[vary]]\nmethod = "sobol"\ncount = 8\nsensors.delay = {from = 0.0, to = 0.004}')
    steps = np.array([sweep.parameters(run).sensors.delay for run in range(8)]) / 0.0005  # none is refused
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-9)
    assert len(set(steps)) > 4
