"""Postures of a walk: the periodic motion of :mod:`ampm.body.orbit`, tiled by mirroring."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from ampm.body.motion import WholeBodyMotion
    from ampm.body.robot import Robot
    from ampm.walk import PostureState


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
        """States at ``times``, shape (T,) [s]; see :meth:`WholeBodyMotion.sample`."""
        return self.motion.sample(times, self.robot)
