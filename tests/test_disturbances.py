"""Pushes and other disturbances of a walk."""

import json
from functools import cache
from typing import Any

import numpy as np
import pytest

from docs.examples.joint_pd import JointPD
from tests.records import first_difference, same_bits, stored
from tests.solved import COARSE, body_of, simulated, walk_of
from tests.test_golden import definition
from validation.measure.measure import measure
from validation.run.replay import replay
from validation.trial.disturbances import Push, Recorded

SHOVE = Push("chest", (0.0, 30.0, 0.0), at=0.6, duration=0.1)


@cache
def walk(*disturbances, **options):
    return simulated(disturbances=disturbances, **options)


def test_a_push_is_recorded_where_and_when_it_acts(tmp_path):
    record = walk(SHOVE)
    assert record.outcome.completed
    assert record.external_segments == ("thorax",)
    pushed = (record.time[:-1] > 0.5999) & (record.time[:-1] < 0.6999)
    assert (record.external_force[pushed, 0] == SHOVE.force).all()
    assert not record.external_force[~pushed].any()
    assert not record.external_moment.any()
    assert (walk().external_segments, walk().controller) == ((), "")
    gained = (record.com - walk().com)[record.time.searchsorted(0.8)]
    assert gained[1] > 1e-3
    assert first_difference(record, stored(record, body_of().xml, tmp_path)) is None


def test_pushes_of_arrays_are_equal_to_those_of_tuples():
    force: Any = np.array([0, 15, 0])
    assert Push("chest", force, 0.5, 0.1) == Push("chest", (0.0, 15.0, 0.0), 0.5, 0.1)


def test_pushes_add_up_and_a_force_lifts():
    up = Push("chest", (0.0, 0.0, 20.0), at=0.0, duration=10.0)
    record = walk(up, up, steps=1)
    np.testing.assert_array_equal(record.external_force[:, 0, 2], 40.0)
    measured = measure(record, walk_of(COARSE).robot.model)
    assert measured.force[100:, 2].mean() == pytest.approx(measured.weight - 40.0, rel=0.02)
    assert abs(measured.self_checks.impulse_residual) < 1e-3


@cache
def disturbed(steps=2, **values):
    """A short walk with some keys of the section ``disturbance``."""
    return simulated(*(f"disturbance.{key}={value}" for key, value in values.items()), steps=steps)


def test_a_com_push_adds_momentum_and_no_angular_momentum():
    plain, record = walk(), walk(Push("com", (60.0, 0.0, 0.0), at=0.3, duration=0.02), steps=1)
    assert record.external_segments == ("pelvis",)
    k = record.time.searchsorted(0.31)
    lever = record.com[k] - record.external_position[k, 0]
    np.testing.assert_allclose(
        record.external_moment[k, 0], np.cross(lever, record.external_force[k, 0]), rtol=0.0, atol=1e-9
    )
    assert abs(lever[2]) > 0.02
    gained = record.com[:, 0] - plain.com[: len(record.com), 0]
    rows = record.time.searchsorted([0.3199, 0.3239])
    speed = np.diff(gained[rows]) / np.diff(record.time[rows])
    assert speed == pytest.approx(60.0 * 0.02 / record.mass, rel=0.3)
    measured = measure(record, walk_of(COARSE).robot.model)
    # Without the push they would be 40 mm apart, without its moment 4 mm.
    np.testing.assert_allclose(measured.zmp, measured.zmp_momentum, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(measured.force, measured.momentum_force, rtol=0.0, atol=1e-2)


def test_recorded_pushes_act_again_to_the_bit():
    record = walk(Push("com", (60.0, 0.0, 0.0), at=0.3, duration=0.02), steps=1)
    again = simulated(disturbances=[Recorded(record)], steps=1)
    assert same_bits(again.q, record.q)


def test_a_moved_floor_has_its_contacts_at_the_new_height():
    record = disturbed(floor_height=0.01, step_height=-0.004)
    np.testing.assert_allclose(record.floor, [0.006, 0.01])
    loaded = record.point_force[..., 2] > 5.0
    assert np.median(record.point_position[..., 2][loaded]) == pytest.approx(0.01, abs=1e-3)


def test_the_velocity_at_the_start_repeats_with_its_seed():
    starts = [disturbed(steps=1, start_velocity=0.02, seed=seed).qd[0] - walk().qd[0] for seed in (0, 1)]
    for start in starts:
        assert 1e-3 < np.abs(start[:3]).max() < 0.08
        assert not start[3:].any()
    assert (starts[0] != starts[1]).any()


def test_the_controller_gets_no_information_on_disturbances():
    class Spy(JointPD):
        runs: list = []

        def __init__(self, robot, run):
            super().__init__(robot, run)
            self.runs.append((run, robot.mass))

    record = simulated("disturbance.mass_change=0.2", "sensors.angle_noise=1e-3", controller=Spy, steps=1)
    run, mass = Spy.runs[0]
    assert run.disturbance == type(run.disturbance)()
    assert run.sensors == type(run.sensors)()
    assert mass == pytest.approx(walk().mass)
    assert record.mass == pytest.approx(1.2 * mass)


def test_all_disturbances_together_replay_to_the_bit_from_their_folder(run_of):
    """The walk in golden.csv has nearly every key of the section."""
    folder = run_of(**definition("disturbed"))
    assert replay(folder).identical
    known = json.loads((folder / "summary.json").read_text())["disturbances"]
    assert "disturbance.slope_along = 0.005" in known
