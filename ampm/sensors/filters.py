"""Compiled filters of hinges and root: predicted by what was commanded, corrected by what was read.

The root's filter estimates place, velocity and attitude, the biases of gyro and accelerometer, and the places
c_i of the P sole points; if encoders have offsets, those of the H hinges between root and soles; if the IMU
is turned in the root, its three angles: ``x``, X numbers. A loaded point rests, ``p + R s_i(q) = c_i``
(Bloesch et al., RSS 2012, with points for feet), and a point that has just touched is as high as the floor.
The attitude is the quaternion of ``q``, whose hinges have the angles without offsets; in ``x`` both are the
correction of a tick, and zero in between.
"""

from typing import Annotated, Any, NamedTuple

import numpy as np

from ampm.body.articulated import respond
from ampm.body.rigid_body import (
    angular_momentum,
    com_of,
    move_links,
    moved,
    place_links,
    place_of,
    sum_inertia,
)
from ampm.compiled import compiled
from ampm.geometry import Array, Flags
from ampm.sensors.soles import spread_wrenches
from ampm.vectors import ZERO, Vector, cross, dot, from_quaternion, minus, plus, put, times, turned, vector

VELOCITY, TILT, GYRO, ACCELEROMETER, POINTS = 3, 6, 9, 12, 15  # where they begin in x; the place is first
LOAD = 0.06  # force from which a point rests, as share of the weight; half of it to go on resting
FIRM = 0.25  # share of the weight below which a point slides the more, the less it bears [1]
RATE_ERROR = 0.4  # of the root's commanded angular acceleration, at least [rad/s^2]
MEMORY = 0.02  # over which the errors of commanded accelerations are averaged [s]
POINT_ERROR = 1e-3  # standard deviation of a resting point [m]
FLOOR_ERROR = 3e-4  # standard deviation of the height of a point that has just touched [m]
STEP_ERROR = 5e-3  # a point that touches so far from all floors stands on something else [m]
SPIN_ERROR = 3e-4  # of the angular momentum by the rates, over the weight [m s]
LEVER_ERROR = 5e-4  # of the moment of the wrenches about the COM, over the weight [m s^0.5]
CLOCK = 1e-9  # a shorter time span is rounding [s]


class Layout(NamedTuple):
    """Where in x what depends on the sensors stands, and the H hinges whose encoders have offsets."""

    worn: Any  # these hinges, (H,)
    moves: Any  # whether they move a sole point, (P, H); the first one of a foot is fixed to its sole
    offsets: int  # where their offsets begin in x
    imu: int  # where the angles of the IMU begin in x; 0 if it is not turned
    momentum: int  # where the angular momentum about the COM begins in x; 0 if it is not estimated


class Read(NamedTuple):
    """The last readings."""

    time: Annotated[Array, (1,)]  # [s]
    angles: Annotated[Array, ("nu",)]  # [rad]
    rates: Annotated[Array, ("nu",)]  # [rad/s]
    gyro: Annotated[Array, (3,)]  # [rad/s]
    gyro_before: Annotated[Array, (3,)]  # the reading before [rad/s]
    accelerometer: Annotated[Array, (3,)]  # [m/s^2]
    position: Annotated[Array, (3,)]  # [m]


class Known(NamedTuple):
    """What is known of body, floor and sensors."""

    tree: Any  # of the body
    armature: Array  # of every coordinate, (nv,) [kg m^2]
    weight: float  # of the body [N]
    gravity: float  # [m/s^2]
    levels: Array  # heights of the floor's surfaces [m]
    slope: Array  # of the floor: dz/dx, dz/dy, (2,) [1]
    wrenches: bool  # whether the wrenches of the feet give force and contact of the sole points
    joint_error: Array  # of the commanded accelerations of the hinges, at least, (nu,) [rad/s^2]
    variance: Array  # of angles, rates, gyro and fixes as read, (4,)
    growth: Array  # of the variances of x in a tick, (X,)
    lag: float  # how much older velocities are than configurations [s]


