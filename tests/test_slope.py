"""Floors that slope, known to the plan or not, and other floors that are not the plan's."""

import numpy as np
import pytest

import ampm
import validation as val
from ampm.planner.newton import newton_residual
from ampm.planners import FootstepPlanner
from validation.trial.plan import load_request, plan_walk

STEEP = 0.0524
PLACES = [("left", 0.0), ("right", 0.0), ("left", 0.5), ("right", 1.0), ("left", 1.5), ("right", 1.5)]
FOOTSTEPS = [{"foot": side, "x": x, "y": 0.09 if side == "left" else -0.09} for side, x in PLACES]


def sloping(slope, preset="normal", *, steps=6, **sections):
    gait = {"steps": steps, "slope": slope}
    return ampm.load_run(preset, gait=gait, simulation={"time_step": 2e-3}, **sections).as_is()


@pytest.fixture(scope="module", params=["normal", "momentum"])
def plans(request):
    """The same gait on level ground and uphill."""
    return [plan_walk(load_request(sloping(k, request.param))).plan for k in (0.0, STEEP)]


def test_only_heights_change_with_the_slope(plans):
    times = np.linspace(0.0, plans[0].duration, 1001)
    level, uphill = (plan.sample(times) for plan in plans)
    np.testing.assert_allclose(uphill.moment, level.moment, atol=1e-9)
    constant = [plan.constants.angular_momentum_y_offset for plan in plans]  # the body's
    momentum = uphill.angular_momentum - [0.0, constant[1] - constant[0]]
    np.testing.assert_allclose(momentum, level.angular_momentum, atol=1e-9)
    np.testing.assert_allclose(uphill.com[:, :2], level.com[:, :2], atol=1e-12)
    np.testing.assert_allclose(uphill.com[:, 2], level.com[:, 2] + STEEP * level.com[:, 0], atol=1e-12)
    np.testing.assert_allclose(uphill.zmp[:, 0], level.zmp[:, 0], atol=1e-12)
    assert np.abs(uphill.zmp[:, 1] - level.zmp[:, 1]).max() < 1e-3
    assert newton_residual(plans[1], times).size < 1e-8


def test_footsteps_on_the_slope_that_are_stopped_pass():
    trial = val.walk(sloping(-STEEP, footsteps=FOOTSTEPS), planner=FootstepPlanner([(1.5, None)]))
    assert trial.verdict.passed, trial.sentence


def off(**changed):
    """Footsteps of which one is elsewhere."""
    return [*FOOTSTEPS[:3], FOOTSTEPS[3] | changed, *FOOTSTEPS[4:]]


class Level:
    """A planner that does not look at the run's slope."""

    def plan(self, run, robot):
        return ampm.PeriodicPlanner().plan(run.replace({"gait.slope": 0.0}), robot)


def test_the_zmp_is_measured_on_an_unknown_slope():
    trial = val.walk(sloping(0.0, disturbance={"slope_along": 0.02}))
    measured = trial.measured
    last = measured.floor[-1]
    assert last == pytest.approx(0.02 * (measured.zmp[-1, 0] - 0.3), abs=0.01)
    assert trial.metrics["zmp_x_rmse"].value < 0.015
