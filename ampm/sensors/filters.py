"""Compiled filters of hinges and root: predicted by what was commanded, corrected by what was read.

The filter of the root holds the errors of place, velocity and attitude (world axes), of the biases of gyro
and accelerometer (root axes) and of the places c_i of the sole points (world axes): 15 + 3 P numbers. A
loaded point rests, ``p + R s_i(q) = c_i`` (Bloesch et al., RSS 2012, with points for feet), and a point that
has just touched is as high as the floor.
"""

from typing import Any, NamedTuple

import numpy as np

from ampm.body.rigid_body import moved, place_links, place_of
from ampm.compiled import compiled
from ampm.vectors import (
    Array,
    Vector,
    cross,
    from_quaternion,
    minus,
    plus,
    put,
    times,
    turned,
    vector,
)

VELOCITY, TURN, GYRO, ACCELEROMETER, POINTS = 3, 6, 9, 12, 15
"""First rows of errors in the covariance; those of the place are 0 to 2."""
LOAD = 0.06
"""Force from which a point rests, as share of the weight; half of it to go on resting."""
LANDING = 0.05
"""Time after a change of the loaded points in which commanded accelerations are less certain [s]."""
LANDING_FACTOR = 5.0
"""By how much their errors are larger then."""
RATE_ERROR = 0.4
"""Error of the commanded angular acceleration of the root [rad/s^2]."""
ACCELERATION_ERROR = 0.05
"""Standard deviation of the accelerometer's mean over a tick [m/s^2]."""
GYRO_WALK, ACCELEROMETER_WALK = 1e-4, 1e-3
"""Random walk of the biases in a second [rad/s], [m/s^2]."""
SLIDE, SINK, REST = 5e-3, 4e-3, 2e-4
"""Random walk of a loaded point in a second: sideways; down while points land; down otherwise [m]. Loaded
soles creep by up to a millimetre in a step, and sink by half of one as the load comes."""
POINT_ERROR, FLOOR_ERROR = 1e-3, 3e-4
"""Standard deviation of a resting point, and of the height of one that has just touched [m]."""
STEP_ERROR = 5e-3
"""Distance of a touching point from all known floors from which it stands on something else [m]."""
CLOCK = 1e-9
"""Shortest time that is none but for rounding [s]."""


class Filter(NamedTuple):
    """State, covariance and readings of the filters.

    Attributes:
        q: Pinocchio configuration, shape (nq,).
        joint_rate: shape (nu,) [rad/s].
        velocity: of the root in world axes, shape (3,) [m/s].
        rate: of the root in its own axes, shape (3,) [rad/s].
        gyro_bias: shape (3,) [rad/s].
        accelerometer_bias: shape (3,) [m/s^2].
        place: of the sole points, shape (P, 3) [m].
        loaded: sole points that rest, shape (P,).
        touched: sole points that touched at the last tick, shape (P,).
        quiet: time since loaded points changed, shape (1,) [s].
        joint_covariance: variance of the angle, covariance with the rate, variance of the rate, (nu, 3).
        rate_variance: of the root's rate, shape (1,) [(rad/s)^2].
        covariance: of the root's errors, shape (15 + 3 P, 15 + 3 P).
        change: their correction, shape (15 + 3 P,).
        turn: axes of the root to world, shape (3, 3).
        tree: of the body.
        link: of the body, placed.
        points: frames of the sole points.
        joint_error: of the commanded acceleration of every hinge, shape (nu,) [rad/s^2].
        variance: of angles, rates, gyro and fixes as read, shape (4,).
        levels: heights of the floor's surfaces [m].
        angles, rates, gyro, accelerometer, force, contact, position: as read.
        commanded: accelerations of the last N ticks, latest last, shape (N, nv).
        begin: times at which they began to act, and that of this tick, shape (N + 1,) [s].
        weight: of the body [N].
        gravity: [m/s^2].
        lag: how much older velocities are than configurations [s].
    """

    q: Array
    joint_rate: Array
    velocity: Array
    rate: Array
    gyro_bias: Array
    accelerometer_bias: Array
    place: Array
    loaded: Any
    touched: Any
    quiet: Array
    joint_covariance: Array
    rate_variance: Array
    covariance: Array
    change: Array
    turn: Array
    tree: Any
    link: Any
    points: Any
    joint_error: Array
    variance: Array
    levels: Array
    angles: Array
    rates: Array
    gyro: Array
    accelerometer: Array
    force: Array
    contact: Any
    position: Array
    commanded: Array
    begin: Array
    weight: float
    gravity: float
    lag: float


@compiled
def update(f: Filter, last: float, now: float, age: float, has_fix: bool, q: Array, v: Array) -> None:
    """Take in the readings of a tick, and go on to the tick itself.

    Args:
        f: with the readings, and with what was commanded until now.
        last: time of the readings before [s].
        now: time of the tick [s].
        age: of the readings [s].
        has_fix: whether the position was read.
        q: configuration at the tick, written, shape (nq,).
        v: velocity at the tick, written, shape (nv,).
    """
    read = now - age
    period = read - last if read - last > CLOCK else 0.0
    if period > 0.0:
        predict(f, last, period)
    correct(f, period, has_fix)
    q[:] = f.q
    put(v[0:3], turned(f.turn.T, vector(f.velocity)))
    put(v[3:6], vector(f.rate))
    v[6:] = f.joint_rate
    for n in range(len(f.commanded)):
        span = acted(f, n, read, now)
        if span > 0.0:
            q[:] = moved(q, span * (v + (f.lag + 0.5 * span) * f.commanded[n]))
            v += span * f.commanded[n]


