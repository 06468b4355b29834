"""How COM and trunk share what the soles can give."""

import math
from typing import Any

import numpy as np

from ampm.compiled import compiled
from ampm.control.stabilizer import write_zmp
from ampm.control.workspace import SteppingState, Workspace
from ampm.geometry import Array
from ampm.vectors import Vector, along_across, clip

OPEN = 0.2
"""Share of its force limit from which a point counts as support [1]."""
TRUNK_SHARE, TRUNK_LEAST, TRUNK_LEAN = 0.8, 0.08, 1.0
"""What the trunk may take of the sole first: a share of it [1], at least so much [m], or per its lean [m]."""
ACROSS = 3.0
"""Distances across the foot count this much more than those along it, to bring the ZMP into the sole [1]."""


@compiled
def places_of(points: Any, com: Array, cos: float, sin: float) -> Array:
    """Places of sole points along and across a heading, shape (P, 2) [m]."""
    places = np.empty((len(points), 2))
    for i in range(len(points)):
        x, y = com[0] + points[i].arm[0], com[1] + points[i].arm[1]
        places[i, 0], places[i, 1] = along_across(x, y, cos, sin)
    return places


@compiled
def share_axis(r: float, arm: float, low: float, high: float, least: float) -> tuple[float, float]:
    """Shifts of r and of the moment's arm that the sole allows along one axis: the trunk comes first.

    Args:
        r: wanted shift of r: feedback of the COM [m].
        arm: wanted shift of ``ZMP - r``: feedback of the angular momentum [m].
        low: position of the sole's lower edge from the planned ZMP [m].
        high: position of its upper edge [m].
        least: shift that the trunk may take of any sole, however small, at the cost of the COM [m].

    Returns:
        Both shifts; the wanted ones where their sum is within the sole.
    """
    if low <= r + arm <= high and low <= r <= high:
        return r, arm
    arm = clip(arm, min(TRUNK_SHARE * low, -least), max(TRUNK_SHARE * high, least))
    return clip(r, low - arm, high - arm), arm


@compiled
def nearest(sole: Array, along: float, across: float) -> tuple[float, float]:
    """The point of the hull of some points that is nearest to another, which may be in it.

    Distances across count :data:`ACROSS` times, because a step can make up for less of them.

    Args:
        sole: the points, shape (n, 2) [m].
        along: of the other point [m].
        across: of the other point [m].
    """
    least, edge, above, below = math.inf, (along, across), False, False
    for i in range(len(sole)):
        for j in range(len(sole)):
            x, y = sole[i, 0] - along, ACROSS * (sole[i, 1] - across)
            dx, dy = sole[j, 0] - sole[i, 0], ACROSS * (sole[j, 1] - sole[i, 1])
            if x <= 0.0 <= x + dx and dx > 0.0:  # the segment passes beside the point
                left = y * dx - x * dy
                above, below = above or left >= 0.0, below or left <= 0.0
            size = dx * dx + dy * dy
            part = clip(-(x * dx + y * dy) / size, 0.0, 1.0) if size > 0.0 else 0.0
            x, y = x + part * dx, y + part * dy
            if x * x + y * y < least:
                least, edge = x * x + y * y, (along + x, across + y / ACROSS)
    return (along, across) if above and below else edge


@compiled
def share_sole(work: Workspace, slope: Array, tilt: Vector) -> None:
    """Share what the soles can give between COM and trunk, off the plan or disturbed.

    The command is untouched where they give it all.

    With ``r = c - (z / (g + zdd)) cdd``, the ZMP of the command is r plus the arm of its moment. The feedback
    of the COM is a shift of r, that of angular momentum and trunk a shift of the arm.

    The points have their limits of this tick. The command is that of
    :func:`~ampm.control.stabilizer.command_wrench`; the slope of the floor is the plan's, and ``tilt`` takes
    the trunk to the planned one [rad].
    """
    state: SteppingState = work.stepping[0]
    body, wanted, com = work.body, work.wanted, work.body.com
    force, moment = work.command.force, work.command.moment
    nearly_falling = force[2] < 0.2 * body.mass * body.gravity  # the ZMP means nothing
    if nearly_falling or not state.active:
        return
    cos, sin = state.heading[0], state.heading[1]
    sole = places_of(body.points[body.points.limit > OPEN], com, cos, sin)
    if len(sole) == 0:
        return
    height = over_plane(com, slope) - state.floor_rise
    down = body.gravity + over_plane(wanted.com_acceleration, slope)
    per_rate = (over_plane(wanted.com, slope) - state.floor_rise) / down
    planned_r = wanted.com[:2] - per_rate * wanted.com_acceleration[:2]
    planned_arm = np.array([-wanted.moment[1], wanted.moment[0]]) / (body.mass * down)
    r_shift = com[:2] - height * force[:2] / force[2] - planned_r
    arm_shift = np.array([-moment[1], moment[0]]) / force[2] - planned_arm
    # In the axes of the foot.
    planned = turned_axes(planned_r + planned_arm, cos, sin)
    r_wanted, arm_wanted = turned_axes(r_shift, cos, sin), turned_axes(arm_shift, cos, sin)
    zmp = planned + r_wanted + arm_wanted
    held = nearest(sole, zmp[0], zmp[1]) if state.off_plan else (math.nan, math.nan)
    r_change, arm_change = np.zeros(2), np.zeros(2)
    least = max(TRUNK_LEAST, TRUNK_LEAN * math.hypot(tilt[0], tilt[1]))
    for axis in range(2):
        low, high = sole[:, axis].min() - planned[axis], sole[:, axis].max() - planned[axis]
        if not state.off_plan:
            low, high = min(low, 0.0), max(high, 0.0)
        elif held[axis] > zmp[axis]:
            low = held[axis] - planned[axis]
        elif held[axis] < zmp[axis]:
            high = held[axis] - planned[axis]
        r_given, arm_given = share_axis(r_wanted[axis], arm_wanted[axis], low, high, least)
        r_change[axis], arm_change[axis] = r_given - r_wanted[axis], arm_given - arm_wanted[axis]
    if not (r_change.any() or arm_change.any()):
        return
    r_change, arm_change = turned_axes(r_change, cos, -sin), turned_axes(arm_change, cos, -sin)
    for axis in range(2):
        force[axis] -= r_change[axis] * force[2] / height
    moment[0] += arm_change[1] * force[2]
    moment[1] -= arm_change[0] * force[2]
    write_zmp(com, work.command)


@compiled
def over_plane(a: Any, slope: Array) -> float:
    """Height of a vector (3,) over the plane with slopes along x and y through the origin."""
    return float(a[2] - slope[0] * a[0] - slope[1] * a[1])


@compiled
def turned_axes(a: Any, cos: float, sin: float) -> Array:
    """:func:`~ampm.vectors.along_across` of two numbers or more, a new array, shape (2,)."""
    out = np.empty(2)  # filled, as an array of a tuple takes much longer
    out[0], out[1] = along_across(a[0], a[1], cos, sin)
    return out
