"""What a control tick reads and writes: named tuples of arrays, and tables of feet, lines and sole points.

Numbers that change lie in arrays, because a compiled function gets all this as one reference, see
:func:`ampm.compiled.refer`. U are the unknowns of the contact forces (:mod:`ampm.control.forces`), R the task
rows: momentum (6), soles (6 each), toes.
"""

import math
from collections import namedtuple
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ampm.body.rigid_body import frames_of
from ampm.body.robot import Robot
from ampm.compiled import records
from ampm.controller_parameters import ControllerParameters

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

HEEL, BALL, TIP = 0, 1, 2
"""Lines of a foot's points."""

LONGEST = 4.0
"""Longest time over which the tilt of the trunk is averaged [s]."""

ANGULAR = 3.0
"""Scale of the rows of angular momentum in the QP [1/m]: a metre of lever is a third of a weight."""

_VECTOR, _MATRIX = (np.float64, (3,)), (np.float64, (3, 3))

FOOT = [
    ("toe", np.int64),  # velocity index of the toe joint, -1 if there is none
    ("toe_row", np.int64),  # its row among the tasks
    ("place", *_VECTOR),  # of the sole's reference point about the COM [m]
    ("pose", *_MATRIX),  # axes of the sole to world
    ("stood", np.bool_),  # whether it was in contact at the last tick
    ("on_heel", np.bool_),  # whether its heel held it then
    ("on_ball", np.bool_),
    ("speed", np.float64),  # upward speed of the line that held it [m/s]
]
"""Fields of a foot besides those of its sole's frame."""

LINE = [
    ("planned", np.bool_),  # planned in contact
    ("due", np.bool_),  # planned in contact now or shortly
    ("touching", np.bool_),  # touches at this tick
    ("off", np.int64),  # ticks since it touched
    ("touched", np.bool_),  # has touched down since its contact was due
    ("opening", np.float64),  # share opened since its touch-down, 0 ... 1
    ("limit", np.float64),  # share of the force limit: the same, but closing before lift-off, 0 ... 1
    ("was_planned", np.bool_),  # at the last tick
    ("was_opening", np.bool_),  # whether it touched then, and was opening
]
"""By foot and line, shape (F, 3)."""

POINT = [
    ("foot", np.int64),
    ("line", np.int64),
    ("sensed", np.float64),  # latest normal force [N]
    ("touching", np.bool_),
    ("floor", np.float64),  # height at which it touched [m]
    ("arm", *_VECTOR),  # place about the COM [m]
    ("opening", np.float64),  # of its line
    ("limit", np.float64),  # of its line
    ("share", np.float64),  # in its foot's tangential forces [1]
    ("twist", np.float64, (2,)),  # its horizontal force per unit twist of the foot [m g]
    ("lever", np.float64),  # distance from the centre of its foot's tangential forces [m]
    ("load_gradient", np.float64),  # of the cost, per planned load of the foot
    ("least", np.float64),  # normal force [m g]
    ("largest", np.float64),  # normal force [m g]
]
"""Fields of a sole point besides those of its frame; the left foot's points come first, as many per foot."""

STEPPING = [
    ("off_plan", np.bool_),  # whether the walk has left its plan
    ("active", np.bool_),  # whether it has, or is disturbed: COM and trunk share what the sole can give
    ("heading", np.float64, (2,)),  # cosine and sine of the standing foot's
    ("floor", np.float64),  # height under the body [m]
    ("com_first", np.bool_),  # whether the COM comes before the trunk in what the sole can give
    ("force_factor", np.float64),  # of the commanded force, which holds the COM's height [1]
]
"""What :mod:`ampm.stepping` says to a tick; one entry."""


class Sensed(NamedTuple):
    """Measured at this tick.

    Attributes:
        q: Pinocchio configuration, shape (nq,).
        v: velocity, shape (nv,).
        normal_force: of every sole point, shape (P,) [N].
        contact: sole points that touch, shape (P,).
    """

    q: Array
    v: Array
    normal_force: Array
    contact: Flags


class Wanted(NamedTuple):
    """The fields of a :class:`~ampm.walk.Reference` by the names of its row; numbers have shape (1,)."""

    com: Array
    com_velocity: Array
    com_acceleration: Array
    angular_momentum: Array
    moment: Array
    right_load: Array
    foot_position: Array
    foot_velocity: Array
    foot_acceleration: Array
    foot_rotation: Array
    foot_angular_velocity: Array
    foot_angular_acceleration: Array
    foot_toe: Array
    planned: Flags
    due: Flags
    until_lift: Array
    q: Array
    v: Array
    acceleration: Array
    trunk: Array
    tilt_window: Array
    jumps: Flags


