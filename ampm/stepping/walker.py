"""One tick of a walk that may step elsewhere, earlier or later than planned."""

import math
from typing import Any

import numpy as np

from ampm.compiled import compiled
from ampm.control.sole import sole_of
from ampm.control.workspace import Array, Wanted
from ampm.stepping.floor import (
    feel,
    floor_under,
    force_factor,
    is_early,
    is_late,
    stands_flat,
    step_up,
)
from ampm.stepping.step_choice import dcm_ahead, plan_step, quintic_tick, ramp_share
from ampm.stepping.stepper import Stepper
from ampm.vectors import clip, cross, minus, plus, put, times, vector

DISTURBED = 0.006
"""Distance of the DCM from its plan from which the sole is shared [m]: twice that of an undisturbed walk."""
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


@compiled
def follow(s: Stepper, wanted: Wanted, stepping: Any) -> None:
    """Take notice of a tick's plan: on the plan, whether to leave it; off the plan, replace it.

    Args:
        s: the stepper.
        wanted: the plan's reference of this tick; off the plan it is replaced.
        stepping: entry of :data:`~ampm.control.workspace.STEPPING`, written.
    """
    w = s.walker[0]
    feel(s)
    off = minus(vector(s.body.com), vector(wanted.com))
    w.away = max(abs(off[0]), abs(off[1]), abs(off[2]))
    dcm = plus(off, times(1.0 / s.omega, minus(vector(s.rates), vector(wanted.com_velocity))))
    stepping.active = stepping.off_plan or math.hypot(dcm[0], dcm[1]) > DISTURBED * s.size
    if stepping.off_plan:
        advance(s, wanted, stepping)
    else:
        stepping.heading[0] = wanted.foot_rotation[w.stance, 0, 0]
        stepping.heading[1] = wanted.foot_rotation[w.stance, 1, 0]
        w.leaves = must_leave(s, wanted)
    stepping.force_factor = force_factor(s, wanted.com[2])


@compiled
def heading_of(rotation: Array) -> tuple[float, float]:
    """Cosine and sine of a foot's heading, from its rotation to world."""
    size = max(math.hypot(rotation[0, 0], rotation[1, 0]), 1e-9)
    return rotation[0, 0] / size, rotation[1, 0] / size


@compiled
def expected_dcm(s: Stepper, wanted: Wanted, out: Array) -> None:
    """DCM, with what taking out the surplus of angular momentum will cost it, shape (2,) [m]."""
    com, mass, surplus = s.body.com, s.body.mass, np.empty(2)
    lever = SURPLUS * s.omega / (mass * s.body.gravity)
    for axis in range(2):
        surplus[axis] = mass * s.rates[3 + axis] - wanted.angular_momentum[axis]
    out[0] = com[0] + s.rates[0] / s.omega + lever * surplus[1]
    out[1] = com[1] + s.rates[1] / s.omega - lever * surplus[0]


@compiled
def must_leave(s: Stepper, wanted: Wanted) -> bool:
    """Whether a walk on the plan has to leave it: a touch out of time, a floor elsewhere, a step in need."""
    w = s.walker[0]
    if is_late(w) or is_early(w):
        return True
    if not w.single:
        return False
    planned = wanted.foot_position[w.stance]
    if stands_flat(s):
        place, floor = s.body.feet[w.stance].place, floor_under(s, w.stance)
        x, y = s.body.com[0] + place[0] - planned[0], s.body.com[1] + place[1] - planned[1]
        if math.hypot(x, y) > OFF_PLACE * s.size or abs(floor[0] - planned[2]) > OFF_HEIGHT:
            return True
        if math.hypot(floor[1], floor[2]) > OFF_TILT:
            return True
    rest = w.duration - w.clock
    if rest < FREEZE:
        return False
    cos, sin = heading_of(wanted.foot_rotation[w.stance])
    sole, reference, dcm = np.empty(4), np.empty(2), np.empty(2)
    sole_of(w.stance, s.body.points, s.body.com, cos, sin, sole)
    expected_dcm(s, wanted, dcm)
    for axis in range(2):
        reference[axis] = wanted.com[axis] + wanted.com_velocity[axis] / s.omega
    begin = w.clock / w.duration * (len(s.curves.r) - 1)
    # Any length: only whether the step is displaced counts.
    return plan_step(s, begin, rest, reference, dcm, sole, 0.0, w.width, cos, sin, False)


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
def read_table(s: Stepper, i: int, part: float, wanted: Wanted) -> None:
    """The planned reference between rows i and i + 1 of the phase's table."""
    w, table = s.walker[0], s.table
    between(table.com, i, part, wanted.com)
    between(table.com_velocity, i, part, wanted.com_velocity)
    between(table.com_acceleration, i, part, wanted.com_acceleration)
    between(table.angular_momentum, i, part, wanted.angular_momentum)
    between(table.moment, i, part, wanted.moment)
    between(table.foot_position, i, part, wanted.foot_position)
    between(table.foot_velocity, i, part, wanted.foot_velocity)
    between(table.foot_acceleration, i, part, wanted.foot_acceleration)
    between(table.foot_rotation, i, part, wanted.foot_rotation)
    between(table.foot_angular_velocity, i, part, wanted.foot_angular_velocity)
    between(table.foot_angular_acceleration, i, part, wanted.foot_angular_acceleration)
    between(table.foot_toe, i, part, wanted.foot_toe)
    between(table.q, i, part, wanted.q)
    between(table.v, i, part, wanted.v)
    between(table.acceleration, i, part, wanted.acceleration)
    between(table.trunk, i, part, wanted.trunk)
    wanted.right_load[0] = (1.0 - part) * table.right_load[i] + part * table.right_load[i + 1]
    wanted.jumps[0] = False
    wanted.planned[:], wanted.due[:] = table.planned[i], table.due[i]
    interval = w.duration / (len(s.curves.r) - 1)
    for foot in range(2):
        for line in range(3):
            left = table.until_lift[i, foot, line]
            if left < math.inf:
                left = max(left - part * interval, 0.0) / max(w.rate, 0.1)
            wanted.until_lift[foot, line] = left


