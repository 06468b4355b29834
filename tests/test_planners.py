"""Planners and postures: the periodic one, and one of a user's own, walked."""

import numpy as np
import pinocchio as pin
import pytest

from ampm.body.motion import PeriodicPosture
from ampm.exceptions import InputError
from ampm.planners import PeriodicPlanner, TablePlanner
from tests.solved import COARSE, motion_of, walk_of
from tests.test_disturbances import example
from tests.test_motion import same
from validation.run.walk import walk_planned
from validation.study.sweep.design import parse_sweep
from validation.trial.plan import Request, load_request, plan_walk

UprightWalk = example("upright_walk").UprightWalk


@pytest.fixture(scope="module")
def inputs():
    """Run and body."""
    return walk_of(COARSE).run, walk_of(COARSE).robot


def test_the_periodic_walk_is_the_plan_with_its_motion(inputs):
    plan, motion = PeriodicPlanner().plan(*inputs), motion_of(COARSE)
    assert isinstance(plan.posture, PeriodicPosture)
    assert same(plan.posture.motion, motion)
    assert plan.constants.angular_momentum_y_offset == motion.report.angular_momentum_y_offset
    assert plan.posture.report() == motion.report.as_dict()
    body = plan.posture.sample([0.1, 0.9])
    assert body.q.tobytes() == motion.sample([0.1, 0.9], inputs[1]).q.tobytes()


def test_a_swaying_posture_begins_on_the_plan(inputs):
    plan, robot = UprightWalk().plan(*inputs), inputs[1]
    begin = plan.posture.sample([0.0]).q[0]
    data = robot.model.createData()
    velocity = plan.posture.sample([0.0]).v[0]
    momentum = pin.computeCentroidalMomentum(robot.model, data, begin, velocity)
    np.testing.assert_allclose(data.com[0], plan.sample(0.0).com[0], rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(
        momentum.linear / robot.mass, plan.sample(0.0).com_velocity[0], rtol=0.0, atol=1e-9
    )


def test_a_swaying_posture_is_near_the_periodic_motion(inputs):
    sway, orbit = UprightWalk().plan(*inputs), PeriodicPlanner().plan(*inputs)
    offset = orbit.constants.angular_momentum_y_offset
    assert sway.constants.angular_momentum_y_offset == pytest.approx(offset, rel=0.1)
    times = np.linspace(0.05, 2.0 * orbit.constants.step_duration, 40)
    pitch = [-np.arcsin(plan.posture.sample(times).trunk[:, 2, 0]) for plan in (sway, orbit)]
    assert np.ptp(pitch[0]) > 0.15  # [rad]; in the orbit the waist turns as well
    assert abs(pitch[0].mean()) < 0.02
    assert np.corrcoef(pitch)[0, 1] > 0.95
    sway = sway.posture.sway
    np.testing.assert_allclose(sway[0], sway[-1], rtol=0.0, atol=1e-9)  # it repeats


def test_a_sway_of_one_step_is_refused():
    with pytest.raises(InputError, match=r"gait\.steps of at least 2"):
        plan_walk(load_request("normal", ["gait.steps=1"]), planner=UprightWalk())


def test_a_table_planner_takes_columns():
    with pytest.raises(InputError, match="columns, not a file"):
        TablePlanner("plan.csv")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("gait", "steps", "largest"),
    [("normal", 4, 0.75e-3), *(pytest.param(*case, marks=pytest.mark.slow) for case in
     (("normal", 30, 0.65e-3), ("momentum", 100, 0.74e-3)))],
)  # fmt: skip
def test_a_gait_walks_with_a_swaying_posture(gait, steps, largest):
    settings = [f"gait.steps={steps}"]
    walked = walk_planned(plan_walk(load_request(gait, settings), planner=UprightWalk()))
    assert walked.record.outcome.completed, walked.record.outcome.cause
    metrics = walked.metrics
    assert metrics["zmp_x_rmse"].value < largest
    assert metrics["zmp_y_rmse"].value < 0.4e-3
    with pytest.raises(InputError, match="SwayingPosture"):
        _ = walked.planned.motion


def test_a_sweep_over_planners_plans_every_gait_with_each():
    sweep = parse_sweep('[[vary]]\nmethod = "list"\ngait.planner = ["ampm", "preview", "dcm"]\n')
    runs = [sweep.parameters(run).replace({"solver.ik_time_step": 0.004}) for run in range(len(sweep))]
    plans = [plan_walk(Request(sweep.name_of(run), values)).plan for run, values in enumerate(runs)]
    times = np.linspace(0.0, plans[0].constants.step_duration, 50)
    zmp = [plan.sample(times).zmp[:, 0] for plan in plans]
    for one, other in ((0, 1), (0, 2), (1, 2)):
        assert np.abs(zmp[one] - zmp[other]).max() > 1e-3
