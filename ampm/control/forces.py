"""Contact forces in the controller's QP: k + 3 unknowns per foot of k points, and their effect on the body.

Units: forces in m g, moments in m g m times :data:`ANGULAR`, so that a metre of lever is as large as a third
of a weight. Per foot: the normal forces of its points, two tangential forces and a twist about the vertical,
in this order. Tangential forces are distributed over the points by their openings.
"""

import math
from typing import Any

from ampm.compiled import compiled
from ampm.control.workspace import ANGULAR
from ampm.geometry import Array
from ampm.planner.feet import TIP
from ampm.vectors import cross, put, times, vector

TWIST_ARM = 0.1
"""Lever that turns a twisting moment into a force of the size of the others [m]."""
NORMAL_COST = 0.6
"""Regularisation of normal forces."""
LARGEST_NORMAL = 1.2
"""Largest normal force of one point [m g]: it carries the weight where the ZMP is in a corner of the sole."""
LEAST_NORMAL = 0.004
"""Least normal force of an open point [m g]: enough to keep it from chattering on a compliant floor."""
_LEAST_OPENING = 1e-3  # in the shares, so that a foot with all points closed has some


@compiled
def change_cost(smoothing: float, frequency: float) -> float:
    """Cost of changing a normal force from one tick to the next: forces follow a floor as it deforms."""
    return NORMAL_COST * smoothing * frequency


@compiled
def share_forces(points: Any, phi: Array, by_load: bool) -> None:
    """Limits and shares of the points, from their openings and arms.

    Args:
        points: opened.
        phi: forces of the last tick [m g].
        by_load: whether tangential forces and twist are shared by the normal forces of the last tick. A foot
            loaded at its toes turns on the floor under a twist that its whole sole could bear.
    """
    per_foot = len(points) // 2
    for foot in range(2):
        sole = points[per_foot * foot : per_foot * (foot + 1)]
        loads = total = 0.0
        for i in range(per_foot):
            point = sole[i]
            point.share = max(point.limit, _LEAST_OPENING)
            total += point.share
            loads += point.share if point.line != TIP else 0.0
            point.least = LEAST_NORMAL * point.limit
            point.largest = max(LARGEST_NORMAL * point.limit, point.least)
        if by_load:
            total = 0.0
            for i in range(per_foot):
                sole[i].share = max(phi[sole[i].normal], _LEAST_OPENING)
                total += sole[i].share
        x = y = 0.0
        for i in range(per_foot):
            point = sole[i]
            opening = max(point.limit, _LEAST_OPENING)
            point.load_gradient = -NORMAL_COST * opening / loads if point.line != TIP else 0.0
            point.share /= total
            x += point.share * point.arm[0]
            y += point.share * point.arm[1]
        turning = 0.0
        for i in range(per_foot):
            point = sole[i]
            dx, dy = point.arm[0] - x, point.arm[1] - y
            point.lever = math.hypot(dx, dy)
            point.twist[0], point.twist[1] = -point.share * dy, point.share * dx
            turning += point.twist[1] * dx - point.twist[0] * dy
        for i in range(per_foot):
            sole[i].twist[0] *= TWIST_ARM / turning
            sole[i].twist[1] *= TWIST_ARM / turning


@compiled
def wrench_map(points: Any, wrench: Array) -> None:
    """W, net force and moment about the COM per unknown, shape (6, U)."""
    wrench[:] = 0.0
    for i in range(len(points)):
        point, tangent = points[i], points[i].tangent
        arm, share = vector(point.arm), point.share
        _add(wrench[:, point.normal], (0.0, 0.0, 1.0), arm)
        _add(wrench[:, tangent], (share, 0.0, 0.0), arm)
        _add(wrench[:, tangent + 1], (0.0, share, 0.0), arm)
        _add(wrench[:, tangent + 2], (point.twist[0], point.twist[1], 0.0), arm)


@compiled
def _add(column: Array, force: Any, arm: Any) -> None:
    """Add the effect of a force at an arm."""
    moment = times(ANGULAR, cross(arm, force))
    for k in range(3):
        column[k] += force[k]
        column[3 + k] += moment[k]


@compiled
def point_forces(points: Any, phi: Array, weight: float, forces: Array) -> None:
    """Forces at the points for the unknowns phi [m g], shape (P, 3) [N]."""
    for i in range(len(points)):
        point, tangent = points[i], points[i].tangent
        x, y, twist = phi[tangent], phi[tangent + 1], phi[tangent + 2]
        along_x, along_y = point.share * x + point.twist[0] * twist, point.share * y + point.twist[1] * twist
        put(forces[i], times(weight, (along_x, along_y, phi[point.normal])))


@compiled
def without_closed(points: Any, phi: Array) -> Array:
    """Forces of an earlier tick, less those at points that have closed since; a new array.

    Tangential forces and twist of a foot shrink with its normal force, so that they stay within the friction.
    """
    kept, per_foot = phi.copy(), len(points) // 2
    for foot in range(2):
        sole = points[per_foot * foot : per_foot * (foot + 1)]
        before = after = 0.0
        for i in range(per_foot):
            normal = sole[i].normal
            before += phi[normal]
            if not sole[i].limit > 0.0:
                kept[normal] = 0.0
            after += kept[normal]
        share = after / before if before > 0.0 else 0.0
        for k in range(3):
            kept[sole[0].tangent + k] *= share
    return kept
