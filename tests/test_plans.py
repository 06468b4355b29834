"""All plans, of gaits, other planners, footsteps and heights, have the properties of a plan."""

import numpy as np
import pytest

import ampm
from ampm.planner.contacts import Footstep
from ampm.planner.heights import Ground
from ampm.planner.sampled import SampledLaw
from ampm.planner.step_planners import STEP_PLANNERS
from tests import properties, test_feet, test_footstep_walk, test_footsteps, test_heights
from tests.solved import body_of

SOLE = body_of().description.sole
OTHERS = ("ipm", "preview", "dcm")
PERIODIC = [(name, "ampm") for name in ("normal", "momentum", "flat", "pitch")]
PERIODIC += [(name, planner) for name in ("normal", "momentum", "flat") for planner in OTHERS]
LEVEL = [(name, walk) for name in test_footsteps.GAITS for walk in test_footsteps.WALKS]


@pytest.mark.parametrize(("name", "planner"), PERIODIC)
def test_steps_of_a_gait_obey_newton_and_mirror_each_other(name, planner):
    run = ampm.load_run(name, gait={"steps": 4})
    plan = STEP_PLANNERS[planner](run.gait, run.body.mass, run.foot, SOLE)
    times = properties.inside(plan)
    if planner in ("preview", "dcm"):  # between its samples the ZMP is interpolated
        times = np.concatenate(
            [phase.start + phase.x.time[:-1] for phase in plan.phases if isinstance(phase.x, SampledLaw)]
        )
        assert plan.least_zmp_margin()[0] > 0.0
    properties.assert_newton_euler(plan, times)
    properties.assert_rates(plan)
    properties.assert_mirrored(plan)
    jumps = planner == "ipm"
    assert (max(plan.residuals().values()) < 1e-11) != jumps
    assert bool(plan.jump_times.size) == jumps
    if planner in OTHERS:  # the force passes through the COM
        assert not plan.sample(properties.inside(plan)).moment.any()


@pytest.mark.parametrize(("gait", "name"), LEVEL)
def test_a_walk_over_footsteps_obeys_newton_from_rest_to_rest(gait, name):
    properties.assert_walk(test_footsteps.plan(test_footsteps.WALKS[name], gait), test_footsteps.SOLE)


@pytest.mark.parametrize(("gait", "name"), test_heights.CASES)
def test_so_does_one_over_heights(gait, name):
    properties.assert_walk(test_heights.plan(test_heights.WALKS[name], gait), test_heights.BODY.sole)


def mirrored(step):
    """The footstep of the other foot."""
    x, y, z = step.position
    return Footstep("left" if step.foot == "right" else "right", (x, -y, z), -step.heading)


@pytest.mark.parametrize(("gait", "name"), LEVEL)
def test_the_mirror_image_of_footsteps_has_the_mirror_image_of_the_plan(gait, name):
    footsteps = test_footsteps.WALKS[name]
    one, other = (test_footsteps.plan(steps, gait) for steps in (footsteps, list(map(mirrored, footsteps))))
    times = np.linspace(0.0, one.duration, 300)
    one, other = one.sample(times), other.sample(times)
    for name, turn in (("com", [1, -1, 1]), ("zmp", [1, -1]), ("angular_momentum", [-1, 1])):
        np.testing.assert_allclose(getattr(other, name), turn * getattr(one, name), atol=1e-9, err_msg=name)


def feet_of(kind, name):
    """Plan with feet, and the floor under it (None: level)."""
    if kind == "schedule":
        return test_feet.planned(test_feet.SCHEDULES[name]), None
    if kind == "height":
        footsteps = test_heights.WALKS[name]
        return test_heights.steps_of(footsteps), Ground.under(footsteps, test_heights.BODY.sole)
    run = ampm.load_run("normal", foot={"heel_rise_lead": 0.0 if kind == "footsteps" else -0.1})
    return test_footstep_walk.plan(test_footstep_walk.WALKS[name], run), None


FEET = {
    "schedule": test_feet.SCHEDULES,
    "height": test_heights.WALKS,
    "footsteps": test_footstep_walk.WALKS,
    "early rise": test_footstep_walk.WALKS,
}


@pytest.mark.parametrize(("kind", "name"), [(kind, name) for kind, names in FEET.items() for name in names])
def test_feet_move_smoothly_and_stand_where_they_should(kind, name):
    plan, ground = feet_of(kind, name)
    properties.assert_feet_move(plan)
    properties.assert_feet_stand(plan, ground, over=kind != "schedule")
