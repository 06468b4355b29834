"""Forces and contacts of sole points from one wrench of every foot, and from where its points are."""

from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ampm.body.rigid_body import frames_of, place_links, place_of
from ampm.body.robot import Robot
from ampm.compiled import bound, compiled, refer, zeros_of
from ampm.geometry import Array, Flags
from ampm.parameters import RunParameters
from ampm.planner.feet import TIP
from ampm.vectors import ZERO, Vector, cross, dot, minus, multiply, plus, put, times, turned, vector

YIELD = 3e-3
"""Height over the lowest point of its foot at which a point takes half of what it would take there [m]."""
LEVEL = 0.1
"""A line that touches stays on the floor up to :data:`YIELD` times the root of this [1]."""
FIRST = 0.15
"""Share of the threshold from which a line touches at the height of the lowest point [1]."""
NO_LOAD = 1e-3
"""Share of the weight below which no load counts, whatever the threshold [1]."""
TIP_SHARE = 0.05
"""What a tip takes where another point at its place would take 1: toes give way [1]."""
ROUNDS = 8
"""Rounds in which the loaded points are found."""
RIDGE = 1e-6
"""Share of the loads that keeps their equations regular where points lie on a line."""
IN_AIR = 0.1
"""Time without load after which a foot's readings are taken for their offset [s]."""
TARE = 0.1
"""Time constant of that offset [s]."""
SCALE = 0.3
"""Time constant in which a foot that stands alone finds the scale of its sensor [s]."""


class Soles(NamedTuple):
    """What is read of the feet and known of them."""

    frame: Any  # of both soles
    points: Any  # frames of the P sole points, the left foot's first
    line: Any  # of every sole point, (P,)
    force: Annotated[Array, ("P",)]  # normal force of every sole point [N]
    contact: Annotated[Flags, ("P",)]  # sole points that touch
    # as read: forces and moments about the sole, in its axes [N, N m]
    wrench: Annotated[Array, (2, 6)]
    offset: Annotated[Array, (2, 6)]  # of the same, found in the air [N, N m]
    scale: Array  # what of the wrenches is read, found by the weight on a foot that stands alone, (2,) [1]
    felt: Annotated[Array, (2, 6)]  # the wrenches without offset and scale, in world axes [N, N m]
    tared: Any  # whether the offsets were found, (2,)
    unloaded: Annotated[Array, (2,)]  # time since the foot was loaded [s]
    loaded: Annotated[Flags, (2,)]  # feet that carry load
    touching: Annotated[Flags, (2, 3)]  # their lines of points
    threshold: float  # load at which a foot or a line touches; half of it to go on touching [N]
    period: float  # of a control tick [s]
    weight: float  # of the body, if the sensors have errors of scale; else 0 [N]


def soles_of(robot: Robot, run: RunParameters) -> Soles:
    """Soles of a body with the run's sensors, unloaded."""
    return zeros_of(
        Soles,
        {"P": len(robot.point_frames)},
        frame=frames_of(robot.model, robot.sole_frames),
        points=frames_of(robot.model, robot.point_frames),
        line=robot.point_group.copy(),
        scale=np.ones(2),
        tared=np.full(2, not (run.sensors.force_bias or run.sensors.moment_bias)),
        threshold=max(run.sensors.contact_threshold, NO_LOAD * robot.mass * robot.gravity),
        period=1.0 / run.controller.frequency,
        weight=robot.mass * robot.gravity if run.sensors.force_scale_bias else 0.0,
    )


