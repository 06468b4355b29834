"""Additions to a walk: pushes, a user's own force, a user's own controller."""

import importlib.util
import json
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import validation as val
from ampm.control.joint_pd import JointPD
from ampm.exceptions import InputError
from ampm.run_file import load_run
from tests.records import first_difference, stored
from tests.solved import COARSE, body_of, replays, simulated, walk_of
from validation.judge.built_in import rms
from validation.measure.measure import measure
from validation.run.replay import replay
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
    assert record.disturbances == str(SHOVE)
    assert (walk().external_segments, walk().disturbances, walk().controller) == ((), "", "")
    gained = (record.com - walk().com)[record.time.searchsorted(0.8)]
    assert gained[1] > 1e-3
    assert first_difference(record, stored(record, body_of().xml, tmp_path)) is None


def test_the_zmp_from_momentum_rates_takes_pushes_into_account():
    robot = walk_of(COARSE).robot
    measured, record = measure(walk(SHOVE), robot.model, to_pinocchio), walk(SHOVE)
    gap = np.linalg.norm(measured.zmp - measured.zmp_momentum, axis=1)
    pushed = record.external_force[:, 0, 1] > 0.0
    calm = measure(walk(), robot.model, to_pinocchio)
    assert np.nanmax(gap[pushed]) < 2.0 * np.nanmax(np.linalg.norm(calm.zmp - calm.zmp_momentum, axis=1))
    off, usual = (rms((one.force - one.momentum_force)[:, 1]) for one in (measured, calm))
    assert off < 2.0 * usual
    # Left out, the push would move the ZMP by its lever over the weight.
    assert 30.0 * 1.1 / measured.weight > 10.0 * np.nanmax(gap[pushed])


def test_pushes_add_up_and_a_force_lifts():
    up = Push("chest", (0.0, 0.0, 20.0), at=0.0, duration=10.0)
    record = walk(up, up, steps=1)
    np.testing.assert_array_equal(record.external_force[:, 0, 2], 40.0)
    measured = measure(record, walk_of(COARSE).robot.model, to_pinocchio)
    assert measured.force[100:, 2].mean() == pytest.approx(measured.weight - 40.0, rel=0.02)
    assert abs(measured.self_checks.impulse_residual) < 1e-3


def test_a_users_own_wind_pushes_with_the_relative_air():
    wind = example("wind").Wind((0.0, 8.0, 0.0), start=0.2, until=0.6)
    record = walk(wind)
    assert record.outcome.completed
    blown = record.external_force[:, 0]
    assert not blown[record.time[:-1] < 0.2].any()
    while_it_blows = (record.time[:-1] > 0.22) & (record.time[:-1] < 0.58)
    assert (blown[while_it_blows, 1] > 10.0).all()  # across
    assert (blown[while_it_blows, 0] < 0.0).all()  # against the walk
    assert "Wind" in record.disturbances


def test_a_users_own_controller_may_fall_and_leaves_the_rest_unsaid():
    record = walk(controller=JointPD, steps=4)
    assert record.outcome.name is OutcomeName.FELL
    assert record.controller == "joint-pd"
    assert np.isnan(record.command_zmp).all()
    assert np.isnan(record.qp_residual).all()
    np.testing.assert_array_equal(record.command_com[0], walk().command_com[0])
    assert replays(record)


@pytest.mark.parametrize(("force", "outcome"), [(30.0, OutcomeName.COMPLETED), (-80.0, OutcomeName.FELL)])
def test_a_light_push_at_the_chest_is_survived_a_hard_one_is_not(force, outcome):
    push = Push("chest", (0.0, force, 0.0), at=1.0, duration=0.2)
    assert walk(push, steps=4).outcome.name is outcome


# --------------------------------------------------------------------------------- the section of a run file


@cache
def disturbed(steps=2, **values):
    """A short walk with some keys of the section ``disturbance``."""
    return simulated(*(f"disturbance.{key}={value}" for key, value in values.items()), steps=steps)


def carried(record, at):
    """Mean height of the points that carry force [m]."""
    rows = record.time[:-1].searchsorted(at)
    loaded = record.point_force[rows, :, 2] > 5.0
    assert loaded.any()
    return record.point_position[rows, loaded, 2].mean()


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


def test_a_push_of_the_run_file_is_that_of_the_list():
    listed = walk(SHOVE)
    record = disturbed(push_y=30.0, push_at=0.6)
    np.testing.assert_array_equal(record.q, listed.q)
    np.testing.assert_array_equal(record.external_force, listed.external_force)


@pytest.mark.parametrize("height", [0.01, -0.01])
def test_a_moved_floor_has_its_contacts_at_the_new_height(height):
    record = disturbed(steps=1, floor_height=height)
    calm = walk()
    assert carried(record, 0.05) == pytest.approx(carried(calm, 0.05) + height, abs=2e-4)
    assert record.point_penetration[: record.time.searchsorted(0.05)].max() < 5e-3
    assert record.foot_position[0, :, 2] == pytest.approx(calm.foot_position[0, :, 2] + height, abs=1e-9)


