"""Refusals by soles and legs alone: each names value, limit and a way out."""

import math
from dataclasses import replace

import pytest

from ampm.body.feasibility import check_body, check_motion
from ampm.body.motion import Extreme, MotionReport
from ampm.description import SoleGeometry
from ampm.exceptions import BodilyRefusal
from ampm.parameters import FootParameters, GaitParameters
from ampm.planner.support import plan_steps
from tests.solved import walk_of

SOLE = SoleGeometry(-0.107, 0.083, 0.151, 0.03, 0.04, 0.035, -0.042, 0.066)
BODY = replace(walk_of().robot.description, sole=SOLE, hip_half_width=0.085, leg_length=0.835)
ANKLE = BODY.legs[0].ankle[1]
FLAT = FootParameters(schedule="flat")
ROLL = FootParameters(swing_height=0.1)
RISE = "heel_rises_before_zmp_reaches_ball"


def flat(**values):
    return GaitParameters(**{"step_length": 0.4, "switching_velocity": 0.8, "steps": 4, **values})


def check(gait, foot):
    check_body(plan_steps(gait, 60.0, foot, SOLE), BODY)


# The way out of a long roll, a_s = 1.477 or more, is one.
@pytest.mark.parametrize("change", [{}, {"steps": 1}, {"a_s": 1.48}])
def test_an_easy_gait_passes(change):
    check(flat(**change), FLAT)


@pytest.mark.parametrize(
    ("gait", "foot", "reason", "value", "limit", "way_out"),
    [
        (flat(step_width=0.07), FLAT, "soles_overlap", 0.07, 0.08, "raise gait.step_width to 0.08 m"),
        (flat(a_s=1.4), FLAT, "zmp_leaves_sole", 0.158 / 1.4, 0.107, "raise gait.a_s to 1.477"),
        # The way out of the next refusal, too.
        (
            flat(a_s=1.4, com_height=0.95),
            FLAT,
            "zmp_leaves_sole",
            0.158 / 1.4,
            0.107,
            "lower gait.com_height",
        ),
        (flat(com_height=0.95), FLAT, "leg_too_short", 0.87724, 0.8517, "lower gait.com_height"),
        (GaitParameters(a_s=5.0), ROLL, RISE, 0.0474, 0.083, "lower gait.a_s to 2.855"),
        (GaitParameters(), FootParameters(heel_rise_lead=0.05), RISE, 0.07184, 0.083, "foot.heel_rise_lead"),
        (GaitParameters(a_s=math.inf), ROLL, RISE, 0.0, 0.083, "foot.schedule = flat"),
        # A step too short to roll is not told to roll more.
        (
            GaitParameters(step_length=0.2),
            ROLL,
            RISE,
            0.030038,
            0.083,
            "lengthen gait.step_length, lower",
        ),
        (
            GaitParameters(),
            FootParameters(swing_height=0.0, heel_strike_angle=0.0),
            "sole_under_floor",
            0.016754,
            1e-6,
            "raise foot.swing_height",
        ),
    ],
)
def test_a_bodily_refusal_names_value_limit_and_way_out(gait, foot, reason, value, limit, way_out):
    with pytest.raises(BodilyRefusal) as caught:
        check(gait, foot)
    refusal = caught.value
    assert refusal.way_out in str(refusal)
    assert str(refusal).count("raise gait.a_s") <= 1
    assert refusal.reason == reason
    assert refusal.value == pytest.approx(value, rel=1e-3)
    assert refusal.limit == pytest.approx(limit)
    assert f"{refusal.value:.4g} m" in str(refusal)
    assert way_out in refusal.way_out


@pytest.mark.parametrize(
    ("change", "reason", "words"),
    [
        ({"residual": 1e-6}, "no_periodic_motion", "gait."),
        ({"residual": math.nan}, "no_periodic_motion", "gait."),
        ({"knee_minimum": Extreme(0.05, 0.3, "left")}, "knee_too_straight", "left knee"),
        ({"joint_limit_margin": Extreme(-0.1, 0.3, ANKLE)}, "joint_limits", "raise gait.com_height"),
        ({"joint_limit_margin": Extreme(-0.1, 0.3, "neck")}, "joint_limits", "lower gait.com_height"),
        ({"clearance": Extreme(0.009, 0.3, "left hand and left thigh")}, "self_collision", "raise body.arm"),
        (
            {"clearance": Extreme(-0.1, 0.3, "left shank and right foot")},
            "self_collision",
            "raise gait.step",
        ),
    ],
)
def test_motions_that_do_not_return_or_pass_a_limit_are_refused(change, reason, words):
    good = Extreme(0.4, 0.1, "right")
    report = MotionReport(0.4, 1e-10, 0.0, (), good, good, good)
    check_motion(report, BODY)
    with pytest.raises(BodilyRefusal) as caught:
        check_motion(replace(report, **change), BODY)
    assert caught.value.reason == reason
    assert words in str(caught.value)
