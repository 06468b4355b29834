"""Errata of the paper that the laws of one phase do not show: orders, shapes, signs, posture, feet.

The others are in ``test_pendulum.py`` and ``test_gait.py``. As there, the printed form fails and the
corrected one passes; nothing here uses the audit.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.linalg import null_space

from ampm.body.inverse_kinematics import InverseKinematics
from ampm.parameters import load_run
from ampm.planner.gait import plan_gait
from tests.solved import COARSE, motion_of, walk_of


@pytest.fixture(scope="module")
def normal():
    run = load_run("normal")
    return plan_gait(run.gait, mass=run.body.mass)


@pytest.fixture(scope="module")
def momentum():
    run = load_run("momentum")
    return plan_gait(run.gait, mass=run.body.mass)


@pytest.fixture(scope="module")
def jacobian():
    """J_all of Eq. 11: COM, angular momentum, left foot, right foot."""
    robot, motion = walk_of(COARSE).robot, motion_of(COARSE)
    return robot.jacobian(motion.q[20], motion.v[20]).jacobian[:18].copy()


def test_e14_a_cost_is_a_number():
    deviation = np.arange(40.0).reshape(40, 1)
    assert (deviation @ deviation.T).shape == (40, 40)  # printed
    assert (deviation.T @ deviation).shape == (1, 1)


def test_e16_two_orders_of_lambda_do_not_mix(jacobian):
    motion, robot = motion_of(COARSE), walk_of(COARSE).robot
    acceleration = motion.acceleration[20]
    robot.jacobian(motion.q[20], motion.v[20])
    drift = robot.drift(motion.q[20], motion.v[20]).drift[:18]
    task = jacobian @ acceleration + drift  # p_l, theta_l, p_r, theta_r, as in lambda
    eq_10 = np.r_[0:9, 12:15, 9:12, 15:18]  # p_l, p_r, theta_l, theta_r
    mixed = jacobian[eq_10] @ acceleration + drift[eq_10]
    assert np.abs(mixed - task).max() > 1.0
    np.testing.assert_allclose(mixed, task[eq_10])  # one order, whichever


def test_e18_the_printed_cost_leaves_directions_without_any(jacobian):
    walk = walk_of(COARSE)
    free = null_space(jacobian)
    assert free.shape[1] == walk.robot.nv - 18 == 22
    loins_and_chest = np.concatenate([[3, 4, 5], walk.robot.trunk_joints])
    printed = np.zeros(walk.robot.nv)
    printed[loins_and_chest] = 1.0
    ours = InverseKinematics(walk.robot, walk.run).weights
    curvature = {
        name: np.linalg.eigvalsh(free.T @ (weights[:, None] * free))
        for name, weights in (("printed", printed), ("ours", ours))
    }
    assert np.count_nonzero(curvature["printed"] < 1e-10) >= 22 - len(loins_and_chest)
    assert curvature["ours"].min() > 1e-4


def test_e19_the_force_is_along_the_vector_not_normal_to_it(normal):
    state = normal.switch_times[0]
    sample = normal.sample(state)
    force = sample.force[0, [0, 2]]
    meets = sample.com[0, 0] - sample.moment[0, 1] / normal.weight  # M_y = -m g (meets - x)
    vector = np.array([meets - sample.zmp[0, 0], normal.parameters.com_height])
    assert force[0] * vector[1] - force[1] * vector[0] == pytest.approx(0.0, abs=1e-9)
    assert abs(force @ vector) > normal.weight * 0.8  # printed: a normal vector


def test_e20_what_is_generated_adds_up(momentum):
    end = momentum.constants.single_support_duration
    l_0, l_1, l_2 = momentum.sample([0.0, 0.3 * end, end]).angular_momentum[:, 1]
    printed = (l_2 - l_0 + l_0) - (l_1 - l_0 + l_0) - (l_2 - l_1 + l_1)  # omega_1 in every piece
    assert abs(printed) > 0.1
    assert (l_2 - l_0) - (l_1 - l_0) - (l_2 - l_1) == pytest.approx(0.0, abs=1e-12)


def test_e22_the_momentum_is_largest_where_the_moment_vanishes(momentum):
    start = momentum.constants.single_support_duration
    times = start + np.linspace(0.0, 0.5, 50) * momentum.constants.double_support_duration
    sample = momentum.sample(times)
    assert (np.diff(np.abs(sample.moment[:, 0])) < 0.0).all()
    assert (np.diff(np.abs(sample.angular_momentum[:, 0])) > 0.0).all()  # printed: decreases
    assert sample.moment[-1, 0] == pytest.approx(0.0, abs=1e-9)


def test_e23_the_com_crosses_the_midline_within_the_double_support(normal):
    gait, constants = normal.parameters, normal.constants
    w_d = math.sqrt(normal.gravity * gait.c_y * constants.s / (gait.com_height * constants.beta))
    t = np.linspace(0.0, constants.double_support_duration, 101)
    sine = constants.lateral_switching_velocity / w_d * np.sin(w_d * t)
    cosine = constants.beta * np.cos(w_d * t)
    planned = -normal.sample(constants.single_support_duration + t * (1 - 1e-12)).com[:, 1]
    np.testing.assert_allclose(sine - cosine, planned, atol=1e-12)
    assert planned[0] < 0.0 < planned[-1]
    printed = sine + cosine  # both signs alike: away from the midline, whichever way y points
    assert (printed > 0.0).all()


def test_e24_one_single_support_does_not_compensate_itself(momentum):
    start, end, next_end = momentum.sample(
        [0.0, momentum.constants.single_support_duration, 2.0 * momentum.constants.step_duration]
    ).angular_momentum[:, 0]
    assert abs(end - start) > 1.0  # printed: symmetry in time compensates
    assert next_end == pytest.approx(start)


def test_e25_a_cubic_cannot_leave_a_rest_without_a_jump(normal):
    duration = normal.constants.single_support_duration
    travel = 2.0 * normal.parameters.step_length
    for speed in (0.0, normal.constants.l_s / duration):
        cubic = CubicSpline([0.0, duration], [0.0, travel], bc_type=((1, speed), (1, 0.0)))
        assert abs(cubic(0.0, 2)) > 10.0
        assert abs(cubic(duration, 2)) > 10.0
    walk = walk_of(COARSE)
    assert walk.plan.feet is not None
    lift = walk.plan.constants.step_duration
    before, after = (walk.plan.feet.sample(lift + e)[0].acceleration for e in (-1e-9, 1e-9))
    np.testing.assert_allclose(after, before, atol=1e-4)


def test_e27_the_mode_plans_no_momentum_about_the_vertical(normal, jacobian):
    planned = 3 + normal.sample(0.0).moment.shape[1] + 12  # COM, moment, feet
    assert planned == jacobian.shape[0] - 1


def test_e28_blocks_of_unequal_height_do_not_stand_side_by_side(jacobian):
    blocks = jacobian[:3], jacobian[3:6], jacobian[6:]
    with pytest.raises(ValueError, match="must match"):
        np.hstack(blocks)
    np.testing.assert_array_equal(np.vstack(blocks), jacobian)


def test_e29_integrating_on_leaves_the_periodic_motion():
    report = motion_of(COARSE).report
    assert max(abs(complex(*pair)) for pair in report.multipliers) > 1.01
    assert report.residual < 1e-9


def test_e31_c_y_is_about_the_anterior_axis():
    sizes = []
    for c_y in (0.1, 1.0):
        run = load_run("momentum", [f"gait.c_y={c_y}"])
        plan = plan_gait(run.gait, mass=run.body.mass)
        times = np.linspace(0.0, 2.0 * plan.constants.step_duration, 2001)
        sizes.append(np.ptp(plan.sample(times).angular_momentum, axis=0))
    assert sizes[0][0] > sizes[1][0] + 10.0
    assert sizes[0][1] == pytest.approx(sizes[1][1])


def test_e32_a_moment_of_the_other_sign_is_made_by_swinging_less():
    swing = [float(np.ptp(motion_of(COARSE, f"gait.c_s={c_s}").trunk_pitch)) for c_s in (0.7, 1.0, 1.3)]
    assert swing == sorted(swing)


def test_e34_a_small_moment_swings_the_trunk_less_than_none():
    c_y = (0.4, 0.7, 0.9, 1.0, 1.1)
    swing = [trunk_roll(f"gait.c_y={value}") for value in c_y]
    assert momentum_about_x("gait.c_y=0.9") > 1.0 > momentum_about_x("gait.c_y=1.0")
    assert swing[2] < 0.5 * swing[3]  # printed: by the size of the moment, so more than with none
    assert swing[:3] == sorted(swing[:3], reverse=True)
    assert swing[2:] == sorted(swing[2:])


def trunk_roll(*overrides):
    """Peak to peak roll of the trunk over two steps, of which the second mirrors the first [rad]."""
    robot, motion = walk_of(COARSE, *overrides).robot, motion_of(COARSE, *overrides)
    roll = []
    for q, v in zip(motion.q, motion.v, strict=True):
        robot.jacobian(q, v)
        rotation = robot.rotation_of(robot.trunk_frame)
        roll.append(math.atan2(rotation[2, 1], rotation[2, 2]))
    return 2.0 * float(np.abs(roll).max())


def momentum_about_x(*overrides):
    """Peak to peak planned L_x over two steps [N m s]."""
    plan = walk_of(COARSE, *overrides).plan
    times = np.linspace(0.0, 2.0 * plan.constants.step_duration, 2001)
    return float(np.ptp(plan.sample(times).angular_momentum[:, 0]))