class Filter(NamedTuple):
    """What is estimated, and from what. World axes; the root's own for its rate and the IMU."""

    q: Annotated[Array, ("nq",)]  # Pinocchio configuration
    joint_rate: Annotated[Array, ("nu",)]  # [rad/s]
    joint_covariance: Annotated[Array, ("nu", 3)]  # of each hinge: var(angle), cov(angle, rate), var(rate)
    rate: Annotated[Array, (3,)]  # of the root [rad/s]
    rate_variance: Annotated[Array, (1,)]  # [(rad/s)^2]
    # mean square of what its readings added to its acceleration lately [(rad/s^2)^2]
    rate_error: Annotated[Array, (1,)]
    angle_error: Annotated[Array, ("nu",)]  # the same of the hinges [(rad/s^2)^2]
    # place, velocity, attitude, biases, points, offsets, IMU [m, m/s, rad, rad/s, m/s^2, m]
    x: Annotated[Array, ("X",)]
    covariance: Array  # of x, (X, X)
    offset: Annotated[Array, ("nu",)]  # of the encoders [rad]
    loaded: Annotated[Flags, ("P",)]  # sole points that rest
    touched: Annotated[Flags, ("P",)]  # sole points that touched at the last tick
    turn: Annotated[Array, (3, 3)]  # axes of the root to world
    link: Any  # of the body, placed
    soles: Any  # :class:`~ampm.sensors.soles.Soles`, with the last readings of force and contact
    commanded: Annotated[Array, ("N", "nv")]  # accelerations of N ticks, latest last [m/s^2, rad/s^2]
    begin: Annotated[Array, ("N + 1",)]  # when they began to act, and the time of this tick [s]
    read: Read
    layout: Layout
    known: Known


@compiled
def update(f: Filter, commanded: Array, now: float, age: float, has_fix: bool, q: Array, v: Array) -> None:
    """Take in the readings of a tick, and go on from them to the tick.

    Args:
        f: with the readings.
        commanded: accelerations since the tick before, (nv,) [m/s^2, rad/s^2].
        now: time of the tick [s].
        age: of the readings [s].
        has_fix: whether the position was read.
        q: configuration at the tick, written, (nq,).
        v: velocity at the tick, written, (nv,).
    """
    f.commanded[:-1] = f.commanded[1:]
    f.commanded[-1] = commanded
    f.begin[:-1] = f.begin[1:]
    f.begin[-1] = now
    last = f.read.time[0]
    period = now - age - last if now - age - last > CLOCK else 0.0
    if period > 0.0:
        predict(f, last, period)
    f.read.time[0] = now - age
    f.read.gyro_before[:] = f.read.gyro
    correct(f, period, has_fix)
    q[:] = f.q
    put(v[0:3], turned(f.turn.T, vector(f.x[VELOCITY:TILT])))
    put(v[3:6], vector(f.rate))
    v[6:] = f.joint_rate
    for n in range(len(f.commanded)):
        span = acting_time(f, n, now - age, now)
        if span > 0.0:
            q[:] = moved(q, span * (v + (f.known.lag + 0.5 * span) * f.commanded[n]))
            v += span * f.commanded[n]


@compiled
def acting_time(f: Filter, n: int, start: float, stop: float) -> float:
    """Time for which command n acted between two times [s]."""
    span = min(f.begin[n + 1], stop) - max(f.begin[n], start)
    return span if span > CLOCK else 0.0


@compiled
def predict(f: Filter, last: float, period: float) -> None:
    """State and covariance a period after the readings before."""
    commanded = np.zeros(f.commanded.shape[1])
    for n in range(len(f.commanded)):
        commanded += acting_time(f, n, last, last + period) / period * f.commanded[n]
    turning = predict_rate(f, commanded, period)
    force, pushed = predict_root(f, commanded, period)
    sum_inertia(f.known.tree, f.link)
    response = respond(f.known.tree, f.known.armature, f.link, pushed, turning)
    predict_joints(f, commanded, response, period)
    propagate(f, period, force, f.covariance)
    propagate(f, period, force, f.covariance.T)
    for e in range(len(f.x)):
        f.covariance[e, e] += f.known.growth[e]
    for i in range(len(f.soles.points)):
        if f.loaded[i]:
            bears = min(max(f.soles.force[i] / f.known.weight, 0.5 * LOAD), FIRM)
            for e in range(POINTS + 3 * i, POINTS + 3 * i + 2):
                f.covariance[e, e] += ((FIRM / bears) ** 2 - 1.0) * f.known.growth[e]


