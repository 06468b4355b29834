"""Hold of the torque between two control ticks.

A constant torque lags by half a period: where the plan's ZMP moves by 7 mm in a tick, that is an error of
2 mm (RMS). The first-order hold extrapolates it with the slope of the last tick.
"""

from ampm.compiled import compiled
from ampm.control.workspace import Line, Workspace
from ampm.vectors import clip

LARGEST = 0.1
"""Largest difference of a torque in a tick, over the motor's limit [1]: a larger one answers an event."""


@compiled
def update_rate(work: Workspace, first: bool) -> None:
    """Rates of the torques until the next tick, from those until this one.

    The rate is the last difference over the period, with three exceptions. It is limited. Where the contact
    has changed, the difference is the response to it, and the earlier rate is kept. Where the plan jumps, it
    is zero, and the reference is that of the middle of the hold.

    Args:
        work: torques and lines of this tick and of the last one; the rate is written.
        first: whether this is the first tick of a run, which has no last one.
    """
    joints, contact, same_contact = work.joints, work.contact, True
    for foot in range(len(contact.lines)):
        for group in range(3):
            line, last = contact.lines[foot, group], contact.last[foot, group]
            if line.planned != last.planned or _is_opening(line) != _is_opening(last):
                same_contact = False
    torque, before, limit, rate = joints.torque, joints.last_torque, joints.torque_limit, joints.rate
    for j in range(len(torque)):
        largest = LARGEST * limit[j]
        if first or work.wanted.jumps[0]:
            rate[j] = 0.0
        elif same_contact:
            rate[j] = clip(torque[j] - before[j], -largest, largest) * work.gains.frequency


@compiled
def _is_opening(line: Line) -> bool:
    """Whether a line touches and is not fully open."""
    return bool(line.touching and 0.0 < line.opening < 1.0)
