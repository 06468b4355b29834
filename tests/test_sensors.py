"""Sensors and estimator between the simulated body and its controller; walks.csv has more walks on them."""

from dataclasses import replace
from functools import cache
from itertools import pairwise
from typing import ClassVar

import numpy as np
import pinocchio as pin
import pytest

import validation as val
from ampm import State, Touch, TrackingController, load_run
from ampm.sensors.filters import ACCELEROMETER, GYRO, POINTS, TILT, VELOCITY, predict
from ampm.sensors.kalman import Kalman
from ampm.sensors.soles import SoleForces
from tests.records import first_difference
from tests.solved import simulated, walk_of
from tests.test_negative_controls import script
from tests.test_tick import frames
from validation.judge.compare import _from_standing_foot
from validation.trial.coordinates import to_pinocchio
from validation.trial.readings import Sensors
from validation.trial.users import users_classes

SENSORS = script("sensors")
NOISE, FORCE_TORQUE = SENSORS.NOISE, SENSORS.ROBOT
WRENCH = {"force_sensor": "wrench", "contact_threshold": 15.0}
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


class Odd(Naive):
    """Gives a state or a touch that no controller can use, or none."""

    def __init__(self, robot, run, start, factor=1.0, velocities=None, lost=False, late=0.0, **touch):
        super().__init__(robot, run, start)
        self.factor, self.velocities, self.lost, self.touch = factor, velocities, lost, touch
        self.late = late

    def update(self, readings, commanded):
        state, touch = super().update(readings, commanded)
        q, v = self.factor * state.q, state.v[: self.velocities]
        state = State(state.time - self.late, q, v)
        return state, None if self.lost else touch._replace(**self.touch)


class Untidy(Kalman):
    """Ours, which writes into what it got and has used."""

    def update(self, readings, commanded):
        estimated = super().update(readings, commanded)
        for values in (readings.angles, readings.force, commanded):
            if values is not None:
                values[:] = 0.0
        return estimated


class Mine(Kalman):
    """Ours, which is kept with what it was told."""

    made: ClassVar[list] = []

    def __init__(self, robot, run, start):
        super().__init__(robot, run, start)
        self.run = run
        self.made.append(self)

    def begin(self, start):
        self.found = self.filter.x[self.filter.layout.imu :].copy()  # before the walk
        super().begin(start)


class Tuned(Kalman):
    """Ours with an option that is needed."""

    def __init__(self, robot, run, start, gain):
        super().__init__(robot, run, start)


@cache
def read(*settings):
    """Record of a walk, and the readings of every tick."""
    readings, plain = [], Sensors.read

    def kept(self, k):
        readings.append(plain(self, k))
        return readings[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Sensors, "read", kept)
        return simulated(*settings), readings


def updates(monkeypatch, what):
    """What a function of filter, readings and state gives after every update of a Kalman filter."""
    found, plain = [], Kalman.update

    def kept(self, readings, commanded):
        state, touch = plain(self, readings, commanded)
        found.append(what(self.filter, readings, state))
        return state, touch

    monkeypatch.setattr(Kalman, "update", kept)
    return found


@cache
def walked(**sensors):
    """Trial of ten steps of `normal`."""
    return val.walk(load_run("normal", gait={"steps": 10}, simulation={"time_step": 1e-3}, sensors=sensors))


def relative(**sensors):
    """ZMP RMSE from the standing foot, x and y [mm]."""
    return np.array([1e3 * walked(**sensors).metrics[f"zmp_foot_{axis}_rmse"].value for axis in "xy"])


