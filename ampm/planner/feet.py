"""Paths of the feet: polynomials of a pivot, pitch and toe angle, and their evaluation at any times.

:mod:`ampm.planner.stride` plans them from key-frames.
"""

import math
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ampm.brief import Brief
from ampm.description import SoleGeometry
from ampm.geometry import Array, ReadOnly
from ampm.planner.contacts import LEVEL, Footstep, times_within

HEEL, BALL, TIP = 0, 1, 2
"""Lines of a foot's points, the columns of :attr:`FootSample.contact`."""
PIVOT_HEEL, PIVOT_BALL = np.int8(0), np.int8(1)
"""Values of :attr:`FootPath.pivot`."""


@dataclass(frozen=True)
class FootSample(ReadOnly):
    """One foot's planned motion at N times, in world."""

    position: Array  # sole reference point, shape (N, 3) [m]
    velocity: Array  # its velocity, shape (N, 3) [m/s]
    acceleration: Array  # its acceleration, shape (N, 3) [m/s^2]
    pitch: Array  # rotation of the foot segment about +y, toes down positive, shape (N,) [rad]
    pitch_velocity: Array  # shape (N,) [rad/s]
    pitch_acceleration: Array  # shape (N,) [rad/s^2]
    heading: Array  # yaw of the foot segment, before its pitch, shape (N,) [rad]
    heading_velocity: Array  # shape (N,) [rad/s]
    heading_acceleration: Array  # shape (N,) [rad/s^2]
    toe: Array  # angle of the toe joint about +y, relative to the foot segment, shape (N,) [rad]
    toe_velocity: Array  # shape (N,) [rad/s]
    toe_acceleration: Array  # shape (N,) [rad/s^2]
    contact: NDArray[np.bool_]  # heel, ball and tip planned in contact, shape (N, 3), bool
    roll: Array  # of the foot about the world's +x, after heading and pitch, shape (N,) [rad]
    roll_velocity: Array  # shape (N,) [rad/s]
    roll_acceleration: Array  # shape (N,) [rad/s^2]
    sole_points: Array  # heel left/right, ball left/right, tip left/right, shape (N, 6, 3) [m]


X, Y, Z, PITCH, TOE, HEADING, ROLL = range(ROWS := 7)
"""Rows of :attr:`FootPath.curve`."""


@dataclass(frozen=True)
class FootPath(ReadOnly):
    """One foot's path as a sequence of polynomial segments, each in the time since its own start."""

    start: Array  # start of every segment, ascending, shape (K,) [s]
    pivot: NDArray[np.int8]  # which point the path is written for, heel or ball, shape (K,)
    contact: NDArray[np.bool_]  # heel, ball, tip in contact, shape (K, 3), bool
    # coefficients of the pivot's x, y, z, of pitch, toe angle, heading and roll, lowest order first,
    # shape (K, 7, order) [m/s^k, rad/s^k]
    curve: Array

    @classmethod
    def still(cls, sole: SoleGeometry, footstep: Footstep) -> Self:
        """A foot that stays flat on a footstep along x."""
        x, y, z = footstep.position
        curve = np.array([x + sole.heel_x, y, z, *np.zeros(ROWS - 3)]).reshape(1, ROWS, 1)
        contact = np.array([[True, True, sole.has_toes]])
        return cls(np.zeros(1), np.array([PIVOT_HEEL]), contact, curve)

    def segments(self, times: Array) -> NDArray[np.intp]:
        """Segment at every time, shape (N,)."""
        last = np.searchsorted(self.start, times + 1e-12, side="right") - 1
        return np.asarray(last.clip(0, len(self.start) - 1))

    def until_lift(self, time: float) -> Array:
        """Time from an instant to the end of every group's present contact, or next one, shape (3,) [s]."""
        lifts = self.contact[:-1] & ~self.contact[1:] & (self.start[1:, None] > time)
        return np.min(np.where(lifts, self.start[1:, None], np.inf), axis=0, initial=np.inf) - time


