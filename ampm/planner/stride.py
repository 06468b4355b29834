"""Paths of the feet from key-frames: heel rise, toe off, swing, initial and full contact.

A foot passes four key-frames in every stride (paper, Fig. 7): initial contact (heel only), full contact, heel
rise, toe off. Between two key-frames its pitch is one quintic in time; the heel is fixed while the foot rolls
down after initial contact, the ball while the heel rises, and in the swing the ball follows a quintic with an
extra lift at mid swing. Pitch, toe angle and the pivot's path are C2 across every key-frame. Feet that turn
swing in the heading of the landing; feet that climb rise early or sink late.

How far a foot rolls at each of them (:class:`KeyFrames`) is the gait's for equal steps (:func:`plan_feet`),
by the planned ZMP for any footsteps (:mod:`ampm.planner.swings`).

Everything is closed form; nothing is sampled or integrated.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import ArrayLike, NDArray

from ampm.description import SoleGeometry
from ampm.exceptions import InputError
from ampm.geometry import Array, rotations
from ampm.parameters import FootParameters
from ampm.planner.contacts import LEVEL, Contacts
from ampm.planner.feet import (
    HEADING,
    PITCH,
    PIVOT_BALL,
    PIVOT_HEEL,
    ROLL,
    ROWS,
    TOE,
    FeetPlan,
    FootPath,
    X,
    Y,
    Z,
    turn_about_x,
)

_QUINTIC = 6  # coefficients of a quintic
_ORDER = 9  # coefficients of a curve
LIFT = np.array([0.0, 0.0, 0.0, 64.0, -192.0, 192.0, -64.0, 0.0, 0.0])
"""64 tau^3 (1 - tau)^3 over the share tau of a swing: one at mid swing."""
_LEVEL = polynomial.polymul(LIFT[:7], [4.0, -12.0, 12.0])
"""Share of a floor's slope across by which a swinging foot is level: one about mid swing, flat there."""
_BUMP = polynomial.polymul([0.0, 0.0, 0.0, 1.0], polynomial.polypow([1.0, -1.0], 5)) / 0.005
"""Pitch of a swing after a flat toe off, about one at its largest, over the share of the swing."""
_EARLY = polynomial.polyint(168.0 * polynomial.polymul([0.0, 0.0, 1.0], polynomial.polypow([1.0, -1.0], 5)))
_LATE = polynomial.polyint(168.0 * polynomial.polymul(np.eye(6)[5], polynomial.polypow([1.0, -1.0], 2)))
_EVEN = np.array([0.0, 0.0, 0.0, 10.0, -15.0, 6.0, 0.0, 0.0, 0.0])
"""Climbs from 0 to 1 over the share of a swing: of a foot that goes up, one that goes down, a quintic."""


class KeyFrames(NamedTuple):
    """How feet leave, swing and land in n steps, as :class:`FootParameters` say it of all.

    The foot of footstep k leaves for swing k. The last of n + 1 entries is for the foot that stands in the
    last single support.
    """

    toe_off_angle: Array  # heel up, shape (n + 1,) [rad]; the foot leaves flat where this and its rate are 0
    toe_off_rate: Array  # shape (n + 1,) [rad/s]
    heel_rise_delay: Array  # beside the gait's lead, shape (n + 1,) [s]
    heel_strike_angle: Array  # toes up, shape (n,) [rad]; the foot lands flat where this and its rate are 0
    heel_strike_rate: Array  # speed at which the toes come down, shape (n,) [rad/s]
    full_contact: Array  # time from the landing to the flat sole, shape (n,) [s]
    swing_height: Array  # extra lift at mid swing, shape (n,) [m]
    swing_pitch: Array  # extra pitch about mid swing, shape (n,) [rad]


class _Segment(NamedTuple):
    """One segment of the stride in each of n steps."""

    feet: NDArray[np.intp]  # footsteps whose feet pass it, shape (n,)
    start: Array  # shape (n,) [s]
    pivot: np.int8  # the point that the curve is written for
    contact: tuple[bool, bool, bool]  # heel, ball, tip
    curve: Array  # coefficients of the rows, shape (n, 7, 9)
    used: NDArray[np.bool_]  # where there is one, shape (n,), bool


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
    out = np.empty((*dp.shape, _QUINTIC))
    out[..., 0], out[..., 1], out[..., 2] = p0, v0, 0.5 * a0
    out[..., 3] = (10.0 * dp - 4.0 * dv + 0.5 * da) / T3
    out[..., 4] = (-15.0 * dp + 7.0 * dv - da) / (T3 * T)
    out[..., 5] = (6.0 * dp - 3.0 * dv + 0.5 * da) / (T3 * T2)
    return out


