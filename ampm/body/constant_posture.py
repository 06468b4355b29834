"""A posture for walks whose steps do not repeat: upright and constant, without a periodic motion."""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ampm.body.robot import Robot
from ampm.body.step_reference import step_reference
from ampm.exceptions import BodilyRefusal
from ampm.geometry import Array
from ampm.parameters import RunParameters
from ampm.planner.contacts import Contacts
from ampm.planner.support import StepPlan
from ampm.walk import PostureState

CLOSING = 1.0
"""Time in which the window of the trunk's tilt closes at a stop [s]."""


class ConstantPosture:
    """One configuration of all joints, the pelvis level and along the mean heading of both feet.

    The plan has no constant of L_y. The controller averages the trunk's tilt over two steps, and an integral
    of this mean finds the angular momentum that keeps the trunk upright (:mod:`ampm.control.trunk`).

    Args:
        plan: begins with a state that the body is placed in.
        run: rest posture's gains.
        robot: the body.
        stops: when the walk comes to rest and when it goes on, in pairs: within them the window closes [s].

    Raises:
        BodilyRefusal: the body cannot take the plan's first instant.
    """

    def __init__(
        self, plan: StepPlan, run: RunParameters, robot: Robot, stops: Sequence[tuple[float, float]] = ()
    ) -> None:
        # Imported here, as the inverse kinematics is compiled, which a plan with a known motion does without.
        from ampm.body.inverse_kinematics import InverseKinematics, Unreachable
        from ampm.body.return_map import standing

        self.window, self.stops = 2.0 * plan.constants.step_duration, tuple(stops)
        self.turns = _turns(plan.contacts)
        heading = float(self.turns[0, 2])
        ik, reference = InverseKinematics(robot, run), step_reference(plan, np.zeros(1)).turned(heading)
        try:
            q, v = ik.upright(reference, 0, standing(ik, reference))
        except Unreachable as error:
            raise BodilyRefusal(
                f"the body cannot stand as the walk begins: {error}",
                reason="no_start",
                value=0.0,
                limit=0.0,
                unit="1",
                way_out="lower gait.com_height",
            ) from error
        self.q = q.copy()
        self.q[3:7] = 0.0, 0.0, 0.0, 1.0
        self.start = turned(q, heading), v
        self.trunk = robot.trunk_rotations(self.q[None])[0]

    def sample(self, times: ArrayLike) -> PostureState:
        """States at ``times``, shape (T,) [s]; at time 0 that in which the walk begins."""
        t = np.atleast_1d(np.asarray(times, dtype=np.float64))
        first, n, nv = t <= 0.0, len(t), len(self.start[1])
        q, (v, acceleration) = np.tile(self.q, (n, 1)), np.zeros((2, n, nv))
        trunk = np.tile(self.trunk, (n, 1, 1))
        heading, v[:, 5], acceleration[:, 5] = self.heading(t)
        q[:, 5], q[:, 6] = np.sin(0.5 * heading), np.cos(0.5 * heading)
        c, s = np.cos(heading)[:, None], np.sin(heading)[:, None]
        trunk[:, 0] = c * self.trunk[0] - s * self.trunk[1]
        trunk[:, 1] = s * self.trunk[0] + c * self.trunk[1]
        q[first], v[first] = self.start
        window = np.full(n, self.window)
        for stop, go in self.stops:
            still = (t >= stop) & (t < go)
            window[still] *= np.maximum(1.0 - (t[still] - stop) / CLOSING, 0.0)
        return PostureState(q, v, acceleration, trunk, np.zeros(n), window)

    def heading(self, times: Array) -> tuple[Array, Array, Array]:
        """Heading of the pelvis, its rate and acceleration, each (T,) [rad, rad/s, rad/s^2]."""
        start, duration, before, change = self.turns.T
        row = np.maximum(np.searchsorted(start, times, side="right") - 1, 0)
        T, turn = duration[row], change[row]
        u = np.clip((times - start[row]) / T, 0.0, 1.0)
        return (
            before[row] + turn * u**3 * (10.0 - 15.0 * u + 6.0 * u * u),
            turn * 30.0 * u * u * (1.0 - u) ** 2 / T,
            turn * 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / T**2,
        )

    def report(self) -> dict[str, Any]:
        """Empty: nothing is solved."""
        return {}


def turned(q: Array, angle: float) -> Array:
    """A configuration turned about the vertical through the origin by an angle [rad]."""
    q, c, s = q.copy(), math.cos(angle), math.sin(angle)
    q[0], q[1] = c * q[0] - s * q[1], s * q[0] + c * q[1]
    q[3:7] = (pin.Quaternion(pin.utils.rotate("z", angle)) * pin.Quaternion(*q[[6, 3, 4, 5]])).coeffs()
    return q


def _turns(contacts: Contacts) -> Array:
    """Turns of the pelvis, each over a single support and the double support after it.

    Returns:
        Start, duration, heading before and change of it; the first one changes nothing, shape (n, 4)
        [s, s, rad, rad].
    """
    rows = [(0.0, 1.0, float(contacts.headings[0]), 0.0)]
    for k, (before, now) in enumerate(pairwise(contacts.headings.tolist())):
        turn = now - before - 2.0 * math.pi * round((now - before) / (2.0 * math.pi))
        if turn:
            phases = contacts.phases[k + 1 : k + 3]
            single = phases[0].duration
            span = single + min(sum(phase.duration for phase in phases[1:]), single)
            rows.append((phases[0].start, span, rows[-1][2] + rows[-1][3], turn))
    return np.array(rows)
