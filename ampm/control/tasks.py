"""Accelerations wanted of soles, toes and posture.

Soles swing, stand, or roll on a heel or toe line. All in plain numbers: arrays of three elements are slower.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ampm.body.robot import FOOT_ROWS
from ampm.control.contact_gate import BALL, HEEL, TIP
from ampm.so3 import cross, rotation_error

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ampm.body.robot import Kinematics, Robot
    from ampm.control.contact_gate import Contact
    from ampm.parameters import ControllerParameters
    from ampm.so3 import Vector
    from ampm.walk import PostureState

STANCE, SWING = 1e-8, 1e-4
"""Softness of a foot's acceleration task when it stands and when it swings, in the metric of the posture."""


Task = tuple[list[float], float]
"""Consecutive rows of the task Jacobian, ``jacobian qdd + drift ~ wanted``: the wanted accelerations
[m/s^2, rad/s^2], and one softness for all of them, 0 for rows that are met exactly."""


class FreeFall:
    """The momentum rate without contact forces; the QP adds them.

    Args:
        robot: the body.
    """

    def __init__(self, robot: Robot) -> None:
        self.task: Task = ([0.0, 0.0, -robot.gravity, 0.0, 0.0, 0.0], 0.0)


class FootTask:
    """Acceleration of one sole.

    Args:
        foot: 0 left, 1 right.
        gains: of the controller.
    """

    def __init__(self, foot: int, gains: ControllerParameters) -> None:
        self._foot, self._gains = foot, gains
        first = 6 + FOOT_ROWS * foot
        self._linear, self._angular = slice(first, first + 3), slice(first + 3, first + FOOT_ROWS)
        self._sinking: tuple[list[bool], float] | None = None  # the line that holds, and its vertical speed

    def at(self, body: Kinematics, reference: list[float], contact: Contact) -> Task:
        """The task at one tick.

        Args:
            body: its state.
            reference: the foot's row of :class:`~ampm.walk.FeetState`, 27 plain numbers.
            contact: touching lines, and their share of the load.
        """
        foot = self._foot
        planned = [c or t for c, t in zip(contact.planned[foot], contact.touched[foot], strict=True)]
        x, y, z, ux, uy, uz, ax, ay, az, xx, xy, xz, yx, yy, yz, zx, zy, zz = reference[:18]
        turn, turning = reference[18:21], reference[21:24]
        (axx, axy, axz, px), (ayx, ayy, ayz, py), (azx, azy, azz, pz), _ = body.soles[foot]
        here = (axx, axy, axz), (ayx, ayy, ayz), (azx, azy, azz)
        tilt = rotation_error(((xx, xy, xz), (yx, yy, yz), (zx, zy, zz)), here)
        velocity, omega = body.rates[self._linear], body.rates[self._angular]
        if True in planned:
            return self._stance(body, planned, contact, velocity, omega, tilt, turn, turning), STANCE
        self._sinking = None
        stiffness, damping = self._gains.swing_stiffness, self._gains.swing_damping
        vx, vy, vz = velocity
        wanted = [
            ax + stiffness * (x - px) + damping * (ux - vx),
            ay + stiffness * (y - py) + damping * (uy - vy),
            az + stiffness * (z - pz) + damping * (uz - vz),
        ]
        for e, w, o, a in zip(tilt, turn, omega, turning, strict=True):
            wanted.append(stiffness * e + damping * (w - o) + a)
        return wanted, SWING

    def _stance(
        self,
        body: Kinematics,
        planned: list[bool],
        contact: Contact,
        velocity: Vector,
        omega: Vector,
        tilt: Vector,
        turn: Vector,
        turning: Vector,
    ) -> list[float]:
        """Wanted acceleration of a sole in contact, linear then angular [m/s^2, rad/s^2]."""
        gains, held, opening = self._gains, contact.touched[self._foot], contact.opening[self._foot]
        # A foot that has not yet taken its load is pressed down, otherwise it would bounce.
        landing = True in contact.planned[self._foot]
        press = 1.0 - max(opening[HEEL], opening[BALL]) if landing else 0.0
        damping = gains.stance_damping + press * (gains.touchdown_damping - gains.stance_damping)
        vx, vy, vz = velocity
        wx, wy, wz = omega
        if False not in planned and held[HEEL] and held[BALL]:  # flat
            down = self._vertical(contact, held, press, damping, vz)
            still = -gains.stance_damping
            return [-damping * vx, -damping * vy, down, still * wx, still * wy, still * wz]
        stiffness, rolling = gains.roll_stiffness, gains.roll_damping
        sx, sy, sz = (stiffness * e - rolling * w for e, w in zip(tilt, omega, strict=True))
        if False not in planned:  # a line is late: turn it to the floor
            rate = gains.touchdown_rate if held[HEEL] else -gains.touchdown_rate
            sy = rolling * ((rate if True in held else 0.0) - wy)
        else:  # rolling on heel or toes
            sy += turning[1] + rolling * turn[1]
            if not planned[BALL]:
                sy -= stiffness * gains.roll_down_bias
        # The line that holds the foot stays where it is; the reference point turns about it.
        pivot = self._pivot(body, held if True in held else planned)
        slide = cross(omega, pivot)
        down = self._vertical(contact, held, press, damping, vz + slide[2])
        tangential, centripetal = cross((sx, sy, sz), pivot), cross(omega, slide)
        return [
            -damping * (vx + slide[0]) - tangential[0] - centripetal[0],
            -damping * (vy + slide[1]) - tangential[1] - centripetal[1],
            down - tangential[2] - centripetal[2],
            sx,
            sy,
            sz,
        ]

    def _vertical(
        self, contact: Contact, held: list[bool], press: float, damping: float, speed: float
    ) -> float:
        """Wanted vertical acceleration of the line that holds the foot [m/s^2].

        The floor yields under a foot that takes its load. On any floor, a commanded acceleration that differs
        from the actual one gives a force that differs from the commanded one. So the command contains a share
        of the actual acceleration.

        Args:
            contact: of this tick.
            held: lines of this foot that have touched.
            press: share of its load that the foot has still to take, 1 ... 0.
            damping: towards the touch-down velocity [1/s].
            speed: of the line [m/s].
        """
        asked = -damping * (speed + press * self._gains.touchdown_velocity)
        last, self._sinking = self._sinking, (held[:TIP], speed)
        if last is None or last[0] != held[:TIP] or True not in contact.touching[self._foot]:
            return asked
        own = (speed - last[1]) * self._gains.frequency
        share = press * self._gains.landing_yield
        return (1.0 - share) * asked + share * own

    def _pivot(self, body: Kinematics, held: list[bool]) -> list[float]:
        """Middle of the line that holds a rolling foot, from the sole's reference point [m]."""
        first = 0 if held[HEEL] else 2
        one, other = body.arm[self._foot, first : first + 2].tolist()
        sole = body.sole_arm[self._foot]
        return [0.5 * (a + b) - c for a, b, c in zip(one, other, sole, strict=True)]


