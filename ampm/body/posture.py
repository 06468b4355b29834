"""Postures of a walk: the periodic motion of :mod:`ampm.body.orbit`, tiled by mirroring."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from ampm.walk import PostureState

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from ampm.body.motion import WholeBodyMotion
    from ampm.body.robot import Robot


@dataclass(frozen=True)
class PeriodicPosture:
    """A periodic whole-body step as the posture of a walk.

    Attributes:
        motion: one step.
        robot: the body.
    """

    motion: WholeBodyMotion
    robot: Robot

    @property
    def angular_momentum_y_offset(self) -> float:
        """Mean of L_y over a step that makes it periodic [N m s]."""
        return self.motion.report.angular_momentum_y_offset

    def report(self) -> dict[str, Any]:
        """Figures of the periodic motion, see :class:`ampm.body.motion.MotionReport`."""
        return self.motion.report.as_dict()

    def sample(self, times: ArrayLike) -> PostureState:
        """States at ``times``, shape (T,) [s]; every array with a leading axis of T.

        Raises:
            InputError: a negative time.
        """
        robot = self.robot
        body = self.motion.sample(times, robot)
        model, data = robot.model, robot.model.createData()
        trunk = np.empty((len(body.q), 3, 3))
        for k, configuration in enumerate(body.q):
            pin.forwardKinematics(model, data, configuration)
            trunk[k] = pin.updateFramePlacement(model, data, robot.trunk_frame).rotation
        return PostureState(body.q, body.v, body.acceleration, trunk, body.angular_momentum_z)
