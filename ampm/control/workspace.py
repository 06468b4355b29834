"""What a control tick reads and writes: named tuples of arrays, and tables of feet, lines and sole points.

Numbers that change lie in arrays, because a compiled function gets all this as one reference, see
:func:`ampm.compiled.refer`. In the annotated shapes, P are the sole points, U the unknowns of the contact
forces (:mod:`ampm.control.forces`), R the task rows: momentum (6), soles (6 each), toes.
"""

import math
from collections import namedtuple
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ampm.body.inverse_kinematics import POSTURE_WEIGHTS
from ampm.body.rigid_body import Array3, Array33, Frame, RigidBody, frames_of
from ampm.body.robot import Robot
from ampm.compiled import records, zeros_of
from ampm.controller_parameters import ControllerParameters
from ampm.geometry import Array, Flags
from ampm.reference import FIELDS

LONGEST_WINDOW = 4.0
"""Longest time over which the tilt of the trunk is averaged [s]."""
ANGULAR = 3.0
"""Scale of the rows of angular momentum in the QP [1/m]: a metre of lever is a third of a weight."""


class Foot(Frame):
    """A foot: its sole's frame, its state, and what the next tick needs of it."""

    toe: int  # velocity index of the toe joint, -1 if there is none
    toe_row: int  # row of the toe joint among the tasks, -1 if there is none
    roll_row: int  # row of its roll among the tasks, -1 if the ankle holds it
    place: Array3  # sole's reference point from the COM, in world [m]
    rotation: Array33  # axes of the sole to world
    last_speed: float  # upward speed of the line that held it at the last tick [m/s]
    last_omega: Array3  # its angular velocity at the last tick, in world [rad/s]
    late: float  # time for which its planned contact has been missing [s]
    hurry: float  # its speed downwards beyond the touch-down velocity [m/s]
    floor_rise: float  # height of the floor under it over the plan's floor [m]
    slope: Annotated[Array, (2,)]  # slopes of the floor less those of the plan's: dz/dx, dz/dy [1]
    footprint: Array3  # planned place of its last flat stand, at the measured height over it, first NaN [m]
    tilt: Annotated[Array, (2,)]  # slopes with which its reference is tilted [1]
    raised: float  # height by which its reference is raised [m]
    raised_rate: float  # rate of this height [m/s]


class Line:
    """A line of a foot's points, by foot and line, shape (F, 3)."""

    planned: bool  # planned in contact
    due: bool  # planned in contact now or shortly
    touching: bool  # touches at this tick
    ticks_off: int  # ticks since it touched
    touched: bool  # has touched down since its contact was due
    opening: float  # share opened since its touch-down, 0 ... 1
    limit: float  # share of the force limit: as `opening`, but closes before lift-off, 0 ... 1


class Point(Frame):
    """A sole point. The left foot's come first, as many per foot."""

    foot: int
    line: int
    normal: int  # unknown of its normal force
    tangent: int  # first unknown of its foot's tangential forces and twist
    touching: bool
    touch_height: float  # height at which it touched [m]
    arm: Array3  # place from the COM, in world [m]
    limit: float  # `limit` of its line
    share: float  # share of its foot's tangential forces that it takes [1]
    twist: Annotated[Array, (2,)]  # its horizontal force per unit twist of the foot [m g]
    lever: float  # distance from the centre of its foot's tangential forces [m]
    load_gradient: float  # linear cost of its normal force, per planned load of the foot
    least: float  # lower limit of its normal force [m g]
    largest: float  # upper limit of its normal force [m g]


