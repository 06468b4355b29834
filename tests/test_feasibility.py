"""What a body refuses by soles and legs alone: each refusal names value, limit and a way out."""

import math

import pytest

from ampm.body.feasibility import check_body
from ampm.description import BodyDescription, LegDescription, SoleGeometry
from ampm.exceptions import BodilyRefusal
from ampm.parameters import FootParameters, GaitParameters
from ampm.planner.support import plan_steps

SOLE = SoleGeometry(
    heel_x=-0.107,
    ball_x=0.083,
    tip_x=0.151,
    heel_half_width=0.03,
    ball_half_width=0.04,
    tip_half_width=0.035,
    ankle_x=-0.042,
    ankle_height=0.066,
)
LEG = LegDescription(
    hip=("", "", ""),
    knee="",
    ankle=("", ""),
    toe="",
    foot_segment="",
    toe_segment="",
    sole_frame="",
    toe_frame="",
    sole_points=("", "", "", "", "", ""),
)
BODY = BodyDescription(
    name="legs and soles only",
    height=1.7,
    mass=60.0,
    root_joint="",
    root_segment="",
    trunk_segment="",
    left_leg=LEG,
    right_leg=LEG,
    waist=(),
    chest=(),
    left_arm=(),
    right_arm=(),
    sole=SOLE,
    hip_height=0.901,
    hip_half_width=0.085,
    leg_length=0.835,
    imu_segment="",
    mirror=(),
    torque_limits=(),
    sources=(),
)
FLAT = FootParameters(schedule="flat")
ROLL = FootParameters(swing_height=0.1)


def flat(**values):
    return GaitParameters(**{"step_length": 0.4, "switching_velocity": 0.8, "steps": 4, **values})


def check(gait, foot):
    check_body(plan_steps(gait, 60.0, foot, SOLE), BODY)


def test_an_easy_gait_passes():
    check(flat(), FLAT)
    check(flat(steps=1), FLAT)


@pytest.mark.parametrize(
    ("gait", "foot", "reason", "limit", "words"),
    [
        (flat(step_width=0.07), FLAT, "soles_overlap", 0.08, ["0.07 m", "raise gait.step_width to 0.08 m"]),
        (flat(a_s=1.4), FLAT, "zmp_leaves_sole", 0.107, ["heel", "0.1129 m", "raise gait.a_s to 1.477"]),
        (flat(com_height=0.95), FLAT, "leg_too_short", 0.8517, ["lower gait.com_height"]),
        (
            GaitParameters(a_s=5.0),
            ROLL,
            "heel_rises_before_zmp_reaches_ball",
            0.083,
            ["0.0474 m, and the ball at 0.083 m", "lower gait.a_s to 2.855", "foot.schedule = flat"],
        ),
        (
            GaitParameters(),
            FootParameters(heel_rise_lead=0.05),
            "heel_rises_before_zmp_reaches_ball",
            0.083,
            ["foot.heel_rise_lead"],
        ),
        (
            GaitParameters(),
            FootParameters(swing_height=0.0, heel_strike_angle=0.0),
            "sole_under_floor",
            1e-6,
            ["mm under the floor", "raise foot.swing_height"],
        ),
    ],
)
def test_a_bodily_refusal_names_value_limit_and_way_out(gait, foot, reason, limit, words):
    with pytest.raises(BodilyRefusal) as caught:
        check(gait, foot)
    refusal = caught.value
    assert refusal.reason == reason
    assert refusal.limit == pytest.approx(limit)
    assert refusal.way_out in str(refusal)
    for word in words:
        assert word in str(refusal)


def test_a_resting_zmp_is_at_the_reference_point_and_not_a_rounding_error_before_it():
    with pytest.raises(BodilyRefusal, match=r"it is at 0 m, and the ball at 0\.083 m") as caught:
        check(GaitParameters(a_s=math.inf), ROLL)
    assert caught.value.value == 0.0


def test_a_refusal_names_the_way_out_of_the_next_one_too():
    with pytest.raises(BodilyRefusal) as caught:
        check(flat(a_s=1.4, com_height=0.95), FLAT)
    assert caught.value.reason == "zmp_leaves_sole"
    text = str(caught.value)
    assert "; also leg too short: lower gait.com_height" in text
    assert text.count("raise gait.a_s") == 1


def test_the_way_out_of_a_long_roll_is_a_way_out():
    with pytest.raises(BodilyRefusal) as caught:
        check(flat(a_s=1.4), FLAT)
    assert caught.value.value == pytest.approx(0.158 / 1.4)
    check(flat(a_s=1.48), FLAT)
