"""A walk that may step elsewhere, earlier or later than planned: what it keeps, and one tick of it."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ampm.compiled import compiled
from ampm.control.floor import (
    Sensed,
    feel,
    floor_under,
    is_early,
    is_late,
    lifted,
    stands_flat,
    step_up,
)
from ampm.control.sole import sole_of
from ampm.control.stepping import Curves, dcm_ahead, plan_step, quintic_tick, ramp_share
from ampm.vectors import clip, cross

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

OFF_PLACE, OFF_HEIGHT, OFF_TILT = 0.015, 0.0015, 0.008
"""How far from its plan a foot may stand before the walk leaves the plan [m, m, rad]."""
LEVEL = 0.005
"""Slope of the floor that is taken for none: a sole under load is not exactly level [1]."""
FREEZE = 0.05
"""Time before landing from which the step is not changed any more [s]."""
PATIENCE = 0.15
"""Longest time that the clock waits [s]."""
DROP = 0.3
"""Speed at which a late foot goes down [m/s]."""
RATE_TIME = 0.03
"""Time constant of the clock's rate [s]."""
HASTE_FROM, HASTE = 0.1, 0.1
"""DCM ahead of its reference from which a double support is shortened, and by which more to its half [m]."""
CLOSE = 0.005
"""COM error up to which its position is fed back; beyond, only the DCM is [m]."""
SURPLUS = 1.0
"""Share of the surplus of angular momentum that the DCM is expected to pay for [1]."""
COM_FIRST = 0.1
"""How far the next step is wanted beyond its limits where the COM comes before the trunk [m]."""
HEIGHT_RATE = 6.0
"""Rate of the double pole with which the COM follows the floor's height [1/s]."""
SAG = 0.15
"""How far the COM goes down per length by which a step is longer than planned: a straight leg is late [1]."""
FEEL_TIME = 0.03
"""Time constant of the measured slope [s]."""

WALKER = [
    ("single", np.bool_),
    ("stance", np.int64),  # foot that stands; in double support the one that leaves
    ("clock", np.float64),  # time since the phase began, by the plan [s]
    ("duration", np.float64),  # of the phase, by the plan [s]
    ("double", np.float64),  # duration of the double support that follows [s]
    ("rate", np.float64),  # of the clock [1]
    ("factor", np.float64),  # duration of the rest of the phase over the planned one [1]
    ("choice", np.int64),  # which of the candidates that is, -1 that which returns to the plan
    ("late", np.float64),  # time behind the plan [s]
    ("waited", np.float64),  # for a late foot [s]
    ("stood", np.float64),  # time since the phase began [s]
    ("step", np.float64, (2,)),  # displacement of the next step from the standing foot's shift [m]
    ("excess", np.float64),  # by which the wanted displacement is beyond its limits [m]
    ("shift", np.float64, (2, 3)),  # of every foot from where it was planned [m]
    ("swing", np.float64, (3, 3)),  # the same of the swing foot: value and two derivatives
    ("slope", np.float64, (2,)),  # of the floor: dz/dx, dz/dy [1]
    ("height", np.float64, (2,)),  # of the COM over its plan, and its rate [m, m/s]
    ("touches", np.int64, (2,)),  # ticks since every foot touched, 0 without contact
    ("sag", np.float64),  # by which the COM goes down for a long step [m]
    ("load", np.float64),  # vertical force that holds the COM's height over the commanded one [1]
]
"""What a walk keeps from tick to tick. The feet's and points' places are in world."""


class Rows(NamedTuple):
    """Parts of a :class:`~ampm.walk.Reference`; a table has a leading axis of n."""

    centre: Array
    right_load: Array
    feet: Array
    planned: Flags
    due: Flags
    until_lift: Array
    q: Array
    v: Array
    acceleration: Array
    trunk: Array


@compiled
def heading_of(rotation: Array) -> tuple[float, float]:
    """Cosine and sine of a foot's heading, from its rotation by rows, shape (9,)."""
    size = max(math.hypot(rotation[0], rotation[3]), 1e-9)
    return rotation[0] / size, rotation[3] / size


