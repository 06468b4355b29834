"""What the soles can give, shared between COM and trunk."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ampm.compiled import compiled
from ampm.vectors import clip

Array = NDArray[np.float64]


OPEN = 0.2
"""Share of its force limit from which a point counts as support [1]."""
TRUNK_SHARE, TRUNK_LEAST = 0.8, 0.08
"""What the trunk may take of the sole first: a share of it [1], at least so much [m]."""

ACROSS = 3.0
"""Weight of distances across the foot over those along it, where the ZMP is brought into the sole [1]."""


@compiled
def sole_of(foot: int, points: Any, com: Array, cos: float, sin: float, out: Array) -> None:
    """Least and largest x, least and largest y of a foot's points in its axes, shape (4,) [m]."""
    out[0] = out[2] = math.inf
    out[1] = out[3] = -math.inf
    for i in range(len(points)):
        if points[i].foot == foot:
            x, y = com[0] + points[i].arm[0], com[1] + points[i].arm[1]
            along, across = cos * x + sin * y, -sin * x + cos * y
            out[0], out[1] = min(out[0], along), max(out[1], along)
            out[2], out[3] = min(out[2], across), max(out[3], across)


@compiled
def share_axis(d: float, m: float, low: float, high: float, com_first: bool) -> tuple[float, float]:
    """Shifts of r and of the moment's arm that the sole allows along one axis.

    Args:
        d: wanted shift of r: feedback of the COM [m].
        m: wanted shift of ``ZMP - r``: feedback of the angular momentum [m].
        low: from the planned ZMP to the sole's edge [m].
        high: the same to the other edge [m].
        com_first: whether the COM gets what it wants first; else the trunk, and the COM may even pay for it.

    Returns:
        Both shifts; those wanted where their sum is within the sole.
    """
    if low <= d + m <= high and low <= d <= high:
        return d, m
    if com_first:
        d = clip(d, low, high)
        return d, clip(m, min(low - d, 0.0), max(high - d, 0.0))
    m = clip(m, min(TRUNK_SHARE * low, -TRUNK_LEAST), max(TRUNK_SHARE * high, TRUNK_LEAST))
    return clip(d, low - m, high - m), m


@compiled
def open_points(points: Any, com: Array, cos: float, sin: float, out: Array) -> int:
    """Places of the points that may carry force in the foot's axes, shape (P, 2) [m]; their number."""
    count = 0
    for i in range(len(points)):
        if points[i].limit > OPEN:
            x, y = com[0] + points[i].arm[0], com[1] + points[i].arm[1]
            out[count, 0], out[count, 1] = cos * x + sin * y, cos * y - sin * x
            count += 1
    return count


@compiled
def nearest(sole: Array, along: float, across: float) -> tuple[float, float]:
    """The point of the hull of some points that is nearest to another, which may be in it.

    Across, distances count :data:`ACROSS` times, as steps can take over less of them.

    Args:
        sole: the points, shape (n, 2) [m].
        along: of the other point [m].
        across: of the other point [m].
    """
    best, found, above, below = math.inf, (along, across), False, False
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
            if x * x + y * y < best:
                best, found = x * x + y * y, (along + x, across + y / ACROSS)
    return (along, across) if above and below else found


@compiled
def share_sole(
    gravity: float, share: Array, centre: Array, com: Array, points: Any, command: Array, mass: float
) -> None:
    """Share what the soles can give between COM and trunk; the command is untouched where they give it all.

    Args:
        gravity: [m/s^2].
        share: axes of the foot (cos, sin), height of the floor [m], whether the COM comes first, the factor
            of the force that holds the COM's height, and whether the walk is off the plan [1], shape (6,).
        centre: of the :class:`~ampm.walk.Reference` followed, shape (5, 3).
        com: measured, shape (3,) [m].
        points: with their limits of this tick.
        command: of :func:`~ampm.control.stabilizer.command_wrench`, which is changed, shape (11,).
        mass: [kg].
    """
    if share[4] != 1.0:
        for axis in range(3):
            command[axis] *= share[4]
    fz = command[2]
    if fz < 0.2 * mass * gravity:  # nearly falling: the ZMP means nothing
        return
    height = com[2] - share[2]
    planned_z = (centre[0, 2] - share[2]) / (gravity + centre[2, 2])
    weight = mass * (gravity + centre[2, 2])
    r = np.empty(2), np.empty(2)  # planned, commanded
    arm = np.empty(2), np.empty(2)  # the same of ZMP - r
    for axis in range(2):
        r[0][axis] = centre[0, axis] - planned_z * centre[2, axis]
        r[1][axis] = com[axis] - height * command[axis] / fz
    arm[0][0], arm[0][1] = -centre[4, 1] / weight, centre[4, 0] / weight
    arm[1][0], arm[1][1] = -command[4] / fz, command[3] / fz
    places = np.empty((len(points), 2))
    sole = places[: open_points(points, com, share[0], share[1], places)]
    if len(sole) == 0:
        return
    axes = (share[0], share[1]), (-share[1], share[0])
    planned, d, m = np.empty(2), np.empty(2), np.empty(2)
    for axis in range(2):
        x, y = axes[axis]
        planned[axis] = x * (r[0][0] + arm[0][0]) + y * (r[0][1] + arm[0][1])
        d[axis] = x * (r[1][0] - r[0][0]) + y * (r[1][1] - r[0][1])
        m[axis] = x * (arm[1][0] - arm[0][0]) + y * (arm[1][1] - arm[0][1])
    wanted = planned + d + m
    held = nearest(sole, wanted[0], wanted[1]) if share[5] > 0.0 else (math.nan, math.nan)
    change_r, change_m = np.zeros(2), np.zeros(2)
    changed = False
    for axis in range(2):
        low, high = sole[:, axis].min() - planned[axis], sole[:, axis].max() - planned[axis]
        if not share[5]:
            low, high = min(low, 0.0), max(high, 0.0)
        elif held[axis] > wanted[axis]:
            low = held[axis] - planned[axis]
        elif held[axis] < wanted[axis]:
            high = held[axis] - planned[axis]
        dd, mm = share_axis(d[axis], m[axis], low, high, share[3] > 0.0)
        if dd != d[axis] or mm != m[axis]:
            changed = True
            for k in range(2):
                change_r[k] += axes[axis][k] * (dd - d[axis])
                change_m[k] += axes[axis][k] * (mm - m[axis])
    if not changed:
        return
    for axis in range(2):
        command[axis] -= change_r[axis] * fz / height
    command[3] += change_m[1] * fz
    command[4] -= change_m[0] * fz
    command[9] = com[0] - (com[2] * command[0] + command[4]) / fz
    command[10] = com[1] - (com[2] * command[1] - command[3]) / fz
