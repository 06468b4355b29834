"""The floor as the feet find it: touches, heights and slopes, and what they say of a walk."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ampm.compiled import compiled
from ampm.control.records import TIP
from ampm.vectors import clip

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

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


class Sensed(NamedTuple):
    """The body of this tick.

    Attributes:
        feet: records of both feet.
        points: records of the sole points.
        touching: shape (P,).
        com: shape (3,) [m].
        rates: momentum and angular momentum over the mass, shape (6, ...).
        mass: [kg].
        omega: [1/s].
        gravity: [m/s^2].
        tick: control period [s].
        size: of the body, of which a stature of 1.70 m is one [1].
        foot_width: [m].
    """

    feet: Any
    points: Any
    touching: Flags
    com: Array
    rates: Array
    mass: float
    omega: float
    gravity: float
    tick: float
    size: float
    foot_width: float


@compiled
def feel(w: Any, body: Sensed) -> None:
    """Count the ticks for which every foot has stood, and note where its points touched."""
    for i in range(len(body.points)):
        if body.touching[i] and not body.points[i].touching:
            body.points[i].floor = body.com[2] + body.points[i].arm[2]
    for foot in range(2):
        touched = False
        for i in range(len(body.points)):
            touched = touched or (body.points[i].foot == foot and body.touching[i])
        touched = touched and body.feet[foot].pose[2, 2] >= TIPPED
        w.touches[foot] = w.touches[foot] + 1 if touched else 0
    w.stood += body.tick


@compiled
def floor_under(body: Sensed, foot: int) -> tuple[float, float, float]:
    """Height of the floor at a sole's reference point, with its slopes dz/dx and dz/dy [m, 1, 1].

    It is the sole's own plane, :data:`SINK` higher; where a point is deeper in the floor, the plane through
    the heights at which the points touched.
    """
    at, pose = body.feet[foot].place, body.feet[foot].pose
    n = x = y = z = xx = xy = yy = xz = yz = deepest = 0.0
    for i in range(len(body.points)):
        point = body.points[i]
        if point.foot == foot and body.touching[i]:
            dx, dy, floor = point.arm[0] - at[0], point.arm[1] - at[1], point.floor
            deepest = max(deepest, floor - body.com[2] - point.arm[2])
            n, x, y, z, xx, xy = n + 1.0, x + dx, y + dy, z + floor, xx + dx * dx, xy + dx * dy
            yy, xz, yz = yy + dy * dy, xz + dx * floor, yz + dy * floor
    height, slope = body.com[2] + at[2] + SINK, (-pose[0, 2] / pose[2, 2], -pose[1, 2] / pose[2, 2])
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
def step_up(body: Sensed, foot: int, planned: Array, floor: float) -> float:
    """How much higher than planned the floor is under a foot that touches [m].

    Args:
        body: of this tick.
        foot: 0 or 1.
        planned: its reference, shape (27,).
        floor: height of the reference point as the phase ends [m].
    """
    pose, agreement = body.feet[foot].pose, 0.0
    for axis in range(3):
        agreement += pose[axis, 2] * planned[11 + 3 * axis]
    if agreement >= AS_PLANNED:
        return floor_under(body, foot)[0] - planned[2]
    count, height = 0, 0.0
    for i in range(len(body.points)):
        if body.points[i].foot == foot and body.touching[i]:
            count, height = count + 1, height + body.points[i].floor
    return height / count - floor


@compiled
def lifted(w: Any, body: Sensed, height: float) -> float:
    """Factor of the commanded force, by the integral of the COM's height under its reference [m]."""
    low = clip(height - body.com[2], -DEEP, DEEP)
    if w.load != 1.0 or abs(low) > SANK:
        w.load = clip(w.load + LIFT * body.omega**3 / body.gravity * low * body.tick, 0.9, 1.1)
    return float(w.load)


@compiled
def stands_flat(w: Any, body: Sensed) -> bool:
    """Whether the foot that stands alone has done so for a while, on all points of heel and ball."""
    for i in range(len(body.points)):
        point = body.points[i]
        if point.foot == w.stance and point.line != TIP and not body.touching[i]:
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
