"""Feet over any footsteps: how far each foot rolls in each step, by what the step allows.

The key-frames are those of the gait (:mod:`ampm.planner.stride`):

- A foot rolls by the distance of both feet ahead. Feet beside each other leave and land flat.
- The heel rises when the planned ZMP has come to the ball, and by so much less.
- The heel strikes if the planned ZMP of the next single support begins behind the ankle.
- A foot that has left flat is pitched during the swing, or the ankle would come to its limit.
- Feet swing as high as the edges of the floor ask for.
"""

import numpy as np
from numpy.polynomial import polynomial

from ampm.description import SoleGeometry
from ampm.exceptions import BodilyRefusal
from ampm.geometry import Array, rotations
from ampm.parameters import FootParameters
from ampm.planner.centroidal import CentroidalPlan
from ampm.planner.contacts import Contacts
from ampm.planner.feet import FeetPlan
from ampm.planner.heights import Ground, uneven
from ampm.planner.rest_to_rest import SETTLING
from ampm.planner.stride import LIFT, KeyFrames, feet_of

_PITCH_BUMP = 0.55  # pitch about mid swing after a step with no roll at all [rad]
_FLAT, _MOST = 0.25, 1.15  # share of the gait's step that is walked flat; largest share of its roll [1]
_AT_BALL = 0.006  # distance of the ZMP behind the ball at which the heel rises without delay [m]
_WAIT, _LATEST = 0.39, 0.65  # share of the sole by which the ZMP lags a whole double support; latest rise [1]
_SLOWLY = 1.5  # least time in which a heel rises, in that of its rate at toe off; a gait's own is longer [1]
_NO_RISE = 0.33  # share of the way to the ball that the ZMP must have gone for any rise [1]
_NO_STRIKE, _FULL_STRIKE = 0.3, 0.55  # shares of the way to the heel: no heel strike, all of it [1]
_QUICKEST = 0.4  # least share of the gait's time in which the sole comes down [1]
_OVER = 0.01  # distance of the soles from floor and edges, at mid swing and along the floor [m]
_HIGHEST = 0.2  # most by which a swing may be higher than the gait's [m]
_GRID = 65  # instants of a double support at which the ZMP is compared with the heel


def plan_swings(plan: CentroidalPlan, foot: FootParameters, sole: SoleGeometry, length: float) -> FeetPlan:
    """Plan both feet of a walk from rest to rest.

    Args:
        plan: double and single supports in turn, double support first and last.
        foot: key-frames of the gait.
        sole: outline of a sole.
        length: of the gait's step, for which its key-frames are meant [m].

    Raises:
        InputError: the heel would rise too early or too late.
        BodilyRefusal: a foot cannot swing over an edge of the floor.
    """
    frames = _key_frames(plan, foot, sole, length)
    feet = feet_of(frames, plan.contacts, foot, sole)
    if uneven(plan.contacts.footsteps):
        higher = frames.swing_height + _missing_height(plan.contacts, feet, sole)
        feet = feet_of(frames._replace(swing_height=higher), plan.contacts, foot, sole)
    return feet


def _missing_height(contacts: Contacts, feet: FeetPlan, sole: SoleGeometry) -> Array:
    """Height that every swing lacks at its middle to pass over the floor, shape (n,) [m]."""
    ground, steps = Ground.under(contacts.footsteps, sole), contacts.footsteps
    share = np.linspace(0.05, 0.95, _GRID)
    lift, missing = polynomial.polyval(share, LIFT), np.zeros(contacts.steps)
    for k, swing in enumerate([phase for phase in contacts.phases if phase.kind == "single_support"]):
        points = feet.sample(swing.start + share * swing.duration)[steps[k].foot == "right"].sole_points
        above = (points[..., 2] - ground.at(points[..., :2], _OVER)).min(axis=1)
        missing[k] = max(float((_OVER - above / lift).max()), 0.0)
        if not missing[k] <= _HIGHEST:
            raise BodilyRefusal(
                f"footstep {k + 3}: the {steps[k].foot} foot would have to swing {missing[k]:.4g} m higher "
                f"than the gait's to pass the edge of the floor, more than {_HIGHEST:g} m",
                reason="edge_in_the_way",
                value=float(missing[k]),
                limit=_HIGHEST,
                unit="m",
                way_out="lengthen the steps about it, or give it less of a step up or down",
            )
    return missing


