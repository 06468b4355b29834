"""A posture for a walk of equal steps without a periodic motion: constant, but for the sway of the trunk.

Legs that swing and the planned angular momentum turn the trunk about its mean. How far follows from the
velocities that inverse kinematics finds for an upright body, integrated over two steps; no search is needed.
The constant of L_y is that with which the trunk turns back as far as it has turned.
"""

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from ampm.body.constant_posture import ConstantPosture
from ampm.body.inverse_kinematics import InverseKinematics
from ampm.body.return_map import standing
from ampm.body.robot import Robot
from ampm.body.step_reference import step_reference
from ampm.exceptions import InputError
from ampm.parameters import RunParameters
from ampm.planner.support import StepPlan
from ampm.walk import PostureState

Array = NDArray[np.float64]

NODES = 32
"""Instants of two steps at which the sway is known; twice as many change an angle of `normal` or `momentum`
by 0.3 degrees at most, half as many by 1.2."""
_TURNS = 2
"""Times that the sway is found, from the second on with a body that sways; a third one changes L_y by 1.2 %
at most."""


class SwayingPosture(ConstantPosture):
    """One configuration of all joints, and a trunk that sways with a mean of zero.

    Args:
        plan: of equal steps along x.
        run: rest posture's gains.
        robot: the body.

    Attributes:
        sway: rotation of the trunk about x and y at :data:`NODES` + 1 instants of two steps, shape (n + 1, 2)
            [rad].
        angular_momentum_y_offset: constant of L_y [N m s].

    Raises:
        InputError: the plan has one step.
        BodilyRefusal: the body cannot take the plan's first instant.
    """

    def __init__(self, plan: StepPlan, run: RunParameters, robot: Robot) -> None:
        super().__init__(plan, run, robot)
        if plan.duration < self.window:
            raise InputError("the trunk's sway is that of two steps; give gait.steps of at least 2.")
        self._times = self.window * np.arange(NODES + 1) / NODES
        ik, reference = InverseKinematics(robot, run), step_reference(plan, self._times)
        still, upright = np.zeros(robot.nv), [standing(ik, reference)]
        for k in range(NODES):
            upright.append(ik.upright(reference, k, upright[-1]))
        self.sway, offset = np.zeros((NODES + 1, 2)), 0.0
        for _ in range(_TURNS):
            rate = np.empty((2, NODES, 2))  # with this constant of L_y, and with 1 N m s more
            for more in range(2):
                for k in range(NODES):
                    q = _turned(upright[k + 1], self.sway[k])
                    rate[more, k] = ik.project(reference, k, q, still, offset + more)[1][3:5]
            mean, mean_with_more = rate[:, :, 1].mean(axis=1)
            more = -mean / (mean_with_more - mean)
            offset += float(more)
            turns = rate[0] + more * (rate[1] - rate[0])
            turns = np.concatenate([turns, turns[:1]])
            change = 0.5 * (turns[1:] + turns[:-1]) * self._times[1]
            self.sway = np.concatenate([np.zeros((1, 2)), np.cumsum(change, axis=0)])
            self.sway -= self.sway[:-1].mean(axis=0)
        self.angular_momentum_y_offset = offset
        self.start = ik.project(reference, 0, _turned(upright[1], self.sway[0]), still, offset)

    def sample(self, times: ArrayLike) -> PostureState:
        """States at ``times``, shape (T,) [s]; at time 0 that in which the walk begins."""
        t = np.atleast_1d(np.asarray(times, dtype=np.float64)) % self.window
        about_x, about_y = (np.interp(t, self._times, angle)[:, None] for angle in self.sway.T)
        state = super().sample(times)
        x, y, z = np.moveaxis(state.trunk, 1, 0)
        y, z = np.cos(about_x) * y - np.sin(about_x) * z, np.sin(about_x) * y + np.cos(about_x) * z
        x, z = np.cos(about_y) * x + np.sin(about_y) * z, np.cos(about_y) * z - np.sin(about_y) * x
        return state._replace(trunk=np.stack([x, y, z], axis=1))


def _turned(q: Array, sway: Array) -> Array:
    """A configuration whose root is turned about x, then about y, by ``sway``, shape (2,) [rad]."""
    turn = pin.utils.rotate("y", float(sway[1])) @ pin.utils.rotate("x", float(sway[0]))
    turned = q.copy()
    turned[3:7] = (pin.Quaternion(turn) * pin.Quaternion(*q[[6, 3, 4, 5]])).coeffs()
    return turned
