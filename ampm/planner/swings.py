"""Feet over any footsteps: roll, swing and landing, each in the heading of its own foot.

The key-frames are those of the periodic gait (:mod:`ampm.planner.stride`), by the share that a step allows:

- A foot rolls by the distance of both feet ahead. Feet beside each other leave and land flat.
- The heel rises when the planned ZMP has come to the ball, and by so much less.
- The heel strikes if the planned ZMP of the next single support begins behind the ankle.
- A foot that has left flat is pitched during the swing, or the ankle would come to its limit.
- A foot that goes up rises early, one that goes down sinks late, and both swing as high as the edges of the
  floor ask for.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray

from ampm.description import SoleGeometry
from ampm.exceptions import BodilyRefusal, InputError
from ampm.parameters import FootParameters
from ampm.planner.centroidal import CentroidalPlan
from ampm.planner.contacts import Contacts
from ampm.planner.feet import PIVOT_BALL, PIVOT_HEEL, FeetPlan, FootPath
from ampm.planner.heights import Ground, uneven
from ampm.planner.stride import LIFT, check_heel_rise, quintic, shift

Array = NDArray[np.float64]
Segment = tuple[float, np.int8, tuple[bool, bool, bool], Array]
"""Start [s], pivot, contact of heel, ball and tip, coefficients of a curve, shape (6, 9)."""

X, Y, Z, PITCH, TOE, HEADING = range(6)
"""Rows of a curve."""

_ORDER = 9
_BUMP = polynomial.polymul([0.0, 0.0, 0.0, 1.0], polynomial.polypow([1.0, -1.0], 5)) / 0.005
"""Pitch of a swing after a flat toe off, about one at its largest, over the share of the swing."""
_PITCH_BUMP = 0.55  # its size after a step with no roll at all [rad]
_FLAT, _MOST = 0.25, 1.15  # share of the gait's step that is walked flat; largest share of its roll [1]
_AT_BALL = 0.006  # distance of the ZMP behind the ball at which the heel rises without delay [m]
_WAIT, _LATEST = 0.39, 0.65  # share of the sole by which the ZMP lags a whole double support; latest rise [1]
_SLOWLY = 1.5  # least time in which a heel rises, in that of its rate at toe off; a gait's own is longer [1]
_NO_RISE = 0.33  # share of the way to the ball that the ZMP must have gone for any rise [1]
_NO_STRIKE, _FULL_STRIKE = 0.3, 0.55  # shares of the way to the heel: no heel strike, all of it [1]
_QUICKEST = 0.4  # least share of the gait's time in which the sole comes down [1]
_EARLY = polynomial.polyint(168.0 * polynomial.polymul([0.0, 0.0, 1.0], polynomial.polypow([1.0, -1.0], 5)))
_LATE = polynomial.polyint(168.0 * polynomial.polymul(np.eye(6)[5], polynomial.polypow([1.0, -1.0], 2)))
_EVEN = np.array([0.0, 0.0, 0.0, 10.0, -15.0, 6.0, 0.0, 0.0, 0.0])
"""Climbs from 0 to 1 over the share of a swing: of a foot that goes up, one that goes down, a quintic."""
_OVER = 0.01  # distance of the soles from floor and edges, at mid swing and along the floor [m]
_HIGHEST = 0.2  # most by which a swing may be higher than the gait's [m]
_GRID = 65  # instants of a double support at which the ZMP is compared with the heel


class Roll(NamedTuple):
    """How each of n swings leaves and lands, shape (n,) each.

    Attributes:
        lift: pitch of the foot at toe off [rad]; zero: it leaves flat.
        lift_rate: its rate [rad/s].
        delay: time by which the heel rises after the begin of the double support [s].
        share: of the gait's roll at toe off [1].
        strike: pitch at landing, toes up [rad]; zero: it lands flat.
        strike_rate: speed at which the toes come down [rad/s].
        down: time in which the sole comes down [s].
    """

    lift: Array
    lift_rate: Array
    delay: Array
    share: Array
    strike: Array
    strike_rate: Array
    down: Array


def plan_swings(
    plan: CentroidalPlan, foot: FootParameters, sole: SoleGeometry, step_length: float
) -> FeetPlan:
    """Plan both feet of a walk from rest to rest.

    Args:
        plan: double and single supports in turn, double support first and last.
        foot: key-frames of the gait.
        sole: outline of a sole.
        step_length: of the gait, for which its key-frames are meant [m].

    Raises:
        InputError: ``foot.swing`` is not quintic, or the heel would rise too early or too late.
        BodilyRefusal: a foot cannot swing over an edge of the floor.
    """
    steps = plan.contacts.footsteps
    higher = np.zeros(plan.contacts.steps)
    if uneven(steps):
        higher = _missing_height(plan.contacts, _planned(plan, foot, sole, step_length, higher), sole)
    return _planned(plan, foot, sole, step_length, higher)


def _missing_height(contacts: Contacts, feet: FeetPlan, sole: SoleGeometry) -> Array:
    """By how much every swing must be higher at its middle to pass over the floor, shape (n,) [m]."""
    ground, steps = Ground.under(contacts.footsteps, sole), contacts.footsteps
    share = np.linspace(0.05, 0.95, _GRID)
    lift, missing = polynomial.polyval(share, LIFT), np.zeros(contacts.steps)
    swings = [phase for phase in contacts.phases if phase.kind == "single_support"]
    for k, swing in enumerate(swings):
        points = feet.sample(swing.start + share * swing.duration)[steps[k].foot == "right"].sole_points
        above = (points[..., 2] - ground.at(points[..., :2], _OVER)).min(axis=1)
        missing[k] = max(float((_OVER - above / lift).max()), 0.0)
        if not missing[k] <= _HIGHEST:
            raise BodilyRefusal(
                f"footstep {k + 3}: the {steps[k].foot} foot would have to swing {missing[k]:.2g} m higher "
                f"than the gait's to pass the edge of the floor, more than {_HIGHEST:g} m",
                reason="edge_in_the_way", value=float(missing[k]), limit=_HIGHEST, unit="m",
                way_out="lengthen the steps about it, or take a lower one",
            )  # fmt: skip
    return missing


def _planned(
    plan: CentroidalPlan, foot: FootParameters, sole: SoleGeometry, step_length: float, higher: Array
) -> FeetPlan:
    """Both feet, with swings that are higher than the gait's, shape (n,) [m]."""
    if foot.swing != "quintic":
        raise InputError(f"footsteps are walked with foot.swing = quintic, not {foot.swing}; leave it out.")
    contacts = plan.contacts
    steps, phases = contacts.footsteps, contacts.phases
    place, heading = np.array([step.position for step in steps]), np.array([step.heading for step in steps])
    start, duration = np.array([phase[:2] for phase in phases]).T
    double, single, lifted = duration[0::2], duration[1::2], start[1::2]
    n = len(single)
    check_heel_rise(foot, single, double[:n])
    roll = _rolls(plan, foot, sole, step_length)
    turn = heading[2:] - heading[:n]
    turn -= 2.0 * math.pi * np.round(turn / (2.0 * math.pi))
    swing, rising, landing = _curves(
        foot, sole, place, heading, turn, roll, single, double, step_length, higher
    )
    toes = sole.has_toes
    none, flat = (False, False, False), (True, True, toes)
    paths: dict[str, list[Segment]] = {"left": [], "right": []}

    def stand(at: float, k: int, yaw: float) -> None:
        curve = np.zeros((6, _ORDER))
        curve[:3, 0], curve[HEADING, 0] = _ball(sole, place[k], yaw), yaw
        paths[steps[k].foot].append((at, PIVOT_BALL, flat, curve))

    yaw = {steps[0].foot: heading[0], steps[1].foot: heading[1]}
    stand(0.0, 0, heading[0])
    stand(0.0, 1, heading[1])
    for k in range(n):
        side, path = steps[k].foot, paths[steps[k].foot]
        rising[k, HEADING, 0] = swing[k, HEADING, 0] = yaw[side]
        if roll.lift[k]:
            at = lifted[k] - double[k] - foot.heel_rise_lead + roll.delay[k]
            path.append((at, PIVOT_BALL, (False, True, toes), rising[k]))
        path.append((lifted[k], PIVOT_BALL, none, swing[k]))
        if roll.lift[k] and toes and foot.toe_return < 1.0:
            since = foot.toe_return * single[k]
            straight = shift(swing[k][None], np.array([since]))[0]
            straight[TOE] = 0.0
            path.append((lifted[k] + since, PIVOT_BALL, none, straight))
        yaw[side] += turn[k]
        landed = lifted[k] + single[k]
        if roll.strike[k]:
            landing[k, HEADING, 0] = yaw[side]
            path.append((landed, PIVOT_HEEL, (True, False, False), landing[k]))
            landed += float(roll.down[k])
        stand(landed, k + 2, yaw[side])
    return FeetPlan(sole, _path(paths["left"]), _path(paths["right"]), contacts.duration)


