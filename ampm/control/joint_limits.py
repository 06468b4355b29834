"""Limits of torque and joint range, as the controller keeps them.

A joint may run towards the end of its range as fast as it can still brake before it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.body.robot import Robot

_BRAKE = 500.0  # deceleration with which a joint may run towards its limit [rad/s^2]
_BRAKE_TIME = 0.01  # time in which a joint that runs faster is slowed down [s]
_LARGEST = 200.0  # a joint far outside is brought back no harder than this [g]


class JointLimits:
    """Checks an answer against the limits, and gives them as bounds.

    Args:
        robot: its torque limits and joint ranges.
    """

    def __init__(self, robot: Robot) -> None:
        self._lower, self._upper = robot.lower, robot.upper
        self._nu = robot.nu
        self._horizon = _BRAKE_TIME * robot.gravity
        self._tested = np.zeros((3, robot.nu))  # torques, joint rates shortly ahead up and down
        self._bounds = np.zeros((3, robot.nu))
        self._bounds[0] = robot.torque_limit

    def broken(
        self,
        q: NDArray[np.float64],
        v: NDArray[np.float64],
        alpha: NDArray[np.float64],
        torque: NDArray[np.float64],
    ) -> bool:
        """Whether an answer breaks a limit at (q, v).

        Args:
            q: Pinocchio configuration, shape (nq,).
            v: velocity, shape (nv,).
            alpha: accelerations, shape (nv,) [g].
            torque: shape (nu,) [N m].
        """
        tested, bounds = self._tested, self._bounds
        np.abs(torque, out=tested[0])
        np.multiply(self._horizon, alpha[6:], out=tested[1])
        tested[1] += v[6:]
        np.negative(tested[1], out=tested[2])
        self._braking_rates(q, out=bounds[1:])
        return bool((tested > bounds).any())

    def acceleration_bounds(
        self, q: NDArray[np.float64], v: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Accelerations that keep every joint able to brake before its limits, shape (nu,) each [g]."""
        up, down = self._braking_rates(q, np.empty((2, self._nu)))
        scale = 1.0 / self._horizon
        low, high = scale * (-down - v[6:]), scale * (up - v[6:])
        return np.minimum(low, _LARGEST), np.maximum(high, -_LARGEST)

    def _braking_rates(self, q: NDArray[np.float64], out: NDArray[np.float64]) -> NDArray[np.float64]:
        """Rates up and down from which every joint can brake before its limits, shape (2, nu) [rad/s]."""
        np.subtract(self._upper, q[7:], out=out[0])
        np.subtract(q[7:], self._lower, out=out[1])
        np.maximum(out, 0.0, out=out)
        out *= 2.0 * _BRAKE
        return np.sqrt(out, out=out)
