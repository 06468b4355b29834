"""Periodic steps of many plans on a coarse grid, each sought from a neighbour's: for searches over gaits."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from ampm.body.inverse_kinematics import InverseKinematics
from ampm.body.orbit import RUNG_TOLERANCE
from ampm.body.return_map import Orbit, StepMap, newton, standing
from ampm.body.step_reference import StepReference, phase_grid, step_reference

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.body.motion import WholeBodyMotion
    from ampm.body.robot import Robot
    from ampm.parameters import RunParameters
    from ampm.planner.support import StepPlan


class RoughOrbits:
    """Solver of periodic steps of one body.

    Args:
        robot: the body.
        run: posture gains and the choice for L_z, the same for all plans.
        nodes: intervals of the grid in single and in double support; fixed, so that what is read off an orbit
            changes smoothly from plan to plan.
        budget: integrated steps that may be spent in all; the search checks :attr:`spent`.
    """

    def __init__(
        self, robot: Robot, run: RunParameters, nodes: tuple[int, int], budget: float = math.inf
    ) -> None:
        self.robot, self.nodes, self.budget = robot, nodes, budget
        self.ik = InverseKinematics(robot, run)

    @property
    def evaluations(self) -> int:
        """Steps that were integrated."""
        return self.ik.integrations

    @property
    def spent(self) -> bool:
        """Whether the budget is used up: a limit to a search that knows no clock."""
        return self.evaluations >= self.budget

    def difference(self, a: Orbit, b: Orbit) -> NDArray[np.float64]:
        """What leads from one orbit to another.

        Returns:
            (2 nv + 1,) tangent of the start configuration, both bodies brought to one place, change of the
            start velocity, and of the constant of L_y [N m s].
        """
        tangent = pin.difference(self.robot.model, _moved(a, b.reference), b.trajectory.q[0])
        return np.concatenate([tangent, b.trajectory.v[0] - a.trajectory.v[0], [b.offset - a.offset]])

    def solve(
        self,
        plan: StepPlan,
        lean: float,
        near: Orbit | None = None,
        shift: NDArray[np.float64] | None = None,
        motion: WholeBodyMotion | None = None,
    ) -> Orbit:
        """The periodic step of a plan.

        Args:
            plan: centroidal motion and feet.
            lean: mean trunk pitch [rad].
            near: orbit of a similar plan; without it, Newton begins from a body that stands upright.
            shift: what is expected to lead there from ``near``, see :meth:`difference`.
            motion: the same plan's, on a fine grid, to begin from instead.

        Raises:
            Unreachable: there is none, or none was found.
        """
        reference = step_reference(plan, phase_grid(plan, *self.nodes))
        step_map = StepMap(self.ik, reference, standing(self.ik, reference), plan.contacts.step_length, lean)
        inverse = None
        if motion is not None:
            z = step_map.encode(motion.q[0], motion.v[0], motion.report.angular_momentum_y_offset)
        elif near is None:
            z = step_map.guess()
        else:
            q, v, offset = _moved(near, reference), near.trajectory.v[0], near.offset
            if shift is not None:
                nv = self.robot.nv
                q = pin.integrate(self.robot.model, q, shift[:nv])
                v, offset = v + shift[nv:-1], offset + shift[-1]
            z, inverse = step_map.encode(q, v, offset), near.inverse
        return newton(step_map, z, RUNG_TOLERANCE, inverse, rebuilds=2 if near else 4)


def _moved(orbit: Orbit, reference: StepReference) -> NDArray[np.float64]:
    """Start configuration of an orbit, moved to where another reference has its COM."""
    q = orbit.trajectory.q[0].copy()
    q[:3] += reference.position[0, 0] - orbit.reference.position[0, 0]
    return q