@compiled
def acted(f: Filter, n: int, start: float, stop: float) -> float:
    """How long a command acted between two times [s]."""
    span = min(f.begin[n + 1], stop) - max(f.begin[n], start)
    return span if span > CLOCK else 0.0


@compiled
def predict(f: Filter, last: float, period: float) -> None:
    """State and covariance a period after the readings before."""
    commanded = np.zeros(f.commanded.shape[1])
    for n in range(len(f.commanded)):
        span = acted(f, n, last, last + period)
        if span > 0.0:
            commanded += span / period * f.commanded[n]
    factor = LANDING_FACTOR if f.quiet[0] < LANDING else 1.0
    filter_joints(f, commanded, period, factor)
    force = move_root(f, commanded, period, factor)
    spread_rows(f, period, force, f.covariance)
    spread_rows(f, period, force, f.covariance.T)
    add_errors(f, period)


@compiled
def correct(f: Filter, period: float, has_fix: bool) -> None:
    """Correct the root by sole points that touch or rest, and by a fix."""
    from_quaternion(f.q[3], f.q[4], f.q[5], f.q[6], f.turn)
    place_links(f.tree, f.q, f.link)
    f.change[:] = 0.0
    update_contacts(f, period)
    for i in range(len(f.points)):
        if f.loaded[i]:
            for axis in range(3):
                rest(f, i, axis)
    if has_fix:
        for axis in range(3):
            column = f.covariance[axis].copy()
            off = f.position[axis] - f.q[axis] - f.change[axis]
            apply(f, column, off, column[axis] + f.variance[3])
    add_correction(f)


@compiled
def filter_joints(f: Filter, commanded: Array, period: float, factor: float) -> None:
    """Angle and rate of every hinge, by the commanded acceleration and two sensors."""
    shift = period * (0.5 * period + f.lag)  # of the angle by an acceleration
    for j in range(len(f.joint_rate)):
        a, start, covariance = commanded[6 + j], f.joint_rate[j], f.joint_covariance[j]
        angle, rate = f.q[7 + j] + period * start + shift * a, start + period * a
        error = (factor * f.joint_error[j]) ** 2
        aa = covariance[0] + period * (2.0 * covariance[1] + period * covariance[2]) + error * shift * shift
        ar = covariance[1] + period * covariance[2] + error * shift * period
        rr = covariance[2] + error * period * period
        off, scale = f.angles[j] - angle, 1.0 / (aa + f.variance[0])
        angle, rate = angle + scale * aa * off, rate + scale * ar * off
        aa, ar, rr = aa - scale * aa * aa, ar - scale * aa * ar, rr - scale * ar * ar
        off, scale = f.rates[j] - rate, 1.0 / (rr + f.variance[1])
        f.q[7 + j], f.joint_rate[j] = angle + scale * ar * off, rate + scale * rr * off
        put(covariance, (aa - scale * ar * ar, ar - scale * ar * rr, rr - scale * rr * rr))


@compiled
def move_root(f: Filter, commanded: Array, period: float, factor: float) -> Vector:
    """Attitude by the gyro, velocity and place by the accelerometer.

    Returns:
        Acceleration less gravity in world axes [m/s^2]; ``f.turn`` is that of the middle of the period.
    """
    f.rate_variance[0] += (factor * RATE_ERROR * period) ** 2
    gain = f.rate_variance[0] / (f.rate_variance[0] + f.variance[2])
    f.rate_variance[0] *= 1.0 - gain
    start = vector(f.rate)
    rate = plus(start, times(period, vector(commanded[3:6])))
    rate = plus(rate, times(gain, minus(minus(vector(f.gyro), vector(f.gyro_bias)), rate)))
    put(f.rate, rate)
    mean = plus(times(0.5, plus(start, rate)), times(f.lag / period, minus(rate, start)))
    half = np.zeros(len(commanded))
    put(half[3:6], times(0.5 * period, mean))
    f.q[:] = moved(f.q, half)
    from_quaternion(f.q[3], f.q[4], f.q[5], f.q[6], f.turn)
    f.q[:] = moved(f.q, half)
    force = turned(f.turn, minus(vector(f.accelerometer), vector(f.accelerometer_bias)))
    acceleration, velocity = plus(force, (0.0, 0.0, -f.gravity)), vector(f.velocity)
    way = plus(times(period, velocity), times(period * (0.5 * period + f.lag), acceleration))
    put(f.q[0:3], plus(vector(f.q), way))
    put(f.velocity, plus(velocity, times(period, acceleration)))
    return force


