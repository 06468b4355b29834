"""Footsteps of different heights and floors that slope: their plans, and the walks over them."""

import math
from dataclasses import replace

import numpy as np
import pytest

import ampm
import validation as val
from ampm.planner import routes
from ampm.planner.contacts import Footstep
from ampm.planner.heights import Ground
from ampm.planner.newton import check_newton
from ampm.planner.sampled import sampled_plan
from tests import properties
from tests.test_footstep_walk import plan as plan_feet
from tests.test_footsteps import BODY, GAITS, plan
from tests.test_make_plan import made, samples_of
from tests.test_walk_motion import gait_of
from tests.walk import assert_follows
from validation.progress import Progress
from validation.trial.plan import complete, load_request, plan_walk

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


@pytest.mark.parametrize(("gait", "name"), CASES)
def test_the_horizontal_motion_is_that_of_level_ground(gait, name):
    walk, level = plan(WALKS[name], gait), plan(raised(WALKS[name], [0.0]), gait)
    here, there = (one.sample(np.linspace(0.0, one.duration, 1001)) for one in (walk, level))
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


def test_edges_lie_along_a_later_footstep_where_the_first_leaves_no_room():
    """Stairs along 45 degrees after a turn in place: boxes along the first footstep overlap."""
    half, tread = 0.1 * math.sqrt(0.5), 0.35 * math.sqrt(0.5)
    places = [
        (tread * k - side * half, tread * k + side * half, 0.03 * k)
        for k, side in zip((0, 1, 2, 3, 4, 4), (1, -1, 1, -1, 1, -1), strict=True)
    ]
    stairs = [Footstep("left", place, 0.25 * math.pi) for place in places]
    ground = Ground.under([Footstep("left", (-1.0, 0.0, 0.0), 0.0), *stairs], BODY.sole)
    assert ground.heading == 0.25 * math.pi
    np.testing.assert_allclose(ground.at(np.array(places)[:, :2]), np.array(places)[:, 2], atol=1e-12)


@pytest.mark.parametrize("name", WALKS)
def test_feet_swing_over_the_edges(name):
    """10 mm beside every edge there is room, too, but where the foot leaves and lands."""
    walk, ground = plan_feet(WALKS[name], GAITS["normal"]), Ground.under(WALKS[name], BODY.sole)
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


STEEP = 0.0524


def sloping(slope, preset="normal", *, across=0.0, steps=6, **sections):
    gait = {"steps": steps, "slope": slope, "cross_slope": across}
    return ampm.load_run(preset, gait=gait, simulation={"time_step": 2e-3}, **sections).as_is()


SLOPES = [("normal", STEEP, 0.0), ("momentum", STEEP, 0.0), ("normal", 0.0, STEEP), ("normal", 0.05, -0.03)]


@pytest.fixture(scope="module", params=SLOPES, ids=str)
def plans(request):
    """The same gait on level ground and on a slope."""
    preset, along, across = request.param
    runs = sloping(0.0, preset), sloping(along, preset, across=across)
    return [plan_walk(load_request(run)).plan for run in runs]


def test_only_heights_change_with_the_slope(plans):
    slope = np.array(plans[1].contacts.slope)
    level, uphill = (plan.sample(np.linspace(0.0, plans[0].duration, 1001)) for plan in plans)
    np.testing.assert_allclose(uphill.moment, level.moment, atol=1e-9)
    constant = [plan.constants.angular_momentum_y_offset for plan in plans]  # the body's
    momentum = uphill.angular_momentum - [0.0, constant[1] - constant[0]]
    np.testing.assert_allclose(momentum, level.angular_momentum, atol=1e-9)
    np.testing.assert_allclose(uphill.com[:, :2], level.com[:, :2], atol=1e-12)
    np.testing.assert_allclose(uphill.com[:, 2], level.com[:, 2] + level.com[:, :2] @ slope, atol=1e-12)
    here, there = ((plan.com[:, :2] - plan.zmp) @ slope for plan in (uphill, level))
    np.testing.assert_allclose(here, there, atol=1e-12)
    assert np.abs(uphill.zmp - level.zmp).max() < 3e-3
    assert check_newton(plans[1]) < 1e-8


def test_a_search_across_a_slope_says_what_it_found():
    said = []
    progress = type("Said", (Progress,), {"say": lambda self, text: said.append(text)})()
    complete(load_request("normal", ["gait.cross_slope=-0.05"]), progress)
    assert said == ["normal, gait.cross_slope -0.05: the open values fit as they are"]


def test_soles_lie_on_the_slope_and_move_continuously(plans):
    uphill = plans[1]
    times = np.linspace(0.0, uphill.duration, 4001)
    for foot in uphill.feet.sample(times):
        height = foot.sole_points[..., 2] - foot.sole_points[..., :2] @ uphill.contacts.slope
        touching = np.repeat(foot.contact, 2, axis=1)
        assert np.abs(height[touching]).max() < 1e-9
        assert height.min() > -1e-9
    properties.assert_feet_move(uphill)


@pytest.mark.parametrize("left_out", ["zmp", "com_acceleration", "moment"])
def test_samples_on_a_slope_are_those_of_the_plan(plans, left_out):
    names, times = ("zmp", "com_acceleration", "moment"), np.linspace(0.0, plans[1].duration, 2001)
    sample = plans[1].sample(times)
    given = {name: getattr(sample, name)[:, :2] for name in names if name != left_out}
    found = sampled_plan(replace(plans[1], phases=()), times, com=sample.com, **given).sample(times)
    for name in names:
        np.testing.assert_allclose(getattr(found, name), getattr(sample, name), atol=1e-6, err_msg=name)
    other = replace(plans[1], phases=(), contacts=replace(plans[1].contacts, slope=(0.01, 0.0)))
    with pytest.raises(ampm.InputError, match="{:g} and {:g} fit best".format(*plans[1].contacts.slope)):
        sampled_plan(other, times, com=sample.com, **given)
