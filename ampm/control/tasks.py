"""Accelerations wanted of soles, toes and posture. Soles swing, stand, or roll on a heel or toe line.

A task is some consecutive rows of the task Jacobian, ``jacobian qdd + drift ~ wanted``, with one softness for
all of them, 0 for rows that are met exactly.
"""

import math
from typing import Any

from ampm.compiled import compiled
from ampm.control.stabilizer import rotation_error
from ampm.control.workspace import Workspace
from ampm.geometry import Array
from ampm.planner.feet import BALL, HEEL, TIP
from ampm.vectors import ZERO, Vector, along_across, clip, cross, dot, minus, plus, put, times, vector

STANCE, SWING, OFF_PLAN = 1e-8, 1e-4, 1e-3
"""Softness of the task of a foot that stands, swings, and swings off the plan, in the metric of the posture.
Off the plan, a foot whose leg is too weak lags, and the trunk stays."""
DEEPEST = 0.01
"""Most pitch by which a heel's sinking is made up for [rad]: a lower floor is not followed."""


@compiled
def sole_task(work: Workspace, i: int) -> None:
    """Write the wanted acceleration of sole i, linear then angular, and its softness.

    Body, lines and rates of the tasks are those of this tick. The foot keeps the line that holds it, and that
    line's speed, for the next one.
    """
    gains, body, wanted, lines = work.gains, work.body, work.wanted, work.contact.lines[i]
    foot, rows = body.feet[i], slice(6 + 6 * i, 12 + 6 * i)
    rates, acceleration = work.tasks.rates[rows], work.tasks.wanted[rows]
    turn = rotation_error(wanted.foot_rotation[i], foot.rotation)
    if _is_held(lines):
        work.tasks.softness[rows] = STANCE
        if foot.roll_row >= 0:  # the sole rolls as the leg leans
            work.tasks.softness[foot.roll_row] = SWING
        _stance(work, i, turn, rates, acceleration)
        return
    work.tasks.softness[rows] = OFF_PLAN if work.stepping[0].off_plan else SWING
    place = plus(vector(body.com), vector(foot.place))
    error, planned = minus(vector(wanted.foot_position[i]), place), vector(wanted.foot_acceleration[i])
    rate_error = minus(vector(wanted.foot_velocity[i]), vector(rates[0:3]))
    put(acceleration[0:3], _swing(gains, planned, error, rate_error))
    rate_error = minus(vector(wanted.foot_angular_velocity[i]), vector(rates[3:6]))
    planned = vector(wanted.foot_angular_acceleration[i])
    put(acceleration[3:6], _swing(gains, planned, turn, rate_error))


@compiled
def _swing(gains: Any, planned: Vector, error: Vector, rate_error: Vector) -> Vector:
    """Planned acceleration of a foot in the air, plus feedback of its errors."""
    feedback = times(gains.swing_damping, rate_error)
    return plus(plus(times(gains.swing_stiffness, error), planned), feedback)


@compiled
def _stance(work: Workspace, i: int, turn: Vector, rates: Array, acceleration: Array) -> None:
    """Write the wanted acceleration of a sole in contact; ``turn`` takes it to the planned rotation [rad].

    A point at an arm r holds the sole: of one that lies flat the reference point, of another the middle of a
    line. With v and w the velocity and rate of the sole, the acceleration wanted of this point is
    ``vd + wd x r + w x (w x r)``.
    """
    gains, foot, lines = work.gains, work.body.feet[i], work.contact.lines[i]
    heel, ball = lines[HEEL], lines[BALL]
    velocity, omega = vector(rates[0:3]), vector(rates[3:6])
    # A foot that has not yet taken its load is pressed down, otherwise it would bounce.
    press = 1.0 - max(heel.opening, ball.opening) if lines.planned.any() else 0.0
    damping = gains.stance_damping + press * (gains.touchdown_damping - gains.stance_damping)
    share, vertical_share = _yield_shares(gains, lines, work.contact.last[i], press)
    yielding = times(share * gains.frequency, minus(omega, vector(foot.last_omega)))
    put(foot.last_omega, omega)
    holds = lines.planned | lines.touched
    should_lie = holds[HEEL] and holds[BALL] and (holds[TIP] or foot.toe < 0)
    if should_lie and heel.touched and ball.touched:  # flat; about z the floor does not yield
        x, y, z = times(-gains.stance_damping, omega)
        alpha = (1.0 - share) * x + yielding[0], (1.0 - share) * y + yielding[1], z
        pivot = ZERO
    else:
        alpha = _rolling(work, i, should_lie, turn, rates, share, yielding)
        on_heel = heel.touched if lines.touched.any() else heel.planned
        pivot = minus(_middle(work.body.points, i, HEEL if on_heel else BALL), vector(foot.place))
    slide = cross(omega, pivot)
    speed = plus(velocity, slide)
    down = -damping * (speed[2] + press * (gains.touchdown_velocity + foot.hurry))
    down = (1.0 - vertical_share) * down + vertical_share * (speed[2] - foot.last_speed) * gains.frequency
    foot.last_speed = speed[2]
    still = -damping * speed[0], -damping * speed[1], down
    put(acceleration[0:3], minus(minus(still, cross(alpha, pivot)), cross(omega, slide)))
    put(acceleration[3:6], alpha)