@compiled
def predict_joints(f: Filter, commanded: Array, response: Array, period: float) -> None:
    """Angle and rate of every hinge, by the commanded acceleration and two sensors.

    Where the root moves otherwise than commanded, the hinges follow it at the commanded torques: their rates
    change by ``response``, shape (nu,) [rad/s].
    """
    shift = period * (0.5 * period + f.known.lag)  # of the angle by an acceleration
    for j in range(len(f.joint_rate)):
        start, covariance = f.joint_rate[j], f.joint_covariance[j]
        acceleration = commanded[6 + j] + response[j] / period
        angle, rate = f.q[7 + j] + period * start + shift * acceleration, start + period * acceleration
        error, predicted = max(f.known.joint_error[j] ** 2, f.angle_error[j]), rate
        # Variances of angle (aa) and rate (rr), and their covariance.
        aa = covariance[0] + period * (2.0 * covariance[1] + period * covariance[2]) + error * shift * shift
        ar = covariance[1] + period * covariance[2] + error * shift * period
        rr = covariance[2] + error * period * period
        innovation, scale = f.read.angles[j] - f.offset[j] - angle, 1.0 / (aa + f.known.variance[0])
        angle, rate = angle + scale * aa * innovation, rate + scale * ar * innovation
        aa, ar, rr = aa - scale * aa * aa, ar - scale * aa * ar, rr - scale * ar * ar
        innovation, scale = f.read.rates[j] - rate, 1.0 / (rr + f.known.variance[1])
        f.q[7 + j], f.joint_rate[j] = angle + scale * ar * innovation, rate + scale * rr * innovation
        put(covariance, (aa - scale * ar * ar, ar - scale * ar * rr, rr - scale * rr * rr))
        added = (f.joint_rate[j] - predicted) / period
        f.angle_error[j] += min(1.0, period / MEMORY) * (added * added - f.angle_error[j])


@compiled
def predict_rate(f: Filter, commanded: Array, period: float) -> Vector:
    """Correct the root's rate by the gyro; its change that was not commanded, in world axes [rad/s]."""
    f.rate_variance[0] += max(RATE_ERROR**2, f.rate_error[0]) * period**2
    gain = f.rate_variance[0] / (f.rate_variance[0] + f.known.variance[2])
    f.rate_variance[0] *= 1.0 - gain
    rate = plus(vector(f.rate), times(period, vector(commanded[3:6])))
    change = times(gain, minus(unbiased(f, f.read.gyro, GYRO), rate))
    added = dot(change, change) / (3.0 * period**2)
    f.rate_error[0] += min(1.0, period / MEMORY) * (added - f.rate_error[0])
    put(f.rate, plus(rate, change))
    return turned(f.turn, change)


@compiled
def predict_root(f: Filter, commanded: Array, period: float) -> tuple[Vector, Vector]:
    """Attitude by the gyro, velocity and place by the accelerometer.

    The filtered rate does not turn the root: a body whose COM is a millimetre off turns otherwise than
    commanded, and the mean of that rate is wrong.

    Returns:
        Acceleration less gravity [m/s^2], and change of velocity that was not commanded [m/s], in world axes.
    """
    start, end = unbiased(f, f.read.gyro_before, GYRO), unbiased(f, f.read.gyro, GYRO)
    mean = plus(times(0.5, plus(start, end)), times(f.known.lag / period, minus(end, start)))
    turn_root(f, times(0.5 * period, mean))
    force = turned(f.turn, unbiased(f, f.read.accelerometer, ACCELEROMETER))
    turn_root(f, times(0.5 * period, mean))
    acceleration, velocity = plus(force, (0.0, 0.0, -f.known.gravity)), vector(f.x[VELOCITY:TILT])
    moving = plus(turned(f.turn, vector(commanded[0:3])), cross(turned(f.turn, vector(f.rate)), velocity))
    way = plus(times(period, velocity), times(period * (0.5 * period + f.known.lag), acceleration))
    put(f.x[0:3], plus(vector(f.x[0:3]), way))
    put(f.x[VELOCITY:TILT], plus(velocity, times(period, acceleration)))
    return force, times(period, minus(acceleration, moving))


@compiled
def unbiased(f: Filter, read: Array, bias: int) -> Vector:
    """A reading of the IMU less its bias, whose place in x is given, in the axes of the root."""
    a = minus(vector(read), vector(f.x[bias : bias + 3]))
    return plus(a, cross(vector(f.x[f.layout.imu : f.layout.imu + 3]), a)) if f.layout.imu else a


@compiled
def turn_root(f: Filter, angle: Vector) -> None:
    """Turn the root by a rotation vector in its own axes [rad]."""
    change = np.zeros(len(f.q) - 1)
    put(change[3:6], angle)
    f.q[:] = moved(f.q, change)
    from_quaternion(f.q[3], f.q[4], f.q[5], f.q[6], f.turn)


