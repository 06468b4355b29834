"""Accelerations wanted of soles and toes: swinging, standing, or rolling on a heel or toe line.

All of it is in plain numbers: vectors of three are too short for arrays to be worth their while.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ampm.body.robot import FOOT_ROWS, LEFT, RIGHT
from ampm.control.wrench_qp import STANCE, SWING
from ampm.so3 import cross, rotation_error

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.body.robot import Robot
    from ampm.control.contact_gate import ContactGate
    from ampm.control.sole_points import SolePoints
    from ampm.parameters import ControllerParameters
    from ampm.so3 import Vector
    from ampm.walk import FeetState

_HEEL, _BALL = 0, 1


class FootTasks:
    """Wanted accelerations of both feet from pose, contact and the planned feet.

    Args:
        robot: the body.
        gains: of the controller.
        gate: what touches, and how far it has taken its load.
        points: where the soles are.
    """

    def __init__(
        self, robot: Robot, gains: ControllerParameters, gate: ContactGate, points: SolePoints
    ) -> None:
        self._gains, self._gate, self._points = gains, gate, points
        self._fall = -robot.gravity
        self._toe_coordinates = [int(joint) + 1 for joint in robot.toe_joints]
        softness = {True: [STANCE] * FOOT_ROWS, False: [SWING] * FOOT_ROWS}
        self._softness = {
            (left, right): np.array([0.0] * 6 + softness[left] + softness[right] + [0.0, 0.0])
            for left in (False, True)
            for right in (False, True)
        }

    def wanted(
        self,
        reference: FeetState,
        q: NDArray[np.float64],
        rates: list[float],
        contact: list[list[bool]],
        due: list[list[bool]],
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Right-hand sides of all task rows but for their drift.

        Args:
            reference: of this tick.
            q: Pinocchio configuration, shape (nq,).
            rates: velocities of both soles (linear, angular) and toe joints, 14 numbers [m/s, rad/s].
            contact: groups of each foot planned in contact.
            due: groups whose contact is planned now or shortly.

        Returns:
            Wanted accelerations, shape (20,) [m/s^2, rad/s^2]: the first six are the momentum's without
            contact forces; and the rows' softness, shape (20,).
        """
        stiffness, damping = self._gains.swing_stiffness, self._gains.swing_damping
        tasks = [0.0, 0.0, self._fall, 0.0, 0.0, 0.0]
        columns = [part.tolist() for part in reference]
        stands = []
        for foot in (LEFT, RIGHT):
            touching, due_now = self._gate.touching[foot], due[foot]
            planned = [c or (due_now[i] and touching[i]) for i, c in enumerate(contact[foot])]
            position, velocity, acceleration, rotation, turn, turning = [c[foot] for c in columns[:6]]
            tilt = rotation_error(rotation, self._points.sole_rotation(foot))
            first = FOOT_ROWS * foot
            speed, omega = rates[first : first + 3], rates[first + 3 : first + FOOT_ROWS]
            stand = True in planned
            if stand:
                tasks += self._stance(foot, planned, contact[foot], speed, omega, tilt, turn, turning)
            else:
                here = self._points.sole_position(foot)
                tasks += [
                    acceleration[i] + stiffness * (position[i] - here[i]) + damping * (velocity[i] - speed[i])
                    for i in (0, 1, 2)
                ]
                tasks += [
                    stiffness * tilt[i] + damping * (turn[i] - omega[i]) + turning[i] for i in (0, 1, 2)
                ]
            stands.append(stand)
        for foot, (toe, rate, acceleration) in enumerate(zip(*columns[6:], strict=True)):
            tasks.append(
                acceleration
                + damping * (rate - rates[2 * FOOT_ROWS + foot])
                + stiffness * (toe - q.item(self._toe_coordinates[foot]))
            )
        return np.array(tasks), self._softness[stands[LEFT], stands[RIGHT]]

    def _stance(
        self,
        foot: int,
        planned: list[bool],
        contact: list[bool],
        velocity: Vector,
        omega: Vector,
        tilt: Vector,
        turn: Vector,
        turning: Vector,
    ) -> list[float]:
        """Wanted acceleration of a sole in contact, linear then angular [m/s^2, rad/s^2]."""
        gains, held, opening = self._gains, self._gate.touched[foot], self._gate.opening[foot]
        # A foot that has not yet taken its load is pressed down, or it would bounce.
        press = 1.0 - max(opening[_HEEL], opening[_BALL]) if True in contact else 0.0
        damping = gains.stance_damping + press * (gains.touchdown_damping - gains.stance_damping)
        vx, vy, vz = velocity
        vz += press * gains.touchdown_velocity
        wx, wy, wz = omega
        if False not in planned and held[_HEEL] and held[_BALL]:  # flat
            still = -gains.stance_damping
            return [-damping * vx, -damping * vy, -damping * vz, still * wx, still * wy, still * wz]
        stiffness, rolling = gains.roll_stiffness, gains.roll_damping
        sx, sy, sz = (stiffness * e - rolling * w for e, w in zip(tilt, omega, strict=True))
        if False not in planned:  # a line is late: turn it to the floor
            rate = gains.touchdown_rate if held[_HEEL] else -gains.touchdown_rate
            sy = rolling * ((rate if True in held else 0.0) - wy)
        else:  # rolling on heel or toes
            sy += turning[1] + rolling * turn[1]
            if not planned[_BALL]:
                sy -= stiffness * gains.roll_down_bias
        # The line that holds the foot stays where it is; the reference point turns about it.
        pivot = self._pivot(foot, held if True in held else planned)
        slide = cross(omega, pivot)
        tangential, centripetal = cross((sx, sy, sz), pivot), cross(omega, slide)
        return [
            -damping * (vx + slide[0]) - tangential[0] - centripetal[0],
            -damping * (vy + slide[1]) - tangential[1] - centripetal[1],
            -damping * (vz + slide[2]) - tangential[2] - centripetal[2],
            sx,
            sy,
            sz,
        ]

    def _pivot(self, foot: int, held: list[bool]) -> list[float]:
        """Middle of the line that holds a rolling foot, from the sole's reference point [m]."""
        first = 0 if held[_HEEL] else 2
        arm = self._points.arm[foot]
        return (0.5 * (arm[first] + arm[first + 1]) - self._points.sole[foot]).tolist()
