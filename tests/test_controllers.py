"""Controllers by name, without a QP, in sweeps and side by side; the walk as a dm_control environment.

Policies as controllers.
"""

from functools import partial
from importlib.metadata import EntryPoint
from os.path import relpath
from typing import Any

import numpy as np
import pytest
from absl.testing import absltest
from dm_env import test_utils

import ampm
import validation as val
from ampm import ControlOutput, InputError, TrackingController
from docs.examples import onnx_policy, tsid_controller
from docs.examples.joint_pd import JointPD
from tests.records import same_bits
from tests.solved import QUICK
from tests.test_bad_input import assert_said, rows_of
from tests.test_disturbances import Once
from validation import Push, environment
from validation.store.record import load_record
from validation.trial import users
from validation.trial.users import CONTROLLER

JOINT_PD = "docs.examples.joint_pd:JointPD"
SETTINGS = ["--steps=2", "--set=solver.ik_time_step=0.01", "--set=simulation.time_step=0.002"]


@pytest.fixture
def installed(monkeypatch):
    """A package that adds the controller ``simple``, and ``broken``, whose module is missing."""
    places = {"simple": JOINT_PD, "broken": "no_such_module:Controller"}
    points = [EntryPoint(name, place, "ampm.controllers") for name, place in places.items()]
    monkeypatch.setattr(users, "entry_points", lambda group: [p for p in points if p.group == group])


def test_a_controller_has_one_name_wherever_it_comes_from(installed):
    assert CONTROLLER.find("ampm") is TrackingController
    assert CONTROLLER.find("simple") is CONTROLLER.find(JOINT_PD) is JointPD
    assert CONTROLLER.name_of(JointPD) == JOINT_PD
    with pytest.raises(InputError, match="no_such_module:Controller' cannot be imported"):
        CONTROLLER.find("broken")
    assert users.load_object("--metric", "docs.examples.joint_pd:JointPD.update") is JointPD.update


def test_tsid_walks_on_flat_feet():
    if tsid_controller.tsid is None:
        pytest.skip("needs the extra tsid, in an environment of its own: pip install -e '.[tsid]'")
    run = ampm.load_run("flat", gait={"steps": 3}, simulation={"time_step": 0.001})
    trial = val.walk(run, controller=tsid_controller.TsidController)
    assert trial.record.outcome.name == "completed"
    limits = {"failed_qp": 0, "zmp_x_rmse": 2e-3, "zmp_y_rmse": 1.5e-3, "angular_momentum_y_rmse": 0.05}
    assert not [name for name, limit in limits.items() if not trial.metrics[name].value <= limit]
    planned = trial.planned.plan.sample(trial.record.time[:-1]).zmp
    assert np.sqrt(np.mean((trial.record.command_zmp - planned) ** 2)) < 2e-3


def test_the_template_walks():
    changes = {"simulation.time_step": 0.002, "gait.steps": 4, "controller.options.resolution": 0.05}
    run = ampm.load_run("normal").replace(changes)
    trial = val.walk(run, controller="docs.examples.controller_template:MyController")
    assert trial.verdict.passed, trial.verdict.reason
    steps = trial.record.torque[0] / 0.05
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)


@pytest.mark.parametrize("row", rows_of("output"))
def test_torques_that_cannot_be_applied_end_the_walk_and_keep_its_record(row):
    class Spoilt(JointPD):
        def update(self, state, touch, reference):
            output = super().update(state, touch, reference)
            if state.time < 0.01:
                return output
            fields = output._asdict()
            exec(row["input"], {"np": np}, fields)
            return output._replace(**fields)

    trial = val.walk(ampm.load_run("normal", **QUICK), controller=Spoilt)
    assert trial.record.outcome.name == "crashed"
    assert_said(trial.record.outcome.cause, f"controller | Spoilt failed | {row['words']}")
    assert (trial.record.steps, trial.verdict.passed) == (5, False)


