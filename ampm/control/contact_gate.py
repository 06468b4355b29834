"""Which sole points may carry force: those planned and sensed in contact, opened and closed gradually.

On the plan's clock alone the controller would load points that are still tenths of a millimetre above the
floor, and the ZMP would jump by centimetres. A line (the heel, ball or tip points) opens when one of its
points touches and stays open until its planned lift-off: a foot that stands on one point of a line is turned
back by the planned force of the other point, and would be turned over without it. Tips open after the ball,
unless they alone hold the body.

A foot that presses with less than the threshold of its sensor is not found, and without an opening it would
not press with more. So a planned line that does not touch opens a little: the share of the threshold in the
weight.
"""

from ampm.compiled import compiled
from ampm.control.workspace import Workspace
from ampm.planner.feet import BALL, TIP

OFF = 2
"""Ticks without touch after which a tip is off the floor."""
OLDEST = 0.005
"""Largest age of sensed forces that the other foot makes up for; older ones oscillate [s]."""


@compiled
def update_contacts(work: Workspace, first: bool) -> None:
    """Advance the lines by one tick, and give the points what is sensed at them, and their limits.

    A line opens, and closes before its lift-off, in the time ``contact_ramp``. ``first`` says whether a run
    starts, standing on the planned points.
    """
    wanted, points, lines, stepping = work.wanted, work.body.points, work.contact.lines, work.stepping[0]
    ramp = work.gains.contact_ramp
    rate = 1.0 / (work.gains.frequency * ramp)
    # Force at a tip off the floor would hold up a toe that a torque has lifted.
    close_lifted_tips = stepping.active and not stepping.off_plan
    missed = min(work.sensed.threshold[0] / (work.body.mass * work.body.gravity), 1.0)
    lines.planned[:], lines.due[:], lines.touching[:] = wanted.planned, wanted.due, False
    if first:
        lines.touched[:], lines.opening[:] = wanted.planned, wanted.planned
    for i in range(len(points)):
        points[i].touching = work.sensed.contact[i]
        if points[i].touching:
            lines[points[i].foot, points[i].line].touching = True
    supported = False
    for foot in range(len(lines)):
        for group in range(3):
            line = lines[foot, group]
            until_lift = wanted.until_lift[foot, group]
            line.touched = line.due and (line.touched or line.touching)
            if group == TIP and not lines[foot, BALL].touched:
                line.touched = False  # a loaded tip would keep the ball off the floor
            largest = 1.0 if line.touched else missed if line.planned and group != TIP else 0.0
            line.opening = min(line.opening + rate, largest)
            line.limit = min(line.opening, until_lift / ramp)
            line.ticks_off = 0 if line.touching else line.ticks_off + 1
            if close_lifted_tips and group == TIP and line.ticks_off > OFF and until_lift > ramp:
                line.limit = 0.0
            supported = supported or line.limit > 0.0
    for foot in range(len(lines)):
        line = lines[foot, TIP]
        if not supported and line.due and line.touching:  # nothing else holds the body
            line.touched, line.opening, line.limit = True, 1.0, 1.0
    for i in range(len(points)):
        points[i].limit = lines[points[i].foot, points[i].line].limit


@compiled
def land(work: Workspace) -> None:
    """Account for points of landing lines, whose forces differ from those commanded.

    The floor pushes as the foot arrives. The QP takes a share of this force as given, their least force, and
    shifts the other foot's load instead of letting the ZMP jump. A line that has touched has a least force at
    once, or it would bounce.

    With ``f`` the commanded force of a point when ``s`` was sensed there, a force ``k (s - f)`` is expected
    beyond the QP's, with k the gain. So is the share that a foot still bears as it leaves the floor, where
    less was commanded: were it given, the torques would press the foot down. The QP's forces and these give
    the commanded net wrench.

    The points' force limits are raised, and the expected forces taken from the wanted wrench.
    """
    gains, points, contact, age = work.gains, work.body.points, work.contact, work.sensed.force_age[0]
    weight = work.body.mass * work.body.gravity
    since = 1.0 - age * gains.frequency if work.extrapolates else 0.0  # ticks, from the last one
    gain = gains.landing_compensation if age <= OLDEST else 0.0
    forces, change, wrench = contact.forces, contact.change, contact.wrench
    for i in range(len(points)):
        point, normal, sensed = points[i], points[i].normal, work.sensed.normal_force[i]
        line, least, expected = contact.lines[point.foot, point.line], 0.0, 0.0
        if point.touching and line.opening < 1.0:
            given = gains.landing_share / weight * sensed
            if line.due:
                least = given
            elif forces[normal] < given and not contact.lines[point.foot].due.any():
                expected = given
        if 0.0 < line.opening < 1.0:
            if point.line != TIP:
                least = max(least, gains.landing_force)
            commanded = forces[normal] + since * change[normal]
            expected = gain * (sensed / weight - commanded)
        for k in range(6):
            wrench[k] -= contact.wrench_map[k, normal] * expected
        point.least = max(point.least, least)
        point.largest = max(point.largest, point.least)
