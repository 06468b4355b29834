"""Which sole points may carry force: planned, and sensed since; opened and closed over a short time.

On the plan's clock alone the controller would load points that are still tenths of a millimetre above the
floor, and the ZMP would jump by centimetres. A line (the heel, ball or tip points) opens when one of its
points touches and stays open until its planned lift-off: a foot that stands on one point of a line is turned
back by the planned force of the other point, and would be turned over without it. Tips open after the ball,
unless they alone hold the body.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ampm.compiled import compiled
from ampm.control.records import BALL, CHANGE, PHI, TIP

Array = NDArray[np.float64]

OFF = 2
"""Ticks without touch after which a tip is off the floor."""


@compiled
def update_gate(
    planned: NDArray[np.bool_],
    due: NDArray[np.bool_],
    until_lift: NDArray[np.float64],
    rate: float,
    ramp: float,
    first: bool,
    strict: bool,
    points: Any,
    lines: Any,
) -> bool:
    """Advance the lines by one tick, and give the points their openings.

    Args:
        planned: lines planned in contact, shape (F, 3).
        due: planned in contact now or shortly, shape (F, 3).
        until_lift: time until the line lifts off, shape (F, 3) [s].
        rate: by which a line opens in a tick [1].
        ramp: time in which a line closes before its lift-off [s].
        first: a run starts standing on the planned points.
        strict: tips off the floor carry no force: that of a toe that a torque has lifted would keep it there.
        points: that touch.
        lines: of the last tick.

    Returns:
        Whether any line touches or has opened that has not fully opened.
    """
    for foot in range(len(lines)):
        for group in range(3):
            line = lines[foot, group]
            line.planned, line.due, line.touching = planned[foot, group], due[foot, group], False
            if first:
                line.touched, line.opening = line.planned, 1.0 if line.planned else 0.0
    for i in range(len(points)):
        if points[i].touching:
            lines[points[i].foot, points[i].line].touching = True
    landing = supported = False
    for foot in range(len(lines)):
        for group in range(3):
            line = lines[foot, group]
            held = line.due and (line.touched or line.touching)
            if group == TIP:  # a loaded tip would keep the ball off the floor
                held = held and lines[foot, BALL].touched
            line.touched = held
            line.opening = min(line.opening + rate, 1.0) if held else 0.0
            line.limit = min(line.opening, until_lift[foot, group] / ramp)
            line.off = 0 if line.touching else line.off + 1
            if strict and group == TIP and line.off > OFF and until_lift[foot, group] > ramp:
                line.limit = 0.0
            supported = supported or line.limit > 0.0
            if line.opening < 1.0 and (line.touching or line.opening > 0.0):
                landing = True
    for foot in range(len(lines)):
        line = lines[foot, TIP]
        if not supported and line.due and line.touching:  # nothing else holds the body
            line.touched, line.opening, line.limit = True, 1.0, 1.0
    for i in range(len(points)):
        line = lines[points[i].foot, points[i].line]
        points[i].opening, points[i].limit = line.opening, line.limit
    return landing


@compiled
def land(
    gain: Any,
    feet: int,
    points: Any,
    weight: float,
    phi: Array,
    since: float,
    wrench: Array,
    momentum: Array,
) -> None:
    """Account for points of landing lines, whose forces differ from those commanded.

    The floor pushes as the foot arrives. The QP takes a share of this force as given, their least force, and
    shifts the other foot's load instead of letting the ZMP jump. A line that has touched has a least force at
    once, or it would bounce.

    With ``f`` the commanded force of a point when ``s`` was sensed there, a force ``k (s - f)`` is expected
    beyond the QP's, with k the gain ``landing_compensation``. The net wrench of the QP's forces and of these
    is the commanded one.

    Args:
        gain: of the controller.
        feet: number of feet.
        points: open to a share.
        weight: of the body [N].
        phi: forces of the last tick and their change, shape (2, U) [m g].
        since: time between the last tick and the sensed forces, in ticks [1].
        wrench: W, shape (6, U).
        momentum: wanted momentum rate plus weight; the expected forces are taken from it, shape (6,).
    """
    for i in range(len(points)):
        point, unknown = points[i], 3 * points[i].foot + i
        given = gain.landing_share / weight * point.sensed if point.touching and point.opening < 1.0 else 0.0
        if 0.0 < point.opening < 1.0:
            if point.line != TIP:
                given = max(given, gain.landing_force)
            asked = phi[PHI, unknown] + since * phi[CHANGE, unknown]
            missing = gain.landing_compensation * (point.sensed / weight - asked)
            for e in range(6):
                momentum[e] -= wrench[e, unknown] * missing
        point.least = max(point.least, given)
        point.largest = max(point.largest, point.least)
