"""Template of a controller: the project's own, behind motors that take torques in steps. Copy and change it.

ampm validate normal --controller controller_template:MyController --set controller.options.resolution=0.05

whole_body_qp.py beside it is a controller from nothing.
"""

import numpy as np

import ampm


class MyController(ampm.TrackingController):
    """The arguments after robot and run are options of a run file: [controller.options]."""

    def __init__(self, robot, run, resolution: float = 0.1):  # [N m]
        super().__init__(robot, run)
        self.resolution = resolution

    def update(self, state, touch, reference):
        """Once a tick: measured state, touch of the soles and the plan at this instant; see ``ampm.walk``."""
        output = super().update(state, touch, reference)
        return output._replace(torque=self.resolution * np.round(output.torque / self.resolution))
