"""Wanted momentum rate of the body, which is the net wrench of the ground."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ampm.so3 import rotation_error

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.body.robot import Kinematics, Robot
    from ampm.parameters import ControllerParameters
    from ampm.walk import Reference

    Array = NDArray[np.float64]


class WrenchCommand(NamedTuple):
    """Command of the stabiliser, in plain numbers.

    Attributes:
        com: COM that the wrench refers to, three numbers [m].
        wrench: net force [N] and moment about the COM [N m], six numbers.
        angular_momentum: about the COM, three numbers [N m s].
    """

    com: list[float]
    wrench: list[float]
    angular_momentum: list[float]

    @property
    def zmp(self) -> Array:
        """ZMP on the floor of the wrench, shape (2,) [m]."""
        x, y, z = self.com
        fx, fy, fz, mx, my, _ = self.wrench
        return np.array([x - (z * fx + my) / fz, y - (z * fy - mx) / fz])


class Stabilizer:
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

    def command(self, body: Kinematics, reference: Reference) -> WrenchCommand:
        """The wrench commanded at one tick."""
        (cx, cy, cz), (ux, uy, uz), (ax, ay, az), (lx, ly, lz), (nx, ny, nz) = reference.centre.tolist()
        x, y, z = com = body.com.tolist()
        vx, vy, vz, hx, hy, hz = body.rates[:6]
        # The periodic motion is an unstable orbit: a trunk that has tilted is brought back by a little more
        # or less angular momentum than planned, slowly.
        tilt = rotation_error(reference.posture.trunk.tolist(), body.trunk)
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
        return WrenchCommand(com, wrench, [lx, ly, lz])
