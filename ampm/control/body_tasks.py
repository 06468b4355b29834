"""What is asked of the body as a whole: its momentum rate, and the posture that yields to it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.body.robot import Robot
    from ampm.control.reference import TrackingReference
    from ampm.parameters import ControllerParameters


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
        mass = self._mass = robot.mass
        self._stiffness, self._damping = mass * gains.com_stiffness, mass * gains.com_damping
        self._momentum_gain, self._half_trunk_gain = gains.momentum_gain, 0.5 * gains.trunk_gain
        self._rows = np.hstack(  # one look-up a tick
            [
                reference.com,
                reference.com_velocity,
                reference.angular_momentum,
                mass * (reference.com_acceleration + np.array([0.0, 0.0, robot.gravity])),
                reference.moment,
                reference.trunk.reshape(-1, 9),
            ]
        )
        self._rotation = robot.placements[robot.trunk_frame].rotation  # a view of Pinocchio's memory

    def wanted(self, k: int, com: list[float], rates: list[float]) -> tuple[list[float], list[float]]:
        """Wrench and angular momentum asked for at tick k; call after the frames are up to date.

        In plain numbers: vectors of three are too short for arrays to be worth their while.

        Args:
            k: tick.
            com: three numbers [m].
            rates: COM velocity [m/s], angular momentum about the COM over the mass [m^2/s], then others.

        Returns:
            Net force [N] and moment about the COM [N m], six numbers; angular momentum [N m s], three.
        """
        row = self._rows[k].tolist()
        cx, cy, cz, ux, uy, uz, lx, ly, lz, fx, fy, fz, nx, ny, nz = row[:15]
        xx, xy, xz, yx, yy, yz, zx, zy, zz = row[15:]
        (axx, axy, axz), (ayx, ayy, ayz), (azx, azy, azz) = self._rotation.tolist()
        x, y, z = com
        vx, vy, vz, hx, hy, hz = rates[:6]
        # The periodic motion is an unstable orbit: a trunk that has tilted is brought back by a little more
        # or less angular momentum than planned, slowly. The tilt is the skew part of R_wanted R^T.
        half = self._half_trunk_gain
        lx += half * (zx * ayx + zy * ayy + zz * ayz - yx * azx - yy * azy - yz * azz)
        ly += half * (xx * azx + xy * azy + xz * azz - zx * axx - zy * axy - zz * axz)
        stiffness, damping, gain, mass = self._stiffness, self._damping, self._momentum_gain, self._mass
        wrench = [
            fx + damping * (ux - vx) + stiffness * (cx - x),
            fy + damping * (uy - vy) + stiffness * (cy - y),
            fz + damping * (uz - vz) + stiffness * (cz - z),
            nx + gain * (lx - mass * hx),
            ny + gain * (ly - mass * hy),
            nz + gain * (lz - mass * hz),
        ]
        return wrench, [lx, ly, lz]


class PostureTask:
    """Accelerations that follow the periodic motion: all joints, and the root's rotation.

    Args:
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
        wanted[3] += gain * (w * a - d * x - y * c + z * b)
        wanted[4] += gain * (w * b - d * y - z * a + x * c)
        wanted[5] += gain * (w * c - d * z - x * b + y * a)
        wanted *= self._scale
        return wanted
