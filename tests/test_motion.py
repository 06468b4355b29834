"""The tiled motion: one step and its mirror images, kept to the last bit on disk."""

from dataclasses import fields, replace

import numpy as np
import pinocchio as pin
import pyarrow.parquet as pq
import pytest

from ampm.body.motion import WholeBodyMotion
from ampm.exceptions import InputError
from tests.solved import COARSE, motion_of, walk_of
from validation.trial.plan import load_request, plan_walk


@pytest.fixture(scope="module")
def robot():
    return walk_of(COARSE).robot


@pytest.fixture(scope="module")
def motion():
    return motion_of(COARSE)


def same(one: WholeBodyMotion | None, other: WholeBodyMotion) -> bool:
    """Equal to the last bit."""

    def values(motion):
        for item in fields(motion):
            value = getattr(motion, item.name)
            yield (value.tobytes(), value.shape) if isinstance(value, np.ndarray) else value

    return one is not None and [*values(one)] == [*values(other)]


def test_every_next_step_is_the_mirror_image_moved_on(motion, robot):
    times = np.linspace(0.0, motion.step_duration, 50, endpoint=False)
    first = motion.sample(times, robot)
    for step in (1, 2, 7):
        later = motion.sample(times + step * motion.step_duration, robot)
        q, v, acceleration, turn = first.q, first.v, first.acceleration, 1.0
        if step % 2:
            q, v, turn = robot.mirror_q(first.q), robot.mirror_v(first.v), -1.0
            acceleration = robot.mirror_v(first.acceleration)
        q = q + np.eye(robot.nq)[0] * step * motion.step_length
        np.testing.assert_allclose(later.q, q, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(later.v, v, atol=1e-7)
        np.testing.assert_allclose(later.acceleration, acceleration, atol=1e-5)
        np.testing.assert_allclose(later.angular_momentum_z, turn * first.angular_momentum_z, atol=1e-7)


def test_velocity_is_the_rate_of_the_configuration(motion, robot):
    times, h = np.linspace(0.01, 2.5, 300), 1e-6
    low, here, high = (motion.sample(times + s, robot) for s in (-h, 0.0, h))
    np.testing.assert_allclose(np.linalg.norm(here.q[:, 3:7], axis=1), 1.0, rtol=0.0, atol=1e-14)
    for k in range(len(times)):
        rate = pin.difference(robot.model, low.q[k], high.q[k]) / (2 * h)
        np.testing.assert_allclose(rate, here.v[k], atol=2e-3 * np.abs(here.v[k]).max())


def test_times_before_the_start_are_refused(motion, robot):
    with pytest.raises(InputError, match=r"-0\.01"):
        motion.sample([-0.01], robot)


def test_nothing_can_be_changed(motion, robot):
    with pytest.raises(AttributeError):
        motion.q = motion.v
    held = [value for value in vars(motion).values() if isinstance(value, np.ndarray)]
    for array in (*held, *motion.sample([0.1], robot)):
        assert not array.flags.writeable
    whole = np.array(motion.q)
    frozen = replace(motion, q=whole[:])  # no view leads around the freeze
    whole[0, 0] += 1.0
    assert frozen.q.tobytes() == motion.q.tobytes()


def test_plan_writes_one_step_of_every_joint(ampm, tmp_path):
    path = tmp_path / "step.parquet"
    answer = ampm("plan", "flat", "--motion", path)
    assert answer.status == 0, answer.err
    motion = plan_walk(load_request("flat")).motion
    written = pq.read_table(path)
    assert written.column_names == [*motion.table()]
    for name, values in motion.table().items():
        np.testing.assert_array_equal(written[name].to_numpy(), values)