@pytest.mark.parametrize("height", [0.005, -0.004])
def test_one_step_of_another_height_is_felt_by_that_foot_alone(height):
    record = disturbed(steps=3, step_height=height, step_number=4)
    assert record.outcome.completed
    loaded = record.point_force[..., 2] > 20.0
    footsteps = walk_of(COARSE).plan.contacts.footsteps
    x = footsteps[3].position[0]
    there = loaded & (np.abs(record.point_position[..., 0] - x) < 0.2)
    there &= record.point_foot == ("left", "right").index(footsteps[3].foot)
    assert there.any()
    assert np.median(record.point_position[there][:, 2]) == pytest.approx(height, abs=2e-3)
    assert abs(np.median(record.point_position[loaded & ~there][:, 2])) < 2e-3
    assert (record.point_force[..., 2] >= 0.0).all()  # up, although a box comes last in its contacts


@pytest.mark.parametrize(("key", "axis"), [("slope_along", 0), ("slope_across", 1)])
def test_a_slope_begins_after_the_first_footsteps_and_rises(key, axis):
    slope = 0.01
    record = disturbed(steps=2, **{key: slope})
    footsteps = walk_of(COARSE).plan.contacts.footsteps
    first = max(item.position[0] for item in footsteps[:2])
    loaded = record.point_force[..., 2] > 20.0
    place = record.point_position[loaded]
    level = place[place[:, 0] < first + 0.05]
    assert abs(np.median(level[:, 2])) < 1e-3
    tilted = place[place[:, 0] > first + 0.35]
    assert len(tilted) > 20
    rise = np.polyfit(tilted[:, axis], tilted[:, 2], 1)[0]
    assert rise == pytest.approx(slope, rel=0.5)


def test_masses_friction_softness_and_damping_are_in_the_simulated_model_only():
    calm = walk()
    record = disturbed(mass_segment="chest,left_thigh", mass_change=0.1)
    model = body_of().compile()
    extra = 0.1 * (model.body("thorax").mass[0] + model.body("left_thigh").mass[0])
    assert record.mass == pytest.approx(calm.mass + extra, rel=1e-9)
    assert disturbed(mass_change=0.1).mass == pytest.approx(1.1 * calm.mass, rel=1e-9)
    assert disturbed(friction_factor=0.5).friction == 0.5 * calm.friction
    soft = disturbed(softness_factor=4.0)
    assert soft.point_penetration.mean() > 2.0 * calm.point_penetration.mean()
    damped = disturbed(joint_damping=1.0)
    assert np.abs(damped.torque).mean() != np.abs(calm.torque).mean()
    for other in (record, soft, damped):  # the first command is made from the plan and the nominal body
        np.testing.assert_allclose(other.command_com, calm.command_com[: len(other.command_com)])


def test_faults_of_motors_repeat_with_their_seed():
    calm = walk()
    biased = disturbed(steps=1, torque_bias=2.0)
    signs = np.unique(np.round(np.abs(biased.torque[0] - calm.torque[0]), 6))
    np.testing.assert_allclose(signs, 2.0)
    late = disturbed(steps=1, actuation_delay=0.004)
    assert late.substeps == 1  # a tick a step: 4 ms are two ticks
    np.testing.assert_array_equal(late.torque[2], calm.torque[0])
    np.testing.assert_array_equal(late.torque[:3], np.repeat(late.torque[:1], 3, axis=0))
    starts = [disturbed(steps=1, start_velocity=0.02, seed=seed).qd[0] - calm.qd[0] for seed in (0, 1)]
    for start in starts:
        assert 1e-3 < np.abs(start[:3]).max() < 0.08
        assert not start[3:].any()
    assert (starts[0] != starts[1]).any()
    with pytest.raises(InputError, match=r"actuation_delay = 0.003 s gives 1.5 ticks of .* 500 Hz.* 0.004"):
        load_run("normal", disturbance={"actuation_delay": 0.003})


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


def test_all_disturbances_together_replay_to_the_bit_from_their_folder(tmp_path):
    keys = {
        "push_y": 10.0,
        "floor_height": 0.003,
        "step_height": 0.002,
        "slope_along": 0.005,
        "slope_across": -0.004,
        "friction_factor": 0.8,
        "softness_factor": 1.5,
        "mass_change": 0.02,
        "joint_damping": 0.1,
        "joint_friction": 0.1,
        "actuation_delay": 0.002,
        "torque_bias": 0.2,
        "seed": 7,
    }
    sensors = {"delay": 0.0015, "angle_noise": 1e-4, "rate_noise": 5e-3, "seed": 7}
    run = load_run("normal", gait={"steps": 2}, disturbance=keys, sensors=sensors)
    trial = val.walk(run)
    folder = trial.save(tmp_path / "run", recording=False)
    assert replay(folder).identical
    again = load_run(folder / "run.toml")
    assert (again.disturbance, again.sensors) == (run.disturbance, run.sensors)
    assert "slope_along = 0.005" in json.loads((folder / "summary.json").read_text())["disturbances"]
