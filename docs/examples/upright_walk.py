"""Example of an own planner: the paper's plan with a constant posture instead of the periodic motion.

trial = val.walk(run, planner=UprightWalk())
"""

from ampm.body.constant_posture import ConstantPosture
from ampm.body.feasibility import check_body
from ampm.body.robot import Robot
from ampm.parameters import RunParameters
from ampm.planner.support import plan_steps
from ampm.walk import WalkPlan


class UprightWalk:
    """The paper's plan, walked with a constant posture."""

    def plan(self, run: RunParameters, robot: Robot) -> WalkPlan:
        """Plan a walk.

        Raises:
            MathematicalRefusal, BodilyRefusal: the gait cannot be walked.
        """
        steps = plan_steps(run.gait, run.body.mass, run.foot, robot.description.sole)
        check_body(steps, robot.description)
        return WalkPlan.of(steps, posture=ConstantPosture(steps, run, robot))
