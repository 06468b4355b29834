"""What is asked of the body as a whole: its momentum rate, and the posture that yields to it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.parameters import ControllerParameters
    from ampm.reference import TrackingReference
    from ampm.robot import Robot


class MomentumTask:
    """Net ground wrench: the plan's, plus feedback of COM, momentum and trunk.

    With c the COM, p and L momentum and angular momentum about it, and bars for the plan::

        f = m (cdd_bar + g e_z) + com_damping (p_bar - p) + m com_stiffness (c_bar - c)
        n = Ld_bar + momentum_gain (L_wanted - L),    L_wanted = L_bar + trunk_gain (tilt_bar - tilt)_xy

    Args:
        robot: the body.
        reference: one row per control tick.
        gains: of the controller.
    """

    def __init__(self, robot: Robot, reference: TrackingReference, gains: ControllerParameters) -> None:
        mass = robot.mass
        self._com, self._trunk = reference.com, reference.trunk
        self._angular_momentum = reference.angular_momentum
        self._momentum = np.hstack([mass * reference.com_velocity, reference.angular_momentum])
        self._wrench = np.hstack([mass * reference.com_acceleration, reference.moment])
        self._wrench[:, 2] += mass * robot.gravity
        self._gain = np.repeat([gains.com_damping, gains.momentum_gain], 3)
        self._stiffness = mass * gains.com_stiffness
        self._half_trunk_gain = 0.5 * gains.trunk_gain
        self._rotation = robot.placements[robot.trunk_frame].rotation  # a view of Pinocchio's memory

    def wanted(
        self, k: int, com: NDArray[np.float64], momentum: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Wrench and angular momentum asked for at tick k; call after the frames are up to date.

        Args:
            k: tick.
            com: shape (3,) [m].
            momentum: linear [kg m/s], and angular about the COM [N m s], shape (6,).

        Returns:
            Net force [N] and moment about the COM [N m], shape (6,); angular momentum, shape (3,) [N m s].
        """
        wanted = self._angular_momentum[k].copy()
        # The periodic motion is an unstable orbit: a trunk that has tilted is brought back by a little more
        # or less angular momentum than planned, slowly.
        turn = self._trunk[k] @ self._rotation.T
        (_, _, xz), (_, _, yz), (zx, zy, _) = turn.tolist()
        wanted[:2] += (self._half_trunk_gain * (zy - yz), self._half_trunk_gain * (xz - zx))
        error = self._momentum[k] - momentum
        error[3:] = wanted - momentum[3:]
        wrench = self._gain * error
        wrench += self._wrench[k]
        wrench[:3] += self._stiffness * (self._com[k] - com)
        return wrench, wanted


class PostureTask:
    """Accelerations that follow the periodic motion: all joints, and the root's rotation.

    Args:
        robot: the body.
        reference: one row per control tick.
        gains: of the controller.
        scale: from rad/s^2 to the metric of the posture, shape (nv,).
    """

    def __init__(
        self,
        reference: TrackingReference,
        gains: ControllerParameters,
        scale: NDArray[np.float64],
    ) -> None:
        self._q, self._v, self._acceleration = reference.q, reference.v, reference.acceleration
        self._stiffness, self._damping = gains.posture_stiffness, gains.posture_damping
        self._scale = scale

    def wanted(self, k: int, q: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
        """Wanted accelerations at tick k, in the metric of the posture, shape (nv,) [g].

        Args:
            k: tick.
            q: Pinocchio configuration, shape (nq,).
            v: velocity, shape (nv,).
        """
        reference = self._q[k]
        wanted = self._v[k] - v
        wanted *= self._damping
        wanted += self._acceleration[k]
        wanted[6:] += self._stiffness * (reference[7:] - q[7:])
        # Root rotation: small-angle error in the root's axes, from the quaternions' product.
        x, y, z, w = q[3:7].tolist()
        a, b, c, d = reference[3:7].tolist()
        gain = 2.0 * self._stiffness
        wanted[3:6] += (
            gain * (w * a - d * x - y * c + z * b),
            gain * (w * b - d * y - z * a + x * c),
            gain * (w * c - d * z - x * b + y * a),
        )
        wanted *= self._scale
        return wanted
