"""Joint PD along the planned posture, with the planned torques fed forward: a baseline.

It uses neither COM nor contact, so the body falls.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ampm.body.robot import Robot
from ampm.parameters import RunParameters
from ampm.walk import ControlOutput, Reference, State, Touch


class JointPD:
    """Torque of every joint from its own error.

    Args:
        robot: the body.
        run: its parameters; unused.
        stiffness: share of a joint's largest torque per radian of error [1/rad].
        damping: the same per radian per second [s/rad].
    """

    def __init__(
        self, robot: Robot, run: RunParameters, stiffness: float = 5.0, damping: float = 0.2
    ) -> None:
        self.robot, self.stiffness, self.damping = robot, stiffness, damping
        self.data = robot.model.createData()

    def update(self, state: State, touch: Touch, reference: Reference) -> ControlOutput:
        """One tick."""
        planned, limit = reference.posture, self.robot.torque_limit
        torque = self._feed_forward(reference)
        torque += limit * self.stiffness * (planned.q[7:] - state.q[7:])
        torque += limit * self.damping * (planned.v[6:] - state.v[6:])
        return ControlOutput(np.clip(torque, -limit, limit))

    def _feed_forward(self, reference: Reference) -> np.ndarray:
        """Inverse dynamics of the plan, its ground force shared between the soles."""
        robot, model, data = self.robot, self.robot.model, self.data
        q, v, a = reference.posture.q, reference.posture.v, reference.posture.acceleration
        torque = pin.rnea(model, data, q, v, a)
        pin.computeJointJacobians(model, data, q)
        ground = robot.mass * (reference.com_acceleration + np.array([0.0, 0.0, robot.gravity]))
        shares = (1.0 - reference.right_load, reference.right_load)
        for share, frame in zip(shares, robot.sole_frames, strict=True):
            jacobian = pin.getFrameJacobian(model, data, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
            torque -= share * jacobian[:3].T @ ground
        return torque[6:]
