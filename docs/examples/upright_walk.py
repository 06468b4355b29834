"""Example of an own planner: the paper's plan with a constant posture instead of the periodic motion.

trial = val.walk(run, planner=UprightWalk())
"""

from __future__ import annotations

from ampm.body.feasibility import check_body
from ampm.body.swaying_posture import SwayingPosture
from ampm.exceptions import InputError
from ampm.planner.support import plan_steps
from ampm.planners import WalkRequest
from ampm.walk import Boundary, WalkPlan


class UprightWalk:
    """The paper's plan, walked with a constant posture."""

    def plan(self, request: WalkRequest, begin: Boundary | None = None) -> WalkPlan:
        """Plan a walk.

        Raises:
            InputError: a boundary was given.
            MathematicalRefusal, BodilyRefusal: the gait cannot be walked.
        """
        if begin is not None:
            raise InputError("this planner begins with a step of its own; plan it without a boundary.")
        run, robot = request.run, request.robot
        steps = plan_steps(run.gait, run.body.mass, run.foot, robot.description.sole)
        check_body(steps, robot.description)
        return WalkPlan.of(steps, posture=SwayingPosture(steps, run, robot))