@compiled
def spread_wrenches(s: Soles, link: Any) -> None:
    """Write normal forces of the sole points that give the wrenches as read, and which points touch.

    Of all forces that push, these have the least sum of squares, each divided by how near its point is to the
    floor. Of a loaded foot a line of points touches that is at the height of its lowest point; higher up it
    touches by its load. A foot that is turned to the floor presses with some newtons only, while another of
    its lines bears the body. The links are placed.
    """
    count = len(s.points) // 2
    for foot in range(2):
        tare(s, link, foot)
        arm, sole, first = np.empty((count, 3)), place_of(link, s.frame[foot]), count * foot
        for i in range(count):
            put(arm[i], minus(place_of(link, s.points[first + i]), sole))
        lowest = arm[:, 2].min()  # all points bear at this height
        height = ((arm[:, 2] - lowest) / YIELD) ** 2
        arm[:, 2] = 1.0
        here, line = s.force[first : first + count], s.line[first : first + count]
        here[:] = np.where(line == TIP, TIP_SHARE, 1.0) / (1.0 + height)
        felt = s.felt[foot]
        wanted = lowest * felt[0] - felt[4], lowest * felt[1] + felt[3], felt[2]
        spread(arm, wanted if s.loaded[foot] else ZERO, here)
        for group in range(s.touching.shape[1]):
            total, level = here[line == group].sum(), 0.5 * height[line == group].sum()
            by_height = s.touching[foot, group] or group == TIP  # a tip bears little
            least = 0.5 * (min(1.0, level) - LEVEL) if by_height else min(1.0, level + FIRST)
            s.touching[foot, group] = s.loaded[foot] and total > s.threshold * least
        for i in range(count):
            s.contact[first + i] = s.touching[foot, line[i]]


@compiled
def tare(s: Soles, link: Any, foot: int) -> None:
    """Write force and moment of a foot in world axes, to scale, less the offsets that it shows in the air."""
    turn, frame = np.empty((3, 3)), s.frame[foot]
    multiply(link[frame.joint].turn, frame.turn, turn)
    share = 1.0 / s.scale[foot]
    load = times(share, turned(turn, vector(s.wrench[foot, 0:3] - s.offset[foot, 0:3])))
    moment = times(share, turned(turn, vector(s.wrench[foot, 3:6] - s.offset[foot, 3:6])))
    s.loaded[foot] = load[2] > (0.5 if s.loaded[foot] else 1.0) * s.threshold
    if s.weight > 0.0 and s.loaded[foot] and not s.loaded[1 - foot]:
        s.scale[foot] *= 1.0 + s.period / SCALE * (load[2] / s.weight - 1.0)
    s.unloaded[foot] = 0.0 if s.loaded[foot] else s.unloaded[foot] + s.period
    if s.unloaded[foot] > IN_AIR:
        s.offset[foot] += s.period / TARE * (s.wrench[foot] - s.offset[foot])
        s.tared[foot] = True
    put(s.felt[foot, 0:3], load)
    put(s.felt[foot, 3:6], moment)


@compiled
def spread(arm: Array, wanted: Vector, force: Array) -> None:
    """Least forces ``w_i max(0, a_i . y)`` with ``sum f_i a_i = wanted``.

    Args:
        arm: a_i of every point, shape (n, 3).
        wanted: first moments [N m] and sum [N].
        force: w_i on entry, the forces on return, shape (n,) [N].
    """
    answer = (0.0, 0.0, 1.0)
    for _ in range(ROUNDS):
        rows = RIDGE * np.eye(3)
        for i in range(len(arm)):
            if dot(vector(arm[i]), answer) > 0.0:
                for k in range(3):
                    rows[k] += force[i] * arm[i, k] * arm[i]
        a, b, c = vector(rows[0]), vector(rows[1]), vector(rows[2])
        first, second, third = cross(b, c), cross(c, a), cross(a, b)
        total = plus(times(wanted[0], first), plus(times(wanted[1], second), times(wanted[2], third)))
        answer = times(1.0 / dot(a, first), total)
    for i in range(len(arm)):
        force[i] *= max(0.0, dot(vector(arm[i]), answer))
    if force.sum() > 0.0:  # a load beyond the sole's edge keeps its size
        force *= wanted[2] / force.sum()


class SoleForces:
    """What the soles feel, from wrenches: for an estimator of one's own.

    Args:
        robot: the body.
        run: its section ``sensors``, and control frequency.
    """

    def __init__(self, robot: Robot, run: RunParameters) -> None:
        body, self._soles = robot.rigid_body, soles_of(robot, run)
        self._place = bound(place_links, (body.tree,), np.zeros(robot.nq), body.link)
        self._link = body.link
        self._spread = bound(spread_wrenches, (refer(self._soles), body.link))

    def update(self, q: Array, wrench: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Normal forces (P,) [N] of the sole points and which of them touch; the next call overwrites both.

        Args:
            q: configuration, shape (nq,).
            wrench: of this control tick, see :class:`~ampm.sensors.readings.Readings`, (2, 6) [N, N m].
        """
        self._soles.wrench[:] = wrench
        self._place(q, self._link)
        self._spread()
        return self._soles.force, self._soles.contact
