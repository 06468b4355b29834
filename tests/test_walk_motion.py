"""Walks over footsteps that a body cannot walk are refused before it tries, and others are not."""

from functools import cache

import numpy as np
import pytest

import ampm
import validation as val
from ampm.body.walk_motion import _follow
from ampm.planner import routes
from tests.test_bodies import run_of
from tests.test_body_files import TOML, write
from tests.walk import assert_follows
from validation.trial.plan import complete, load_request, make_body

HUMAN = ampm.load_run("normal", simulation={"time_step": 0.002})


@cache
def gait_of(source: str) -> ampm.RunParameters:
    """The gait found for a body."""
    run_of(source)  # skips what is not installed
    request = load_request(None, [f"body.source='{source}'", "simulation.time_step=0.002"])
    return complete(request).run.as_is()


def plan(source: str, footsteps: list[ampm.Footstep]) -> None:
    run = HUMAN if source == "human" else gait_of(source)
    ampm.FootstepPlanner().plan(run.replace({}, footsteps=footsteps), make_body(run).robot)


def test_followed_torques_ranges_and_distances_are_those_of_the_walk() -> None:
    trial = val.walk(HUMAN, footsteps=routes.arc(5, 0.4, -1.0, 0.2))
    robot, record = trial.planned.body.robot, trial.record
    run = HUMAN.replace({"body.arm_abduction": 0.25})
    walk = _follow(trial.plan, trial.plan.posture, run, robot)  # type: ignore[arg-type]
    assert not walk.lost
    walked = np.abs(record.torque / record.torque_limit).max(axis=0)
    knees = [record.joint_names.index(leg.knee) for leg in robot.description.legs]
    np.testing.assert_allclose(np.nanmax(walk.share, axis=0)[knees], walked[knees], rtol=0.0, atol=0.03)
    rates = np.abs(record.qd[:, 6:]).max(axis=0)
    np.testing.assert_allclose(np.nanmax(np.abs(walk.rate), axis=0)[knees], rates[knees], rtol=0.05)
    clearance = trial.comparison.costs["margins"]["clearance"].value
    assert walk.closest.value == pytest.approx(clearance, abs=2e-3)


@pytest.mark.parametrize("landing", [4.7, 6.0])
def test_after_a_stand_a_leg_gets_straight_and_the_walk_is_accepted(landing) -> None:
    footsteps = routes.straight(10, 0.35, 0.2)
    footsteps[4] = footsteps[4]._replace(time=landing)
    plan("human", footsteps)


def test_a_quicker_gait_whose_heels_rise_late_is_walked() -> None:
    run = gait_of("g1")
    faster = {"gait.switching_velocity": 1.2 * run.gait.switching_velocity}
    run = run.replace(faster | {"foot.heel_rise_lead": run.foot.heel_rise_lead / 1.2})
    trial = val.walk(run, footsteps=routes.straight(4, 0.14, 0.19))
    assert np.count_nonzero(trial.record.qp_status == 2) == 0
    assert np.nanmax(np.abs(trial.measured.zmp - trial.comparison.sample.zmp)) < 0.02


def test_a_body_of_ones_own_with_dry_friction_walks_footsteps(tmp_path) -> None:
    run = gait_of(str(write(tmp_path, toml=TOML + 'friction.".*" = 0.2\n')))
    assert val.walk(run, footsteps=routes.straight(4, 0.15, 0.17)).verdict.passed


def test_steps_longer_than_the_gaits_are_walked() -> None:
    run = gait_of("talos")
    length = 1.2 * run.gait.step_length
    footsteps = routes.straight(4, length, 1.1 * run.gait.step_width)
    assert_follows(val.walk(run, footsteps=footsteps), 1e-3)


@pytest.mark.slow
def test_the_suite_humanoid_walks_ahead_and_aside_with_angular_momentum() -> None:
    run = gait_of("suite-humanoid").replace({"gait.c_y": 0.6})
    for footsteps in (routes.straight(3, 0.246, 0.2), routes.sidestep(4, 0.06, 0.2)):
        assert_follows(val.walk(run, footsteps=footsteps), 2.5e-3)
