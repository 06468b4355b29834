"""Accelerations wanted of soles, toes and posture. Soles swing, stand, or roll on a heel or toe line.

A task is some consecutive rows of the task Jacobian, ``jacobian qdd + drift ~ wanted``, with one softness for
all of them, 0 for rows that are met exactly.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ampm.compiled import compiled
from ampm.control.records import BALL, HEEL, TIP
from ampm.control.stabilizer import rotation_error
from ampm.vectors import ZERO, Vector, cross, minus, plus, put, times, vector

Array = NDArray[np.float64]

STANCE, SWING = 1e-8, 1e-4
"""Softness of a foot's acceleration task when it stands and when it swings, in the metric of the posture."""
HURRIED = 1e-3
"""That of a swinging foot off the plan: where its leg's torque does not suffice, it lags rather than that
trunk and arms are thrown."""


@compiled
def foot_task(
    gains: Any, foot: Any, lines: Any, points: Any, com: Vector, reference: Array, rates: Array, wanted: Array
) -> float:
    """Acceleration of one sole.

    Args:
        gains: of the controller.
        foot: placed; keeps the line that holds it, and that line's vertical speed, for the next tick.
        lines: of this foot.
        points: of this foot.
        com: [m].
        reference: the foot's row of :class:`~ampm.walk.FeetState`, shape (27,).
        rates: velocity of the sole, linear then angular, shape (6,).
        wanted: linear then angular, shape (6,) [m/s^2, rad/s^2].

    Returns:
        The softness.
    """
    tilt = rotation_error(reference[9:18].reshape(3, 3), foot.pose)
    velocity, omega = vector(rates[0:3]), vector(rates[3:6])
    some = all_planned = lines[HEEL].planned or lines[HEEL].touched
    for group in (BALL, TIP):
        planned = lines[group].planned or lines[group].touched
        some, all_planned = some or planned, all_planned and (planned or (group == TIP and foot.toe < 0))
    if some:
        _stance(gains, foot, lines, points, reference, all_planned, velocity, omega, tilt, wanted)
        return STANCE
    foot.stood = False
    gain = gains[0]
    place = minus(vector(reference[0:3]), plus(com, vector(foot.place)))
    swing = plus(times(gain.swing_stiffness, place), vector(reference[6:9]))
    put(wanted[0:3], plus(swing, times(gain.swing_damping, minus(vector(reference[3:6]), velocity))))
    turn = plus(times(gain.swing_stiffness, tilt), vector(reference[21:24]))
    put(wanted[3:6], plus(turn, times(gain.swing_damping, minus(vector(reference[18:21]), omega))))
    return SWING


@compiled
def _stance(
    gains: Any,
    foot: Any,
    lines: Any,
    points: Any,
    reference: Array,
    all_planned: bool,
    velocity: Vector,
    omega: Vector,
    tilt: Vector,
    wanted: Array,
) -> None:
    """Wanted acceleration of a sole in contact."""
    gain, heel, ball = gains[0], lines[HEEL], lines[BALL]
    # A foot that has not yet taken its load is pressed down, otherwise it would bounce.
    landing = heel.planned or ball.planned or lines[TIP].planned
    press = 1.0 - max(heel.opening, ball.opening) if landing else 0.0
    damping = gain.stance_damping + press * (gain.touchdown_damping - gain.stance_damping)
    if all_planned and heel.touched and ball.touched:  # flat
        put(wanted[0:3], times(-damping, velocity))
        wanted[2] = _vertical(gain, foot, lines, press, damping, velocity[2])
        put(wanted[3:6], times(-gain.stance_damping, omega))
        return
    # Roll and pitch in the axes of the foot's heading.
    c, s = reference[13], -reference[10]
    turning = minus(times(gain.roll_stiffness, tilt), times(gain.roll_damping, omega))
    roll, level = c * turning[0] + s * turning[1], c * turning[1] - s * turning[0]
    pitch_rate = c * omega[1] - s * omega[0]
    holds = heel.touched or ball.touched or lines[TIP].touched
    if all_planned:  # a line is late: turn it to the floor
        rate = gain.touchdown_rate if heel.touched else -gain.touchdown_rate
        pitch = gain.roll_damping * ((rate if holds else 0.0) - pitch_rate)
    else:  # rolling on heel or toes
        wanted_rate, change = c * reference[19] - s * reference[18], c * reference[22] - s * reference[21]
        pitch = level + change + gain.roll_damping * wanted_rate
        if not (ball.planned or ball.touched):
            pitch -= gain.roll_stiffness * gain.roll_down_bias
    turning = c * roll - s * pitch, s * roll + c * pitch, turning[2]
    # The line that holds the foot stays where it is; the reference point turns about it.
    on_heel = heel.touched if holds else heel.planned or heel.touched
    pivot = minus(_middle(points, HEEL if on_heel else BALL), vector(foot.place))
    slide = cross(omega, pivot)
    speed = plus(velocity, slide)
    down = _vertical(gain, foot, lines, press, damping, speed[2])
    still = -damping * speed[0], -damping * speed[1], down
    put(wanted[0:3], minus(minus(still, cross(turning, pivot)), cross(omega, slide)))
    put(wanted[3:6], turning)