@compiled
def expected_dcm(w: Any, body: Sensed, centre: Array, out: Array) -> None:
    """DCM, with what taking out the surplus of angular momentum will cost it, shape (2,) [m]."""
    lever = SURPLUS * body.omega / (body.mass * body.gravity)
    out[0] = body.com[0] + body.rates[0] / body.omega + lever * (body.mass * body.rates[4] - centre[3, 1])
    out[1] = body.com[1] + body.rates[1] / body.omega - lever * (body.mass * body.rates[3] - centre[3, 0])


@compiled
def departs(
    walker: Any,
    body: Sensed,
    share: Array,
    clock: float,
    curves: Curves,
    width: float,
    centre: Array,
    feet_values: Array,
) -> bool:
    """Whether a walk on the plan has to leave it at this tick.

    Args:
        walker: one entry.
        body: of this tick.
        share: for :func:`~ampm.control.sole.share_sole`; axes and weight are written.
        clock: time since the phase began [s].
        curves: of the phase.
        width: planned distance of the next step from the standing foot, across [m].
        centre: of the planned reference, shape (5, 3).
        feet_values: of the planned reference, shape (2, 27).
    """
    w = walker[0]
    w.clock = clock
    share[0], share[1] = feet_values[w.stance, 9], feet_values[w.stance, 12]
    feel(w, body)
    share[4] = lifted(w, body, centre[0, 2])
    if is_late(w) or is_early(w):
        return True
    if not w.single:
        return False
    planned = feet_values[w.stance]
    if stands_flat(w, body):
        place, floor = body.feet[w.stance].place, floor_under(body, w.stance)
        x, y = body.com[0] + place[0] - planned[0], body.com[1] + place[1] - planned[1]
        if math.hypot(x, y) > OFF_PLACE * body.size or abs(floor[0] - planned[2]) > OFF_HEIGHT:
            return True
        if math.hypot(floor[1], floor[2]) > OFF_TILT:
            return True
    rest = w.duration - w.clock
    if rest < FREEZE:
        return False
    cos, sin = heading_of(planned[9:18])
    sole, reference, xi = np.empty(4), np.empty(2), np.empty(2)
    sole_of(w.stance, body.points, body.com, cos, sin, sole)
    expected_dcm(w, body, centre, xi)
    for axis in range(2):
        reference[axis] = centre[0, axis] + centre[1, axis] / body.omega
    begin = w.clock / w.duration * (len(curves.r) - 1)
    frame = 0.0, width, cos, sin  # any length: only whether the step is displaced counts
    return bool(
        plan_step(
            w, body.omega, body.size, body.foot_width, curves, begin, rest, reference, xi, sole, *frame, False
        )
    )


@compiled
def pass_time(walker: Any, tick: float) -> bool:
    """Let the clock run for a tick; whether the phase has ended."""
    w = walker[0]
    w.late += tick
    if is_early(w):
        w.late -= w.duration - w.clock
        w.clock = w.duration
    if is_late(w) and w.waited < PATIENCE:
        w.waited += tick
        return False
    w.waited = 0.0
    w.rate += (1.0 / w.factor - w.rate) * min(tick / RATE_TIME, 1.0)
    w.clock += w.rate * tick
    w.late -= w.rate * tick
    return bool(w.clock >= w.duration)


@compiled
def between(table: Array, i: int, share: float, out: Array) -> None:
    """What lies between rows i and i + 1 of a table."""
    before, after, result = table[i].ravel(), table[i + 1].ravel(), out.ravel()
    for k in range(len(result)):
        result[k] = (1.0 - share) * before[k] + share * after[k]