def plan_feet(contacts: Contacts, foot: FootParameters, sole: SoleGeometry) -> FeetPlan:
    """Plan both feet over footsteps straight ahead, with the gait's key-frames in every step.

    Args:
        contacts: which foot stands where, and when; a single support first.
        foot: key-frame angles, rates and timings.
        sole: the sole's outline.

    Returns:
        Closed-form paths of both feet over the whole plan.

    Raises:
        InputError: a footstep turns or climbs, or the heel would rise before the foot stands alone, or after
            it has left.
    """
    if any(step.heading or step.position[2] for step in contacts.footsteps):
        raise InputError("feet are planned straight ahead on level ground; let heading and z be 0.")
    n = contacts.steps
    double = np.array([phase.duration for phase in contacts.phases[1::2]])
    rolls = float(foot.schedule == "roll")
    frames = KeyFrames(
        toe_off_angle=np.full(n + 1, rolls * foot.toe_off_angle),
        toe_off_rate=np.full(n + 1, rolls * foot.toe_off_rate),
        heel_rise_delay=np.zeros(n + 1),
        heel_strike_angle=np.full(n, rolls * foot.heel_strike_angle),
        heel_strike_rate=np.full(n, rolls * foot.heel_strike_rate),
        full_contact=foot.full_contact * double,
        swing_height=np.full(n, foot.swing_height),
        swing_pitch=np.zeros(n),
    )
    return feet_of(frames, contacts, foot, sole)


def feet_of(frames: KeyFrames, contacts: Contacts, foot: FootParameters, sole: SoleGeometry) -> FeetPlan:
    """Plan both feet over footsteps, with key-frames of each step.

    All steps are built at once: every segment of the stride is an array over the steps, so footsteps and
    durations may differ from step to step.

    Args:
        frames: of every step.
        contacts: left and right footsteps, single and double supports in turn, a double support last.
        foot: key-frame timings.
        sole: the sole's outline.

    Raises:
        InputError: the heel would rise before the foot stands alone, or after it has left.
    """
    place, yaw, tilt, roll_angle = _on_slope(contacts)
    times = np.array([phase[:2] for phase in contacts.phases])
    first = int(contacts.kind_codes[0])  # 1: both feet stand before the first swing
    lifted, single = times[first::2].T
    landed, double = times[first + 1 :: 2].T
    if foot.schedule == "roll":
        earliest, latest = -double.min(), single.min()
        if not earliest < foot.heel_rise_lead < latest:
            raise InputError(
                f"foot.heel_rise_lead = {foot.heel_rise_lead:g} s lets the heel rise before the foot stands "
                f"alone, or after it has left; take one between {earliest:.4g} s and {latest:.4g} s."
            )
    n, steps = len(single), np.arange(len(single))
    swings = _swings(foot, sole, place, yaw, single, frames, (tilt, roll_angle))
    none, flat = (False, False, False), (True, True, sole.has_toes)
    everywhere = np.ones(n, dtype=bool)
    still = np.zeros((n + 2, ROWS, _ORDER))
    still[:, :3, 0], still[:, HEADING, 0] = _on_sole(sole.ball_x, place, yaw, tilt), yaw
    still[:, PITCH, 0], still[:, ROLL, 0] = -tilt, roll_angle
    segments = [
        _Segment(np.arange(2), np.zeros(2), PIVOT_BALL, flat, still[:2], np.array([first == 1, True])),
        *(
            _Segment(steps, lifted + share * single, PIVOT_BALL, none, curve, everywhere)
            for share, curve in swings
        ),
    ]
    # Roll down about the heel, then the whole sole stands.
    strikes = (frames.heel_strike_angle != 0.0) | (frames.heel_strike_rate != 0.0)
    begin, end = np.zeros((2, 3, n))
    begin[0], begin[1] = -frames.heel_strike_angle, frames.heel_strike_rate
    on_heel = still[2:].copy()
    on_heel[:, : Z + 1, 0] = _on_sole(sole.heel_x, place[2:], yaw[2:], tilt)
    on_heel[:, PITCH, :_QUINTIC] = quintic(begin, end, frames.full_contact)
    on_heel[:, PITCH, 0] -= tilt
    down = landed + np.where(strikes, frames.full_contact, 0.0)
    segments += [
        _Segment(steps + 2, landed, PIVOT_HEEL, (True, False, False), on_heel, strikes),
        _Segment(steps + 2, down, PIVOT_BALL, flat, still[2:], everywhere),
    ]
    # The heel of the standing foot rises about the ball.
    rises = (frames.toe_off_angle[1:] != 0.0) | (frames.toe_off_rate[1:] != 0.0)
    rise = double + foot.heel_rise_lead - frames.heel_rise_delay[1:]
    end[0], end[1] = frames.toe_off_angle[1:], frames.toe_off_rate[1:]
    rising = still[1:-1].copy()
    rising[:, PITCH, :_QUINTIC] = quintic(np.zeros((3, n)), end, rise)
    if sole.has_toes:
        rising[:, TOE] = -rising[:, PITCH]
    rising[:, PITCH, 0] -= tilt
    segments.append(
        _Segment(steps + 1, landed + double - rise, PIVOT_BALL, (False, True, sole.has_toes), rising, rises)
    )
    even, odd = _foot_path(segments, 0), _foot_path(segments, 1)
    left, right = (even, odd) if contacts.footsteps[0].foot == "left" else (odd, even)
    return FeetPlan(sole, left, right, contacts.duration, contacts.slope)


