"""Where the feet are planned to be: key-frames, heel rise, swing, heel strike, and the sole points in contact.

A foot passes four key-frames in every stride (paper, Fig. 7): initial contact (heel only), full contact, heel
rise, toe off. Between two key-frames its pitch is one quintic in time; the heel is fixed while the foot rolls
down after initial contact, the ball while the heel rises, and in the swing the ball follows a quintic with an
extra lift at mid swing. Pitch, toe angle and the pivot's path are C2 across every key-frame: the paper's cubic
with a resting foot lifted at ``l_s / T_swing`` would let the foot's velocity jump.

Everything is closed form; nothing is sampled or integrated.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ampm.body import SoleGeometry
from ampm.exceptions import InputError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from ampm.gait import GaitPlan
    from ampm.parameters import FootParameters

HEEL, BALL, TIP = 0, 1, 2
"""Columns of :attr:`FootSample.contact`."""

_PIVOT_HEEL, _PIVOT_BALL = 0, 1
_ORDER = 6  # coefficients of a quintic
_LIFT = np.array([0.0, 0.0, 0.0, 64.0, -192.0, 192.0, -64.0])  # 64 tau^3 (1 - tau)^3, one at mid swing


@dataclass(frozen=True)
class FootSample:
    """One foot's planned motion at N times, in world.

    Attributes:
        position: sole reference point, shape (N, 3) [m].
        velocity: its velocity, shape (N, 3) [m/s].
        acceleration: its acceleration, shape (N, 3) [m/s^2].
        pitch: rotation of the foot segment about +y, toes down positive, shape (N,) [rad].
        pitch_velocity: shape (N,) [rad/s].
        pitch_acceleration: shape (N,) [rad/s^2].
        toe: angle of the toe joint about +y, relative to the foot segment, shape (N,) [rad].
        toe_velocity: shape (N,) [rad/s].
        toe_acceleration: shape (N,) [rad/s^2].
        contact: heel, ball and tip planned in contact, shape (N, 3), bool.
        sole_points: heel left/right, ball left/right, tip left/right, shape (N, 6, 3) [m].
    """

    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    acceleration: NDArray[np.float64]
    pitch: NDArray[np.float64]
    pitch_velocity: NDArray[np.float64]
    pitch_acceleration: NDArray[np.float64]
    toe: NDArray[np.float64]
    toe_velocity: NDArray[np.float64]
    toe_acceleration: NDArray[np.float64]
    contact: NDArray[np.bool_]
    sole_points: NDArray[np.float64]

    def __post_init__(self) -> None:
        for value in vars(self).values():
            value.setflags(write=False)


@dataclass(frozen=True)
class FootPath:
    """One foot's path as a sequence of polynomial segments, each in the time since its own start.

    Attributes:
        start: start of every segment, ascending, shape (K,) [s].
        pivot: which point the path is written for, heel or ball, shape (K,).
        path: coefficients of the pivot's x, y, z, shape (K, 3, 7), lowest order first [m/s^k].
        pitch: coefficients of the foot's pitch, shape (K, 6) [rad/s^k].
        toe: coefficients of the toe angle, shape (K, 6) [rad/s^k].
        contact: heel, ball, tip in contact, shape (K, 3), bool.
    """

    start: NDArray[np.float64]
    pivot: NDArray[np.int8]
    path: NDArray[np.float64]
    pitch: NDArray[np.float64]
    toe: NDArray[np.float64]
    contact: NDArray[np.bool_]

    def __post_init__(self) -> None:
        for value in vars(self).values():
            value.setflags(write=False)


@dataclass(frozen=True)
class FeetPlan:
    """Both feet's paths over a whole plan."""

    sole: SoleGeometry
    left: FootPath
    right: FootPath
    duration: float

    def sample(self, times: ArrayLike) -> tuple[FootSample, FootSample]:
        """Evaluate left and right foot at ``times``, shape (N,) [s].

        Raises:
            InputError: a time lies outside the plan.
        """
        t = np.atleast_1d(np.asarray(times, dtype=np.float64))
        if t.size and not (t.min() >= -1e-9 and t.max() <= self.duration + 1e-9):
            raise InputError(
                f"time {t.min():g} ... {t.max():g} s lies outside the plan's 0 ... {self.duration:g} s; "
                "ask for times within it or plan more steps"
            )
        return _sample_path(self.left, self.sole, t), _sample_path(self.right, self.sole, t)


