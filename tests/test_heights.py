"""Footsteps of different heights: their plan, their floor, and the walk over it."""

import numpy as np
import pytest

import ampm
import validation as val
from ampm.planner import routes
from ampm.planner.heights import Ground
from tests.test_footstep_walk import plan as plan_feet
from tests.test_footsteps import BODY, GAITS, plan
from tests.test_make_plan import made, samples_of
from tests.test_walk_motion import gait_of
from tests.walk import assert_follows

WIDTH = 0.2


def raised(footsteps, heights):
    """Footsteps at the given heights [m], the last of which goes on."""
    heights = [*heights, *[heights[-1]] * (len(footsteps) - len(heights))]
    return [one._replace(position=(*one.position[:2], z)) for one, z in zip(footsteps, heights, strict=True)]


WALKS = {
    "up": routes.platform(8, 0.4, WIDTH, 0.05),
    "down": routes.platform(8, 0.4, WIDTH, -0.05),
    "up and down": routes.platform(8, 0.4, WIDTH, 0.05, last=5),
    "one foot": routes.platform(8, 0.4, WIDTH, 0.05, first=4, last=4),
    "stairs": raised(routes.straight(8, 0.4, WIDTH), [0.0, 0.0, 0.0, 0.04, 0.09, 0.15, 0.2]),
    "from a kerb": raised(routes.straight(8, 0.5, WIDTH), [0.05, 0.0, 0.05, 0.0]),
    "onto a kerb at last": raised(routes.straight(6, 0.4, WIDTH), [0.0] * 7 + [0.05]),
    "all high": routes.platform(6, 0.4, WIDTH, 0.3, first=-1),
    "arc": raised(routes.arc(8, 0.45, 4.0, WIDTH), [0.0] * 4 + [0.03]),
}
# momentum turns the trunk too far at the end of the arc, as on level ground
CASES = [(gait, name) for gait in GAITS for name in WALKS if (gait, name) != ("momentum", "arc")]


def steps_of(footsteps):
    return plan_feet(footsteps, GAITS["normal"])


@pytest.mark.parametrize(("gait", "name"), CASES)
def test_the_horizontal_motion_is_that_of_level_ground(gait, name):
    walk, level = plan(WALKS[name], gait), plan(raised(WALKS[name], [0.0]), gait)
    times = np.linspace(0.0, walk.duration, 1001)
    here, there = walk.sample(times), level.sample(times)
    for field in ("com", "com_velocity", "com_acceleration"):
        np.testing.assert_array_equal(getattr(here, field)[:, :2], getattr(there, field)[:, :2])
    for field in ("moment", "angular_momentum", "stance"):
        np.testing.assert_array_equal(getattr(here, field), getattr(there, field))
    np.testing.assert_allclose(here.zmp, there.zmp, atol=2e-4 if gait == "normal" else 3e-3)


@pytest.mark.parametrize("left_out", ["zmp", "com_acceleration"])
def test_samples_of_a_walk_up_stairs_have_its_floor(left_out):
    walk = plan(WALKS["stairs"])
    samples = samples_of(walk)
    samples["com_acceleration"] = walk.sample(samples["times"]).com_acceleration
    del samples[left_out]
    here, there = (one.sample(np.linspace(0.0, walk.duration, 997)) for one in (made(samples), walk))
    assert np.ptp(there.floor) == pytest.approx(0.2)
    np.testing.assert_allclose(here.floor, there.floor, atol=1e-3)
    np.testing.assert_allclose(here.zmp, there.zmp, atol=3e-3)


def test_a_foot_stands_lower_beside_two_higher_footsteps():
    """The box around these two would reach under it."""
    steps = raised(routes.straight(4, 0.38, WIDTH), [0.0, 0.0, 0.0, 0.05, 0.05, 0.0])
    ground = Ground.under(steps, BODY.sole)
    places = np.array([step.position for step in steps])
    np.testing.assert_array_equal(ground.at(places[:, :2]), places[:, 2])


@pytest.mark.parametrize("name", WALKS)
def test_feet_swing_over_the_edges(name):
    """10 mm beside every edge there is room, too, but where the foot leaves and lands."""
    walk, ground = steps_of(WALKS[name]), Ground.under(WALKS[name], BODY.sole)
    times = np.linspace(0.0, walk.duration, 1501)
    for side, foot in zip(("left", "right"), walk.feet.sample(times), strict=True):
        for phase in walk.contacts.phases:
            if getattr(phase, side) is None:
                rows = np.abs((times - phase.start) / phase.duration - 0.5) < 0.4
                wide = foot.sole_points[rows, :, 2] - ground.at(foot.sole_points[rows, :, :2], 0.0099)
                assert wide.min() > 1e-4


def assert_walked(trial, limit):
    """Completed on a floor of the planned heights, within a limit of the ZMP error [m]."""
    record, measured, sample = trial.record, trial.measured, trial.comparison.sample
    assert_follows(trial, limit)
    # the contacts are at the heights of the footsteps, and the plane of the ZMP with them
    loaded = record.point_force[..., 2] > 0.0
    levels = np.array(sorted({step.position[2] for step in trial.plan.contacts.footsteps}))
    under = np.abs(record.point_position[..., 2][loaded][:, None] - levels)
    assert under.min(axis=1).max() < 2e-3
    assert (under.argmin(axis=1) == len(levels) - 1).sum() > 0.02 * len(under)
    single = (sample.phase == 0) & (measured.foot_contact.sum(axis=1) == 1)
    np.testing.assert_allclose(measured.floor[single], sample.floor[single], atol=1e-9)
    assert trial.metrics["zmp_agreement_rmse"].value < 1e-7
    assert trial.comparison.zmp_split.residual < 1e-12


HIGH = [pytest.param(name, marks=pytest.mark.slow) for name in ("up", "down", "up and down", "one foot")]


@pytest.mark.parametrize("name", ["stairs", *HIGH])
def test_the_human_walks_over_heights(name):
    run = ampm.load_run("normal", simulation={"time_step": 0.002})
    assert_walked(val.walk(run, footsteps=WALKS[name]), 0.8e-3)


@pytest.mark.parametrize("height", [0.05, pytest.param(-0.05, marks=pytest.mark.slow)])
def test_the_robot_walks_over_heights(height):
    run = gait_of("g1").replace({"simulation.time_step": 0.001})  # skips where its package is not installed
    trial = val.walk(run, footsteps=routes.platform(6, 0.24, 1.1 * run.gait.step_width, height, last=4))
    assert_walked(trial, 0.015 * trial.plan.feet.sole.length)