def _on_slope(contacts: Contacts) -> tuple[Array, Array, float, float]:
    """Places (n + 2, 3) [m] and headings (n + 2,) [rad] of the footsteps, and the angles of the floor [rad].

    The places are in axes turned about x with a floor that slopes across; the angles are front up, left up.
    Raises InputError if footsteps on a slope turn or climb.
    """
    place = np.array([step.position for step in contacts.footsteps])
    yaw, slope = np.array([step.heading for step in contacts.footsteps]), contacts.slope
    for first in (0, 1):  # without turns of more than pi from a foot's step to its next one
        yaw[first::2] = np.unwrap(yaw[first::2])
    if slope != LEVEL and (yaw.any() or place[:, 2].any()):
        key, value = ("gait.slope", slope[0]) if slope[0] else ("gait.cross_slope", slope[1])
        raise InputError(
            f"{key} = {value:g} needs footsteps straight along x, all on the slope; give "
            f"footsteps of zero heading and z, or {key} = 0."
        )
    roll_angle = math.atan(slope[1])
    place[:, 2] += place[:, :2] @ slope
    return place @ turn_about_x(roll_angle), yaw, math.atan(slope[0] * math.cos(roll_angle)), roll_angle


def _swings(
    foot: FootParameters,
    sole: SoleGeometry,
    place: Array,
    yaw: Array,
    single: Array,
    frames: KeyFrames,
    floor: tuple[float, float],
) -> list[tuple[float, Array]]:
    """Pieces of n swings: share of the swing at which a piece begins, and its curves, shape (n, 7, 9).

    Arguments are places (n + 2, 3) [m] and headings (n + 2,) [rad] of the footsteps, durations of the swings
    (n,) [s], and the angles of the floor, front up and left up [rad].
    """
    n, (tilt, roll_angle) = len(single), floor
    behind, ahead = place[:n], place[2:]
    along = rotations(yaw[2:])[:, :, 0]
    # Value, rate and acceleration of the ball at both ends. It arrives turning about the heel that has just
    # landed.
    x, pitch, rate = sole.ball_x - sole.heel_x, -frames.heel_strike_angle - tilt, frames.heel_strike_rate
    c, s = np.cos(pitch), np.sin(pitch)
    begin, end = np.zeros((2, 3, ROWS, n))
    begin[0, :3] = _on_sole(sole.ball_x, behind, yaw[:n], tilt).T
    begin[0, PITCH], begin[1, PITCH] = frames.toe_off_angle[:n] - tilt, frames.toe_off_rate[:n]
    heel = _on_sole(sole.heel_x, ahead, yaw[2:], tilt)
    end[0, :2] = (heel[:, :2] + (x * c)[:, None] * along).T
    end[0, Z], end[0, PITCH], end[0, HEADING] = heel[:, 2] - x * s, pitch, yaw[2:] - yaw[:n]
    end[1, :2], end[1, Z], end[1, PITCH] = -x * s * rate * along.T, -x * c * rate, rate
    end[2, :2], end[2, Z] = -x * c * rate**2 * along.T, x * s * rate**2
    durations = np.tile(single, (ROWS, 1))
    if sole.has_toes:
        begin[0, TOE], begin[1, TOE] = -frames.toe_off_angle[:n], -frames.toe_off_rate[:n]
        durations[TOE] *= foot.toe_return
    swing = np.zeros((n, ROWS, _ORDER))
    swing[:, :, :_QUINTIC] = quintic(begin, end, durations).swapaxes(0, 1)
    swing[:, HEADING, 0] = yaw[:n]
    powers = np.vander(single, _ORDER, increasing=True)
    travel = ahead - behind
    travel[:, 2] -= math.tan(tilt) * travel[:, 0]
    if travel[:, 2].any():
        climb = np.where(travel[:, 2:] > 0.0, _EARLY, _LATE) - _EVEN
        swing[:, Z] += travel[:, 2:] * climb / powers
    swing[:, PITCH] += frames.swing_pitch[:, None] * _BUMP / powers
    lift = LIFT / powers
    # A foot that points down turns about the world's x axis by the whole leg, so it swings level.
    swing[:, ROLL] -= roll_angle * _LEVEL / powers
    swing[:, ROLL, 0] += roll_angle
    swing[:, X] -= (foot.swing_lag * travel[:, 0])[:, None] * lift
    swing[:, Y] -= (foot.swing_lag * travel[:, 1])[:, None] * lift
    swing[:, Z] += (frames.swing_height - math.tan(tilt) * foot.swing_lag * travel[:, 0])[:, None] * lift
    if foot.schedule == "flat" or foot.toe_return == 1.0:
        return [(0.0, swing)]
    straight = shift(swing, foot.toe_return * single)  # from there on the toe joint is straight
    straight[:, TOE] = 0.0
    return [(0.0, swing), (foot.toe_return, straight)]