class ToeTask:
    """Accelerations of the toe joints.

    Args:
        robot: the body.
        gains: of the controller.
    """

    def __init__(self, robot: Robot, gains: ControllerParameters) -> None:
        self._stiffness, self._damping = gains.swing_stiffness, gains.swing_damping
        self._coordinates = [int(joint) + 1 for joint in robot.toe_joints]

    def at(self, body: Kinematics, reference: list[list[float]]) -> Task:
        """The task at one tick, from both rows of :class:`~ampm.walk.FeetState` in plain numbers."""
        measured = body.rates[-len(self._coordinates) :]
        wanted = [
            row[26] + self._damping * (row[25] - now) + self._stiffness * (row[24] - body.q.item(coordinate))
            for row, now, coordinate in zip(reference, measured, self._coordinates, strict=True)
        ]
        return wanted, 0.0


class PostureTask:
    """Accelerations that follow the planned posture: all joints, and the root's rotation.

    Args:
        gains: of the controller.
        scale: from rad/s^2 to the metric of the posture, shape (nv,).
    """

    def __init__(self, gains: ControllerParameters, scale: NDArray[np.float64]) -> None:
        self._stiffness, self._damping = gains.posture_stiffness, gains.posture_damping
        self._scale = scale

    def at(self, body: Kinematics, reference: PostureState) -> NDArray[np.float64]:
        """Wanted accelerations at one tick, in the metric of the posture, shape (nv,) [g]."""
        q = body.q
        wanted = reference.v - body.now
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