@compiled
def spread_rows(f: Filter, period: float, force: Vector, rows: Array) -> None:
    """How errors of place, velocity and attitude follow from the others over a period."""
    for e in range(rows.shape[1]):
        push = cross(force, (rows[6, e], rows[7, e], rows[8, e]))
        push = plus(push, turned(f.turn, (rows[12, e], rows[13, e], rows[14, e])))
        turn = turned(f.turn, (rows[9, e], rows[10, e], rows[11, e]))
        for axis in range(3):
            rows[axis, e] += period * rows[VELOCITY + axis, e]
            rows[VELOCITY + axis, e] -= period * push[axis]
            rows[TURN + axis, e] -= period * turn[axis]


@compiled
def add_errors(f: Filter, period: float) -> None:
    """Errors that a period adds."""
    p = f.covariance
    for axis in range(3):
        p[VELOCITY + axis, VELOCITY + axis] += (period * ACCELERATION_ERROR) ** 2
        p[TURN + axis, TURN + axis] += period**2 * f.variance[2]
        p[GYRO + axis, GYRO + axis] += period * GYRO_WALK**2
        p[ACCELEROMETER + axis, ACCELEROMETER + axis] += period * ACCELEROMETER_WALK**2
    down = SINK if f.quiet[0] < LANDING else REST
    for row in range(POINTS, len(p)):
        p[row, row] += period * (down if row % 3 == 2 else SLIDE) ** 2


@compiled
def update_contacts(f: Filter, period: float) -> None:
    """Which points rest, from now on where they are; heights of those that have just touched."""
    p, changed = f.covariance, False
    for i in range(len(f.points)):
        arm = place_of(f.link, f.points[i])
        if f.contact[i] and not f.touched[i]:
            stand(f, arm)
        f.touched[i] = f.contact[i]
        loaded = f.contact[i] and f.force[i] > (0.5 if f.loaded[i] else 1.0) * LOAD * f.weight
        if loaded != f.loaded[i]:
            put(f.place[i], plus(vector(f.q), arm))
            for row in range(POINTS + 3 * i, POINTS + 3 * i + 3):
                f.change[row] = 0.0
                p[row] = 0.0
                p[:, row] = 0.0
                p[row, row] = 1.0
            f.loaded[i], changed = loaded, True
    f.quiet[0] = 0.0 if changed else f.quiet[0] + period


@compiled
def coordinate(errors: Any, axis: int, arm: Vector) -> Any:
    """One coordinate of a point at an arm from the root, of errors of place and attitude or of their rows."""
    after, last = (axis + 1) % 3, (axis + 2) % 3  # (turn x arm)[axis] = turn[after] arm[last] - ...
    return errors[axis] + errors[TURN + after] * arm[last] - errors[TURN + last] * arm[after]


@compiled
def stand(f: Filter, arm: Vector) -> None:
    """Correct by the height of a point that has just touched the floor."""
    z = f.q[2] + arm[2]
    level = f.levels[0]
    for other in f.levels:
        if abs(z - other) < abs(z - level):
            level = other
    column = coordinate(f.covariance, 2, arm)
    off = level - z - coordinate(f.change, 2, arm)
    if abs(off) < STEP_ERROR:
        apply(f, column, off, coordinate(column, 2, arm) + FLOOR_ERROR**2)


@compiled
def rest(f: Filter, i: int, axis: int) -> None:
    """Correct by one coordinate of a loaded point: ``c_i - p - R s_i`` is zero."""
    arm, row = place_of(f.link, f.points[i]), POINTS + 3 * i + axis
    column = coordinate(f.covariance, axis, arm) - f.covariance[row]
    off = f.place[i, axis] - f.q[axis] - arm[axis] - (coordinate(f.change, axis, arm) - f.change[row])
    apply(f, column, off, coordinate(column, axis, arm) - column[row] + POINT_ERROR**2)


@compiled
def apply(f: Filter, column: Array, off: float, variance: float) -> None:
    """Correct the errors by a number that is off, with its variance and its covariance with all of them."""
    change, covariance = f.change, f.covariance
    for e in range(len(change)):
        gain = column[e] / variance
        if gain != 0.0:  # of points in the air it is zero
            change[e] += gain * off
            row = covariance[e]
            for d in range(len(row)):
                row[d] -= gain * column[d]


@compiled
def add_correction(f: Filter) -> None:
    """Add the correction to the state."""
    change, step = f.change, np.zeros(f.commanded.shape[1])
    put(step[0:3], turned(f.turn.T, vector(change[0:3])))
    f.q[:] = moved(f.q, step)
    put(step[0:3], (0.0, 0.0, 0.0))
    put(step[3:6], turned(f.turn.T, vector(change[TURN:GYRO])))
    f.q[:] = moved(f.q, step)
    from_quaternion(f.q[3], f.q[4], f.q[5], f.q[6], f.turn)
    f.velocity[:] += change[VELOCITY:TURN]
    f.gyro_bias[:] += change[GYRO:ACCELEROMETER]
    f.accelerometer_bias[:] += change[ACCELEROMETER:POINTS]
    for i in range(len(f.place)):
        f.place[i] += change[POINTS + 3 * i : POINTS + 3 * i + 3]
