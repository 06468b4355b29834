"""What is asked of the body as a whole: its momentum rate, and the posture that yields to it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ampm.so3 import rotation_error

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ampm.body.robot import Robot
    from ampm.parameters import ControllerParameters
    from ampm.walk import PostureState, Reference


class MomentumTask:
    """Net ground wrench: the plan's, plus feedback of COM, momentum and trunk.

    With c the COM, p and L momentum and angular momentum about it, and bars for the plan::

        f = m (cdd_bar + g e_z) + com_damping (p_bar - p) + m com_stiffness (c_bar - c)
        n = Ld_bar + momentum_gain (L_wanted - L),    L_wanted = L_bar + trunk_gain (tilt_bar - tilt)_xy

    Args:
        robot: the body.
        gains: of the controller.
    """

    def __init__(self, robot: Robot, gains: ControllerParameters) -> None:
        mass = self._mass = robot.mass
        self._gravity = robot.gravity
        self._stiffness, self._damping = mass * gains.com_stiffness, mass * gains.com_damping
        self._momentum_gain, self._trunk_gain = gains.momentum_gain, gains.trunk_gain
        self._rotation = robot.placements[robot.trunk_frame].rotation  # a view of Pinocchio's memory

    def wanted(
        self, reference: Reference, com: list[float], rates: list[float]
    ) -> tuple[list[float], list[float]]:
        """Wrench and angular momentum asked for at a tick; call after the frames are up to date.

        In plain numbers: vectors of three are too short for arrays to be worth their while.

        Args:
            reference: of this tick.
            com: three numbers [m].
            rates: COM velocity [m/s], angular momentum about the COM over the mass [m^2/s], then others.

        Returns:
            Net force [N] and moment about the COM [N m], six numbers; angular momentum [N m s], three.
        """
        cx, cy, cz = reference.com.tolist()
        ux, uy, uz = reference.com_velocity.tolist()
        ax, ay, az = reference.com_acceleration.tolist()
        lx, ly, lz = reference.angular_momentum.tolist()
        nx, ny, nz = reference.moment.tolist()
        x, y, z = com
        vx, vy, vz, hx, hy, hz = rates[:6]
        # The periodic motion is an unstable orbit: a trunk that has tilted is brought back by a little more
        # or less angular momentum than planned, slowly.
        tilt = rotation_error(reference.posture.trunk.tolist(), self._rotation.tolist())
        lx += self._trunk_gain * tilt[0]
        ly += self._trunk_gain * tilt[1]
        stiffness, damping, gain, mass = self._stiffness, self._damping, self._momentum_gain, self._mass
        wrench = [
            mass * ax + damping * (ux - vx) + stiffness * (cx - x),
            mass * ay + damping * (uy - vy) + stiffness * (cy - y),
            mass * (az + self._gravity) + damping * (uz - vz) + stiffness * (cz - z),
            nx + gain * (lx - mass * hx),
            ny + gain * (ly - mass * hy),
            nz + gain * (lz - mass * hz),
        ]
        return wrench, [lx, ly, lz]


class PostureTask:
    """Accelerations that follow the planned posture: all joints, and the root's rotation.

    Args:
        gains: of the controller.
        scale: from rad/s^2 to the metric of the posture, shape (nv,).
    """

    def __init__(self, gains: ControllerParameters, scale: NDArray[np.float64]) -> None:
        self._stiffness, self._damping = gains.posture_stiffness, gains.posture_damping
        self._scale = scale

    def wanted(
        self, reference: PostureState, q: NDArray[np.float64], v: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Wanted accelerations, in the metric of the posture, shape (nv,) [g].

        Args:
            reference: of this tick.
            q: Pinocchio configuration, shape (nq,).
            v: velocity, shape (nv,).
        """
        wanted = reference.v - v
        wanted *= self._damping
        wanted += reference.acceleration
        wanted[6:] += self._stiffness * (reference.q[7:] - q[7:])
        # Root rotation: small-angle error in the root's axes, from the quaternions' product.
        x, y, z, w = q[3:7].tolist()
        a, b, c, d = reference.q[3:7].tolist()
        gain = 2.0 * self._stiffness
        wanted[3] += gain * (w * a - d * x - y * c + z * b)
        wanted[4] += gain * (w * b - d * y - z * a + x * c)
        wanted[5] += gain * (w * c - d * z - x * b + y * a)
        wanted *= self._scale
        return wanted
