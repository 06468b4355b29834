"""Joint torques of accelerations and contact forces, and the affine map that the limits are put on."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from ampm.control.wrench_qp import ANGULAR, FORCES

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.body.robot import Robot
    from ampm.control.sole_points import SolePoints
    from ampm.control.wrench_qp import ForceMap


class InverseDynamics:
    """``tau = (M qdd + h - J' f)`` of the joints, at the robot's last state.

    Args:
        robot: the body; its task Jacobian carries the feet's wrenches.
        points: where the soles are.
        forces: what the force unknowns do.
    """

    def __init__(self, robot: Robot, points: SolePoints, forces: ForceMap) -> None:
        self._robot, self._points, self._forces = robot, points, forces
        self._g, self._weight = robot.gravity, robot.mass * robot.gravity
        self._contact_rows = robot.terms.jacobian[6:]  # feet and toes; a view

    def torque(
        self,
        q: NDArray[np.float64],
        v: NDArray[np.float64],
        alpha: NDArray[np.float64],
        phi: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Joint torques, shape (nu,) [N m].

        Args:
            q: Pinocchio configuration, shape (nq,).
            v: velocity, shape (nv,).
            alpha: accelerations, shape (nv,) [g].
            phi: force unknowns, shape (18,) [m g].
        """
        robot = self._robot
        total = pin.rnea(robot.model, robot.data, q, v, self._g * alpha)
        total -= (self._weight * self._loads(phi)) @ self._contact_rows
        return total[6:]

    def torque_map(
        self, q: NDArray[np.float64], v: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Torques as ``map @ (alpha, phi) + bias``, shapes (nu, nv + 18) and (nu,) [N m]."""
        robot = self._robot
        mass = pin.crba(robot.model, robot.data, q)
        mass = np.triu(mass) + np.triu(mass, 1).T
        bias = pin.nle(robot.model, robot.data, q, v)
        loads = np.array([self._loads(unit) for unit in np.eye(FORCES)])
        forces = -self._weight * (loads @ self._contact_rows).T
        return np.hstack([self._g * mass[6:], forces[6:]]), bias[6:]

    def _loads(self, phi: NDArray[np.float64]) -> NDArray[np.float64]:
        """Force and moment about the sole of each foot, and both toe moments, shape (14,) [m g, m g m]."""
        left, right = self._forces.foot_wrenches(phi).tolist()
        (lx, ly, lz), (rx, ry, rz) = (
            self._points.sole.tolist()
        )  # moments: from about the COM to about the soles
        fx, fy, fz, mx, my, mz, left_toe = left
        gx, gy, gz, nx, ny, nz, right_toe = right
        return np.array(
            [
                fx,
                fy,
                fz,
                mx / ANGULAR - ly * fz + lz * fy,
                my / ANGULAR - lz * fx + lx * fz,
                mz / ANGULAR - lx * fy + ly * fx,
                gx,
                gy,
                gz,
                nx / ANGULAR - ry * gz + rz * gy,
                ny / ANGULAR - rz * gx + rx * gz,
                nz / ANGULAR - rx * gy + ry * gx,
                left_toe,
                right_toe,
            ]
        )
