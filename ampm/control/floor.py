"""The reference over a floor that is higher, lower or steeper than the plan's.

A foot that stands flat tells the height and the slope of the floor under it. The reference follows: the swing
foot's height over that plane, and the COM's as the load goes from foot to foot. A foot that touches late goes
down faster and faster.
"""

import numpy as np

from ampm.compiled import compiled
from ampm.control.workspace import Workspace
from ampm.geometry import Array
from ampm.planner.feet import BALL, HEEL
from ampm.vectors import clip, column, cross, plus, put

LEVEL_HEIGHT = 0.005
"""Largest height over the plan's floor that is not followed [m]: soles sink in by some millimetres."""
FLAT_SLOPE = 0.012
"""Largest mean slope that is not followed [1]."""
RISE = 0.005
"""Rise from foot to foot from which on their heights tell whether a slope is one [m]."""
AGREES = 0.15
"""If a foot rises by less than this share of what its slope says, a stone tilts it and the floor counts as
level. From twice the share on, the whole slope counts [1]."""
SLOPE_RATE = 5.0
"""Rate of the mean of the slope [1/s]: on a soft floor a sole tilts to and fro with its load."""
UPRIGHT = 0.995
"""Cosine of a sole's tilt below which it stands on an edge."""
RATE = 40.0
"""Rate of the filters of heights, critically damped, and tilts [1/s]."""
PATIENCE = 0.016
"""Time that a foot may be late before it goes down faster [s]."""
HURRY, FASTEST = 5.0, 0.3
"""Acceleration of a late foot [m/s^2], and its largest speed beyond the touch-down velocity [m/s]."""


@compiled
def follow_floor(work: Workspace) -> None:
    """Raise feet and COM of the reference by the floor's height over the plan's, and tilt the soles."""
    lines, tick = work.contact.lines, 1.0 / work.gains.frequency
    for i in range(len(work.body.feet)):
        if lines[i].touched.any():
            _measure_floor(work, i, tick)
        elif lines[1 - i].touched.any():
            _expect_floor(work, i, tick)
        _hurry(work, i, tick)
        _raise(work, i, tick)


@compiled
def _measure_floor(work: Workspace, i: int, tick: float) -> None:
    """Update footprint, height and slope of the floor over the plan's from a foot, if it stands flat."""
    foot, heel, ball = work.body.feet[i], work.contact.lines[i, HEEL], work.contact.lines[i, BALL]
    place, planned = work.wanted.foot_position[i], work.wanted.foot_rotation[i]
    loaded = heel.opening == 1.0 and heel.limit == 1.0 and ball.opening == 1.0
    level = heel.touching and ball.touching and foot.rotation[2, 2] > UPRIGHT
    if heel.planned and ball.planned and loaded and level:
        height = work.body.com[2] - place[2] + foot.place[2]
        foot.footprint[0], foot.footprint[1], foot.footprint[2] = place[0], place[1], height
        tilted = np.abs(foot.tilt).max() > 0.5 * FLAT_SLOPE
        foot.floor_rise = height if tilted else _beyond(height, LEVEL_HEIGHT)
        for axis in range(2):
            slope = planned[axis, 2] / planned[2, 2] - foot.rotation[axis, 2] / foot.rotation[2, 2]
            foot.slope[axis] += SLOPE_RATE * tick * (slope - foot.slope[axis])


@compiled
def _expect_floor(work: Workspace, i: int, tick: float) -> None:
    """Update height and slope of the floor where a foot is to land, from what the other foot measured."""
    foot, other, planned = work.body.feet[i], work.body.feet[1 - i], work.wanted.foot_position
    step = other.footprint - foot.footprint
    told = other.slope[0] * step[0] + other.slope[1] * step[1]
    share = slope_share(told, step[2]) if abs(told) > RISE else 1.0
    reach, foot.floor_rise = planned[i] - planned[1 - i], other.floor_rise
    for axis in range(2):
        slope = share * _beyond(other.slope[axis], FLAT_SLOPE)
        foot.floor_rise += slope * reach[axis]
        foot.tilt[axis] += RATE * tick * (slope - foot.tilt[axis])
    if foot.floor_rise != other.floor_rise:  # on a slope, heights count whole
        foot.floor_rise += other.footprint[2] - other.floor_rise


@compiled
def _hurry(work: Workspace, i: int, tick: float) -> None:
    """Let a foot that is late go down faster."""
    foot, lines = work.body.feet[i], work.contact.lines[i]
    planned = lines[HEEL].planned or lines[BALL].planned
    foot.late = foot.late + tick if planned and not lines.touched.any() else 0.0
    foot.hurry = min(HURRY * max(foot.late - PATIENCE, 0.0), FASTEST)


@compiled
def _raise(work: Workspace, i: int, tick: float) -> None:
    """Raise and tilt the reference of a foot, and raise the COM's by the load that the foot bears."""
    foot, wanted = work.body.feet[i], work.wanted
    acceleration = RATE * (RATE * (foot.floor_rise - foot.raised) - 2.0 * foot.raised_rate)
    foot.raised_rate += tick * acceleration
    foot.raised += tick * foot.raised_rate
    if foot.tilt.any():  # never on a level floor
        tilt_sole(wanted.foot_rotation[i], foot.tilt[0], foot.tilt[1])
    load = wanted.right_load[0] if i == 1 else 1.0 - wanted.right_load[0]
    wanted.foot_position[i, 2] += foot.raised
    wanted.foot_velocity[i, 2] += foot.raised_rate
    wanted.com[2] += load * foot.raised
    wanted.com_velocity[2] += load * foot.raised_rate


@compiled
def tilt_sole(rotation: Array, slope_x: float, slope_y: float) -> None:
    """Turn a sole, given by its rotation to world, with a floor that has slopes [1]."""
    for axis in range(3):
        old = column(rotation, axis)
        put(rotation[:, axis], plus(old, cross((slope_y, -slope_x, 0.0), old)))


@compiled
def slope_share(told: float, rise: float) -> float:
    """Share of a foot's slope that counts, as it says a rise from the other foot, and what it is [1]."""
    return clip((rise / told - AGREES) / AGREES, 0.0, 1.0)


@compiled
def _beyond(value: float, limit: float) -> float:
    """A value that is larger than a limit in size; otherwise zero."""
    return value if abs(value) > limit else 0.0
