"""The floor as the feet find it: touches, heights and slopes, and what they say of a walk."""

from typing import Any

from ampm.compiled import compiled
from ampm.control.workspace import TIP, Array
from ampm.stepping.stepper import Stepper
from ampm.vectors import clip, column, dot

SINK = 0.00075
"""How far a sole sinks into the floor under load [m]."""
DEEP_IN = 0.0018
"""Depth of a sole's point in the floor from which the sole does not lie as the floor does [m]."""
LIFT = 0.5
"""Integral gain of the COM's height, times omega^3 [1]."""
SANK, DEEP = 0.0015, 0.01
"""Error of the height from which it is fed back, and that beyond which it counts as no larger [m]."""
TIPPED = 0.9
"""Cosine of a foot's tilt below which its touch is no landing: a foot that was hit scuffs [1]."""
AS_PLANNED = 0.993
"""Cosine of the angle between a foot and its plan below which only its points tell the floor's height [1]."""
EARLY = 0.045
"""A touch so long before its time begins the double support [s]."""
SWUNG = 0.6
"""Share of the single support from which a touch counts [1]."""
GRACE = 0.016
"""Time that a foot may be late before the clock waits for it [s]."""


@compiled
def feel(s: Stepper) -> None:
    """Count the ticks for which every foot has stood, and note where its points touched."""
    w, points = s.walker[0], s.body.points
    for i in range(len(points)):
        if s.contact[i] and not points[i].touching:
            points[i].floor = s.body.com[2] + points[i].arm[2]
    for foot in range(2):
        touched = False
        for i in range(len(points)):
            touched = touched or (points[i].foot == foot and s.contact[i])
        touched = touched and s.body.feet[foot].pose[2, 2] >= TIPPED
        w.touches[foot] = w.touches[foot] + 1 if touched else 0
    w.stood += s.tick


@compiled
def floor_under(s: Stepper, foot: int) -> tuple[float, float, float]:
    """Height of the floor at a sole's reference point, with its slopes dz/dx and dz/dy [m, 1, 1].

    It is the sole's own plane, :data:`SINK` higher; where a point is deeper in the floor, the plane through
    the heights at which the points touched, by least squares.
    """
    com, at, pose = s.body.com, s.body.feet[foot].place, s.body.feet[foot].pose
    n = x = y = z = xx = xy = yy = xz = yz = deepest = 0.0
    for i in range(len(s.body.points)):
        point = s.body.points[i]
        if point.foot == foot and s.contact[i]:
            dx, dy, floor = point.arm[0] - at[0], point.arm[1] - at[1], point.floor
            deepest = max(deepest, floor - com[2] - point.arm[2])
            n, x, y, z = n + 1.0, x + dx, y + dy, z + floor
            xx, xy, yy = xx + dx * dx, xy + dx * dy, yy + dy * dy
            xz, yz = xz + dx * floor, yz + dy * floor
    height, slope = com[2] + at[2] + SINK, (-pose[0, 2] / pose[2, 2], -pose[1, 2] / pose[2, 2])
    if deepest < DEEP_IN:
        return height, slope[0], slope[1]
    x, y, z = x / n, y / n, z / n
    xx, xy, yy, xz, yz = xx / n - x * x, xy / n - x * y, yy / n - y * y, xz / n - x * z, yz / n - y * z
    size = xx * yy - xy * xy
    if size < 1e-8:  # of a line
        return height - SINK + deepest, slope[0], slope[1]
    dzdx, dzdy = (yy * xz - xy * yz) / size, (xx * yz - xy * xz) / size
    return z - dzdx * x - dzdy * y, dzdx, dzdy


@compiled
def step_up(s: Stepper, foot: int, position: Array, rotation: Array, floor: float) -> float:
    """How much higher than planned the floor is under a foot that touches [m].

    Args:
        s: the stepper.
        foot: 0 or 1.
        position: planned, of the sole's reference point, shape (3,) [m].
        rotation: planned, of the sole to world, shape (3, 3).
        floor: height of the reference point as the phase ends [m].
    """
    pose = s.body.feet[foot].pose
    if dot(column(pose, 2), column(rotation, 2)) >= AS_PLANNED:
        return floor_under(s, foot)[0] - position[2]
    count, height = 0, 0.0
    for i in range(len(s.body.points)):
        if s.body.points[i].foot == foot and s.contact[i]:
            count, height = count + 1, height + s.body.points[i].floor
    return height / count - floor


@compiled
def force_factor(s: Stepper, height: float) -> float:
    """Factor of the commanded force, by the integral of the COM's height under its reference [m]."""
    w = s.walker[0]
    low = clip(height - s.body.com[2], -DEEP, DEEP)
    if w.load != 1.0 or abs(low) > SANK:
        w.load = clip(w.load + LIFT * s.omega**3 / s.body.gravity * low * s.tick, 0.9, 1.1)
    return float(w.load)


@compiled
def stands_flat(s: Stepper) -> bool:
    """Whether the foot that stands alone has done so for a while, on all points of heel and ball."""
    w = s.walker[0]
    for i in range(len(s.body.points)):
        point = s.body.points[i]
        if point.foot == w.stance and point.line != TIP and not s.contact[i]:
            return False
    return bool(w.single and w.stood > 0.04 and w.clock < 0.7 * w.duration)


@compiled
def is_early(w: Any) -> bool:
    """Whether the swing foot has landed long before its time."""
    rest = (w.duration - w.clock) / w.rate
    return bool(w.single and w.clock > SWUNG * w.duration and rest > EARLY and w.touches[1 - w.stance] > 1)


@compiled
def is_late(w: Any) -> bool:
    """Whether the foot that should have landed has not."""
    return bool(not w.single and GRACE < w.clock < 0.5 * w.duration and w.touches[1 - w.stance] == 0)
