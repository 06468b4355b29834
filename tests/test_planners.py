"""Planners and postures: the periodic one, and one of a user's own, walked."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from ampm.exceptions import InputError
from tests.solved import COARSE, walk_of
from tests.test_disturbances import example
from validation.run.walk import walk_planned
from validation.study.sweep.design import parse_sweep
from validation.trial.plan import Request, load_request, plan_walk

UprightWalk = example("upright_walk").UprightWalk


@pytest.fixture(scope="module")
def inputs():
    """Run and body."""
    return walk_of(COARSE).run, walk_of(COARSE).robot


def test_a_constant_posture_begins_on_the_plan(inputs):
    plan, robot = UprightWalk().plan(*inputs), inputs[1]
    begin = plan.posture.sample([0.0]).q[0]
    data = robot.model.createData()
    velocity = plan.posture.sample([0.0]).v[0]
    momentum = pin.computeCentroidalMomentum(robot.model, data, begin, velocity)
    np.testing.assert_allclose(data.com[0], plan.sample(0.0).com[0], rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(
        momentum.linear / robot.mass, plan.sample(0.0).com_velocity[0], rtol=0.0, atol=1e-9
    )


@pytest.mark.parametrize(
    ("gait", "steps", "largest"),
    [("normal", 4, 1.2e-3), pytest.param("momentum", 100, 1.0e-3, marks=pytest.mark.slow)],
)
def test_a_gait_walks_with_a_constant_posture(gait, steps, largest):
    settings = [f"gait.steps={steps}"]
    walked = walk_planned(plan_walk(load_request(gait, settings), planner=UprightWalk()))
    assert walked.record.outcome.completed, walked.record.outcome.cause
    metrics = walked.metrics
    assert metrics["zmp_x_rmse"].value < largest
    assert metrics["zmp_y_rmse"].value < 0.7e-3
    with pytest.raises(InputError, match="ConstantPosture"):
        _ = walked.planned.motion


def test_a_sweep_over_planners_plans_every_gait_with_each():
    sweep = parse_sweep('[[vary]]\nmethod = "list"\ngait.planner = ["ampm", "preview", "dcm"]\n')
    runs = [sweep.parameters(run).replace({"solver.ik_time_step": 0.004}) for run in range(len(sweep))]
    plans = [plan_walk(Request(sweep.name_of(run), values)).plan for run, values in enumerate(runs)]
    times = np.linspace(0.0, plans[0].constants.step_duration, 50)
    zmp = [plan.sample(times).zmp[:, 0] for plan in plans]
    for one, other in ((0, 1), (0, 2), (1, 2)):
        assert np.abs(zmp[one] - zmp[other]).max() > 1e-3


def test_a_planner_that_leaves_out_the_footsteps_is_refused():
    request = load_request("flat", ["gait.steps=4"])
    sides = [("left", 0.3), ("right", 0.1)] * 3
    sideways = [{"foot": foot, "x": 0.3 * i, "y": y} for i, (foot, y) in enumerate(sides)]
    request = replace(request, run=request.run.replace({}, footsteps=sideways))
    with pytest.raises(InputError, match=r"UprightWalk does not step on footstep 1 .* leave them out"):
        plan_walk(request, planner=UprightWalk())