@compiled
def advance(s: Stepper, wanted: Wanted, stepping: Any) -> None:
    """The reference of one tick of a walk that has left the plan; arguments as in :func:`follow`."""
    w, last = s.walker[0], len(s.curves.r) - 1
    at = clip(w.clock / w.duration, 0.0, 1.0) * last
    i = min(int(at), last - 1)
    part = at - i
    read_table(s, i, part, wanted)
    if stands_flat(s):
        under, gain = floor_under(s, w.stance), min(s.tick / FEEL_TIME, 1.0)
        w.slope[0] += gain * (under[1] - w.slope[0])
        w.slope[1] += gain * (under[2] - w.slope[1])
    slope = w.slope[0] - clip(w.slope[0], -LEVEL, LEVEL), w.slope[1] - clip(w.slope[1], -LEVEL, LEVEL)
    cos, sin = heading_of(wanted.foot_rotation[w.stance])
    dcm = np.empty(2)
    if w.single:
        moved = 0.0
        _swing(s, at, cos, sin, slope, wanted, dcm)
    else:
        moved = clip(w.clock / w.duration, 0.0, 1.0)
        _transfer(s, at, moved, cos, sin, wanted, dcm)
    stepping.floor = _centre(s, i, part, moved, slope, dcm, wanted)
    _feet(w, slope, wanted)
    rate = 0.0 if w.waited > 0.0 else w.rate
    for j in range(len(wanted.v)):
        wanted.v[j] *= rate
        wanted.acceleration[j] *= rate * rate
    stepping.heading[0], stepping.heading[1] = cos, sin
    stepping.com_first = w.single and w.excess > COM_FIRST * s.size


@compiled
def _swing(
    s: Stepper, at: float, cos: float, sin: float, slope: tuple[float, float], wanted: Wanted, dcm: Array
) -> None:
    """Single support: the next step, the swing foot on its way to it, and the DCM's reference."""
    w, curves, last = s.walker[0], s.curves, len(s.curves.r) - 1
    i = min(int(at), last - 1)
    part = at - i
    shift, rest = w.shift[w.stance], w.duration - w.clock
    landing = s.table.foot_position[last]
    reach = landing[1 - w.stance, 0:2] - landing[w.stance, 0:2]
    if rest * w.factor > FREEZE:
        sole, measured = np.empty(4), np.empty(2)
        sole_of(w.stance, s.body.points, s.body.com, cos, sin, sole)
        expected_dcm(s, wanted, measured)
        for axis in range(2):
            dcm[axis] = (1.0 - part) * curves.xi[i, axis] + part * curves.xi[i + 1, axis]
        length, width = cos * reach[0] + sin * reach[1], abs(-sin * reach[0] + cos * reach[1])
        plan_step(s, at, rest, dcm, measured, sole, length, width, cos, sin, True)
    duration = max(rest * w.factor, 1e-4)
    x = s.omega * duration
    dcm_ahead(curves.r, curves.xi[-1], at, x, dcm)
    for axis in range(2):
        dcm[axis] += shift[axis] + w.step[axis] * ramp_share(s.omega * w.double) * math.exp(-x)
    target = np.empty(3)
    target[0], target[1] = shift[0] + w.step[0], shift[1] + w.step[1]
    target[2] = shift[2] + slope[0] * (reach[0] + w.step[0]) + slope[1] * (reach[1] + w.step[1])
    quintic_tick(w.swing, target, duration, s.tick)
    longer = math.hypot(reach[0] + w.step[0], reach[1] + w.step[1]) - math.hypot(reach[0], reach[1])
    w.sag = SAG * max(longer, 0.0)