@compiled
def propagate(f: Filter, period: float, force: Vector, rows: Array) -> None:
    """Propagate rows of the covariance over a period; the force is that of :func:`predict_root`."""
    imu_rows = f.layout.imu
    for e in range(rows.shape[1]):
        tilt = rows[6, e], rows[7, e], rows[8, e]
        turn = turned(f.turn, (rows[9, e], rows[10, e], rows[11, e]))
        if imu_rows:
            imu = turned(f.turn, (rows[imu_rows, e], rows[imu_rows + 1, e], rows[imu_rows + 2, e]))
            tilt = plus(tilt, imu)
            turn = plus(turn, cross(turned(f.turn, vector(f.rate)), imu))
        push = plus(cross(force, tilt), turned(f.turn, (rows[12, e], rows[13, e], rows[14, e])))
        for axis in range(3):
            rows[axis, e] += period * rows[VELOCITY + axis, e]
            rows[VELOCITY + axis, e] -= period * push[axis]
            rows[TILT + axis, e] -= period * turn[axis]


@compiled
def correct(f: Filter, period: float, has_fix: bool) -> None:
    """Correct the root by sole points that touch or rest, and by a fix."""
    place_links(f.known.tree, f.q, f.link)
    if f.known.wrenches:
        spread_wrenches(f.soles, f.link)
    if f.layout.momentum:
        correct_by_momentum(f, period)
    for i in range(len(f.soles.points)):
        update_contact(f, i, place_of(f.link, f.soles.points[i]))
    for i in range(len(f.soles.points)):
        if f.loaded[i]:
            for axis in range(3):
                correct_by_rest(f, axis, place_of(f.link, f.soles.points[i]), i)
    if has_fix:
        for axis in range(3):
            correct_entry(f, axis, f.read.position[axis], f.known.variance[3])
    turn_root(f, turned(f.turn.T, vector(f.x[TILT:GYRO])))
    f.x[TILT:GYRO] = 0.0
    f.q[0:3] = f.x[0:3]
    for h in range(len(f.layout.worn)):
        e = f.layout.offsets + h
        f.offset[f.layout.worn[h]] += f.x[e]
        f.q[7 + f.layout.worn[h]] -= f.x[e]
        f.x[e] = 0.0


@compiled
def correct_by_momentum(f: Filter, period: float) -> None:
    """Correct by the angular momentum about the COM, which the wrenches of the feet change.

    Where encoders put the COM beside its place over the foot, the body turns otherwise than by the force.
    Before the offsets of a loaded foot's wrench are known, the momentum is that of the rates.
    """
    s, first, v = f.soles, f.layout.momentum, np.zeros(6 + len(f.joint_rate))
    sum_inertia(f.known.tree, f.link)
    predict_momentum(f, period, com_of(f.link))
    v[3:6], v[6:] = f.rate, f.joint_rate
    move_links(f.known.tree, v, np.zeros(len(v)), 0.0, f.link)
    read, variance = angular_momentum(f.known.tree, f.link), (SPIN_ERROR * f.known.weight) ** 2
    known = (s.tared[0] or not s.loaded[0]) and (s.tared[1] or not s.loaded[1])
    for axis in range(3):
        if known:
            correct_entry(f, first + axis, read[axis], variance)
        else:
            set_entry(f, first + axis, read[axis], variance)


@compiled
def predict_momentum(f: Filter, period: float, com: Vector) -> None:
    """Angular momentum about the COM a period later, by the wrenches of the feet, and its covariance."""
    first, moment = f.layout.momentum, ZERO
    for foot in range(2):
        lever, push = minus(place_of(f.link, f.soles.frame[foot]), com), vector(f.soles.felt[foot, 0:3])
        moment = plus(moment, plus(cross(lever, push), vector(f.soles.felt[foot, 3:6])))
    put(f.x[first : first + 3], plus(vector(f.x[first : first + 3]), times(period, moment)))
    for h in range(len(f.layout.worn)):
        turning = times(-period, moment_derivative(f, h, com))
        for axis in range(3):
            f.covariance[first + axis] += turning[axis] * f.covariance[f.layout.offsets + h]
        for axis in range(3):
            f.covariance[:, first + axis] += turning[axis] * f.covariance[:, f.layout.offsets + h]


