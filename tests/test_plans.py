"""All plans, of gaits, other planners, footsteps and heights, have the properties of a plan.

IPM, preview control and DCM planning are held to their own equations.
"""

import math

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

import ampm
from ampm.parameters import GRAVITY
from ampm.planner.contacts import Footstep
from ampm.planner.heights import Ground
from ampm.planner.sampled import SampledLaw
from ampm.planner.step_planners import JERK_WEIGHT, SAMPLE_TIME, STEP_PLANNERS, reference_zmp
from ampm.planner.step_planners import step_axes as axes_of
from tests import properties, test_footstep_walk, test_footsteps, test_gait, test_heights
from tests.solved import body_of
from tests.test_footstep_walk import plan as plan_feet

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
        return test_gait.planned(test_gait.SCHEDULES[name]), None
    if kind == "height":
        footsteps = test_heights.WALKS[name]
        return plan_feet(footsteps, test_footsteps.GAITS["normal"]), Ground.under(footsteps, SOLE)
    run = ampm.load_run("normal", foot={"heel_rise_lead": 0.0 if kind == "footsteps" else -0.1})
    return plan_feet(test_footstep_walk.WALKS[name], run), None


FEET = {
    "schedule": test_gait.SCHEDULES,
    "height": test_heights.WALKS,
    "footsteps": test_footstep_walk.WALKS,
    "early rise": test_footstep_walk.WALKS,
}


@pytest.mark.parametrize(("kind", "name"), [(kind, name) for kind, names in FEET.items() for name in names])
def test_feet_move_smoothly_and_stand_where_they_should(kind, name):
    plan, ground = feet_of(kind, name)
    properties.assert_feet_move(plan)
    properties.assert_feet_stand(plan, ground, over=kind != "schedule")


def plans_of(name, planner):
    """The AMPM's plan of a gait and another planner's."""
    run = ampm.load_run(name, gait={"steps": 4})
    return [STEP_PLANNERS[which](run.gait, 60.0, run.foot, SOLE) for which in ("ampm", planner)]


def test_the_dcm_obeys_its_dynamics_and_its_recursion():
    """xi' = w (xi - p); single support closed form, double support a cubic of xi; both ends of it meet."""
    own, plan = plans_of("normal", "dcm")
    w, h = math.sqrt(GRAVITY / plan.com_height), 1e-6
    times = properties.inside(plan, 60)
    sample, before, after = (plan.sample(times + shift) for shift in (0.0, -h, h))
    np.testing.assert_allclose((after.dcm - before.dcm) / (2 * h), w * (sample.dcm - sample.zmp), atol=1e-5)

    single, double = plan.contacts.phases[:2]
    inner = double.start + double.duration * np.linspace(0.01, 0.99, 9)
    assert np.abs(np.diff(plan.sample(inner).dcm, 4, axis=0)).max() < 1e-9
    assert np.abs(np.diff(plan.sample(inner).dcm, 3, axis=0)).max() > 1e-7  # no parabola

    # Backwards from the start of the next single support, the ZMP at its heel for half of the double support,
    # then at the toe: the end of this single support (Englsberger et al. 2015).
    toe, heel = plan.sample(double.start).zmp[0], plan.sample(double.start + double.duration).zmp[0]
    fade = math.exp(-0.5 * w * double.duration)
    middle = heel + (plan.sample(double.start + double.duration).dcm[0] - heel) * fade
    first = toe + (middle - toe) * fade
    np.testing.assert_allclose(plan.sample(double.start).dcm[0], first, rtol=0.0, atol=1e-12)
    roll = own.constants.l_s * own.constants.inverse_a_s
    np.testing.assert_allclose(plan.sample([0, single.duration]).zmp[:, 0], [-roll, roll], rtol=0, atol=1e-12)


def preview_gains(height, period):
    """Cart-table A, B, C, and the servo's gains of error, state and preview (Kajita et al. 2003)."""
    A = np.array([[1.0, period, 0.5 * period**2], [0.0, 1.0, period], [0.0, 0.0, 1.0]])
    B = np.array([[period**3 / 6.0], [0.5 * period**2], [period]])
    C = np.array([[1.0, 0.0, -height / GRAVITY]])
    big_A, big_B = np.block([[np.ones((1, 1)), C @ A], [np.zeros((3, 1)), A]]), np.vstack([C @ B, B])
    P = solve_discrete_are(big_A, big_B, np.diag([1.0, 0.0, 0.0, 0.0]), [[JERK_WEIGHT]])
    scale = JERK_WEIGHT + (big_B.T @ P @ big_B)[0, 0]
    of_state = big_B.T @ P @ np.vstack([C @ A, A]) / scale
    closed = big_A - big_B @ (big_B.T @ P @ big_A) / scale
    preview, ahead = [], -P @ np.eye(4)[:, 0]
    for _ in range(round(6.4 / period)):
        preview.append((big_B.T @ ahead)[0] / scale)
        ahead = closed.T @ ahead
    return A, B[:, 0], C[0], (big_B.T @ P)[0, 0] / scale, of_state[0], np.array(preview)


def test_preview_control_is_what_the_papers_servo_comes_to():
    """From any start, with the sum of errors as its integrator and 6.4 s of preview."""
    _, plan = plans_of("normal", "preview")
    count = round(plan.constants.step_duration / SAMPLE_TIME)
    period = plan.constants.step_duration / count
    A, B, C, of_error, of_state, preview = preview_gains(plan.com_height, period)
    axes, laws = axes_of(plans_of("normal", "ampm")[0]), (plan.phases[0].x, plan.phases[0].y)
    for axis, law in zip(axes, laws, strict=True):
        ahead, number = len(preview), 20 * count
        reference = reference_zmp(plan, axis, period * np.arange(number + ahead + 1))
        state, total, states = np.array([0.05, 0.1, 0.0]), 0.0, []
        for k in range(number):
            states.append(state)
            total += C @ state - reference[k]
            jerk = -of_error * total - of_state @ state - preview @ reference[k + 1 : k + 1 + ahead]
            state = A @ state + B * jerk
        expected = np.array(states[18 * count : 19 * count]).T  # an even step, like the first
        expected[0] -= 18 * axis.shift
        motion = np.array([law.position, law.velocity, law.acceleration])[:, :count]
        np.testing.assert_allclose(motion, expected, rtol=0.0, atol=1e-6)