class SteppingState:
    """State of the stabiliser that steps, one entry of a table; shifts and steps are in world.

    Under the stabiliser ``fixed`` it does not change.
    """

    time: float  # of the tick, on the walk's clock; off the plan only [s]
    phase: int  # its number in the plan, whose numbers go on after its end
    off_plan: bool  # whether the walk has left its plan
    leaving: bool  # whether it leaves its plan at the next tick
    active: bool  # whether it is off its plan or disturbed: COM and trunk share what the sole can give
    heading: Annotated[Array, (2,)]  # cosine and sine of the standing foot's heading
    floor_rise: float  # height of the floor under the body over the plan's floor [m]
    force_factor: float  # multiplies the commanded force, to hold the COM's height [1]
    single: bool  # whether this is a single support
    stance: int  # foot that stands; in double support the one that leaves
    clock: float  # time since the phase began, on the plan's clock [s]
    clock_rate: float  # speed of this clock [1]
    duration: float  # planned duration of the phase [s]
    double_duration: float  # planned duration of the double support that follows [s]
    stretch: float  # duration of the rest of the phase over the planned one [1]
    choice: int  # candidate for `stretch` that was chosen; -1: it returns to the plan
    delay: float  # time behind the plan [s]
    waited: float  # time that the clock has waited for a late foot [s]
    elapsed: float  # time since the phase began [s]
    length: float  # planned distance of the next step ahead of the standing foot [m]
    width: float  # planned distance of the next step beside the standing foot [m]
    step: Annotated[Array, (2,)]  # displacement of the next step from the standing foot's shift [m]
    shift: Annotated[Array, (2, 3)]  # displacement of every foot from where it was planned [m]
    swing: Annotated[Array, (3, 3)]  # displacement of the swing foot, with two derivatives
    slope: Annotated[Array, (2,)]  # slopes of the floor less those of the plan's: dz/dx, dz/dy [1]
    level_slope: float  # slope up to which the floor counts as level [1]
    height: Annotated[Array, (2,)]  # height of the COM over its plan, and its rate [m, m/s]
    sag: float  # height by which the COM goes down for a long step [m]
    com_error: float  # largest component of the COM's distance from the plan's [m]
    touch_ticks: Annotated[Array, (2,)]  # ticks for which each foot has touched, 0 without contact


class Curves(NamedTuple):
    """Horizontal curves of a phase at equal intervals, shapes (n, 2) [m]."""

    r: Array  # `c - cdd / omega^2`
    xi: Array  # DCM
    zmp: Array  # ZMP


class Stepper(NamedTuple):
    """Constants and phase of a walk that may leave its plan."""

    omega: float  # `sqrt(g / H)` of the pendulum [1/s]
    tick: float  # control period [s]
    size: float  # size of the body, 1 for a stature of 1.70 m [1]
    foot_width: float  # [m]
    plan_slope: Array  # of the plan's floor: dz/dx, dz/dy, shape (2,) [1]
    curves: Curves  # of the phase
    table: Any  # references of the phase at equal intervals, see `rows_of`


class Sensed(NamedTuple):
    """What is measured at this tick."""

    q: Annotated[Array, ("nq",)]  # Pinocchio configuration
    v: Annotated[Array, ("nv",)]  # velocity
    velocity_lag: Annotated[Array, (1,)]  # how much older it is than q [s]
    normal_force: Annotated[Array, ("P",)]  # of every sole point [N]
    force_age: Annotated[Array, (1,)]  # how old these forces are [s]
    contact: Annotated[Flags, ("P",)]  # sole points that touch
    threshold: Annotated[Array, (1,)]  # load below which a touch may be missed [N]


Wanted: Any = namedtuple("Wanted", ["smooth", *FIELDS])  # type: ignore[misc]
"""Views of the fields of a :class:`~ampm.walk.Reference`; numbers have shape (1,).

``smooth`` has all numbers of the smooth fields, shape (n,).
"""


class PlacedBody(NamedTuple):
    """The rigid body, placed at the measured configuration."""

    rigid: RigidBody  # whose soles are the feet
    feet: Any  # table of Foot
    points: Any  # table of Point
    passive: Array  # see ampm.body.rigid_body.passive_torques, shape (nu, 4)
    com: Array  # in world, shape (3,) [m]
    mass: float  # [kg]
    gravity: float  # [m/s^2]