@compiled
def advance(
    walker: Any, body: Sensed, share: Array, felt: bool, curves: Curves, table: Rows, row: Rows
) -> None:
    """The reference of one tick of a walk that has left the plan.

    Args:
        walker: one entry.
        body: of this tick.
        share: for :func:`~ampm.control.sole.share_sole`; written.
        felt: whether :func:`feel` was called at this tick.
        curves: of the phase.
        table: of the phase, at equal intervals.
        row: written.
    """
    w = walker[0]
    if not felt:
        feel(w, body)
    last = len(curves.r) - 1
    at = clip(w.clock / w.duration, 0.0, 1.0) * last
    i = min(int(at), last - 1)
    part = at - i
    between(table.centre, i, part, row.centre)
    between(table.feet, i, part, row.feet)
    between(table.q, i, part, row.q)
    between(table.v, i, part, row.v)
    between(table.acceleration, i, part, row.acceleration)
    between(table.trunk, i, part, row.trunk)
    row.right_load[0] = (1.0 - part) * table.right_load[i] + part * table.right_load[i + 1]
    row.planned[:], row.due[:] = table.planned[i], table.due[i]
    for foot in range(2):
        for line in range(3):
            left = table.until_lift[i, foot, line]
            if left < math.inf:
                left = max(left - part * w.duration / last, 0.0) / max(w.rate, 0.1)
            row.until_lift[foot, line] = left
    if stands_flat(w, body):
        under, gain = floor_under(body, w.stance), min(body.tick / FEEL_TIME, 1.0)
        w.slope[0] += gain * (under[1] - w.slope[0])
        w.slope[1] += gain * (under[2] - w.slope[1])
    slope = w.slope[0] - clip(w.slope[0], -LEVEL, LEVEL), w.slope[1] - clip(w.slope[1], -LEVEL, LEVEL)
    cos, sin = heading_of(row.feet[w.stance, 9:18])
    reference = np.empty(2)
    if w.single:
        moved = 0.0
        _swing(w, body, curves, table, at, part, cos, sin, slope, row.centre, reference)
    else:
        moved = clip(w.clock / w.duration, 0.0, 1.0)
        _transfer(w, body, curves, at, moved, cos, sin, table.feet[last, 1 - w.stance, 2], row, reference)
    floor = _centre(w, body, curves, i, part, moved, slope, reference, row)
    _feet(w, slope, row)
    rate = 0.0 if w.waited > 0.0 else w.rate
    for j in range(len(row.v)):
        row.v[j] *= rate
        row.acceleration[j] *= rate * rate
    share[0], share[1], share[2] = cos, sin, floor
    if not felt:
        share[4] = lifted(w, body, row.centre[0, 2])
    share[3] = 1.0 if w.single and w.excess > COM_FIRST * body.size else 0.0


@compiled
def _swing(
    w: Any,
    body: Sensed,
    curves: Curves,
    table: Rows,
    at: float,
    part: float,
    cos: float,
    sin: float,
    slope: tuple[float, float],
    centre: Array,
    reference: Array,
) -> None:
    """Single support: the next step, the swing foot on its way to it, and the DCM's reference."""
    i, last = int(at - part + 0.5), len(curves.r) - 1
    shift, rest = w.shift[w.stance], w.duration - w.clock
    reach = table.feet[last, 1 - w.stance, 0:2] - table.feet[last, w.stance, 0:2]
    if rest * w.factor > FREEZE:
        sole, xi = np.empty(4), np.empty(2)
        sole_of(w.stance, body.points, body.com, cos, sin, sole)
        expected_dcm(w, body, centre, xi)
        for axis in range(2):
            reference[axis] = (1.0 - part) * curves.xi[i, axis] + part * curves.xi[i + 1, axis]
        frame = cos * reach[0] + sin * reach[1], abs(-sin * reach[0] + cos * reach[1]), cos, sin
        plan_step(
            w, body.omega, body.size, body.foot_width, curves, at, rest, reference, xi, sole, *frame, True
        )
    duration = max(rest * w.factor, 1e-4)
    x = body.omega * duration
    dcm_ahead(curves.r, curves.xi[-1], at, x, reference)
    for axis in range(2):
        reference[axis] += shift[axis] + w.step[axis] * ramp_share(body.omega * w.double) * math.exp(-x)
    target = np.empty(3)
    target[0], target[1] = shift[0] + w.step[0], shift[1] + w.step[1]
    target[2] = shift[2] + slope[0] * (reach[0] + w.step[0]) + slope[1] * (reach[1] + w.step[1])
    quintic_tick(w.swing, target, duration, body.tick)
    longer = math.hypot(reach[0] + w.step[0], reach[1] + w.step[1]) - math.hypot(reach[0], reach[1])
    w.sag = SAG * max(longer, 0.0)