@compiled
def _transfer(
    s: Stepper, at: float, moved: float, cos: float, sin: float, wanted: Wanted, dcm: Array
) -> None:
    """Double support: the shift of the foot that has landed, the DCM's reference, and the clock's rate."""
    w, curves = s.walker[0], s.curves
    landed = 1 - w.stance
    old, new = w.shift[w.stance], w.shift[landed]
    if w.touches[landed] > 0 and w.waited == 0.0:
        for axis in range(2):
            place = s.body.com[axis] + s.body.feet[landed].place[axis]
            new[axis] = place - wanted.foot_position[landed, axis]
        floor = s.table.foot_position[-1, landed, 2]
        new[2] = step_up(s, landed, wanted.foot_position[landed], wanted.foot_rotation[landed], floor)
    x = s.omega * max((w.duration - w.clock) * w.factor, 1e-4)
    dcm_ahead(curves.r, curves.xi[-1], at, x, dcm)
    for axis in range(2):
        here = old[axis] + moved * (new[axis] - old[axis])
        dcm[axis] += here + (new[axis] - here) * (1.0 - ramp_share(x))
    measured = np.empty(2)
    expected_dcm(s, wanted, measured)
    ahead = cos * (measured[0] - dcm[0]) + sin * (measured[1] - dcm[1])
    w.factor = 1.0 / (1.0 + clip((ahead / s.size - HASTE_FROM) / HASTE, 0.0, 1.0))


@compiled
def _centre(
    s: Stepper, i: int, part: float, moved: float, slope: tuple[float, float], dcm: Array, wanted: Wanted
) -> float:
    """COM: horizontally by the DCM, vertically over the floor; height of the floor [m]."""
    w, curves, com, omega = s.walker[0], s.curves, s.body.com, s.omega
    old, new = w.shift[w.stance], w.shift[1 - w.stance]
    for axis in range(2):
        base = old[axis] + moved * (new[axis] - old[axis])
        r = (1.0 - part) * curves.r[i, axis] + part * curves.r[i + 1, axis] + base
        off = com[axis] - wanted.com[axis] - base
        wanted.com[axis] += base + off - clip(off, -CLOSE * s.size, CLOSE * s.size)
        wanted.com_velocity[axis] = omega * (dcm[axis] - wanted.com[axis])
        wanted.com_acceleration[axis] = omega * omega * (wanted.com[axis] - r)
        wanted.moment[axis] *= w.rate
    floor = old[2] + moved * (new[2] - old[2])
    goal = floor - w.sag
    if w.single:
        for axis in range(2):
            goal += slope[axis] * (com[axis] - wanted.foot_position[w.stance, axis] - old[axis])
    climb = slope[0] * s.rates[0] + slope[1] * s.rates[1]
    rise = HEIGHT_RATE**2 * (goal - w.height[0]) + 2.0 * HEIGHT_RATE * (climb - w.height[1])
    w.height[0] += s.tick * (w.height[1] + 0.5 * s.tick * rise)
    w.height[1] += s.tick * rise
    wanted.com[2] += w.height[0]
    wanted.com_velocity[2] += w.height[1]
    wanted.com_acceleration[2] += rise
    return floor


@compiled
def _feet(w: Any, slope: tuple[float, float], wanted: Wanted) -> None:
    """Both feet: their shifts, the clock's rate, the floor's tilt."""
    swing, waits = 1 - w.stance, w.waited > 0.0
    rate, turn = 0.0 if waits else w.rate, (slope[1], -slope[0], 0.0)
    for foot in range(2):
        for axis in range(3):
            wanted.foot_velocity[foot, axis] *= rate
            wanted.foot_acceleration[foot, axis] *= rate * rate
            wanted.foot_angular_velocity[foot, axis] *= rate
            wanted.foot_angular_acceleration[foot, axis] *= rate * rate
        wanted.foot_toe[foot, 1] *= rate
        wanted.foot_toe[foot, 2] *= rate * rate
        if w.single and foot == swing:
            for axis in range(3):
                wanted.foot_position[foot, axis] += w.swing[0, axis]
                wanted.foot_velocity[foot, axis] += w.swing[1, axis]
                wanted.foot_acceleration[foot, axis] += w.swing[2, axis]
        else:
            position = wanted.foot_position[foot]
            put(position, plus(vector(position), vector(w.shift[foot])))
        if slope[0] != 0.0 or slope[1] != 0.0:
            rotation = wanted.foot_rotation[foot]
            for axis in range(3):
                old = rotation[0, axis], rotation[1, axis], rotation[2, axis]
                put(rotation[:, axis], plus(old, cross(turn, old)))
    if waits:
        wanted.planned[swing, :], wanted.due[swing, :] = False, True
        wanted.foot_position[swing, 2] -= DROP * w.waited
        wanted.foot_velocity[swing, 2] = -DROP