def test_a_resting_point_slides_the_more_the_less_it_bears():
    robot, run = walk_of().robot, load_run("normal", sensors={"estimator": "kalman"})
    f = Kalman(robot, run, State(0.0, pin.neutral(robot.model), np.zeros(robot.nv), 0.0)).filter
    f.loaded[:], f.soles.force[:] = True, f.known.weight * np.tile([0.01, 0.03, 0.05, 0.1, 0.25, 0.5], 2)
    rows = slice(POINTS, POINTS + 3 * len(f.soles.points))
    before = np.diag(f.covariance)[rows].copy()
    predict(f, 0.0, 0.002)
    growth = ((np.diag(f.covariance)[rows] - before) / f.known.growth[rows]).reshape(-1, 3)
    expected = np.tile([[70.0], [70.0], [25.0], [6.25], [1.0], [1.0]], (2, 2))
    np.testing.assert_allclose(growth[:, :2], expected, rtol=0.01)
    np.testing.assert_allclose(growth[:, 2], 1.0, rtol=1e-3)


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


def test_a_wrench_is_that_of_the_sole_points_in_the_axes_of_the_foot():
    record, readings = read("sensors.force_sensor=wrench")
    robot = walk_of().robot
    for k in range(1, len(readings), 20):
        q, _ = to_pinocchio(record.q[k - 1], record.qd[k - 1])
        turns = robot.jacobian(q).sole_turn
        for foot in range(2):
            of_foot = robot.point_foot == foot
            force = record.point_force[k - 1, of_foot]
            arm = record.point_position[k - 1, of_foot] - record.foot_position[k - 1, foot]
            total = np.r_[turns[foot].T @ force.sum(0), turns[foot].T @ np.cross(arm, force).sum(0)]
            np.testing.assert_allclose(readings[k].wrench[foot], total, atol=1e-6)
        assert not readings[k].contact.any()


def test_sensors_are_turned_scaled_rounded_and_drift():
    record, readings = read("sensors.imu_angle_bias=0.1", "sensors.force_scale_bias=0.2")
    for n, item in enumerate(readings[1:200], 1):
        true, force = record.qd[n * record.substeps, 3:6], record.point_force[n * record.substeps - 1, :, 2]
        assert np.linalg.norm(item.gyro) == pytest.approx(np.linalg.norm(true))
        np.testing.assert_allclose(np.abs(item.force - force), 0.2 * force, atol=1e-9)
    assert np.linalg.norm(item.gyro - true) > 0.05 * np.linalg.norm(true)
    rounded = read("sensors.angle_resolution=1e-3", "sensors.gyro_drift=1.0")[1]
    counts = np.array([item.angles for item in rounded]) / 1e-3
    np.testing.assert_allclose(counts, np.rint(counts), atol=1e-9)
    record = read("sensors.angle_resolution=1e-3", "sensors.gyro_drift=1.0")[0]
    off = np.array([item.gyro for item in rounded]) - record.qd[: -1 : record.substeps, 3:6]
    half = len(off) // 2
    assert off[half:].std() > off[:20].std() > 0.0
    assert np.diff(off, axis=0).std() == pytest.approx(np.sqrt(record.substeps * record.time_step), rel=0.1)


def test_slower_sensors_hold_their_readings_and_switches_close_at_their_threshold():
    _, readings = read("sensors.rate=100", "sensors.rate_noise=0.1", "sensors.contact_threshold=20")
    held = np.arange(len(readings)) % 5
    np.testing.assert_allclose([item.age for item in readings], 0.002 * held, atol=1e-9)
    for before, item in pairwise(readings):
        assert (before.rates == item.rates).all() == (item.age > 0.0)
        assert (item.contact >= (item.force > 20.0)).all()
        assert (item.contact <= (item.force > 10.0)).all()
        assert not np.shares_memory(before.rates, item.rates)  # an estimator may write into them


