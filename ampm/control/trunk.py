"""The tilt of the trunk that is fed back: the present one, or its mean over a time, with an integral.

A trunk that swings within every step, beside a posture that does not plan this swing, is upright if its mean
over two steps is. The integral of this mean finds the mean angular momentum that the body needs.
"""

import math

from ampm.compiled import compiled
from ampm.control.workspace import Workspace
from ampm.vectors import Vector, along_across

RIGHTING = 4.0
"""Off the plan a tilt counts so much more: no orbit is kept there, and pushes tilt the trunk far [1]."""


@compiled
def fed_back_tilt(work: Workspace, tilt: Vector) -> Vector:
    """Tilt to be fed back, in world axes [rad].

    It is averaged over the wanted window, up to :data:`~ampm.control.workspace.LONGEST_WINDOW`; without one
    the present tilt is fed back. The time before the window first opens counts as upright. As a window
    closes, the present tilt replaces mean and integral gradually.

    Args:
        work: gains, the planned trunk, whose first axis is the heading, and the memory of its tilt.
        tilt: rotation from the trunk to the planned one, in world axes [rad].
    """
    gains, memory, trunk = work.gains, work.tilt, work.wanted.trunk
    past, integral = memory.past, memory.integral
    count = min(round(work.wanted.tilt_window[0] * gains.frequency), len(past))
    if count == 0:
        if memory.longest[0] > 0:
            past[:] = 0.0
            integral[:] = 0.0
            memory.longest[0] = memory.next_row[0] = 0
        return tilt
    longest = max(memory.longest[0], count)
    length = math.sqrt(trunk[0, 0] ** 2 + trunk[1, 0] ** 2)
    cos, sin = trunk[0, 0] / length, trunk[1, 0] / length
    row = memory.next_row[0]
    past[row, 0], past[row, 1] = along_across(tilt[0], tilt[1], cos, sin)
    along = across = 0.0
    for k in range(longest):  # a negative row counts from the end
        along += past[row - k, 0]
        across += past[row - k, 1]
    along, across = along / longest, across / longest
    integral[0] += along / gains.frequency
    integral[1] += across / gains.frequency
    memory.next_row[0], memory.longest[0] = (row + 1) % len(past), longest
    along += gains.trunk_integral * integral[0]
    across += gains.trunk_integral * integral[1]
    x, y = along_across(along, across, cos, -sin)
    share = count / longest
    rest = 1.0 - share
    return share * x + rest * tilt[0], share * y + rest * tilt[1], tilt[2]