@compiled
def moment_derivative(f: Filter, h: int, com: Vector) -> Vector:
    """Derivative of the moment of the wrenches about the COM by the angle of a hinge [N m/rad]."""
    s, joint, total = f.soles, f.link[1 + f.layout.worn[h]], ZERO
    axis, place = vector(joint.axis), vector(joint.place)
    swing = minus(vector(joint.first), times(joint.mass, place))
    away = times(-1.0 / f.link[0].mass, cross(axis, swing))
    for foot in range(2):
        push, moment = vector(s.felt[foot, 0:3]), vector(s.felt[foot, 3:6])
        shifted = away
        if f.layout.moves[foot * len(f.soles.points) // 2, h]:
            sole = place_of(f.link, s.frame[foot])
            shifted = plus(away, cross(axis, minus(sole, place)))
            turning = plus(cross(minus(sole, com), cross(axis, push)), cross(axis, moment))
            total = plus(total, turning)
        total = plus(total, cross(shifted, push))
    return total


@compiled
def update_contact(f: Filter, i: int, arm: Vector) -> None:
    """Update whether a point rests, and its place if that changes; correct by its height at a touch."""
    if f.soles.contact[i] and not f.touched[i]:
        correct_by_touch(f, arm, i)
    f.touched[i] = f.soles.contact[i]
    loaded = f.soles.contact[i] and f.soles.force[i] > (0.5 if f.loaded[i] else 1.0) * LOAD * f.known.weight
    if loaded != f.loaded[i]:
        f.loaded[i] = loaded
        for axis in range(3):
            set_entry(f, POINTS + 3 * i + axis, point_row(f, axis, arm, i, f.x) + arm[axis], 1.0)


@compiled
def point_row(f: Filter, axis: int, arm: Vector, i: int, rows: Any) -> Any:
    """Derivatives of a coordinate of sole point i at an arm by x, times x or rows of the covariance."""
    after, last = (axis + 1) % 3, (axis + 2) % 3  # (turn x arm)[axis] = turn[after] arm[last] - ...
    total = rows[axis] + rows[TILT + after] * arm[last] - rows[TILT + last] * arm[after]
    for h in range(len(f.layout.worn)):
        if f.layout.moves[i, h]:
            joint = f.link[1 + f.layout.worn[h]]
            lever = cross(vector(joint.axis), minus(arm, vector(joint.place)))[axis]
            total = total - lever * rows[f.layout.offsets + h]
    return total


@compiled
def correct_by_touch(f: Filter, arm: Vector, i: int) -> None:
    """Correct by the height of a point that has just touched the floor."""
    z = height_row(f, arm, i, f.x) + arm[2] - f.known.slope[0] * arm[0] - f.known.slope[1] * arm[1]
    innovation = f.known.levels[0] - z
    for level in f.known.levels:
        if abs(level - z) < abs(innovation):
            innovation = level - z
    if abs(innovation) < STEP_ERROR:
        column = height_row(f, arm, i, f.covariance)
        update_by(f, innovation, column, height_row(f, arm, i, column) + FLOOR_ERROR**2)


@compiled
def height_row(f: Filter, arm: Vector, i: int, rows: Any) -> Any:
    """As :func:`point_row`, for the height over the plane of the floor."""
    along = f.known.slope[0] * point_row(f, 0, arm, i, rows)
    return point_row(f, 2, arm, i, rows) - along - f.known.slope[1] * point_row(f, 1, arm, i, rows)


@compiled
def correct_by_rest(f: Filter, axis: int, arm: Vector, i: int) -> None:
    """Correct by one coordinate of a loaded point: ``c_i - p - R s_i`` is zero."""
    row = POINTS + 3 * i + axis
    innovation = f.x[row] - point_row(f, axis, arm, i, f.x) - arm[axis]
    column = point_row(f, axis, arm, i, f.covariance) - f.covariance[row]
    update_by(f, innovation, column, point_row(f, axis, arm, i, column) - column[row] + POINT_ERROR**2)


@compiled
def set_entry(f: Filter, e: int, value: float, variance: float) -> None:
    """Give an entry of x a value that is independent of the others."""
    f.x[e] = value
    f.covariance[e] = 0.0
    f.covariance[:, e] = 0.0
    f.covariance[e, e] = variance


@compiled
def correct_entry(f: Filter, e: int, value: float, variance: float) -> None:
    """Correct by a reading of an entry of x."""
    column = f.covariance[e].copy()
    update_by(f, value - f.x[e], column, column[e] + variance)


@compiled
def update_by(f: Filter, innovation: float, column: Array, variance: float) -> None:
    """Kalman update by one number: its innovation, the variance of this, and its covariance with x."""
    x, covariance = f.x, f.covariance
    for e in range(len(x)):
        gain = column[e] / variance
        if gain != 0.0:  # it is zero for points in the air
            x[e] += gain * innovation
            row = covariance[e]
            for d in range(len(row)):
                row[d] -= gain * column[d]