@compiled
def _rolling(
    work: Workspace, i: int, should_lie: bool, turn: Vector, rates: Array, share: float, yielding: Vector
) -> Vector:
    """Wanted angular acceleration of a sole that does not lie flat [rad/s^2].

    If it ``should_lie`` flat, the sole turns to the floor; else it rolls on heel or toes as planned. Its roll
    yields as :func:`_stance` says, its pitch does not.
    """
    gains, wanted, omega, lines = work.gains, work.wanted, vector(rates[3:6]), work.contact.lines[i]
    heel, ball = lines[HEEL], lines[BALL]
    x, y, yaw = minus(times(gains.roll_stiffness, turn), times(gains.roll_damping, omega))
    # Roll and pitch in the axes of the foot's heading: about its x and y axis.
    cos, sin = wanted.foot_rotation[i, 1, 1], -wanted.foot_rotation[i, 0, 1]
    roll, pitch = along_across(x, y, cos, sin)
    roll = (1.0 - share) * roll + cos * yielding[0] + sin * yielding[1]
    if should_lie:
        rate = gains.touchdown_rate if lines.touched.any() else 0.0
        _, pitch_rate = along_across(omega[0], omega[1], cos, sin)
        pitch = gains.roll_damping * ((rate if heel.touched else -rate) - pitch_rate)
    else:
        planned, change = wanted.foot_angular_velocity[i], wanted.foot_angular_acceleration[i]
        _, planned_rate = along_across(planned[0], planned[1], cos, sin)
        _, planned_change = along_across(change[0], change[1], cos, sin)
        pitch = pitch + planned_change + gains.roll_damping * planned_rate
        if heel.touched and not (ball.planned or ball.touched):
            pitch -= _sinking(work, i, turn, rates)
    x, y = along_across(roll, pitch, cos, -sin)
    return x, y, yaw


@compiled
def _yield_shares(gains: Any, lines: Any, last: Any, press: float) -> tuple[float, float]:
    """Shares of the actual acceleration in the command: of a sole's turning, and of its vertical motion [1].

    The floor yields under a foot, most as it takes its load: ``press`` is the share of its load that it has
    still to take, 1 ... 0. On any floor, a commanded acceleration that differs from the actual one gives a
    force that differs from the commanded one. But an impact is not repeated: nothing yields as a foot comes
    to be held, no turning where a line begins or ceases to touch, no sinking where heel or ball begins or
    ceases to hold, or where nothing touches.
    """
    if not _is_held(last):
        return 0.0, 0.0
    turning = gains.stance_yield if (lines.touching == last.touching).all() else 0.0
    same_hold = last[HEEL].touched == lines[HEEL].touched and last[BALL].touched == lines[BALL].touched
    sinks = same_hold and lines.touching.any()
    return turning, max(turning, press * gains.landing_yield) if sinks else 0.0


@compiled
def _is_held(lines: Any) -> bool:
    """Whether a line of a foot is in contact, or planned to be."""
    return bool(lines.planned.any() or lines.touched.any())


@compiled
def _sinking(work: Workspace, i: int, turn: Vector, rates: Array) -> float:
    """Pitch acceleration [rad/s^2] that makes up for a loaded heel's sinking: the ball lands as planned."""
    gains, foot, points = work.gains, work.body.feet[i], work.body.points
    heel, ball = _middle(points, i, HEEL), _middle(points, i, BALL)
    length, arm = math.hypot(ball[0] - heel[0], ball[1] - heel[1]), minus(heel, vector(foot.place))
    planned = work.wanted.foot_position[i, 2] + cross(turn, arm)[2]
    sunk = (planned - work.body.com[2] - foot.place[2]) / length
    rate = -(rates[2] + cross(vector(rates[3:6]), arm)[2]) / length if 0.0 < sunk < DEEPEST else 0.0
    feedback = gains.roll_stiffness * clip(sunk, 0.0, DEEPEST) + gains.roll_damping * rate
    return gains.sink_compensation * feedback


@compiled
def _middle(points: Any, foot: int, line: int) -> Vector:
    """Middle of the points of a foot's line about the COM [m]."""
    total, count = ZERO, 0
    for i in range(len(points)):
        if points[i].foot == foot and points[i].line == line:
            total, count = plus(total, vector(points[i].arm)), count + 1
    return times(1.0 / count, total)


@compiled
def toe_task(work: Workspace, i: int) -> None:
    """Write the wanted acceleration of the toe joint of foot i, if it has one."""
    gains, row, planned = work.gains, work.body.feet[i].toe_row, work.wanted.foot_toe[i]
    if row >= 0:
        off = planned[0] - work.sensed.q[work.body.feet[i].toe + 1]
        feedback = gains.swing_damping * (planned[1] - work.tasks.rates[row]) + gains.swing_stiffness * off
        work.tasks.wanted[row] = planned[2] + feedback


@compiled
def posture_task(work: Workspace) -> None:
    """Write the accelerations that follow the planned posture: all joints, and the root's rotation."""
    damping, stiffness = work.gains.posture_damping, work.gains.posture_stiffness
    q, v, acceleration = work.sensed.q, work.motion.v, work.motion.posture
    planned_q, planned_v, planned_a = work.wanted.q, work.wanted.v, work.wanted.acceleration
    for j in range(len(v)):
        acceleration[j] = planned_a[j] + damping * (planned_v[j] - v[j])
        if j >= 6:
            acceleration[j] += stiffness * (planned_q[j + 1] - q[j + 1])
    # Root rotation: small-angle error in the root's axes, from the quaternions' product.
    here, planned = vector(q[3:6]), vector(planned_q[3:6])
    error = plus(minus(times(q[6], planned), times(planned_q[6], here)), cross(planned, here))
    cosine = q[6] * planned_q[6] + dot(here, planned)  # of half the angle; opposite quaternions are equal
    for k in range(3):
        acceleration[3 + k] += math.copysign(2.0, cosine) * stiffness * error[k]
