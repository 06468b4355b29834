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

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ampm.description import SoleGeometry
from ampm.exceptions import InputError
from ampm.geometry import Array
from ampm.parameters import FootParameters
from ampm.planner.contacts import Contacts
from ampm.planner.feet import PIVOT_BALL, PIVOT_HEEL, FeetPlan, FootPath

_ORDER = 6  # coefficients of a quintic
_PITCH, _TOE = 3, 4  # places of a curve after x, y, z
_CUBIC_RISE = np.array([0.0, 0.0, 3.0, -2.0, 0.0, 0.0, 0.0])  # from 0 to 1 in unit time, at rest at both ends
LIFT = np.array([0.0, 0.0, 0.0, 64.0, -192.0, 192.0, -64.0])  # 64 tau^3 (1 - tau)^3, one at mid swing


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
    out[..., 3] = (dv - 2.0 * dp) / (T * T * T)
    return out


class _Segment(NamedTuple):
    """One segment of the stride in each of n steps, or a table of segments with one more leading axis.

    Attributes:
        start: shape (n,) [s].
        pivot: the point that the curve is written for.
        contact: heel, ball, tip.
        curve: coefficients of the pivot's x, y, z, of pitch and toe angle, shape (n, 5, 7).
    """

    start: Array
    pivot: Any
    contact: Any
    curve: Array


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
    stance = contacts.stance_codes
    if len(stance) % 2 or ((stance[0::2] == 2) | (stance[1::2] != 2)).any():
        raise InputError(
            "feet are planned for single and double supports in turn; give a plan of such phases."
        )
    times = np.array([phase[:2] for phase in contacts.phases])
    start, single, double = times[0::2, 0], times[0::2, 1], times[1::2, 1]
    if foot.schedule == "roll":
        check_heel_rise(foot, single, double)
    placement = np.array([f.position for f in contacts.footsteps])
    n = len(start)
    behind, here, ahead = placement[:n], placement[1 : n + 1], placement[2 : n + 2]
    standing, swing = _stride(foot, sole, start, single, double, behind, here, ahead, lift_speed)
    stands_left = stance[0::2] == 0
    table = _Segment(*map(np.array, zip(*standing, *swing, strict=True)))
    stands = np.arange(len(table.start))[:, None] < len(standing)
    return FeetPlan(
        sole=sole,
        left=_foot_path(table, stands == stands_left),
        right=_foot_path(table, stands != stands_left),
        duration=contacts.duration,
    )


def check_heel_rise(foot: FootParameters, single: Array, double: Array) -> None:
    """Refuse a heel that does not rise between single supports, of durations (n,) each [s]."""
    if not -double.min() < foot.heel_rise_lead < single.min():
        raise InputError(
            f"foot.heel_rise_lead = {foot.heel_rise_lead:g} s lets the heel rise before the foot stands "
            f"alone, or after it has left; take one between {-double.min():.4g} s and {single.min():.4g} s."
        )


def _stride(
    foot: FootParameters, sole: SoleGeometry, start: Array, single: Array, double: Array, behind: Array,
    here: Array, ahead: Array, lift_speed: float,
) -> tuple[list[_Segment], list[_Segment]]:  # fmt: skip
    """Segments of the foot that stands, and of the one that swings from ``behind`` to ``ahead``.

    The times have the shape (n,) [s], the placements (n, 3) [m].
    """
    roll, paper = foot.schedule == "roll", foot.swing == "paper"
    rise, down = double + foot.heel_rise_lead, foot.full_contact * double
    toe_off, landing = _key_frames(foot, sole, behind, ahead, lift_speed)
    # One call for the swing's five curves, the pitch from flat to toe off and that from landing to flat.
    begin, end = np.zeros((2, 3, 7, len(start)))
    begin[:, :5], end[:, :5] = toe_off, landing
    end[:, 5], begin[:, 6] = toe_off[:, _PITCH], landing[:, _PITCH]
    durations = np.array([single, single, single, single, foot.toe_return * single, rise, down])
    curves = (cubic if paper else quintic)(begin, end, durations)
    flight = np.zeros((len(start), 5, _ORDER + 1))
    flight[:, :, :_ORDER] = curves[:5].swapaxes(0, 1)
    pieces = [(0.0, flight)]
    if paper:
        pieces = _paper_swing(flight, single, foot.swing_height)
    else:
        lift_shape = LIFT / np.vander(single, _ORDER + 1, increasing=True)
        flight[:, 0] -= (foot.swing_lag * (ahead[:, 0] - behind[:, 0]))[:, None] * lift_shape
        flight[:, 2] += foot.swing_height * lift_shape

    def resting(at: Array, pivot_x: float) -> Array:
        still = np.zeros_like(flight)
        still[:, 0, 0], still[:, 1, 0] = at[:, 0] + pivot_x, at[:, 1]
        return still

    toes = sole.has_toes
    none, flat = (False, False, False), (True, True, toes)
    standing = resting(here, sole.ball_x)
    stance = [_Segment(start, PIVOT_BALL, flat, standing)]
    swing = []
    # The share of the swing from which on the toe joint is straight.
    returned = foot.toe_return if roll else 0.0
    shares = {share for share, _ in pieces} | ({returned} if returned < 1.0 else set())
    for share in sorted(shares):  # the same polynomials, their time counted from a later start
        since, piece = [item for item in pieces if item[0] <= share][-1]
        curve = shift(flight, share * single) if share else flight.copy()
        if paper:
            curve[:, :_PITCH] = shift(piece[:, :_PITCH], (share - since) * single)
        if share >= returned:
            curve[:, _TOE] = 0.0
        swing.append(_Segment(start + share * single, PIVOT_BALL, none, curve))
    landed = start + single
    if roll:
        rising, on_heel = standing.copy(), resting(ahead, sole.heel_x)
        rising[:, _PITCH, :_ORDER], rising[:, _TOE, :_ORDER] = curves[5], -curves[5]
        on_heel[:, _PITCH, :_ORDER] = curves[6]
        stance.append(_Segment(start + single + double - rise, PIVOT_BALL, (False, True, toes), rising))
        swing.append(_Segment(landed, PIVOT_HEEL, (True, False, False), on_heel))
        landed = landed + down
    if not roll or foot.full_contact < 1.0:
        swing.append(_Segment(landed, PIVOT_BALL, flat, resting(ahead, sole.ball_x)))
    return stance, swing


