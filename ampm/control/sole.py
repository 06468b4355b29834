"""What the soles can give, shared between COM and trunk."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ampm.compiled import compiled
from ampm.vectors import clip

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


OPEN = 0.2
"""Share of its force limit from which a point counts as support [1]."""
TRUNK_SHARE, TRUNK_LEAST = 0.8, 0.08
"""What the trunk may take of the sole first: a share of it [1], at least so much [m]."""


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
def extent(points: Any, com: Array, share: Array, axis: int, at: float) -> tuple[float, float]:
    """Least and largest coordinate of the points that may carry force, along or across the foot [m].

    Off the plan that across the foot is of the points' convex hull where it is cut at ``at`` along the foot;
    on the plan of all points.

    Args:
        points: with their limits of this tick.
        com: measured, shape (3,) [m].
        share: see :func:`share_sole`.
        axis: 0 along, 1 across.
        at: the other coordinate, for axis 1 [m].
    """
    low, high, cut = math.inf, -math.inf, axis == 1 and share[5] > 0.0
    cos, sin = share[0], share[1]
    for i in range(len(points)):
        if points[i].limit <= OPEN:
            continue
        x, y = com[0] + points[i].arm[0], com[1] + points[i].arm[1]
        along, across = cos * x + sin * y, cos * y - sin * x
        if axis == 0:
            low, high = min(low, along), max(high, along)
        elif not cut:
            low, high = min(low, across), max(high, across)
        else:
            for j in range(len(points)):
                if points[j].limit <= OPEN:
                    continue
                x, y = com[0] + points[j].arm[0], com[1] + points[j].arm[1]
                ahead, beside = cos * x + sin * y - along, cos * y - sin * x - across
                if ahead >= 0.0 and along - 0.002 <= at <= along + ahead + 0.002:
                    part = clip((at - along) / ahead, 0.0, 1.0) if ahead > 0.002 else 0.0
                    low, high = min(low, across + part * beside), max(high, across + part * beside)
    return low, high


@compiled
def share_sole(
    gravity: float, share: Array, centre: Array, com: Array, points: Any, command: Array, mass: float
) -> None:
    """Share what the soles can give between COM and trunk; the command is untouched where they give it all.

    Args:
        gravity: [m/s^2].
        share: axes of the foot (cos, sin), height of the floor [m], whether the COM comes first, and the
            weight of the body over its model's, and whether the walk is off the plan [1], shape (6,).
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
    change_r, change_m = np.zeros(2), np.zeros(2)
    changed = False
    at = 0.0
    for axis in range(2):
        x, y = (share[0], share[1]) if axis == 0 else (-share[1], share[0])
        low, high = extent(points, com, share, axis, at)
        if low > high:
            return
        planned = x * (r[0][0] + arm[0][0]) + y * (r[0][1] + arm[0][1])
        low, high = low - planned, high - planned
        if not share[5]:
            low, high = min(low, 0.0), max(high, 0.0)
        d = x * (r[1][0] - r[0][0]) + y * (r[1][1] - r[0][1])
        m = x * (arm[1][0] - arm[0][0]) + y * (arm[1][1] - arm[0][1])
        dd, mm = share_axis(d, m, low, high, share[3] > 0.0)
        at = planned + dd + mm
        if dd != d or mm != m:
            changed = True
            change_r[0] += x * (dd - d)
            change_r[1] += y * (dd - d)
            change_m[0] += x * (mm - m)
            change_m[1] += y * (mm - m)
    if not changed:
        return
    for axis in range(2):
        command[axis] -= change_r[axis] * fz / height
    command[3] += change_m[1] * fz
    command[4] -= change_m[0] * fz
    command[9] = com[0] - (com[2] * command[0] + command[4]) / fz
    command[10] = com[1] - (com[2] * command[1] - command[3]) / fz
