"""Cost of a walk and its margins to every limit of body and floor.

Units and meanings are listed in :mod:`validation.judge.metrics`.
"""

import math
from typing import Any

import numpy as np

from ampm.body.motion import Extreme
from ampm.description import BodyDescription
from ampm.geometry import Array, Flags, blocks
from ampm.planner.centroidal import PlanSample
from validation.measure.log import LOADED
from validation.measure.measure import MeasuredGait
from validation.trial.followed import Followed
from validation.trial.record import SimulationRecord, state_steps
from validation.trial.shapes import Shapes

SATURATED = 0.999
"""Share of its limit from which a motor counts as saturated [1]."""
STANDING = 0.05
"""Mean speed of the COM on the floor below which a body stands, and has no cost of transport [m/s]."""
CLEARANCE_ROWS = 2
"""Clearance is measured at every second state on disk, so every 20 ms: at 10 m/s^2 half a millimetre is
lost."""
_TILTED = 0.5  # tilt of pelvis or trunk that is warned of [rad]


def tilt_warnings(tilt: float | None, where: str) -> list[str]:
    """A sentence on a pelvis or trunk that tilts far [rad]; none if it does not."""
    if tilt is None or not tilt > _TILTED:
        return []
    why = "Undisturbed, it balances the legs: shorter steps need less, in a periodic gait a smaller gait.c_s."
    return [f"The segment {where} tilts by {tilt:.2f} rad. {why}"]


def largest_tilt(q: Array, time: Array, description: BodyDescription, shapes: Shapes) -> Extreme:
    """Largest angle of pelvis or trunk from upright [rad], at MuJoCo configurations q, shape (T, nq)."""
    names = (description.root_segment, description.trunk_segment)
    return Extreme.of(shapes.tilts(q, names), time, names, largest=True)


def feedback_effort(record: SimulationRecord, sample: PlanSample, rows: Flags) -> dict[str, Any]:
    """RMS of command minus plan over ``rows``, shape (K,): the controller's correction of the formula.

    It has ``force`` [N], ``angular_momentum`` [N m s] and ``zmp`` [m]. Only instants with a new command
    count: between them it is held, while the plan goes on.
    """
    pairs = {
        "force": (record.command_force, sample.force),
        "angular_momentum": (record.command_angular_momentum[:, :2], sample.angular_momentum),
        "zmp": (record.command_zmp, sample.zmp),
    }
    effort = {}
    for name, (command, planned) in pairs.items():
        used = rows.copy()
        used[1:] &= (command[1:] != command[:-1]).any(axis=1)
        gap = (command - planned)[used]
        effort[name] = tuple(np.sqrt((gap**2).sum(axis=0) / (len(gap) or math.nan)).tolist())
    return effort


