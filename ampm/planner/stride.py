"""Plan of the feet: key-frames, heel rise, swing, heel strike, sole points in contact.

A foot passes four key-frames in every stride (paper, Fig. 7): initial contact (heel only), full contact, heel
rise, toe off. Between two key-frames its pitch is one quintic in time; the heel is fixed while the foot rolls
down after initial contact, the ball while the heel rises, and in the swing the ball follows a quintic with an
extra lift at mid swing. Pitch, toe angle and the pivot's path are C2 across every key-frame.

``foot.swing = "paper"`` plans the same key-frames as section 2.3 of the paper, for comparison: cubic splines,
and a ball that leaves the floor with the forward speed ``l_s / T_swing``. The ball is at rest before, so the
foot's velocity jumps there; accelerations jump at every key-frame. With ``foot.v_swing_of = "ankle"`` it is
the ankle's speed, which a rising heel gives it: then no velocity jumps.

Everything is closed form; nothing is sampled or integrated.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ampm.description import SoleGeometry
from ampm.exceptions import InputError
from ampm.parameters import FootParameters
from ampm.planner.contacts import Contacts
from ampm.planner.feet import PIVOT_BALL, PIVOT_HEEL, FeetPlan, FootPath

Array = NDArray[np.float64]

_ORDER = 6  # coefficients of a quintic
_CUBIC_RISE = np.array([0.0, 0.0, 3.0, -2.0, 0.0, 0.0, 0.0])  # from 0 to 1 in unit time, at rest at both ends
_LIFT = np.array([0.0, 0.0, 0.0, 64.0, -192.0, 192.0, -64.0])  # 64 tau^3 (1 - tau)^3, one at mid swing


def quintic(start: ArrayLike, end: ArrayLike, duration: ArrayLike) -> Array:
    """Quintics through (position, velocity, acceleration) at both ends.

    Args:
        start: value, first and second derivative at time 0, shape (3, ...).
        end: the same at ``duration``, shape (3, ...).
        duration: [s], positive, shape (...).

    Returns:
        Coefficients, lowest order first, in time since the start, shape (..., 6).
    """
    p0, v0, a0 = np.asarray(start, dtype=np.float64)
    p1, v1, a1 = np.asarray(end, dtype=np.float64)
    T = np.asarray(duration, dtype=np.float64)
    T2 = T * T
    T3 = T2 * T
    dp, dv, da = p1 - p0 - v0 * T - 0.5 * a0 * T2, (v1 - v0 - a0 * T) * T, (a1 - a0) * T2
    out = np.empty((*dp.shape, _ORDER))
    out[..., 0], out[..., 1], out[..., 2] = p0, v0, 0.5 * a0
    out[..., 3] = (10.0 * dp - 4.0 * dv + 0.5 * da) / T3
    out[..., 4] = (-15.0 * dp + 7.0 * dv - da) / (T3 * T)
    out[..., 5] = (6.0 * dp - 3.0 * dv + 0.5 * da) / (T3 * T2)
    return out


def cubic(start: ArrayLike, end: ArrayLike, duration: ArrayLike) -> Array:
    """Cubics through (position, velocity) at both ends, with coefficients as of :func:`quintic`.

    Args:
        start: value and first derivative at time 0; further rows are not read, shape (2+, ...).
        end: the same at ``duration``, shape (2+, ...).
        duration: [s], positive, shape (...).

    Returns:
        Coefficients, lowest order first, the last two zero, shape (..., 6).
    """
    p0, v0 = np.asarray(start, dtype=np.float64)[:2]
    p1, v1 = np.asarray(end, dtype=np.float64)[:2]
    T = np.asarray(duration, dtype=np.float64)
    dp, dv = p1 - p0 - v0 * T, (v1 - v0) * T
    out = np.zeros((*dp.shape, _ORDER))
    out[..., 0], out[..., 1] = p0, v0
    out[..., 2] = (3.0 * dp - dv) / T**2
    out[..., 3] = (dv - 2.0 * dp) / T**3
    return out


class KeyFrame(NamedTuple):
    """State of a foot where one part of its stride ends and the next begins: value, rate, acceleration.

    Attributes:
        pitch: of the foot segment, shape (3,) [rad, rad/s, rad/s^2].
        toe: angle of the toe joint, shape (3,) [rad, rad/s, rad/s^2].
        ball: x, y, z of the ball in each of n steps, shape (3, 3, n) [m, m/s, m/s^2].
    """

    pitch: Array
    toe: Array
    ball: Array


class _Segment(NamedTuple):
    """One segment of the stride in each of n steps; by default at rest: no motion, flat, straight toe.

    Attributes:
        start: shape (n,) [s].
        pivot: the point that ``path`` is written for.
        contact: heel, ball, tip.
        path: shape (n, 3, 7).
        pitch: shape (n, 6).
        toe: shape (n, 6).
    """

    start: Array
    pivot: int
    contact: tuple[bool, bool, bool]
    path: Array
    pitch: Array | None = None
    toe: Array | None = None


def plan_feet(contacts: Contacts, foot: FootParameters, sole: SoleGeometry, lift_speed: float) -> FeetPlan:
    """Plan both feet's motion over footsteps and phases.

    All steps are built at once: every segment of the stride is an array over the steps, so footsteps and
    durations may differ from step to step.

    Args:
        contacts: which foot stands where, and when.
        foot: key-frame angles, rates and timings.
        sole: the sole's outline.
        lift_speed: the paper's ``v_swing``, read by ``foot.swing = "paper"`` only [m/s].

    Returns:
        Closed-form paths of both feet over the whole plan.

    Raises:
        InputError: a footstep turns or climbs, the phases are not single and double supports in turn, or the
            heel would rise before the foot stands alone, or after it has left.
    """
    if any(step.heading or step.position[2] for step in contacts.footsteps):
        raise InputError(
            "feet are planned straight ahead on level ground; give footsteps of zero heading and z."
        )
    singles, doubles = contacts.phases[0::2], contacts.phases[1::2]
    turns = {(single.kind, double.kind) for single, double in zip(singles, doubles, strict=False)}
    if turns != {("single_support", "double_support")} or len(singles) != len(doubles):
        raise InputError(
            "feet are planned for single and double supports in turn; give a plan of such phases."
        )
    start, single, double = np.array(
        [(s.start, s.duration, d.duration) for s, d in zip(singles, doubles, strict=True)]
    ).T
    if foot.schedule == "roll" and not -double.min() < foot.heel_rise_lead < single.min():
        raise InputError(
            f"foot.heel_rise_lead = {foot.heel_rise_lead:g} s lets the heel rise before the foot stands "
            f"alone, or after it has left; take one between {-double.min():.4g} s and {single.min():.4g} s."
        )
    placement = np.array([f.position for f in contacts.footsteps])
    n = len(singles)
    behind, here, ahead = placement[:n], placement[1 : n + 1], placement[2 : n + 2]
    stance, swing = _stride(foot, sole, start, single, double, behind, here, ahead, lift_speed)
    stands_left = np.array([p.stance == "left" for p in singles])
    return FeetPlan(
        sole=sole,
        left=_foot_path(stance, swing, stands_left),
        right=_foot_path(stance, swing, ~stands_left),
        duration=contacts.duration,
    )


def _stride(
    foot: FootParameters, sole: SoleGeometry, start: Array, single: Array, double: Array, behind: Array,
    here: Array, ahead: Array, lift_speed: float,
) -> tuple[list[_Segment], list[_Segment]]:  # fmt: skip
    """Segments of the foot that stands, and of the one that swings from ``behind`` to ``ahead``.

    The times have the shape (n,) [s], the placements (n, 3) [m].
    """
    roll, paper = foot.schedule == "roll", foot.swing == "paper"
    rise, straighten = double + foot.heel_rise_lead, foot.toe_return * single
    down = foot.full_contact * double
    toe_off, landing = _key_frames(foot, sole, behind, ahead, lift_speed)
    connect = cubic if paper else quintic
    flat_foot, straight_toe = np.zeros(3), np.zeros(3)
    pitch_up = connect(flat_foot, toe_off.pitch, rise)
    pitch = connect(toe_off.pitch, landing.pitch, single)
    pitch_down = connect(landing.pitch, flat_foot, down)
    toe = connect(toe_off.toe, straight_toe, straighten)
    path = np.zeros((len(start), 3, _ORDER + 1))
    path[:, :, :_ORDER] = connect(toe_off.ball, landing.ball, single).swapaxes(0, 1)
    pieces = _paper_swing(path, single, foot.swing_height) if paper else [(0.0, path)]
    if not paper:
        lift_shape = _LIFT / single[:, None] ** np.arange(_ORDER + 1)
        path[:, 0] -= (foot.swing_lag * (ahead[:, 0] - behind[:, 0]))[:, None] * lift_shape
        path[:, 2] += foot.swing_height * lift_shape

    def resting(at: Array, pivot_x: float) -> Array:
        still = np.zeros((len(start), 3, _ORDER + 1))
        still[:, 0, 0], still[:, 1, 0] = at[:, 0] + pivot_x, at[:, 1]
        return still

    none, flat = (False, False, False), (True, True, True)
    standing = resting(here, sole.ball_x)
    stance = [_Segment(start, PIVOT_BALL, flat, standing)]
    swing = []
    # The share of the swing from which on the toe joint is straight.
    returned = foot.toe_return if roll else 0.0
    shares = {share for share, _ in pieces} | ({returned} if returned < 1.0 else set())
    for share in sorted(shares):  # the same polynomials, their time counted from a later start
        since, piece = [item for item in pieces if item[0] <= share][-1]
        bent = _shift(toe, share * single) if share < returned else None
        ball, turned = _shift(piece, (share - since) * single), _shift(pitch, share * single)
        swing.append(_Segment(start + share * single, PIVOT_BALL, none, ball, turned, bent))
    if not roll:
        landed = start + single
    else:
        off = start + single + double
        stance.append(_Segment(off - rise, PIVOT_BALL, (False, True, True), standing, pitch_up, -pitch_up))
        on_heel = resting(ahead, sole.heel_x)
        swing.append(_Segment(start + single, PIVOT_HEEL, (True, False, False), on_heel, pitch_down))
        landed = start + single + down
    if not roll or foot.full_contact < 1.0:
        swing.append(_Segment(landed, PIVOT_BALL, flat, resting(ahead, sole.ball_x)))
    return stance, swing


def _key_frames(
    foot: FootParameters, sole: SoleGeometry, behind: Array, ahead: Array, lift_speed: float
) -> tuple[KeyFrame, KeyFrame]:
    """Toe off and initial contact; at heel rise and full contact the foot is flat and at rest."""
    lift = land = (0.0, 0.0)
    paper, roll = foot.swing == "paper", foot.schedule == "roll"
    of_ankle = paper and roll and foot.v_swing_of == "ankle"
    if roll:
        rate = lift_speed / _ankle_rise(sole, foot.toe_off_angle) if of_ankle else foot.toe_off_rate
        lift = (foot.toe_off_angle, rate)
        land = (-foot.heel_strike_angle, 0.0 if paper else foot.heel_strike_rate)
    toe_off, landing = np.zeros((2, 3, 3, len(behind)))
    # The ball leaves its place from rest.
    toe_off[0, 0], toe_off[0, 1] = behind[:, 0] + sole.ball_x, behind[:, 1]
    if paper and not of_ankle:
        toe_off[1, 0] = lift_speed
    # It arrives turning about the heel that has just landed.
    x, rate = sole.ball_x - sole.heel_x, land[1]
    c, s = math.cos(land[0]), math.sin(land[0])
    landing[0, 0], landing[0, 1], landing[0, 2] = ahead[:, 0] + sole.heel_x + x * c, ahead[:, 1], -x * s
    landing[1, 0], landing[1, 2] = -x * s * rate, -x * c * rate
    landing[2, 0], landing[2, 2] = -x * c * rate**2, x * s * rate**2
    angle = np.array([*lift, 0.0])
    return KeyFrame(angle, -angle, toe_off), KeyFrame(np.array([*land, 0.0]), np.zeros(3), landing)


def _ankle_rise(sole: SoleGeometry, pitch: float) -> float:
    """Height of the ankle over the ball of a foot pitched about it: forward speed per rate [m]."""
    return (sole.ball_x - sole.ankle_x) * math.sin(pitch) + sole.ankle_height * math.cos(pitch)


def _paper_swing(path: Array, single: Array, height: float) -> list[tuple[float, Array]]:
    """The swing's two pieces: a clamped cubic spline through one more key-frame, ``height`` up at mid swing.

    Args:
        path: the swing without the lift, shape (n, 3, 7).
        single: durations of the swings, shape (n,) [s].
        height: lift at mid swing [m].

    Returns:
        (share of the swing at which it begins, coefficients) of either piece.
    """
    half = 0.5 * single
    shape = height * _CUBIC_RISE / half[:, None] ** np.arange(_ORDER + 1)
    rising, falling = path.copy(), _shift(path, half)
    rising[:, 2] += shape
    falling[:, 2] -= shape
    falling[:, 2, 0] += height
    return [(0.0, rising), (0.5, falling)]


def _foot_path(stance: list[_Segment], swing: list[_Segment], stands: NDArray[np.bool_]) -> FootPath:
    """Path of the foot that stands in the steps where ``stands`` holds and swings in the others."""
    parts = [(segment, stands) for segment in stance] + [(segment, ~stands) for segment in swing]
    start = np.concatenate([segment.start[steps] for segment, steps in parts])
    order = np.argsort(start, kind="stable")
    still = np.zeros((len(stands), _ORDER))

    def gather(values: list[Array]) -> Array:
        return np.concatenate([v[steps] for v, (_, steps) in zip(values, parts, strict=True)])[order]

    lengths = [int(np.count_nonzero(steps)) for _, steps in parts]
    return FootPath(
        start=start[order],
        pivot=np.repeat(np.array([segment.pivot for segment, _ in parts], dtype=np.int8), lengths)[order],
        path=gather([segment.path for segment, _ in parts]),
        pitch=gather([still if segment.pitch is None else segment.pitch for segment, _ in parts]),
        toe=gather([still if segment.toe is None else segment.toe for segment, _ in parts]),
        contact=np.repeat(np.array([segment.contact for segment, _ in parts]), lengths, axis=0)[order],
    )


def _shift(coefficients: Array, by: Array) -> Array:
    """Coefficients of p(t + by) from those of p(t), by Taylor expansion (repeated Horner).

    Args:
        coefficients: lowest order first, shape (n, ..., K).
        by: shape (n,) [s].
    """
    shifted = coefficients.copy()
    by = by.reshape(-1, *(1,) * (coefficients.ndim - 2))
    size = coefficients.shape[-1]
    for k in range(size - 1):
        for j in range(size - 2, k - 1, -1):
            shifted[..., j] += by * shifted[..., j + 1]
    return shifted
