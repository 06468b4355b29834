"""What the feet sense of the floor: touches, early and late ones, heights and slopes."""

from ampm.compiled import compiled
from ampm.control.floor import RISE, slope_share
from ampm.control.workspace import Stepper, SteppingState, Workspace
from ampm.geometry import Array
from ampm.planner.feet import TIP
from ampm.vectors import column, dot

SINK = 0.00075
"""A sole under load sinks into the floor by this depth [m]."""
DEEP_IN = 0.0018
"""A sole with a point deeper than this does not lie as the floor does [m]."""
FEEL_TIME = 0.03
"""Time constant of the measured slope [s]."""
LEVEL_SLOPE = 0.005
"""Slopes up to this count as level, because a sole under load is not exactly level [1]."""
TIPPED = 0.9
"""A touch is a landing only if the cosine of the foot's tilt is larger: a foot that was hit scuffs [1]."""
AS_PLANNED = 0.993
"""If the cosine of the angle to the plan is smaller, only the sole's points tell the floor's height [1]."""
EARLY = 0.045
"""A touch that comes earlier than planned by this time begins the double support [s]."""
SWUNG = 0.6
"""A touch counts after this share of the single support [1]."""
GRACE = 0.016
"""The clock waits for a foot that is later than this [s]."""


@compiled
def sense_touch(work: Workspace, stepper: Stepper) -> None:
    """Count the ticks for which every foot has stood, and note where its points touched."""
    state: SteppingState = work.stepping[0]
    points, contact = work.body.points, work.sensed.contact
    for i in range(len(points)):
        if contact[i] and not points[i].touching:
            points[i].touch_height = work.body.com[2] + points[i].arm[2]
    count = len(points) // 2
    for foot in range(2):
        upright = work.body.feet[foot].rotation[2, 2] >= TIPPED
        touched = upright and contact[count * foot : count * (foot + 1)].any()
        state.touch_ticks[foot] = state.touch_ticks[foot] + 1 if touched else 0
    state.elapsed += stepper.tick


@compiled
def floor_under(work: Workspace, plan_slope: Array, foot: int) -> tuple[float, float, float]:
    """Height of the floor at a sole's reference point, and its slopes less the plan's [m, 1, 1].

    The floor is the sole's own plane, :data:`SINK` higher. Where a point is deeper in it, the floor is the
    plane through the heights at which the points touched, by least squares.
    """
    points, com, sole = work.body.points, work.body.com, work.body.feet[foot]
    at, rotation = sole.place, sole.rotation
    n = x = y = z = xx = xy = yy = xz = yz = deepest = 0.0
    for i in range(len(points)):
        point = points[i]
        if point.foot == foot and work.sensed.contact[i]:
            dx, dy, floor = point.arm[0] - at[0], point.arm[1] - at[1], point.touch_height
            deepest = max(deepest, floor - com[2] - point.arm[2])
            n, x, y, z = n + 1.0, x + dx, y + dy, z + floor
            xx, xy, yy = xx + dx * dx, xy + dx * dy, yy + dy * dy
            xz, yz = xz + dx * floor, yz + dy * floor
    height = com[2] + at[2] + SINK
    slope = -rotation[0, 2] / rotation[2, 2] - plan_slope[0], -rotation[1, 2] / rotation[2, 2] - plan_slope[1]
    if deepest < DEEP_IN:
        return height, slope[0], slope[1]
    x, y, z = x / n, y / n, z / n
    xx, xy, yy, xz, yz = xx / n - x * x, xy / n - x * y, yy / n - y * y, xz / n - x * z, yz / n - y * z
    size = xx * yy - xy * xy
    if size < 1e-8:  # of a line
        return height - SINK + deepest, slope[0], slope[1]
    dzdx, dzdy = (yy * xz - xy * yz) / size, (xx * yz - xy * xz) / size
    return z - dzdx * x - dzdy * y, dzdx - plan_slope[0], dzdy - plan_slope[1]


@compiled
def feel_slope(work: Workspace, stepper: Stepper) -> None:
    """Measure the slope under the foot that stands flat, and up to which slope the floor counts as level."""
    state: SteppingState = work.stepping[0]
    stance, swing, places = state.stance, 1 - state.stance, stepper.table.foot_position[0]
    _, slope_x, slope_y = floor_under(work, stepper.plan_slope, stance)
    shift = state.shift[stance] - state.shift[swing]
    x, y, _ = places[stance] - places[swing] + shift
    told, level = slope_x * x + slope_y * y, LEVEL_SLOPE
    if abs(told) > RISE:
        level = (slope_x**2 + slope_y**2) ** 0.5 * (1.0 - slope_share(told, shift[2]))
    gain = min(stepper.tick / FEEL_TIME, 1.0)
    state.slope[0] += gain * (slope_x - state.slope[0])
    state.slope[1] += gain * (slope_y - state.slope[1])
    state.level_slope += gain * (level - state.level_slope)


@compiled
def step_up(work: Workspace, plan_slope: Array, foot: int, floor: float) -> float:
    """Height of the floor over the planned one under a foot that touches [m].

    ``floor`` is the planned height of its reference point as the phase ends [m].
    """
    rotation, points, wanted = work.body.feet[foot].rotation, work.body.points, work.wanted
    if dot(column(rotation, 2), column(wanted.foot_rotation[foot], 2)) >= AS_PLANNED:
        return floor_under(work, plan_slope, foot)[0] - wanted.foot_position[foot, 2]
    count, height = 0, 0.0
    for i in range(len(points)):
        if points[i].foot == foot and work.sensed.contact[i]:
            count, height = count + 1, height + points[i].touch_height
    return height / count - floor


@compiled
def stands_flat(work: Workspace) -> bool:
    """Whether the foot that stands alone has done so for a while, on all points of heel and ball."""
    state: SteppingState = work.stepping[0]
    for i in range(len(work.body.points)):
        point = work.body.points[i]
        if point.foot == state.stance and point.line != TIP and not work.sensed.contact[i]:
            return False
    return bool(state.single and state.elapsed > 0.04 and state.clock < 0.7 * state.duration)


@compiled
def is_early(state: SteppingState) -> bool:
    """Whether the swing foot has landed long before its time."""
    rest = (state.duration - state.clock) / state.clock_rate
    counts = state.single and state.clock > SWUNG * state.duration and rest > EARLY
    return bool(counts and state.touch_ticks[1 - state.stance] > 1)


@compiled
def is_late(state: SteppingState) -> bool:
    """Whether the foot that should have landed has not."""
    awaited = not state.single and GRACE < state.clock < 0.5 * state.duration
    return bool(awaited and state.touch_ticks[1 - state.stance] == 0)
