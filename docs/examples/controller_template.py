"""Template of a controller: copy it and replace the torque.

ampm validate normal --controller controller_template:MyController

As it is the body falls after 0.4 s: springs hold the joints' angles, but nothing carries the weight or feeds
back the COM. To begin with a controller that walks, make a subclass of ``ampm.TrackingController``.
"""

import numpy as np

from ampm.body.robot import Robot
from ampm.parameters import RunParameters
from ampm.walk import ControlOutput, Reference, State, Touch


class MyController:
    """A spring and a damper at every joint, from the planned posture."""

    def __init__(self, robot: Robot, run: RunParameters) -> None:
        """Once a walk: the body (``robot.model`` is Pinocchio's) and the parameters of the run."""
        self.limit = robot.torque_limit  # of every motor [N m]

    def update(self, state: State, touch: Touch, reference: Reference) -> ControlOutput:
        """Once a tick: measured state, touch of the soles and the plan at this instant; see ``ampm.walk``."""
        wanted = reference.posture  # also reference.com, .angular_momentum, .feet, .contacts
        angle_error = wanted.q[7:] - state.q[7:]  # after position and quaternion of the root [rad]
        rate_error = wanted.v[6:] - state.v[6:]  # after the root's velocities [rad/s]
        torque = self.limit * (5.0 * angle_error + 0.2 * rate_error)  # in the order of robot.joint_names
        # The other fields of ControlOutput (commanded force and ZMP, status of a QP) are optional.
        return ControlOutput(np.clip(torque, -self.limit, self.limit))