@compiled
def _vertical(gain: Any, foot: Any, lines: Any, press: float, damping: float, speed: float) -> float:
    """Wanted vertical acceleration of the line that holds the foot [m/s^2].

    The floor yields under a foot that takes its load. On any floor, a commanded acceleration that differs
    from the actual one gives a force that differs from the commanded one. So the command contains a share
    of the actual acceleration.

    Args:
        gain: of the controller.
        foot: its state at the last tick, which is replaced.
        lines: of the foot.
        press: share of its load that the foot has still to take, 1 ... 0.
        damping: towards the touch-down velocity [1/s].
        speed: of the line [m/s].
    """
    heel, ball = lines[HEEL], lines[BALL]
    asked = -damping * (speed + press * gain.touchdown_velocity)
    touching = heel.touching or ball.touching or lines[TIP].touching
    if foot.stood and touching and foot.on_heel == heel.touched and foot.on_ball == ball.touched:
        share = press * gain.landing_yield
        asked = (1.0 - share) * asked + share * (speed - foot.speed) * gain.frequency
    foot.stood, foot.speed = True, speed
    foot.on_heel, foot.on_ball = heel.touched, ball.touched
    return asked


@compiled
def _middle(points: Any, line: int) -> Vector:
    """Middle of a line's points about the COM [m]."""
    total, count = ZERO, 0
    for i in range(len(points)):
        if points[i].line == line:
            total, count = plus(total, vector(points[i].arm)), count + 1
    return times(1.0 / count, total)


@compiled
def toe_task(gains: Any, reference: Array, angle: float, rate: float) -> float:
    """Acceleration of a toe joint [rad/s^2], from its foot's row of :class:`~ampm.walk.FeetState`."""
    gain = gains[0]
    pull = gain.swing_damping * (reference[25] - rate) + gain.swing_stiffness * (reference[24] - angle)
    return reference[26] + pull


@compiled
def posture_task(
    gains: Any, q: Array, now: Array, planned_q: Array, planned_v: Array, planned_a: Array, wanted: Array
) -> None:
    """Accelerations that follow the planned posture: all joints, and the root's rotation.

    Args:
        gains: of the controller.
        q: shape (nq,).
        now: velocity, shape (nv,).
        planned_q: configuration of the :class:`~ampm.walk.PostureState`, shape (nq,).
        planned_v: its velocity, shape (nv,).
        planned_a: its acceleration, shape (nv,).
        wanted: shape (nv,) [m/s^2, rad/s^2].
    """
    gain = gains[0]
    for j in range(len(now)):
        wanted[j] = planned_a[j] + gain.posture_damping * (planned_v[j] - now[j])
        if j >= 6:
            wanted[j] += gain.posture_stiffness * (planned_q[j + 1] - q[j + 1])
    # Root rotation: small-angle error in the root's axes, from the quaternions' product.
    here, there = (q[3], q[4], q[5]), (planned_q[3], planned_q[4], planned_q[5])
    error = plus(minus(times(q[6], there), times(planned_q[6], here)), cross(there, here))
    for k in range(3):
        wanted[3 + k] += 2.0 * gain.posture_stiffness * error[k]
