"""Floors that slope: their plans, and what is measured; walks.csv has walks on them."""

from dataclasses import replace

import numpy as np
import pytest

import ampm
from ampm.planner import routes
from ampm.planner.newton import check_newton
from ampm.planner.sampled import sampled_plan
from tests import properties
from validation.progress import Progress
from validation.trial.plan import complete, load_request, plan_walk

STEEP = 0.0524
FOOTSTEPS = routes.as_rows(routes.straight(4, 0.5, 0.18))


def sloping(slope, preset="normal", *, across=0.0, steps=6, **sections):
    gait = {"steps": steps, "slope": slope, "cross_slope": across}
    return ampm.load_run(preset, gait=gait, simulation={"time_step": 2e-3}, **sections).as_is()


CASES = [
    ("normal", (STEEP, 0.0)),
    ("momentum", (STEEP, 0.0)),
    ("normal", (0.0, STEEP)),
    ("normal", (0.05, -0.03)),
]


@pytest.fixture(scope="module", params=CASES, ids=str)
def plans(request):
    """The same gait on level ground and on a slope."""
    preset, (along, across) = request.param
    runs = sloping(0.0, preset), sloping(along, preset, across=across)
    return [plan_walk(load_request(run)).plan for run in runs]


def test_only_heights_change_with_the_slope(plans):
    slope = np.array(plans[1].contacts.slope)
    times = np.linspace(0.0, plans[0].duration, 1001)
    level, uphill = (plan.sample(times) for plan in plans)
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