class Body(NamedTuple):
    """The rigid body, placed at the measured configuration.

    Attributes:
        tree, link, feet, trunk, points: tables, see :mod:`ampm.body.rigid_body`, :data:`FOOT`, :data:`POINT`.
        armature: shape (nv,) [kg m^2].
        passive: of the hinges, see :func:`~ampm.body.rigid_body.passive_torques`, shape (nu, 4).
        com: shape (3,) [m].
        mass: [kg].
        gravity: [m/s^2].
    """

    tree: Any
    link: Any
    feet: Any
    trunk: Any
    points: Any
    armature: Array
    passive: Array
    com: Array
    mass: float
    gravity: float


class Motion(NamedTuple):
    """Per degree of freedom, shape (nv,).

    Attributes:
        now: velocity at the instant of q.
        acceleration: of this tick [m/s^2, rad/s^2].
        last_acceleration: of the last tick.
        zero: zeros.
        posture: wanted acceleration, later in the metric of the posture [g].
        root_weight: square root of the posture weights.
        passive_torque: torque that overcomes dampers, springs and friction, shape (nu,) [N m].
    """

    now: Array
    acceleration: Array
    last_acceleration: Array
    zero: Array
    posture: Array
    root_weight: Array
    passive_torque: Array


class Tasks(NamedTuple):
    """Task rows, shape (R,) unless said.

    Attributes:
        jacobian: transposed, shape (nv, R).
        rates: ``jacobian' v``.
        drift: of the accelerations at zero qdd.
        wanted: accelerations; of the momentum, those without contact forces.
        softness: 0 for rows that are met exactly.
        scale: of the rows in the QP.
        rhs: wanted less drift in units of the QP [g].
        scaled: ``jacobian`` in the metric of the posture and in units of the QP, shape (nv, R).
        system: matrix and solutions of the elimination, shape (R, R + 7).
    """

    jacobian: Array
    rates: Array
    drift: Array
    wanted: Array
    softness: Array
    scale: Array
    rhs: Array
    scaled: Array
    system: Array


class Command(NamedTuple):
    """The net wrench of the ground that is wanted.

    Attributes:
        force: shape (3,) [N].
        moment: about the COM, shape (3,) [N m].
        angular_momentum: about the COM, shape (3,) [N m s].
        zmp: of this wrench, on z = 0, shape (2,) [m].
    """

    force: Array
    moment: Array
    angular_momentum: Array
    zmp: Array


class Tilt(NamedTuple):
    """Memory of the trunk's tilt, see :mod:`ampm.control.trunk`.

    Attributes:
        past: along and across the heading, shape (M, 2) [rad].
        integral: of the mean, along and across, shape (2,) [rad s].
        next_row: shape (1,).
        longest: longest window since it opened, shape (1,) [ticks].
    """

    past: Array
    integral: Array
    next_row: NDArray[np.int64]
    longest: NDArray[np.int64]


class Contact(NamedTuple):
    """Contact forces in the unknowns of :mod:`ampm.control.forces`, shape (U,) [m g].

    Attributes:
        lines: table, see :data:`LINE`, shape (F, 3).
        forces: of the last tick.
        change: their change from the tick before.
        solution: of this tick.
        wrench_map: net force and moment per unknown, shape (6, U).
        momentum: wanted momentum rate plus weight, shape (6,) [m g].
        point_force: of this tick, shape (P, 3) [N].
    """

    lines: Any
    forces: Array
    change: Array
    solution: Array
    wrench_map: Array
    momentum: Array
    point_force: Array


class Problem(NamedTuple):
    """``min 1/2 x'Px + q'x``, ``lower <= A x <= upper``."""

    P: Array
    q: Array
    A: Array
    lower: Array
    upper: Array


class Joints(NamedTuple):
    """Hinges, shape (nu,).

    Attributes:
        torque: of this tick [N m].
        last_torque: of the last tick [N m].
        rate: at which the torque goes on [N m/s].
        torque_limit: [N m].
        lower: end of the range [rad].
        upper: end of the range [rad].
    """

    torque: Array
    last_torque: Array
    rate: Array
    torque_limit: Array
    lower: Array
    upper: Array


class Workspace(NamedTuple):
    """All that a tick reads and writes.

    Attributes:
        gains: the numbers among the parameters of the controller, by their names.
        extrapolates: whether the torque goes on with its rate.
        stepping: table of one entry, see :data:`STEPPING`.
    """

    gains: Any
    extrapolates: bool
    sensed: Sensed
    wanted: Wanted
    body: Body
    motion: Motion
    tasks: Tasks
    command: Command
    tilt: Tilt
    contact: Contact
    problem: Problem
    joints: Joints
    stepping: Any


