"""The walk as a dm_control environment, and policies as controllers."""

from typing import Any

import numpy as np
import pytest
from absl.testing import absltest
from dm_env import test_utils

import ampm
import validation as val
from ampm import ControlOutput, TrackingController
from docs.examples import onnx_policy
from tests.records import same_bits
from tests.solved import QUICK
from validation import Push, environment

COARSE = QUICK | {"gait": {"steps": 3}}


def load(**options: Any) -> Any:
    return environment.load("normal", **{**COARSE, **options})


class TestContract(test_utils.EnvironmentTestMixin, absltest.TestCase):
    """dm_env's own tests, with full torques: the body collapses, and the simulation may diverge."""

    def make_object_under_test(self):
        return load(seed=1)

    def make_action_sequence(self):
        spec = self.environment.action_spec()
        for action in (spec.minimum, spec.maximum):
            for _ in range(150):
                yield np.broadcast_to(action, spec.shape).astype(spec.dtype)


def tracking(env):
    """The controller of a walk, for an environment."""
    planned = env.physics.planned
    controller = TrackingController(planned.body.own_robot(), planned.run.undisturbed)
    controller.follow(planned.plan, env.physics.walk.timing)
    return lambda: controller.update(*env.physics.sensed).torque


def episode(env, act):
    step, found = env.reset(), []
    while not step.last():
        step = env.step(act())
        found.append(step.reward)
    return np.array(found), step.discount


def test_the_own_controller_scores_nearly_one_a_tick_and_no_torque_little():
    env = load(seed=2)
    found, discount = episode(env, tracking(env))
    assert found.mean() >= 0.95
    assert discount == 1.0
    found, discount = episode(env, lambda: np.zeros(env.action_spec().shape))
    assert discount == 0.0
    assert found[-20:].mean() < 0.2


@pytest.mark.parametrize(
    ("sections", "disturbances"),
    [
        ({}, []),
        ({"sensors": {"rate_noise": 0.01, "delay": 0.002}}, [Push("chest", (30.0, 0.0, 0.0), 0.5, 0.1)]),
        (
            {
                "disturbance": {"slope_along": 0.002, "actuation_delay": 0.002, "push_y": 20.0},
                "simulation": {"time_step": 0.001},
            },
            [],
        ),
    ],
    ids=["plain", "sensors and a push", "disturbance, two steps a tick"],
)
def test_torques_of_the_own_controller_give_the_same_bits_as_a_walk(sections, disturbances):
    env = load(random_start=False, disturbances=disturbances, **sections)
    episode(env, tracking(env))
    loop = env.physics.loop
    run = ampm.load_run("normal", **{**COARSE, **sections, "controller": {"hold": "zero-order"}})
    record = val.walk(run, disturbances=disturbances).record
    assert loop.done == (record.steps - 1) // record.substeps * record.substeps
    rows = dict.fromkeys(("q", "qd", "point_force", "point_position"), loop.done)
    for name, count in {**rows, "tick_torque": loop.done // record.substeps}.items():
        same = getattr(loop.log.record, name)[:count], getattr(record, name)[:count]
        assert same_bits(*same), name


def test_a_diverged_simulation_ends_the_episode_without_reward():
    env = load(seed=2)
    env.reset()
    env.physics.loop.physics.data.qvel[:] = np.inf
    step = env.step(np.zeros(env.action_spec().shape))
    assert (step.last(), step.reward, step.discount) == (True, 0.0, 0.0)
    assert env.step(np.zeros(env.action_spec().shape)).first()


def test_episodes_begin_on_the_plan_at_instants_that_the_seed_fixes():
    def starts(seed):
        env, found = load(seed=seed), []
        for _ in range(6):
            observation = env.reset().observation
            assert np.abs(observation["posture_error"]).max() == 0.0
            found.append(env.physics.first)
        return found

    assert len({*starts(5)}) > 3
    assert starts(5) == starts(5) != starts(6)


class Springs:
    """The law of the toy policy."""

    def __init__(self, robot, run):
        self.limit = robot.torque_limit

    def update(self, state, touch, reference):
        off = reference.q[7:] - state.q[7:], reference.v[6:] - state.v[6:]
        return ControlOutput(np.clip(self.limit * (5.0 * off[0] + 0.2 * off[1]), -self.limit, self.limit))


def test_a_policy_in_an_onnx_file_walks_like_the_same_law_in_python(tmp_path):
    for package in ("onnx", "onnxruntime"):
        pytest.importorskip(package, reason=f"needs {package}: .venv/bin/pip install {package}")
    toy = str(tmp_path / "toy.onnx")
    onnx_policy.main(toy)
    changes = {"controller.name": "docs.examples.onnx_policy:OnnxPolicy", "controller.options.file": toy}
    run = ampm.load_run("normal", **COARSE)
    learned = val.walk(run.replace(changes))
    same = val.walk(run, controller=Springs)
    assert learned.summary["controller"] == "docs.examples.onnx_policy:OnnxPolicy"
    assert learned.record.outcome.name == same.record.outcome.name == "fell"
    np.testing.assert_allclose(learned.record.torque[:20], same.record.torque[:20], atol=1e-3)
