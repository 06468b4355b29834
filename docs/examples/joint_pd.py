"""Joint PD along the planned posture, with the planned torques fed forward: a baseline.

ampm validate normal --controller docs.examples.joint_pd:JointPD

Springs follow the inertia of each joint, and in the standing legs the strength of the motors. The controller
uses neither COM nor contact, so the body falls.
"""

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
        frequency: of every joint as an oscillator [rad/s]; damping is critical.
        stance: share of a motor's largest torque per radian of error, in a standing leg [1/rad].
    """

    def __init__(
        self, robot: Robot, run: RunParameters, frequency: float = 40.0, stance: float = 2.0
    ) -> None:
        self.robot, self.data = robot, robot.model.createData()
        inertia = pin.crba(robot.model, self.data, pin.neutral(robot.model)).diagonal()[6:]
        self.legs = [
            [robot.joint_names.index(name) for name in (*leg.hip, leg.knee, *leg.ankle)]
            for leg in robot.description.legs
        ]
        self.swinging, self.standing = frequency**2 * inertia, stance * robot.torque_limit
        self.damping_time = 2.0 / frequency  # critical [s]

    def update(self, state: State, touch: Touch, reference: Reference) -> ControlOutput:
        """One tick."""
        limit = self.robot.torque_limit
        stiffness = self.swinging.copy()
        for leg, contact in zip(self.legs, reference.planned, strict=True):
            if contact.any():
                stiffness[leg] = self.standing[leg]
        error = reference.q[7:] - state.q[7:] + self.damping_time * (reference.v[6:] - state.v[6:])
        torque = self._feed_forward(reference) + stiffness * error
        return ControlOutput(np.clip(torque, -limit, limit))

    def _feed_forward(self, reference: Reference) -> np.ndarray:
        """Inverse dynamics of the plan, its ground force shared between the soles."""
        robot, model, data = self.robot, self.robot.model, self.data
        torque = pin.rnea(model, data, reference.q, reference.v, reference.acceleration)
        pin.computeJointJacobians(model, data, reference.q)
        ground = robot.mass * (reference.com_acceleration + np.array([0.0, 0.0, robot.gravity]))
        shares = (1.0 - reference.right_load, reference.right_load)
        for share, frame in zip(shares, robot.sole_frames, strict=True):
            jacobian = pin.getFrameJacobian(model, data, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
            torque -= share * jacobian[:3].T @ ground
        return torque[6:]