def quintic(start: ArrayLike, end: ArrayLike, duration: float) -> NDArray[np.float64]:
    """Quintic through (position, velocity, acceleration) at both ends.

    Args:
        start: value, first and second derivative at time 0.
        end: the same at ``duration``.
        duration: [s], positive.

    Returns:
        Six coefficients, lowest order first, in time since the start.
    """
    p0, v0, a0 = np.asarray(start, dtype=np.float64)
    p1, v1, a1 = np.asarray(end, dtype=np.float64)
    T = duration
    dp, dv, da = p1 - p0 - v0 * T - 0.5 * a0 * T * T, (v1 - v0 - a0 * T) * T, (a1 - a0) * T * T
    return np.array(
        [
            p0,
            v0,
            0.5 * a0,
            (10.0 * dp - 4.0 * dv + 0.5 * da) / T**3,
            (-15.0 * dp + 7.0 * dv - da) / T**4,
            (6.0 * dp - 3.0 * dv + 0.5 * da) / T**5,
        ]
    )


def _evaluate(
    coefficients: NDArray[np.float64], t: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Value and two derivatives of polynomials (..., K) at times broadcast against their leading axes."""
    value = np.zeros(np.broadcast_shapes(coefficients.shape[:-1], t.shape))
    first = np.zeros_like(value)
    second = np.zeros_like(value)
    for k in range(coefficients.shape[-1] - 1, -1, -1):  # Horner, derivatives alongside
        second = second * t + 2.0 * first
        first = first * t + value
        value = value * t + coefficients[..., k]
    return value, first, second


def _sample_path(path: FootPath, sole: SoleGeometry, t: NDArray[np.float64]) -> FootSample:
    index = np.clip(np.searchsorted(path.start, t + 1e-12, side="right") - 1, 0, len(path.start) - 1)
    local = t - path.start[index]
    pivot, pivot_velocity, pivot_acceleration = _evaluate(path.path[index], local[:, None])
    pitch, pitch_velocity, pitch_acceleration = _evaluate(path.pitch[index], local)
    toe, toe_velocity, toe_acceleration = _evaluate(path.toe[index], local)
    x = np.where(path.pivot[index] == _PIVOT_HEEL, sole.heel_x, sole.ball_x)
    c, s = np.cos(pitch), np.sin(pitch)
    zero = np.zeros_like(c)
    arm = np.stack([x * c, zero, -x * s], axis=1)
    arm_first = np.stack([-x * s, zero, -x * c], axis=1)  # d arm / d pitch
    position = pivot - arm
    velocity = pivot_velocity - pitch_velocity[:, None] * arm_first
    acceleration = (
        pivot_acceleration - pitch_acceleration[:, None] * arm_first + (pitch_velocity**2)[:, None] * arm
    )
    return FootSample(
        position=position,
        velocity=velocity,
        acceleration=acceleration,
        pitch=pitch,
        pitch_velocity=pitch_velocity,
        pitch_acceleration=pitch_acceleration,
        toe=toe,
        toe_velocity=toe_velocity,
        toe_acceleration=toe_acceleration,
        contact=path.contact[index],
        sole_points=_sole_points(sole, position, pitch, toe),
    )


def _sole_points(
    sole: SoleGeometry, position: NDArray[np.float64], pitch: NDArray[np.float64], toe: NDArray[np.float64]
) -> NDArray[np.float64]:
    points = np.empty((len(position), 6, 3))
    c, s = np.cos(pitch), np.sin(pitch)
    ct, st = np.cos(pitch + toe), np.sin(pitch + toe)
    toes = sole.tip_x - sole.ball_x
    for group, half_width in enumerate((sole.heel_half_width, sole.ball_half_width, sole.tip_half_width)):
        x = (sole.heel_x, sole.ball_x, sole.ball_x)[group]
        dx, dz = x * c, -x * s
        if group == TIP:
            dx, dz = dx + toes * ct, dz - toes * st
        for side, sign in enumerate((1.0, -1.0)):
            points[:, 2 * group + side, 0] = position[:, 0] + dx
            points[:, 2 * group + side, 1] = position[:, 1] + sign * half_width
            points[:, 2 * group + side, 2] = position[:, 2] + dz
    return points


class _PathBuilder:
    """Collects the segments of one foot in order of time."""

    def __init__(self, sole: SoleGeometry) -> None:
        self.sole = sole
        self.start: list[float] = []
        self.pivot: list[int] = []
        self.path: list[NDArray[np.float64]] = []
        self.pitch: list[NDArray[np.float64]] = []
        self.toe: list[NDArray[np.float64]] = []
        self.contact: list[tuple[bool, bool, bool]] = []

    def add(
        self,
        start: float,
        pivot: int,
        path: NDArray[np.float64],
        pitch: NDArray[np.float64],
        toe: NDArray[np.float64],
        contact: tuple[bool, bool, bool],
    ) -> None:
        self.start.append(start)
        self.pivot.append(pivot)
        self.path.append(path)
        self.pitch.append(pitch)
        self.toe.append(toe)
        self.contact.append(contact)

    def resting(self, start: float, pivot: int, at: NDArray[np.float64]) -> NDArray[np.float64]:
        """Path of a pivot that rests on the floor of the placement ``at`` (x, y)."""
        path = np.zeros((3, _ORDER + 1))
        path[0, 0] = at[0] + (self.sole.heel_x if pivot == _PIVOT_HEEL else self.sole.ball_x)
        path[1, 0] = at[1]
        return path

    def build(self) -> FootPath:
        return FootPath(
            start=np.array(self.start),
            pivot=np.array(self.pivot, dtype=np.int8),
            path=np.array(self.path),
            pitch=np.array(self.pitch),
            toe=np.array(self.toe),
            contact=np.array(self.contact, dtype=bool),
        )


def plan_feet(plan: GaitPlan, foot: FootParameters, sole: SoleGeometry) -> FeetPlan:
    """Plan both feet's motion for a plan's footsteps and phases.

    Args:
        plan: supplies phases (who stands, when) and footsteps (where).
        foot: key-frame angles, rates and timings.
        sole: the sole's outline.

    Returns:
        Closed-form paths of both feet over the whole plan.
    """
    builders = {name: _PathBuilder(sole) for name in ("left", "right")}
    steps = [p for p in plan.phases if p.kind == "single_support"]
    placements = [np.array(f.position, dtype=np.float64) for f in plan.footsteps]
    for k, single in enumerate(steps):
        double_start = single.start + single.duration
        double = next((p for p in plan.phases if p.kind == "double_support" and p.start >= double_start - 1e-12))
        swing_foot = "right" if single.stance == "left" else "left"
        behind, here, ahead = placements[k], placements[k + 1], placements[k + 2]
        _add_stance(builders[single.stance], foot, single.start, single.duration, double.duration, here)
        _add_swing(builders[swing_foot], foot, single.start, single.duration, double.duration, behind, ahead)
    return FeetPlan(sole=sole, left=builders["left"].build(), right=builders["right"].build(), duration=plan.duration)


def _add_stance(
    builder: _PathBuilder,
    foot: FootParameters,
    start: float,
    single: float,
    double: float,
    here: NDArray[np.float64],
) -> None:
    """Flat through single support, then the heel rises about the ball until toe off."""
    still = np.zeros(_ORDER)
    builder.add(start, _PIVOT_BALL, builder.resting(start, _PIVOT_BALL, here), still, still, (True, True, True))
    if foot.schedule == "flat":
        return
    rise = double + foot.heel_rise_lead
    pitch = quintic((0.0, 0.0, 0.0), (foot.toe_off_angle, foot.toe_off_rate, 0.0), rise)
    path = builder.resting(start, _PIVOT_BALL, here)
    builder.add(start + single + double - rise, _PIVOT_BALL, path, pitch, -pitch, (False, True, True))


def _add_swing(
    builder: _PathBuilder,
    foot: FootParameters,
    start: float,
    single: float,
    double: float,
    behind: NDArray[np.float64],
    ahead: NDArray[np.float64],
) -> None:
    """Swing from toe off to initial contact, then roll down about the heel to full contact."""
    sole = builder.sole
    roll = foot.schedule == "roll"
    lift = (foot.toe_off_angle, foot.toe_off_rate, 0.0) if roll else (0.0, 0.0, 0.0)
    land = (-foot.heel_strike_angle, foot.heel_strike_rate, 0.0) if roll else (0.0, 0.0, 0.0)
    pitch = quintic(lift, land, single)
    # The ball leaves its place from rest; it arrives turning about the heel that has just landed.
    x = sole.ball_x - sole.heel_x
    c, s, rate = np.cos(land[0]), np.sin(land[0]), land[1]
    path = np.zeros((3, _ORDER + 1))
    path[0, :_ORDER] = quintic(
        (behind[0] + sole.ball_x, 0.0, 0.0),
        (ahead[0] + sole.heel_x + x * c, -x * s * rate, -x * c * rate**2),
        single,
    )
    path[1, :_ORDER] = quintic((behind[1], 0.0, 0.0), (ahead[1], 0.0, 0.0), single)
    path[2, :_ORDER] = quintic((0.0, 0.0, 0.0), (-x * s, -x * c * rate, x * s * rate**2), single)
    path[0] -= foot.swing_lag * (ahead[0] - behind[0]) * _LIFT / single ** np.arange(_ORDER + 1)
    path[2] += foot.swing_height * _LIFT / single ** np.arange(_ORDER + 1)
    none = (False, False, False)
    if roll:
        straighten = foot.toe_return * single
        toe = quintic((-lift[0], -lift[1], 0.0), (0.0, 0.0, 0.0), straighten)
        builder.add(start, _PIVOT_BALL, path, pitch, toe, none)
        if foot.toe_return < 1.0:  # the same polynomials, their time counted from a later start
            builder.add(
                start + straighten, _PIVOT_BALL, _shift(path, straighten), _shift(pitch, straighten), np.zeros(_ORDER), none
            )
        down = foot.full_contact * double
        roll_down = quintic(land, (0.0, 0.0, 0.0), down)
        rest = builder.resting(start, _PIVOT_HEEL, ahead)
        builder.add(start + single, _PIVOT_HEEL, rest, roll_down, np.zeros(_ORDER), (True, False, False))
        start_flat = start + single + down
    else:
        builder.add(start, _PIVOT_BALL, path, pitch, np.zeros(_ORDER), none)
        start_flat = start + single
    if not roll or foot.full_contact < 1.0:
        still = np.zeros(_ORDER)
        rest = builder.resting(start, _PIVOT_BALL, ahead)
        builder.add(start_flat, _PIVOT_BALL, rest, still, still, (True, True, True))


def _shift(coefficients: NDArray[np.float64], by: float) -> NDArray[np.float64]:
    """Coefficients of p(t + by), by Taylor expansion (repeated Horner)."""
    shifted = np.array(coefficients, dtype=np.float64)
    n = shifted.shape[-1]
    for k in range(n - 1):
        for j in range(n - 2, k - 1, -1):
            shifted[..., j] += by * shifted[..., j + 1]
    return shifted
