"""Additions to a walk: pushes, a user's own force, a user's own controller."""

from __future__ import annotations

import importlib.util
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from ampm.control.joint_pd import JointPD
from ampm.exceptions import InputError
from tests.records import first_difference, stored
from tests.solved import COARSE, body_of, simulated, walk_of
from validation.measure.measure import measure
from validation.run.replay import step_again
from validation.trial.bridge import to_pinocchio
from validation.trial.disturbances import Push
from validation.trial.outcome import OutcomeName

SHOVE = Push("chest", (0.0, 30.0, 0.0), at=0.6, duration=0.1)


def example(name):
    """A module of docs/examples."""
    path = Path(__file__).parents[1] / "docs" / "examples" / f"{name}.py"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@cache
def walk(*disturbances, **options):
    return simulated(disturbances=disturbances, **options)


def test_a_push_is_recorded_where_and_when_it_acts(tmp_path):
    record = walk(SHOVE)
    assert record.outcome.completed
    assert record.external_segments == ("thorax",)
    pushed = (record.time[:-1] > 0.5999) & (record.time[:-1] < 0.6999)
    assert pushed.any()
    assert (record.external_force[pushed, 0] == SHOVE.force).all()
    assert not record.external_force[~pushed].any()
    assert not record.external_moment.any()
    assert (np.abs(record.external_position[pushed, 0] - record.com[:-1][pushed]) < 0.5).all()
    assert record.metadata["disturbances"] == str(SHOVE)
    gained = (record.com - walk().com)[record.time.searchsorted(0.8)]
    assert gained[1] > 1e-3
    assert first_difference(record, stored(record, body_of().xml, tmp_path)) is None


def test_a_pushed_walk_replays_to_the_bit_and_only_with_its_push():
    record = walk(SHOVE)
    assert step_again(body_of().compile(), record).identical
    assert walk().external_segments == ()
    assert not walk().metadata


def test_the_zmp_from_momentum_rates_takes_pushes_into_account():
    robot = walk_of(COARSE).robot
    measured, record = measure(walk(SHOVE), robot.model, to_pinocchio), walk(SHOVE)
    gap = np.linalg.norm(measured.zmp - measured.zmp_momentum, axis=1)
    pushed = record.external_force[:, 0, 1] > 0.0
    calm = measure(walk(), robot.model, to_pinocchio)
    assert np.nanmax(gap[pushed]) < 2.0 * np.nanmax(np.linalg.norm(calm.zmp - calm.zmp_momentum, axis=1))
    assert measured.self_checks.force_agreement[1] < 2.0 * calm.self_checks.force_agreement[1]
    # Left out, the push would move the ZMP by its lever over the weight.
    assert 30.0 * 1.1 / measured.weight > 10.0 * np.nanmax(gap[pushed])


def test_pushes_add_up_and_a_force_lifts():
    up = Push("chest", (0.0, 0.0, 20.0), at=0.0, duration=10.0)
    record = walk(up, up, steps=1)
    np.testing.assert_array_equal(record.external_force[:, 0, 2], 40.0)
    measured = measure(record, walk_of(COARSE).robot.model, to_pinocchio)
    assert measured.force[100:, 2].mean() == pytest.approx(measured.weight - 40.0, rel=0.02)
    assert abs(measured.self_checks.impulse_residual) < 1e-3


@pytest.mark.parametrize(
    ("push", "word"),
    [
        (("wing", (1.0, 0.0, 0.0), 0.0, 1.0), "wing"),
        (("chest", (np.nan, 0.0, 0.0), 0.0, 1.0), "finite"),
        (("chest", (1.0, 0.0), 0.0, 1.0), "three"),
        (("chest", (1.0, 0.0, 0.0), -0.5, 1.0), "-0.5"),
        (("chest", (1.0, 0.0, 0.0), 0.5, -0.1), "-0.1"),
    ],
)
def test_impossible_pushes_are_refused(push, word):
    with pytest.raises(InputError, match=word):
        walk(Push(*push))


def test_a_users_own_wind_pushes_with_the_relative_air():
    wind = example("wind").Wind((0.0, 8.0, 0.0), start=0.2, until=0.6)
    record = walk(wind)
    assert record.outcome.completed
    blown = record.external_force[:, 0]
    assert not blown[record.time[:-1] < 0.2].any()
    while_it_blows = (record.time[:-1] > 0.22) & (record.time[:-1] < 0.58)
    assert (blown[while_it_blows, 1] > 10.0).all()  # across
    assert (blown[while_it_blows, 0] < 0.0).all()  # against the walk
    assert "Wind" in record.metadata["disturbances"]


def test_a_users_own_controller_may_fall_and_leaves_the_rest_unsaid():
    record = walk(controller=JointPD)
    assert record.outcome.name is OutcomeName.FELL
    assert record.metadata["controller"] == "joint-pd"
    assert np.isnan(record.command_zmp).all()
    assert np.isnan(record.qp_residual).all()
    np.testing.assert_array_equal(record.command_com[0], walk().command_com[0])
    assert step_again(body_of().compile(), record).identical


@pytest.mark.parametrize(("force", "outcome"), [(30.0, OutcomeName.COMPLETED), (80.0, OutcomeName.FELL)])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_light_push_at_the_chest_is_survived_a_hard_one_is_not(force, outcome, side):
    push = Push("chest", (0.0, side * force, 0.0), at=1.0, duration=0.2)
    assert walk(push, steps=4).outcome.name is outcome