def _rolls(plan: CentroidalPlan, foot: FootParameters, sole: SoleGeometry, step_length: float) -> Roll:
    """Share of the gait's roll at every toe off and landing."""
    contacts = plan.contacts
    steps, starts = contacts.footsteps, contacts.starts
    place, heading = np.array([step.position[:2] for step in steps]), np.array([s.heading for s in steps])
    n = contacts.steps
    # Distance ahead of the front foot in every double support, along the mean heading.
    between = contacts.headings[0::2]
    ahead = np.diff(place, axis=0)
    spread = np.cos(between) * ahead[:, 0] + np.sin(between) * ahead[:, 1]
    share = np.clip((spread / step_length - _FLAT) / (1.0 - _FLAT), 0.0, _MOST)
    if foot.schedule == "flat":
        share[:] = 0.0
    # ZMP on the standing foot, along it, at the begin and the end of every single support.
    along = np.stack([np.cos(heading[1:-1]), np.sin(heading[1:-1])], axis=1)
    begin, end = (
        ((plan.sample(times).zmp - place[1:-1]) * along).sum(axis=1) for times in (starts[1::2], starts[2::2])
    )
    # The feet do not roll into the first single support, nor out of the last one.
    lift, strike = share[:n].copy(), share[1:].copy()
    lift[0] = strike[-1] = 0.0
    delay = np.zeros(n)
    behind = sole.ball_x - _AT_BALL - end[:-1]
    delay[1:] = np.clip(behind / (_WAIT * sole.length), 0.0, _LATEST)
    lift[1:][end[:-1] < _NO_RISE * sole.ball_x] = 0.0
    double = np.diff(starts, append=contacts.duration)[0::2]
    # A heel that rises late by itself waits only for the rest.
    late = np.minimum(foot.heel_rise_lead, 0.0) / double[:-1]
    wait = np.maximum(delay + late, 0.0)
    back = -begin[1:] / -sole.heel_x
    strike[:-1] *= np.clip((back - _NO_STRIKE) / (_FULL_STRIKE - _NO_STRIKE), 0.0, 1.0)
    # The sole is down before the ZMP has passed the heel.
    share_of_time = np.linspace(0.0, foot.full_contact, _GRID)
    times = (starts[2::2, None] + share_of_time * double[1:, None]).ravel()
    zmp = plan.sample(np.minimum(times, plan.duration)).zmp.reshape(n, _GRID, 2) - place[2:, None]
    landing = np.stack([np.cos(heading[2:]), np.sin(heading[2:])], axis=1)
    before = (zmp * landing[:, None]).sum(axis=2) <= sole.heel_x
    down = foot.full_contact * np.clip((before.sum(axis=1) - 1) / (_GRID - 1), _QUICKEST, 1.0)
    angle, rate = lift * foot.toe_off_angle * (1.0 - wait / (1.0 + late)), lift * foot.toe_off_rate
    latest = double[:-1] + foot.heel_rise_lead - _SLOWLY * angle / np.maximum(rate, 1e-9)
    return Roll(
        lift=angle,
        lift_rate=rate,
        delay=np.minimum(wait * double[:-1], latest),
        share=lift * (1.0 - delay),
        strike=strike * foot.heel_strike_angle,
        strike_rate=strike * foot.heel_strike_rate,
        down=down * double[1:],
    )