def _key_frames(
    foot: FootParameters, sole: SoleGeometry, behind: Array, ahead: Array, lift_speed: float
) -> Array:
    """Toe off and initial contact; at heel rise and full contact the foot is flat and at rest.

    Returns:
        Of both, value, rate and acceleration of the ball's x, y, z, of pitch and toe angle in each of n
        steps, shape (2, 3, 5, n) [m, rad, s].
    """
    lift = land = (0.0, 0.0)
    paper, roll = foot.swing == "paper", foot.schedule == "roll"
    of_ankle = paper and roll and foot.v_swing_of == "ankle"
    if roll:
        rate = lift_speed / _ankle_rise(sole, foot.toe_off_angle) if of_ankle else foot.toe_off_rate
        lift = (foot.toe_off_angle, rate)
        land = (-foot.heel_strike_angle, 0.0 if paper else foot.heel_strike_rate)
    # The ball leaves its place from rest.
    speed = lift_speed if paper and not of_ankle else 0.0
    # It arrives turning about the heel that has just landed.
    x, rate = sole.ball_x - sole.heel_x, land[1]
    c, s = math.cos(land[0]), math.sin(land[0])
    frames = np.array(
        [
            [[0.0, 0.0, 0.0, lift[0], -lift[0]], [speed, 0.0, 0.0, lift[1], -lift[1]], [0.0] * 5],
            [
                [0.0, 0.0, -x * s, land[0], 0.0],
                [-x * s * rate, 0.0, -x * c * rate, land[1], 0.0],
                [-x * c * rate**2, 0.0, x * s * rate**2, 0.0, 0.0],
            ],
        ]
    )
    both = frames[..., None].repeat(len(behind), axis=3)
    both[0, 0, 0], both[0, 0, 1] = behind[:, 0] + sole.ball_x, behind[:, 1]
    both[1, 0, 0], both[1, 0, 1] = ahead[:, 0] + sole.heel_x + x * c, ahead[:, 1]
    return both


def _ankle_rise(sole: SoleGeometry, pitch: float) -> float:
    """Height of the ankle over the ball of a foot pitched about it: forward speed per rate [m]."""
    return (sole.ball_x - sole.ankle_x) * math.sin(pitch) + sole.ankle_height * math.cos(pitch)


def _paper_swing(flight: Array, single: Array, height: float) -> list[tuple[float, Array]]:
    """The swing's two pieces: a clamped cubic spline through one more key-frame, ``height`` up at mid swing.

    Args:
        flight: the swing without the lift, shape (n, 5, 7).
        single: durations of the swings, shape (n,) [s].
        height: lift at mid swing [m].

    Returns:
        (share of the swing at which it begins, coefficients) of either piece.
    """
    half = 0.5 * single
    shape = height * _CUBIC_RISE / np.vander(half, _ORDER + 1, increasing=True)
    rising, falling = flight.copy(), shift(flight, half)
    rising[:, 2] += shape
    falling[:, 2] -= shape
    falling[:, 2, 0] += height
    return [(0.0, rising), (0.5, falling)]


def _foot_path(table: _Segment, used: NDArray[np.bool_]) -> FootPath:
    """Path of the foot that passes through the segments of a table of S where ``used``, (S, n), holds."""
    segment, step = used.nonzero()
    order = table.start[segment, step].argsort(kind="stable")
    segment, step = segment[order], step[order]
    curve = table.curve[segment, step]
    return FootPath(
        start=table.start[segment, step],
        pivot=table.pivot[segment],
        path=curve[:, :_PITCH],
        pitch=curve[:, _PITCH, :_ORDER],
        toe=curve[:, _TOE, :_ORDER],
        contact=table.contact[segment],
    )


def shift(curve: Array, by: Array) -> Array:
    """Coefficients of p(t + by) from those of p(t), by Taylor expansion (repeated Horner).

    Args:
        curve: lowest order first, shape (n, m, K).
        by: shape (n,) [s].
    """
    shifted = curve.transpose(2, 1, 0).copy()
    for k in range(len(shifted) - 2, -1, -1):
        shifted[k:-1] += by * shifted[k + 1 :]
    return shifted.transpose(2, 1, 0)
