"""A posture for walks whose steps do not repeat: upright and constant, without a periodic motion."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ampm.body.inverse_kinematics import InverseKinematics, Unreachable
from ampm.body.return_map import standing
from ampm.body.robot import Robot
from ampm.body.step_reference import step_reference
from ampm.exceptions import BodilyRefusal
from ampm.parameters import RunParameters
from ampm.planner.support import StepPlan
from ampm.walk import PostureState


class ConstantPosture:
    """One configuration of all joints, the pelvis level.

    The plan has no constant of L_y. The controller's trunk feedback keeps the trunk upright by a little more
    or less angular momentum than planned: ``normal`` walks 30 steps so with an RMSE of the ZMP of 7.4 and
    1.4 mm, and of 2.8 and 1.0 mm with ``controller.trunk_gain = 1``; with 0.3 it falls.

    Args:
        plan: begins with a state that the body is placed in.
        run: rest posture's gains.
        robot: the body.

    Raises:
        BodilyRefusal: the body cannot take the plan's first instant.
    """

    angular_momentum_y_offset = 0.0

    def __init__(self, plan: StepPlan, run: RunParameters, robot: Robot) -> None:
        ik, reference = InverseKinematics(robot, run), step_reference(plan, np.zeros(1))
        try:
            upright = ik.upright(reference, 0, standing(ik, reference))
            self.start = ik.project(reference, 0, upright, np.zeros(robot.nv), 0.0)
        except Unreachable as error:
            raise BodilyRefusal(
                f"the body cannot stand as the walk begins: {error}",
                reason="no_start",
                value=error.value,
                limit=error.limit,
                unit=error.unit,
                way_out="lower gait.com_height",
            ) from error
        self.q = self.start[0].copy()
        self.q[3:7] = 0.0, 0.0, 0.0, 1.0
        data = robot.model.createData()
        pin.forwardKinematics(robot.model, data, self.q)
        self.trunk = pin.updateFramePlacement(robot.model, data, robot.trunk_frame).rotation.copy()

    def sample(self, times: ArrayLike) -> PostureState:
        """States at ``times``, shape (T,) [s]; at time 0 that in which the walk begins."""
        first = np.atleast_1d(times) <= 0.0
        n, nv = len(first), len(self.start[1])
        q, v = np.tile(self.q, (n, 1)), np.zeros((n, nv))
        q[first], v[first] = self.start
        return PostureState(q, v, np.zeros((n, nv)), np.tile(self.trunk, (n, 1, 1)), np.zeros(n))

    def report(self) -> dict[str, Any]:
        """Empty: nothing is solved."""
        return {}