@compiled
def _transfer(
    w: Any, body: Sensed, curves: Curves, at: float, moved: float, cos: float, sin: float, floor: float,
    row: Rows, reference: Array,
) -> None:  # fmt: skip
    """Double support: the shift of the foot that has landed, the DCM's reference, and the clock's rate."""
    landed = 1 - w.stance
    old, new = w.shift[w.stance], w.shift[landed]
    if w.touches[landed] > 0 and w.waited == 0.0:
        for axis in range(2):
            new[axis] = body.com[axis] + body.feet[landed].place[axis] - row.feet[landed, axis]
        new[2] = step_up(body, landed, row.feet[landed], floor)
    x = body.omega * max((w.duration - w.clock) * w.factor, 1e-4)
    dcm_ahead(curves.r, curves.xi[-1], at, x, reference)
    for axis in range(2):
        here = old[axis] + moved * (new[axis] - old[axis])
        reference[axis] += here + (new[axis] - here) * (1.0 - ramp_share(x))
    xi = np.empty(2)
    expected_dcm(w, body, row.centre, xi)
    ahead = cos * (xi[0] - reference[0]) + sin * (xi[1] - reference[1])
    w.factor = 1.0 / (1.0 + clip((ahead / body.size - HASTE_FROM) / HASTE, 0.0, 1.0))


@compiled
def _centre(
    w: Any,
    body: Sensed,
    curves: Curves,
    i: int,
    part: float,
    moved: float,
    slope: tuple[float, float],
    reference: Array,
    row: Rows,
) -> float:
    """COM: horizontally by the DCM, vertically over the floor; height of the floor [m]."""
    old, new, centre = w.shift[w.stance], w.shift[1 - w.stance], row.centre
    com, omega = body.com, body.omega
    for axis in range(2):
        base = old[axis] + moved * (new[axis] - old[axis])
        r = (1.0 - part) * curves.r[i, axis] + part * curves.r[i + 1, axis] + base
        off = com[axis] - centre[0, axis] - base
        centre[0, axis] += base + off - clip(off, -CLOSE * body.size, CLOSE * body.size)
        centre[1, axis] = omega * (reference[axis] - centre[0, axis])
        centre[2, axis] = omega * omega * (centre[0, axis] - r)
        centre[4, axis] *= w.rate
    floor = old[2] + moved * (new[2] - old[2])
    goal = floor - w.sag
    if w.single:
        for axis in range(2):
            goal += slope[axis] * (com[axis] - row.feet[w.stance, axis] - old[axis])
    climb = slope[0] * body.rates[0] + slope[1] * body.rates[1]
    rise = HEIGHT_RATE**2 * (goal - w.height[0]) + 2.0 * HEIGHT_RATE * (climb - w.height[1])
    w.height[0] += body.tick * (w.height[1] + 0.5 * body.tick * rise)
    w.height[1] += body.tick * rise
    centre[0, 2] += w.height[0]
    centre[1, 2] += w.height[1]
    centre[2, 2] += rise
    return floor


@compiled
def _feet(w: Any, slope: tuple[float, float], row: Rows) -> None:
    """Both feet: their shifts, the clock's rate, the floor's tilt."""
    swing, waits = 1 - w.stance, w.waited > 0.0
    rate, turn = 0.0 if waits else w.rate, (slope[1], -slope[0], 0.0)
    for foot in range(2):
        values = row.feet[foot]
        for axis in range(3):
            for k in (3, 18):
                values[k + axis] *= rate
                values[k + 3 + axis] *= rate * rate
        values[25] *= rate
        values[26] *= rate * rate
        for axis in range(3):
            if w.single and foot == swing:
                for order in range(3):
                    values[3 * order + axis] += w.swing[order, axis]
            else:
                values[axis] += w.shift[foot, axis]
        if slope[0] != 0.0 or slope[1] != 0.0:
            for axis in range(3):
                moved = cross(turn, (values[9 + axis], values[12 + axis], values[15 + axis]))
                for k in range(3):
                    values[9 + 3 * k + axis] += moved[k]
    if waits:
        row.planned[swing, :], row.due[swing, :] = False, True
        row.feet[swing, 2] -= DROP * w.waited
        row.feet[swing, 5] = -DROP
