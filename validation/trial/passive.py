"""Forces in the joints of a body beside those of its motors."""

from typing import NamedTuple

from ampm.geometry import Array


class PassiveJoints(NamedTuple):
    """Springs, dampers and dry friction of a body's coordinates, each shape (nv,).

    Attributes:
        damping: [N m s/rad].
        stiffness: [N m/rad].
        rest: angle of the spring at rest [rad].
        friction: dry friction [N m].
        implicit: whether the integrator takes the damping at the velocity after the step.
    """

    damping: Array
    stiffness: Array
    rest: Array
    friction: Array
    implicit: bool