def margins(
    followed: Followed,
    record: SimulationRecord,
    measured: MeasuredGait,
    description: BodyDescription | None = None,
    shapes: Shapes | None = None,
) -> dict[str, Any]:
    """Distances to the limits of body and floor, over the whole record, first step included.

    Returns:
        :class:`Extreme` values, ``knee`` NaN without a description, ``clearance`` and ``tilt`` of pelvis or
        trunk [rad] NaN without shapes, ``speed`` of a body with speed limits only; the share ``saturated``,
        the largest share of each motor's limit ``torque_by_joint`` [1], and the floor's coefficient
        ``friction_available`` [1].
    """
    time, joints, feet = measured.time, record.joint_names, ("left", "right")
    angles, rates, (low, high) = record.q[:, 7:], record.qd[:, 6:], record.joint_range.T  # of the hinges
    room = angles - low
    np.minimum(room, high - angles, out=room)
    legs = [] if description is None else [leg for leg in description.legs if leg.knee in joints]
    knees = np.empty((record.time.size, len(legs)))
    for column, leg in enumerate(legs):
        knees[:, column] = leg.knee_sign * (angles[:, joints.index(leg.knee)] - leg.straight_knee)
    # The ratio of two small forces is noise.
    normal = measured.foot_force[..., 2]
    normal = np.where(normal >= LOADED * measured.weight, normal, np.nan)
    friction = np.hypot(measured.foot_force[..., 0], measured.foot_force[..., 1]) / normal
    found: dict[str, Any] = {
        **_motors(record, time),
        "friction": Extreme.of(friction, time, feet, largest=True),
        "friction_available": record.friction,
        "joint": Extreme.of(room, record.time, joints),
        "knee": Extreme.of(knees, record.time, [leg.knee for leg in legs]),
        "clearance": Extreme(math.nan),
        "tilt": Extreme(math.nan),
        "plan_polygon": _plan_polygon(followed, record, time),
        "measured_polygon": Extreme.of(measured.polygon_margin, time),
        "penetration": Extreme.of(measured.penetration, time, feet, largest=True),
    }
    if shapes:
        rows = record.state_rows % (CLEARANCE_ROWS * state_steps(record.time_step)) == 0
        q, instants = record.q[rows], record.state_rows[rows] * record.time_step
        found["clearance"] = Extreme.of_gaps(shapes.recorded_gaps(q), instants)
        if description is not None:
            found["tilt"] = largest_tilt(q, instants, description, shapes)
    if fastest := dict(() if description is None else description.speed_limits):
        columns, limits = [joints.index(name) for name in fastest], np.array(list(fastest.values()))
        shares = np.abs(rates[:, columns]) / limits
        found["speed"] = Extreme.of(shares, record.time, list(fastest), largest=True)
    return found


def _motors(record: SimulationRecord, time: Array) -> dict[str, Any]:
    """Torques over their limits: largest, by joint, and how often one is saturated [1]."""
    use, joints = record.torque, record.joint_names
    use /= record.torque_limit
    np.abs(use, out=use)
    saturated = np.count_nonzero((use >= SATURATED).any(axis=1))
    return {
        "torque": Extreme.of(use, time, joints, largest=True),
        "torque_by_joint": dict(zip(joints, use.max(axis=0, initial=0.0).tolist(), strict=True)),
        "saturated": saturated / time.size if time.size and joints else math.nan,
    }


def _plan_polygon(followed: Followed, record: SimulationRecord, time: Array) -> Extreme:
    """Least margin of the planned ZMP; of a whole walk on one plan exactly, else at the instants compared."""
    if followed.plans[0].plan.command is not None:
        return Extreme(math.nan)
    least = followed.plans[0].least_zmp_margin
    if least is not None and not followed.moved and record.outcome.completed:
        return Extreme(*least)
    return Extreme.of(followed.at(time).zmp_margin, time)


def energy(record: SimulationRecord, rows: Flags) -> dict[str, float]:
    """Work of the motors over ``rows``, shape (K,): torque of the step times the mean joint rate over it.

    The mechanical cost of transport is that of Collins, Ruina, Tedrake and Wisse, Science 307 (2005), over
    the length of the COM's path on the floor.
    """
    names = ("positive_work", "negative_work", "distance", "speed", "cost_of_transport")
    used = np.flatnonzero(rows)
    if used.size == 0 or not record.joint_names:
        return dict.fromkeys(names, math.nan)
    rates = record.qd[:, 6:]  # of the hinges
    power = record.torque_at(used)
    for part in blocks(used.size):
        power[part] *= 0.5 * (rates[used[part] + 1] + rates[used[part]])
    positive, negative = (float(of(power, 0.0).sum() * record.time_step) for of in (np.maximum, np.minimum))
    moves = np.diff(record.com[used[0] : used[-1] + 2, :2], axis=0)
    distance = float(np.sqrt((moves * moves).sum(axis=1)).sum())
    speed = distance / (len(moves) * record.time_step)
    transport = positive / (record.mass * record.gravity * distance) if speed >= STANDING else math.nan
    return dict(zip(names, (positive, negative, distance, speed, transport), strict=True))