class Motion(NamedTuple):
    """Rates, accelerations and passive torques per degree of freedom."""

    v: Annotated[Array, ("nv",)]  # velocity at the instant of q [m/s, rad/s]
    acceleration: Annotated[Array, ("nv",)]  # commanded at this tick [m/s^2, rad/s^2]
    last_acceleration: Annotated[Array, ("nv",)]  # commanded at the last tick [m/s^2, rad/s^2]
    posture: Annotated[Array, ("nv",)]  # wanted [m/s^2, rad/s^2]
    sqrt_weight: Array  # square roots of the posture weights, shape (nv,)
    passive_torque: Annotated[Array, ("nu",)]  # overcomes dampers, springs and friction [N m]


class Tasks(NamedTuple):
    """Task rows: momentum over the mass, soles (linear, angular), toes; in world."""

    rates: Annotated[Array, ("R",)]  # jacobian v
    drift: Annotated[Array, ("R",)]  # accelerations at zero qdd
    wanted: Annotated[Array, ("R",)]  # accelerations; the momentum's without contact forces
    softness: Annotated[Array, ("R",)]  # 0 for rows that are met exactly
    scale: Array  # factors of the rows in the QP, shape (R,)
    rhs: Annotated[Array, ("R",)]  # wanted less drift in units of the QP [g]
    jacobian: Annotated[Array, ("nv", "R")]  # transposed, in the metric of the posture and in units of the QP
    posture: Annotated[Array, ("nv",)]  # accelerations wanted of it, in the same metric [g]
    system: Annotated[Array, ("R", "R + 7")]  # matrix and solutions of the elimination


class Wrench(NamedTuple):
    """The net wrench of the ground that is commanded."""

    force: Annotated[Array, (3,)]  # [N]
    moment: Annotated[Array, (3,)]  # about the COM [N m]
    angular_momentum: Annotated[Array, (3,)]  # about the COM [N m s]
    zmp: Annotated[Array, (2,)]  # of this wrench, on z = 0 [m]


class Tilt(NamedTuple):
    """Memory of the trunk's tilt, see :mod:`ampm.control.trunk`."""

    past: Annotated[Array, ("M", 2)]  # along and across the heading [rad]
    integral: Annotated[Array, (2,)]  # of the mean, along and across [rad s]
    next_row: Annotated[NDArray[np.int64], (1,)]  # row of `past` that is written next
    longest: Annotated[NDArray[np.int64], (1,)]  # longest window since it opened [ticks]


class Contact(NamedTuple):
    """Contact forces in the unknowns of :mod:`ampm.control.forces`, [m g]."""

    lines: Any  # table of Line, shape (F, 3)
    last: Any  # the same of the last tick
    forces: Annotated[Array, ("U",)]  # of the last tick
    change: Annotated[Array, ("U",)]  # their change from the tick before
    solution: Annotated[Array, ("U",)]  # of this tick
    wrench_map: Annotated[Array, (6, "U")]  # net force and moment per unknown
    wrench: Annotated[Array, (6,)]  # wanted net force, and moment times ANGULAR
    point_force: Annotated[Array, ("P", 3)]  # of this tick [N]


class Joints(NamedTuple):
    """Hinges; limits have the shape (nu,)."""

    torque: Annotated[Array, ("nu",)]  # commanded at this tick [N m]
    last_torque: Annotated[Array, ("nu",)]  # commanded at the last tick [N m]
    rate: Annotated[Array, ("nu",)]  # rate of the torque until the next tick [N m/s]
    torque_limit: Array  # [N m]
    lower: Array  # lower end of the range [rad]
    upper: Array  # upper end of the range [rad]


class Workspace(NamedTuple):
    """All that a tick reads and writes."""

    gains: Any  # see Gains
    extrapolates: bool  # whether the torque goes on with its rate between two ticks
    sensed: Sensed
    wanted: Any  # see Wanted
    body: PlacedBody
    motion: Motion
    tasks: Tasks
    command: Wrench
    tilt: Tilt
    contact: Contact
    problem: Any  # QPProblem of the contact forces
    joints: Joints
    stepping: Any  # table of one SteppingState