def make_workspace(
    robot: Robot, gains: ControllerParameters, weights: Array, row: NDArray[Any], problem: Problem
) -> Workspace:
    """The workspace of a controller.

    Args:
        robot: the body, as the controller knows it.
        gains: of the controller.
        weights: of the posture, shape (nv,).
        row: one reference, shape (1,), of which ``wanted`` are views.
        problem: the QP of the contact forces: U of them, then six slacks.
    """
    body, nv, nu = robot.rigid_body, robot.nv, robot.nu
    q = np.zeros(robot.nq)
    q[6] = 1.0
    body.place(q)
    rows, unknowns, points = body.columns.shape[1], len(problem.q) - 6, points_of(robot)
    scale = np.ones(rows)
    scale[3:6] = ANGULAR
    return Workspace(
        gains=gains_of(gains),
        extrapolates=gains.hold == "first-order",
        sensed=Sensed(
            q=np.zeros(robot.nq),
            v=np.zeros(nv),
            normal_force=np.zeros(len(points)),
            contact=np.zeros(len(points), dtype=bool),
        ),
        wanted=wanted_of(row),
        body=Body(
            tree=body.tree,
            link=body.link,
            feet=feet_of(robot),
            trunk=body.trunk,
            points=points,
            armature=body.armature,
            passive=robot.passive,
            com=np.zeros(3),
            mass=float(body.link["mass"][0]),
            gravity=robot.gravity,
        ),
        motion=Motion(
            now=np.zeros(nv),
            acceleration=np.zeros(nv),
            last_acceleration=np.zeros(nv),
            zero=np.zeros(nv),
            posture=np.zeros(nv),
            root_weight=np.sqrt(weights),
            passive_torque=np.zeros(nu),
        ),
        tasks=Tasks(
            jacobian=body.columns,
            rates=np.zeros(rows),
            drift=np.zeros(rows),
            wanted=np.zeros(rows),
            softness=np.zeros(rows),
            scale=scale,
            rhs=np.zeros(rows),
            scaled=np.zeros((nv, rows)),
            system=np.zeros((rows, rows + 7)),
        ),
        command=Command(force=np.zeros(3), moment=np.zeros(3), angular_momentum=np.zeros(3), zmp=np.zeros(2)),
        tilt=Tilt(
            past=np.zeros((math.ceil(LONGEST * gains.frequency), 2)),
            integral=np.zeros(2),
            next_row=np.zeros(1, dtype=np.int64),
            longest=np.zeros(1, dtype=np.int64),
        ),
        contact=Contact(
            lines=records((len(robot.sole_frames), 3), LINE),
            forces=np.zeros(unknowns),
            change=np.zeros(unknowns),
            solution=np.zeros(unknowns),
            wrench_map=np.zeros((6, unknowns)),
            momentum=np.zeros(6),
            point_force=np.zeros((len(points), 3)),
        ),
        problem=problem,
        joints=Joints(
            torque=np.zeros(nu),
            last_torque=np.zeros(nu),
            rate=np.zeros(nu),
            torque_limit=robot.torque_limit.copy(),
            lower=robot.lower.copy(),
            upper=robot.upper.copy(),
        ),
        stepping=records(1, STEPPING),
    )


def wanted_of(row: NDArray[Any]) -> Wanted:
    """Views of one row of references, shape (1,)."""
    parts = {name: row[name] for name in Wanted._fields}
    return Wanted(**{name: part if part.ndim == 1 else part[0] for name, part in parts.items()})


def rows_of(rows: NDArray[Any]) -> Wanted:
    """Copies of the fields of T rows of references, each with a leading axis of T."""
    return Wanted(**{name: np.array(rows[name], order="C") for name in Wanted._fields})


def feet_of(robot: Robot) -> Any:
    """The feet of a body."""
    feet, count = frames_of(robot.model, robot.sole_frames, FOOT), len(robot.toe_joints)
    feet["toe"], feet["toe_row"] = -1, -1
    feet["toe"][:count] = robot.toe_joints
    feet["toe_row"][:count] = 6 + 6 * len(feet) + np.arange(count)
    return feet


def points_of(robot: Robot) -> Any:
    """The sole points of a body."""
    points = frames_of(robot.model, robot.point_frames, POINT)
    points["foot"], points["line"] = robot.point_foot, robot.point_group
    return points


_NUMBERS = [key for key, value in ControllerParameters() if isinstance(value, float)]
Gains: Any = namedtuple("Gains", _NUMBERS)  # type: ignore[misc]
"""The numbers among the parameters. Code for a class of a function would be compiled by every process."""


def gains_of(gains: ControllerParameters) -> Any:
    """The :class:`Gains` of a controller's parameters."""
    return Gains(*(getattr(gains, name) for name in _NUMBERS))
