"""Refusals by soles and legs alone, which bad_input.csv lists: each names value, limit and a way out."""

from dataclasses import replace

import pytest

from ampm.body.feasibility import check_body, check_motion
from ampm.body.motion import Extreme, MotionReport
from ampm.description import SoleGeometry
from ampm.parameters import FootParameters, GaitParameters
from ampm.planner.support import plan_steps
from tests.solved import walk_of

SOLE = SoleGeometry(-0.107, 0.083, 0.151, 0.03, 0.04, 0.035, -0.042, 0.066)
BODY = replace(walk_of().robot.description, sole=SOLE, hip_half_width=0.085, leg_length=0.835)
FLAT = FootParameters(schedule="flat")
ROLL = FootParameters(swing_height=0.1)


def flat(**values):
    return GaitParameters(**{"step_length": 0.4, "switching_velocity": 0.8, "steps": 4, **values})


def check(gait, foot):
    check_body(plan_steps(gait, 60.0, foot, SOLE), BODY)


EASY = Extreme(0.4, 0.1, "right")
GOOD = MotionReport(0.4, 1e-10, 0.0, (), EASY, EASY, EASY)


# The way out of a long roll, a_s = 1.477 or more, is one.
@pytest.mark.parametrize("change", [{}, {"steps": 1}, {"a_s": 1.48}])
def test_an_easy_gait_and_an_easy_motion_pass(change):
    check(flat(**change), FLAT)
    check_motion(GOOD, walk_of().robot)