@pytest.mark.parametrize("toes", [0.0, -0.4])
def test_sole_forces_give_the_wrench_again_and_push_only(toes):
    robot = walk_of().robot
    run = load_run("normal", sensors=WRENCH)
    q = pin.neutral(robot.model)
    q[robot.toe_joints + 1] = toes
    terms = robot.jacobian(q)
    points = frames(robot, q, robot.point_frames)[0]
    random = np.random.default_rng(1)
    for _ in range(20):
        force = random.uniform(0.0, 200.0, len(points)) * (robot.point_group < 2)
        wrench = np.zeros((2, 6))
        for foot in range(2):
            of_foot = robot.point_foot == foot
            turn = terms.sole_turn[foot]
            arm, push = points[of_foot] - terms.sole[foot], np.outer(force[of_foot], [0.0, 0.0, 1.0])
            wrench[foot] = np.r_[turn.T @ push.sum(0), turn.T @ np.cross(arm, push).sum(0)]
        found, contact = SoleForces(robot, run).update(q, wrench)
        assert (found >= 0.0).all()
        for foot in range(2):
            of_foot = robot.point_foot == foot
            assert found[of_foot].sum() == pytest.approx(force[of_foot].sum())
            for axis in range(2):
                centre = [f[of_foot] @ points[of_foot, axis] / f[of_foot].sum() for f in (found, force)]
                assert centre[0] == pytest.approx(centre[1], abs=1e-3)
        assert contact[robot.point_group < 2].all()
        assert contact[robot.point_group == 2].all() == (toes == 0.0)
    assert not SoleForces(robot, run).update(q, 0.1 * wrench / wrench[:, 2:3])[1].any()


def test_angles_and_biases_of_the_imu_are_found_and_cost_nothing():
    sensors = {"imu_angle_bias": 0.01, "gyro_bias": 1e-3, "seed": 11, **NOISE}
    trial = walked(estimator="tests.test_sensors:Mine", **sensors)
    assert trial.verdict.passed, trial.verdict.reason
    f = Mine.made[-1].filter
    np.testing.assert_allclose(np.abs(f.x[f.layout.imu : f.layout.imu + 2]), 0.01, atol=2e-3)
    assert np.abs(np.abs(f.x[GYRO:ACCELEROMETER][:2]) - 1e-3).max() < 0.7e-3


