"""Forces in the joints of a body beside those of its motors."""

from typing import NamedTuple

from ampm.geometry import Array


class PassiveJoints(NamedTuple):
    """Springs, dampers and dry friction of a body's coordinates, each shape (nv,)."""

    damping: Array  # [N m s/rad]
    stiffness: Array  # [N m/rad]
    rest: Array  # angle of the spring at rest [rad]
    friction: Array  # dry friction [N m]
    implicit: bool  # whether the integrator takes the damping at the velocity after the step