def make_workspace(robot: Robot, gains: ControllerParameters, row: NDArray[Any], problem: Any) -> Workspace:
    """The workspace of a controller.

    Args:
        robot: the body, as the controller knows it.
        gains: parameters of the controller.
        row: one reference, shape (1,), of which ``wanted`` are views.
        problem: QP in U contact forces, then six slacks.
    """
    feet, points, rows = feet_of(robot), frames_of(robot.model, robot.point_frames, Point), robot.task_rows
    points["foot"], points["line"], per_foot = robot.point_foot, robot.point_group, len(points) // 2
    # Unknowns of a foot: the normal forces of its points, two tangential forces, a twist.
    points["normal"] = 3 * points["foot"] + np.arange(len(points))
    points["tangent"] = (per_foot + 3) * points["foot"] + per_foot
    body, q = robot.rigid_body._replace(soles=feet), np.zeros(robot.nq)
    q[6] = 1.0
    body.place(q)
    scale = np.ones(rows)
    scale[3:6] = ANGULAR
    sizes = {"nq": robot.nq, "nv": robot.nv, "nu": robot.nu, "P": len(points), "R": rows, "R + 7": rows + 7}
    lines = len(robot.sole_frames), 3
    sizes |= {"U": len(problem.q) - 6, "M": math.ceil(LONGEST_WINDOW * gains.frequency)}
    return Workspace(
        gains=gains_of(gains),
        extrapolates=gains.hold == "first-order",
        sensed=zeros_of(Sensed, sizes),
        wanted=Wanted._make(part if part.ndim == 1 else part[0] for part in rows_of(row)),
        body=PlacedBody(
            rigid=body,
            feet=feet,
            points=points,
            passive=robot.passive,
            com=np.zeros(3),
            mass=float(body.link["mass"][0]),
            gravity=robot.gravity,
        ),
        motion=zeros_of(Motion, sizes, sqrt_weight=np.sqrt(robot.by_group(POSTURE_WEIGHTS))),
        tasks=zeros_of(Tasks, sizes, scale=scale),
        command=zeros_of(Wrench, sizes),
        tilt=zeros_of(Tilt, sizes),
        contact=zeros_of(Contact, sizes, lines=records(lines, Line), last=records(lines, Line)),
        problem=problem,
        joints=zeros_of(
            Joints,
            sizes,
            torque_limit=robot.torque_limit.copy(),
            lower=robot.lower.copy(),
            upper=robot.upper.copy(),
        ),
        stepping=records(1, SteppingState),
    )


def rows_of(rows: NDArray[Any]) -> Any:
    """:data:`Wanted` of T rows of references; every array has a leading axis of T."""
    count = sum(rows[name][0].size for name, field in FIELDS.items() if field.smooth)
    smooth = rows.view(np.float64).reshape(len(rows), -1)[:, :count]
    return Wanted._make([smooth, *(rows[name] for name in FIELDS)])


def feet_of(robot: Robot) -> Any:
    """The feet of a body."""
    feet, count = frames_of(robot.model, robot.sole_frames, Foot), len(robot.toe_joints)
    feet["toe"], feet["toe_row"], feet["roll_row"], feet["footprint"] = -1, -1, -1, np.nan
    feet["roll_row"][: len(robot.roll_rows)] = robot.roll_rows
    feet["toe"][:count] = robot.toe_joints
    feet["toe_row"][:count] = 6 + 6 * len(feet) + np.arange(count)
    return feet


_NUMBERS = [key for key, value in ControllerParameters() if isinstance(value, float)]
Gains: Any = namedtuple("Gains", _NUMBERS)  # type: ignore[misc]
"""The controller's parameters that are numbers. Of a class made in a function, each process would compile."""


def gains_of(gains: ControllerParameters) -> Any:
    """The :class:`Gains` of a controller's parameters."""
    return Gains(*(getattr(gains, name) for name in _NUMBERS))