def _key_frames(plan: CentroidalPlan, foot: FootParameters, sole: SoleGeometry, length: float) -> KeyFrames:
    """Key-frames of every step: as much of the gait's as the feet's distance and the planned ZMP allow."""
    footsteps, starts, n = plan.contacts.footsteps, plan.contacts.starts, plan.contacts.steps
    place = np.array([step.position[:2] for step in footsteps])
    forward = rotations([step.heading for step in footsteps])[:, :, 0]
    double = np.diff(starts, append=plan.duration)[0::2]
    share = _roll_shares(plan.contacts, place, double, length) * float(foot.schedule == "roll")
    # ZMP on the standing foot at the begin and the end of every single support.
    stance = place[1:-1], forward[1:-1]
    begin, end = (_zmp_ahead(plan, times, *stance) for times in (starts[1::2], starts[2::2]))
    lift, delay = _heel_rises(share[:n], end, sole)
    # A heel that rises late by itself waits only for the rest.
    late = np.minimum(foot.heel_rise_lead, 0.0) / double[:-1]
    wait = np.maximum(delay + late, 0.0)
    angle, rate = lift * foot.toe_off_angle * (1.0 - wait / (1.0 + late)), lift * foot.toe_off_rate
    latest = double[:-1] + foot.heel_rise_lead - _SLOWLY * angle / np.maximum(rate, 1e-9)
    strike = share[1:].copy()
    to_heel = begin[1:] / sole.heel_x
    strike[:-1] *= np.clip((to_heel - _NO_STRIKE) / (_FULL_STRIKE - _NO_STRIKE), 0.0, 1.0)
    # The sole is down before the ZMP has passed the heel.
    grid = starts[2::2] + np.linspace(0.0, foot.full_contact, _GRID)[:, None] * double[1:]
    behind_heel = _zmp_ahead(plan, grid, place[2:], forward[2:]) <= sole.heel_x
    down = foot.full_contact * np.clip((behind_heel.sum(axis=0) - 1) / (_GRID - 1), _QUICKEST, 1.0)
    travel = ((place[2:] - place[:n]) * forward[2:]).sum(axis=1) / (1.5 * length)
    return KeyFrames(
        toe_off_angle=np.append(angle, 0.0),
        toe_off_rate=np.append(rate, 0.0),
        heel_rise_delay=np.append(np.minimum(wait * double[:-1], latest), 0.0),
        heel_strike_angle=strike * foot.heel_strike_angle,
        heel_strike_rate=strike * foot.heel_strike_rate,
        full_contact=down * double[1:],
        swing_height=np.full(n, foot.swing_height),
        swing_pitch=_PITCH_BUMP * np.maximum(1.0 - lift * (1.0 - delay), 0.0) * np.clip(travel, 0.0, 1.0),
    )


def _roll_shares(contacts: Contacts, place: Array, double: Array, step_length: float) -> Array:
    """Share of the gait's roll by the distance of the front foot in all n + 1 double supports [1].

    The feet do not roll out of a stand, nor into one. Durations ``double`` are in s.
    """
    along = rotations(contacts.headings[0::2])[:, :, 0]  # the mean heading
    length = (along * np.diff(place, axis=0)).sum(axis=1)
    rests = double >= 2.0 * SETTLING - 1e-9
    rests[[0, -1]] = True
    return np.where(rests, 0.0, np.clip((length / step_length - _FLAT) / (1.0 - _FLAT), 0.0, _MOST))


def _heel_rises(share: Array, end: Array, sole: SoleGeometry) -> tuple[Array, Array]:
    """Shares of the gait's roll with which n feet leave, and delay of the rise over the double support [1].

    The ZMP ``end`` is that on all but the first foot when its single support ends [m].
    """
    rises, delay = share.copy(), np.zeros(len(share))
    rises[1:][end[:-1] < _NO_RISE * sole.ball_x] = 0.0
    delay[1:] = np.clip((sole.ball_x - _AT_BALL - end[:-1]) / (_WAIT * sole.length), 0.0, _LATEST)
    return rises, delay


def _zmp_ahead(plan: CentroidalPlan, times: Array, place: Array, forward: Array) -> Array:
    """Distance of the ZMP ahead of n footsteps, along them, at times (..., n) [s], shape (..., n) [m]."""
    sample = plan.sample(np.clip(times.ravel(), plan.phases[0].start, plan.duration))
    return np.asarray(((sample.zmp.reshape(*times.shape, 2) - place) * forward).sum(axis=-1))