@dataclass(frozen=True)
class FeetPlan(Brief):
    """Both feet's paths over a whole plan, on a floor with slopes along x and y, dz/dx and dz/dy [1].

    The paths' points have axes that are turned about x by the angle of the slope across.
    """

    sole: SoleGeometry
    left: FootPath
    right: FootPath
    duration: float
    slope: tuple[float, float] = LEVEL

    def sample(self, times: ArrayLike) -> tuple[FootSample, FootSample]:
        """Left and right foot at times, shape (N,) [s]; raises InputError if one lies outside the plan."""
        t = times_within(times, self.duration)
        left, right = _sample_path(self.left, self.sole, t), _sample_path(self.right, self.sole, t)
        across = math.atan(self.slope[1])
        return (_rolled(left, across), _rolled(right, across)) if across else (left, right)

    def heights(self, feet: tuple[FootSample, FootSample]) -> Array:
        """Height of the lowest sole point of sampled feet over the floor's plane, shape (N, 2) [m]."""
        points = np.stack([foot.sole_points for foot in feet], axis=1)
        return np.asarray((points[..., 2] - points[..., :2] @ self.slope).min(axis=2))

    def contact(self, times: Array) -> NDArray[np.bool_]:
        """Groups of both feet in contact at times (T,) [s], shape (T, 2, 3)."""
        return np.stack([path.contact[path.segments(times)] for path in (self.left, self.right)], axis=1)

    def until_lift(self, times: Array, contact: NDArray[np.bool_]) -> Array:
        """Time from each tick to the end of the present contact, or of the next one, counted in whole ticks.

        Lift-offs after the last tick count, as far as the feet are planned.

        Args:
            times: of the ticks, shape (T,) [s].
            contact: groups of both feet in contact at these times, shape (T, 2, 3).

        Returns:
            Infinite where nothing lifts off, shape (T, 2, 3) [s].
        """
        beyond = np.stack([path.until_lift(float(times[-1])) for path in (self.left, self.right)])
        if len(times) > 1:
            period = times[-1] - times[-2]
            beyond = period * np.ceil(beyond / period - 1e-6)
        until, ticks = np.full(contact.shape, np.inf), np.arange(len(times))
        for foot, group in np.ndindex(contact.shape[1:]):
            planned = contact[:, foot, group]
            lifts = 1 + np.flatnonzero(planned[:-1] & ~planned[1:])
            at = np.append(times[lifts], times[-1] + beyond[foot, group])
            until[:, foot, group] = at[np.searchsorted(lifts, ticks, side="right")] - times
        return until


def foot_rotation(heading: Array, pitch: Array, roll: Array) -> Array:
    """Rotation of a foot to world, (..., 3, 3), by its heading, pitch and roll (...) [rad]."""
    rotation = np.zeros((*pitch.shape, 3, 3))
    rotation[..., 0, 0] = rotation[..., 2, 2] = np.cos(pitch)
    rotation[..., 0, 2] = np.sin(pitch)
    rotation[..., 2, 0] = -rotation[..., 0, 2]
    rotation[..., 1, 1] = 1.0
    rotation = _turned(heading, rotation.swapaxes(-1, -2)).swapaxes(-1, -2)
    return turn_about_x(roll) @ rotation if roll.any() else rotation


def turn_about_x(angle: ArrayLike) -> Array:
    """Rotations about the x axis by angles (...), shape (..., 3, 3)."""
    c, s, one, zero = np.broadcast_arrays(np.cos(angle), np.sin(angle), 1.0, 0.0)
    return np.stack([one, zero, zero, zero, c, -s, zero, s, c], axis=-1).reshape(*c.shape, 3, 3)


def _rolled(foot: FootSample, angle: float) -> FootSample:
    """A foot whose path is turned about the world's x axis [rad], and the sole by its roll."""
    turn, arms = turn_about_x(angle).T, foot.sole_points - foot.position[:, None]
    position = foot.position @ turn
    return replace(
        foot,
        position=position,
        velocity=foot.velocity @ turn,
        acceleration=foot.acceleration @ turn,
        sole_points=position[:, None] + arms @ turn_about_x(foot.roll).swapaxes(1, 2),
    )


def foot_turning(foot: FootSample) -> tuple[Array, Array]:
    """Angular velocity and acceleration of a foot, each (N, 3) [rad/s, rad/s^2]."""
    velocity, acceleration = np.zeros((2, len(foot.pitch), 3))
    velocity[:, 1], acceleration[:, 1] = foot.pitch_velocity, foot.pitch_acceleration
    acceleration[:, 0] -= foot.pitch_velocity * foot.heading_velocity  # the pitch's axis turns
    velocity, acceleration = _turned(foot.heading, velocity), _turned(foot.heading, acceleration)
    velocity[:, 2], acceleration[:, 2] = foot.heading_velocity, foot.heading_acceleration
    if foot.roll.any():
        velocity, acceleration = (
            np.einsum("nij,nj->ni", turn_about_x(foot.roll), rates) for rates in (velocity, acceleration)
        )
        acceleration += foot.roll_velocity[:, None] * np.cross([1.0, 0.0, 0.0], velocity)
        velocity[:, 0] += foot.roll_velocity
        acceleration[:, 0] += foot.roll_acceleration
    return velocity, acceleration