def _curves(
    foot: FootParameters, sole: SoleGeometry, place: Array, heading: Array, turn: Array, roll: Roll,
    single: Array, double: Array, step_length: float, higher: Array,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Curves of swing, heel rise before it and roll on the heel after it, each (n, 6, 9)."""
    n = len(single)
    behind, ahead, was, now = place[:n], place[2:], heading[:n], heading[2:]
    along = np.stack([np.cos(now), np.sin(now)], axis=1)
    x, c, s = sole.ball_x - sole.heel_x, np.cos(roll.strike), -np.sin(roll.strike)
    rate = roll.strike_rate
    # Value, rate and acceleration at both ends; it arrives turning about the heel that has just landed.
    begin, end = np.zeros((2, 3, 6, n))
    begin[0, :3] = _ball(sole, behind, was).T
    begin[0, PITCH], begin[1, PITCH] = roll.lift, roll.lift_rate
    reach, speed, gain = sole.heel_x + x * c, -x * s * rate, -x * c * rate**2
    end[0, :2] = (ahead[:, :2] + reach[:, None] * along).T
    end[0, Z], end[0, PITCH], end[0, HEADING] = ahead[:, 2] - x * s, -roll.strike, turn
    end[1, :2], end[1, Z], end[1, PITCH] = speed * along.T, -x * c * rate, rate
    end[2, :2], end[2, Z] = gain * along.T, x * s * rate**2
    swing, rising, landing = np.zeros((3, n, 6, _ORDER))
    swing[:, :, :6] = quintic(begin, end, single).swapaxes(0, 1)
    if sole.has_toes:
        toe = np.zeros((3, n))
        toe[0], toe[1] = -roll.lift, -roll.lift_rate
        swing[:, TOE, :6] = quintic(toe, np.zeros((3, n)), foot.toe_return * single)
    else:
        swing[:, TOE] = 0.0
    # Lift and lag at mid swing, and the pitch after a flat toe off.
    lift_shape = LIFT / np.vander(single, len(LIFT), increasing=True)
    travel = ahead - behind
    for axis in (X, Y):
        swing[:, axis, : len(LIFT)] -= (foot.swing_lag * travel[:, axis])[:, None] * lift_shape
    swing[:, Z, : len(LIFT)] += (foot.swing_height + higher)[:, None] * lift_shape
    climb = travel[:, 2:]
    if climb.any():
        bent = climb * (np.where(climb > 0.0, _EARLY, _LATE) - _EVEN)
        swing[:, Z] += bent / np.vander(single, _ORDER, increasing=True)
    forward = np.clip((travel[:, :2] * along).sum(axis=1) / (1.5 * step_length), 0.0, 1.0)
    bump = _PITCH_BUMP * np.maximum(1.0 - roll.share, 0.0) * forward
    swing[:, PITCH] += bump[:, None] * _BUMP / np.vander(single, _ORDER, increasing=True)
    # Heel rise about the ball, roll down about the heel.
    still, lifting, striking = np.zeros((3, 3, n))
    lifting[0], lifting[1] = roll.lift, roll.lift_rate
    rise = double[:n] + foot.heel_rise_lead - roll.delay
    rising[:, :3, 0] = begin[0, :3].T
    rising[:, PITCH, :6] = quintic(still, lifting, rise)
    if sole.has_toes:
        rising[:, TOE, :6] = -rising[:, PITCH, :6]
    striking[0], striking[1] = -roll.strike, rate
    landing[:, :2, 0], landing[:, Z, 0] = ahead[:, :2] + sole.heel_x * along, ahead[:, 2]
    landing[:, PITCH, :6] = quintic(striking, still, roll.down)
    return swing, rising, landing


def _ball(sole: SoleGeometry, place: Array, heading: Array | float) -> Array:
    """The middle of the ball of a flat foot, shape (..., 3) [m]."""
    ahead = np.stack([np.cos(heading), np.sin(heading), np.zeros_like(heading)], axis=-1)
    return np.asarray(place + sole.ball_x * ahead)


def _path(segments: list[Segment]) -> FootPath:
    start, pivot, contact, curve = zip(*segments, strict=True)
    curves = np.stack(curve)
    return FootPath(
        start=np.array(start),
        pivot=np.array(pivot),
        path=curves[:, :PITCH].copy(),
        pitch=curves[:, PITCH].copy(),
        toe=curves[:, TOE].copy(),
        contact=np.array(contact),
        heading=curves[:, HEADING].copy(),
    )
