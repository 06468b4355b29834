"""The reference over a floor that is higher, lower or steeper than the plan's.

A foot that stands flat tells the height and the slope of the floor under it. The reference follows: the swing
foot's height over that plane, and the COM's as the load goes from foot to foot. A foot that touches late goes
down faster and faster.
"""

from typing import Any

from ampm.compiled import compiled
from ampm.control.workspace import BALL, HEEL, Foot, Workspace
from ampm.geometry import Array

LEVEL = 0.008
"""Largest height over the plan's floor that is not followed [m]: soles sink in by some millimetres."""
FLAT = 0.012
"""Largest mean slope that is not followed [1]."""
AVERAGE = 5.0
"""Rate of the mean of the slope [1/s]: on a soft floor a sole tilts to and fro with its load."""
UPRIGHT = 0.995
"""Cosine of a sole's tilt below which it stands on an edge."""
RATE = 40.0
"""Rate of the critically damped filter of the heights [1/s]."""
PATIENCE = 0.016
"""Time that a foot may be late before it goes down faster [s]."""
HURRY, FASTEST = 5.0, 0.3
"""Acceleration of a late foot [m/s^2], and its largest speed beyond the touch-down velocity [m/s]."""


@compiled
def follow_floor(work: Workspace) -> None:
    """Raise feet and COM of the reference by the height of the floor over the plan's floor."""
    feet, wanted, tick = work.body.feet, work.wanted, 1.0 / work.gains.frequency
    right = wanted.right_load[0]
    for i in range(len(feet)):
        foot, other, lines = feet[i], feet[1 - i], work.contact.lines
        stands = lines[i].touched.any()
        if stands:
            height = work.body.com[2] - wanted.foot_position[i, 2]
            _measure_floor(foot, lines[i], wanted.foot_rotation[i], height, tick)
        elif lines[1 - i].touched.any():
            x, y, _ = wanted.foot_position[i] - wanted.foot_position[1 - i]
            foot.floor = other.floor + _beyond(other.slope[0], FLAT) * x + _beyond(other.slope[1], FLAT) * y
        planned = lines[i, HEEL].planned or lines[i, BALL].planned
        foot.late = foot.late + tick if planned and not stands else 0.0
        foot.hurry = min(HURRY * max(foot.late - PATIENCE, 0.0), FASTEST)
        acceleration = RATE * (RATE * (foot.floor - foot.raised) - 2.0 * foot.raised_rate)
        foot.raised_rate += tick * acceleration
        foot.raised += tick * foot.raised_rate
        load = right if i == 1 else 1.0 - right
        wanted.foot_position[i, 2] += foot.raised
        wanted.foot_velocity[i, 2] += foot.raised_rate
        wanted.com[2] += load * foot.raised
        wanted.com_velocity[2] += load * foot.raised_rate


@compiled
def _measure_floor(foot: Foot, lines: Any, planned: Array, height: float, tick: float) -> None:
    """Update height and slope of the floor over the plan's from a foot, if it stands flat.

    Planned are its rotation to world, and the height of the measured COM over its place [m].
    """
    heel, ball = lines[HEEL], lines[BALL]
    loaded = heel.opening == 1.0 and heel.limit == 1.0 and ball.opening == 1.0
    level = heel.touching and ball.touching and foot.pose[2, 2] > UPRIGHT
    if heel.planned and ball.planned and loaded and level:
        foot.floor = _beyond(height + foot.place[2], LEVEL)
        for axis in range(2):
            slope = planned[axis, 2] / planned[2, 2] - foot.pose[axis, 2] / foot.pose[2, 2]
            foot.slope[axis] += AVERAGE * tick * (slope - foot.slope[axis])


@compiled
def _beyond(value: float, limit: float) -> float:
    """A value that is larger than a limit in size; otherwise zero."""
    return value if abs(value) > limit else 0.0