def test_wrenches_tell_where_the_com_is_over_the_foot(monkeypatch):
    robot = walk_of().robot
    found = updates(monkeypatch, lambda f, _, state: (state.q, f.soles.loaded.copy()))
    walked.cache_clear()
    record = walked(estimator="kalman", angle_bias=1e-3, seed=11, **NOISE | FORCE_TORQUE).record
    off = []
    for k in range(len(found) // 2, len(found), 10):
        (q, loaded), row = found[k], k * record.substeps
        here, true = (robot.jacobian(q_) for q_ in (q, to_pinocchio(record.q[row], record.qd[row])[0]))
        levers = [(item.com - item.sole).copy() for item in (here, true)]
        if loaded.sum() == 1:
            off.append((levers[0] - levers[1])[loaded.argmax(), :2])
    assert np.sqrt(np.mean(np.square(off), axis=0)).max() < 1.1e-3  # [m], 2.5 mm by the offsets alone
    walked.cache_clear()


def test_a_stand_before_the_walk_finds_how_the_imu_is_turned():
    walked(estimator="tests.test_sensors:Mine", stand=1.0, imu_angle_bias=0.01, seed=11, **NOISE)
    np.testing.assert_allclose(np.abs(Mine.made[-1].found[:2]), 0.01, atol=2e-3)


def test_without_errors_of_sensors_a_walk_keeps_its_bits():
    assert first_difference(simulated(), simulated("sensors.seed=3", "sensors.fix_rate=100")) is None
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

    def kept(f, readings, _):
        covariance = f.covariance[VELOCITY:GYRO, VELOCITY:GYRO].copy()
        return readings, f.x[VELOCITY:TILT].copy(), f.turn.copy(), covariance

    found, nees = updates(monkeypatch, kept), []
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


def test_rates_are_estimated_where_a_push_makes_accelerations_other_than_commanded(monkeypatch):
    found = updates(monkeypatch, lambda _, readings, state: (readings.time, state.v[6:].copy()))
    noise = (f"sensors.{key}={value}" for key, value in NOISE.items())
    pushed = "disturbance.push_y=150", "disturbance.push_at=0.8"
    record = simulated("simulation.time_step=0.001", "sensors.estimator=kalman", *pushed, *noise)
    after = [(round(time / record.time_step), v) for time, v in found if 0.8 < time < 1.1]
    errors = [v - to_pinocchio(record.q[row], record.qd[row])[1][6:] for row, v in after]
    assert np.sqrt(np.mean(np.square(errors))) < 0.05  # 0.02; with errors of fixed size it is 0.16


def test_a_known_delay_costs_at_most_half_a_millimetre():
    now, late = relative(estimator="kalman"), relative(estimator="kalman", delay=0.002)
    assert np.abs(late - now).max() < 0.5
    assert (relative(delay=0.002) > late + np.array([1.0, 0.5])).all()  # the same delay, unknown


def test_an_estimate_that_diverges_is_no_fault_of_a_class():
    outcome = simulated("sensors.estimator=kalman", "sensors.delay=0.05", steps=3).outcome
    assert (outcome.name, outcome.steps_completed) == ("diverged", 1)
    assert outcome.ending.startswith(
        "The numbers of the walk diverged: the estimate of kalman diverged at 0."
    )
    assert "; the first sign was a torque or joint limit" in outcome.cause


def test_an_estimated_walk_keeps_its_place_relative_to_the_foot_and_with_fixes_in_the_world():
    trial = walked(estimator="kalman", **NOISE)
    assert trial.verdict.profile == "odometry"
    assert trial.verdict.passed, trial.verdict.reason
    assert "zmp_x_rmse" not in {item.name for item in trial.verdict.judged}
    assert (relative(estimator="kalman", **NOISE) < [3.5, 2.0]).all()
    assert 0.15e-3 < trial.metrics["drift_per_step"].value < 1.5e-3
    fixed = walked(estimator="kalman", fix_rate=100, **NOISE)
    assert fixed.verdict.profile == "default"
    assert fixed.metrics["drift_per_step"].value < 0.15e-3
    assert fixed.verdict.passed, fixed.verdict.reason


def test_the_zmp_from_the_standing_foot_does_not_depend_on_where_the_walk_is():
    comparison = walked().comparison
    sample, measured, record = comparison.sample, comparison.measured, comparison.record
    feet, forward = comparison.sample.feet, record.foot_forward[:-1]
    here, wanted = _from_standing_foot(comparison.sample, measured, forward)
    turn = pin.utils.rotate("z", 0.3)

    moved = replace(
        measured,
        zmp=measured.zmp @ turn[:2, :2].T + [5.0, -3.0],
        foot_position=measured.foot_position @ turn.T + [5.0, -3.0, 0.0],
    )
    there, same = _from_standing_foot(comparison.sample, moved, forward @ turn.T)
    np.testing.assert_allclose(there, here, atol=1e-12)
    np.testing.assert_array_equal(same, wanted)
    statistics = comparison.signals["zmp_foot_x"]["run"]
    error = (here - wanted)[comparison.inside, 0]
    assert statistics.rmse == pytest.approx(np.sqrt(np.mean(error**2)))
    # Where one foot stands, it is the plain difference.
    row = np.flatnonzero(measured.foot_force[:, 1, 2] <= 0.0)[100]
    foot = measured.foot_position[row, 0, :2] - feet[row, :2]
    np.testing.assert_allclose((here - wanted)[row], (measured.zmp - sample.zmp)[row] - foot, atol=2e-3)


def test_ones_own_estimator_walks_and_does_not_know_the_seed():
    name = "sensors.estimator=tests.test_sensors:Mine"
    record = simulated(name, "sensors.gyro_bias=1e-4", "sensors.seed=5", "disturbance.push_y=1.0")
    assert record.outcome.completed
    known = Mine.made[-1].run
    assert (known.sensors.gyro_bias, known.sensors.seed, known.disturbance.push_y) == (1e-4, 0, 0.0)
    assert known.sensors.estimator == "tests.test_sensors:Mine"
    assert not simulated("sensors.estimator=tests.test_sensors:Naive").outcome.completed


def sent(**options):
    run = load_run("normal", sensors={"estimator": "tests.test_sensors:Tuned", "options": options})
    return users_classes({"request": run})


def test_an_estimator_travels_with_a_study():
    (found,) = sent(gain=1.0).values()
    assert found.__name__ == "Tuned"