def _on_sole(x: float, place: Array, heading: Array, tilt: float) -> Array:
    """The middle of flat soles at a distance ahead of their reference points, shape (n, 3) [m]."""
    ahead = np.stack([np.cos(heading), np.sin(heading), np.zeros_like(heading)], axis=-1)
    ahead[:, 0], ahead[:, 2] = math.cos(tilt) * ahead[:, 0], math.sin(tilt)
    return np.asarray(place + x * ahead)


def _foot_path(segments: list[_Segment], parity: int) -> FootPath:
    """Path of the foot of the even (0) or odd (1) footsteps."""
    rows = [part.used & (part.feet % 2 == parity) for part in segments]
    counts = [int(row.sum()) for row in rows]
    start = np.concatenate([part.start[row] for part, row in zip(segments, rows, strict=True)])
    curve = np.concatenate([part.curve[row] for part, row in zip(segments, rows, strict=True)])
    order = start.argsort(kind="stable")
    return FootPath(
        start=start[order],
        pivot=np.repeat([part.pivot for part in segments], counts)[order],
        contact=np.repeat([part.contact for part in segments], counts, axis=0)[order],
        curve=curve[order],
    )


def joined(old: FootPath, new: FootPath, begin: float, landed: float) -> FootPath:
    """A foot of one plan until an instant, then of another; their difference fades until a landing.

    Args:
        old: motion until then.
        new: motion from then on, with the foot on the floor at that instant or not, as the old one.
        begin: the instant, within both plans [s]; a foot on its heel first comes down as in the old one.
        landed: when the swinging foot lands, or the next one to swing if both stand [s].
    """
    last = int(old.segments(np.array([begin]))[0])
    if old.pivot[last] == PIVOT_HEEL:
        last, begin = last + 1, float(old.start[last + 1])
    row = int(new.segments(np.array([begin]))[0])
    row += int(new.pivot[row] == PIVOT_HEEL)
    before, start = old.start < begin, np.append(begin, new.start[row + 1 :])
    curves = shift(new.curve[row:], start - new.start[row:])
    gap = shift(old.curve[last : last + 1], np.array([begin - old.start[last]]))[0] - curves[0]
    values = gap[:, :3].T * np.array([[1.0], [1.0], [2.0]])  # with rates and accelerations
    fade = np.zeros_like(gap)
    fade[:, :6] = quintic(values, np.zeros_like(values), np.full(len(gap), landed - begin))
    swings = start < landed - 1e-9
    curves[swings] += shift(fade[None].repeat(swings.sum(), axis=0), start[swings] - begin)
    return FootPath(
        start=np.concatenate([old.start[before], start]),
        pivot=np.concatenate([old.pivot[before], new.pivot[row:]]),
        contact=np.concatenate([old.contact[before], new.contact[row:]]),
        curve=np.concatenate([old.curve[before], curves]),
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
