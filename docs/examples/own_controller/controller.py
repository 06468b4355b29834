"""The built-in controller behind motors that take torques in steps of 0.1 N m."""

import numpy as np

from ampm.control.controller import TrackingController
from ampm.walk import ControlOutput, Reference, State, Touch


class Stepped(TrackingController):
    """Rounds every torque."""

    def update(self, state: State, touch: Touch, reference: Reference) -> ControlOutput:
        """One tick."""
        output = super().update(state, touch, reference)
        return output._replace(torque=np.round(output.torque, 1))