def _turned(heading: Array, vectors: Array) -> Array:
    """Vectors (..., 3), or (..., n, 3), turned about the vertical by (...) [rad]."""
    turned = vectors.copy()
    extra = (1,) * (vectors.ndim - 1 - heading.ndim)
    c, s = (part.reshape(*heading.shape, *extra) for part in (np.cos(heading), np.sin(heading)))
    turned[..., 0] = c * vectors[..., 0] - s * vectors[..., 1]
    turned[..., 1] = s * vectors[..., 0] + c * vectors[..., 1]
    return turned


def _evaluate(coefficients: Array, t: Array) -> tuple[Array, Array, Array]:
    """Value and two derivatives of polynomials (..., K) at times broadcast against their leading axes."""
    value = np.zeros(np.broadcast_shapes(coefficients.shape[:-1], t.shape))
    first = np.zeros_like(value)
    second = np.zeros_like(value)
    for k in range(coefficients.shape[-1] - 1, -1, -1):  # Horner, derivatives alongside
        second = second * t + 2.0 * first
        first = first * t + value
        value = value * t + coefficients[..., k]
    return value, first, second


def _sample_path(path: FootPath, sole: SoleGeometry, t: Array) -> FootSample:
    """Evaluate one foot's path at times (N,) [s], in the path's axes."""
    index = path.segments(t)
    value, first, second = _evaluate(path.curve[index], (t - path.start[index])[:, None])
    pitch, pitch_velocity, pitch_acceleration = value[:, PITCH], first[:, PITCH], second[:, PITCH]
    yaw, yaw_velocity = value[:, HEADING], first[:, HEADING]
    x = np.where(path.pivot[index] == PIVOT_HEEL, sole.heel_x, sole.ball_x)
    c, s = np.cos(pitch), np.sin(pitch)
    zero, rate, turning = np.zeros_like(c), pitch_velocity[:, None], yaw_velocity[:, None]
    # From the reference point to the pivot, and the derivative with respect to the pitch.
    arm, per_pitch = np.stack([x * c, zero, -x * s], axis=1), np.stack([-x * s, zero, -x * c], axis=1)
    points = _sole_points(sole, c, s, pitch + value[:, TOE])
    arm, per_pitch, points = (_turned(yaw, vectors) for vectors in (arm, per_pitch, points))
    across = _turned_left(arm)
    position = value[:, :PITCH] - arm
    velocity = first[:, :PITCH] - rate * per_pitch - turning * across
    acceleration = second[:, :PITCH] - pitch_acceleration[:, None] * per_pitch + rate**2 * arm
    yaw_part = second[:, HEADING, None] * across + turning**2 * _turned_left(across)
    acceleration -= yaw_part + 2.0 * turning * rate * _turned_left(per_pitch)
    rows = {"pitch": PITCH, "heading": HEADING, "toe": TOE, "roll": ROLL}
    ends = {"": value, "_velocity": first, "_acceleration": second}
    angles = {name + end: part[:, row] for name, row in rows.items() for end, part in ends.items()}
    contact, points = path.contact[index], position[:, None] + points
    return FootSample(position, velocity, acceleration, contact=contact, sole_points=points, **angles)


def _turned_left(vectors: Array) -> Array:
    """Vectors turned about the vertical by a right angle; those along it vanish."""
    return np.stack([-vectors[:, 1], vectors[:, 0], np.zeros(len(vectors))], axis=1)


def _sole_points(sole: SoleGeometry, c: Array, s: Array, toes_pitch: Array) -> Array:
    """Heel left/right, ball left/right, tip left/right from the reference point of a sole that heads along x.

    ``c`` and ``s`` are of the pitch. Shape (N, 6, 3) [m].
    """
    points = np.empty((len(c), 6, 3))
    ct, st = np.cos(toes_pitch), np.sin(toes_pitch)
    toes = sole.tip_x - sole.ball_x
    for group, half_width in enumerate((sole.heel_half_width, sole.ball_half_width, sole.tip_half_width)):
        x = (sole.heel_x, sole.ball_x, sole.ball_x)[group]
        dx, dz = x * c, -x * s
        if group == TIP:
            dx, dz = dx + toes * ct, dz - toes * st
        pair = points[:, 2 * group : 2 * group + 2]
        pair[..., 0], pair[..., 1], pair[..., 2] = dx[:, None], (half_width, -half_width), dz[:, None]
    return points