def test_the_record_keeps_the_reference_that_a_controller_followed():
    class Elsewhere(TrackingController):
        def update(self, state, touch, reference):
            output = super().update(state, touch, reference)
            return output._replace(reference=reference.replace(com=reference.com + 0.01))

    run = ampm.load_run("normal", **QUICK)
    record, plain = (val.walk(run, controller=it).record for it in (Elsewhere, None))
    np.testing.assert_array_equal(record.command_com, plain.command_com + 0.01)

    class Limp(Elsewhere):
        def update(self, state, touch, reference):
            output = super().update(state, touch, reference)
            fallen = reference.replace(
                com=np.array(state.q[:3]), foot_position=np.array([state.q[:3]] * 2) - 0.8
            )
            return output._replace(torque=0.0 * output.torque, rate=None, reference=fallen)

    assert val.walk(run, controller=Limp).record.outcome.name == "fell"
    np.testing.assert_array_equal(record.q, plain.q)


def test_a_crash_in_mid_walk_keeps_the_run(ampm, tmp_path, caplog):
    words = [*SETTINGS, "--controller", "tests.test_api:Late", "--out", relpath(tmp_path / "run")]
    answer = ampm("validate", "normal", *words, "--json", "--debug")
    assert (answer.status, answer.json["outcome"]) == (3, "crashed")
    assert "Late failed (KeyError: 'late')" in answer.json["end"]["cause"]
    assert 'raise KeyError("late")' in caplog.text
    assert load_record(tmp_path / "run").steps == 26


class Ramp:
    """Gives the same torque and rate at every tick."""

    def __init__(self, robot, run, rate):
        self.torque = 0.98 * robot.torque_limit
        self.unknown: Any = dict.fromkeys(("residual", "iterations", "seconds"))
        self.rate = None if rate is None else np.full(robot.nu, rate)

    def update(self, state, touch, reference):
        return ControlOutput(self.torque, rate=self.rate, **self.unknown)


def above_limits(rate):
    """Torques of the first milliseconds over 98 % of the motors' limits, four steps a tick; the other 2 %."""
    record = val.walk(ampm.load_run("normal", gait={"steps": 1}), controller=partial(Ramp, rate=rate)).record
    assert record.controller == f"{__name__}:<partial Ramp>"
    return record.torque[:8] - 0.98 * record.torque_limit, 0.02 * record.torque_limit


def test_the_torque_goes_on_with_its_rate_within_the_limits():
    above, room = above_limits(1e3)
    since = np.array([0.0, 1.0, 2.0, 3.0] * 2)[:, None] * 0.0005  # since the tick [s]
    np.testing.assert_allclose(above, np.minimum(1e3 * since, room), rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(above_limits(None)[0], 0.0, rtol=0.0, atol=1e-9)


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


@pytest.mark.parametrize(
    ("estimator", "spoil"),
    [
        ("exact", lambda loop: loop.physics.data.qvel.fill(np.inf)),
        ("kalman", lambda loop: loop.sensors._estimator.filter.x.fill(np.nan)),
    ],
)
def test_a_diverged_simulation_ends_the_episode_without_reward(estimator, spoil):
    env = load(seed=2, sensors={"estimator": estimator})
    env.reset()
    spoil(env.physics.loop)
    step = env.step(np.zeros(env.action_spec().shape))
    assert (step.last(), step.reward, step.discount) == (True, 0.0, 0.0)
    assert env.step(np.zeros(env.action_spec().shape)).first()


def test_every_episode_begins_with_a_disturbance_as_it_was_given():
    env = load(random_start=False, disturbances=[Once()])
    act, after = np.zeros(env.action_spec().shape), []
    for _ in range(2):
        env.reset()
        env.step(act)
        after.append(env.physics.loop.log.record.qd[1].copy())
    assert same_bits(*after)


def test_episodes_begin_on_the_plan_at_instants_that_the_seed_fixes():
    def starts(seed):
        env, found = load(seed=seed), []
        for _ in range(6):
            assert np.abs(env.reset().observation["posture_error"]).max() == 0.0
            found.append(env.physics.first)
        return found

    assert len({*starts(5)}) > 3
    assert starts(5) == starts(5) != starts(6)


@pytest.mark.parametrize(("random_start", "many"), [(True, 3), (False, 1)])
def test_sensors_have_other_errors_in_every_episode_that_begins_at_random(random_start, many):
    seeds = []
    for _ in range(2):
        env = load(seed=5, random_start=random_start, sensors={"rate_noise": 0.01, "seed": 7})
        for _ in range(3):
            env.reset()
            seeds.append(env.physics.loop.sensors.parameters.seed)
    assert seeds[:3] == seeds[3:]
    assert len({*seeds}) == many
    assert (7 in seeds) != random_start


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
