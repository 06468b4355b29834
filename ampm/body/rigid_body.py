"""The physics of a tree of rigid bodies: a free root and hinges of any axis and placement.

Axes are those of the world, positions count from the root's place O. A pass outwards gives places and
motions, a pass inwards the sums over all that hangs on a hinge: mass m, first moment h = m c, inertia I about
O, force f and moment n about O. Turning a hinge with the axis a at the place p moves what is at O with the
velocity ``u = p x a``, and gives

    momentum          l = m u + a x h,    about O   I a + h x u,    about the COM c   I a + h x u - c x l
    its rate          f,                            n,                                n - c x f
    torque            a . (n - p x f)

At zero joint accelerations the sums f and n over the whole body are the drift of the momentum.

Coordinates are Pinocchio's, which builds the tree and is compared with in the tests: q the root's position,
quaternion (x, y, z, w) and hinges; v the root's velocity and rate in its own axes, and the hinges' rates.
"""

import math
from collections.abc import Sequence
from typing import Annotated, Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ampm.compiled import compiled, records
from ampm.exceptions import InputError
from ampm.geometry import Array
from ampm.vectors import (
    ZERO,
    Vector,
    column,
    cross,
    dot,
    from_quaternion,
    minus,
    multiply,
    plus,
    put,
    times,
    turn_about,
    turned,
    vector,
)

Array3 = Annotated[Array, (3,)]
Array33 = Annotated[Array, (3, 3)]
Records = Any
"""Structured array, whose entries numba and a record array give as attributes."""

_STILL = 0.003  # rate at which dry friction begins to have a direction [rad/s]


class Joint:
    """A joint of the tree, parents first; what a body keeps."""

    parent: int  # -1 of the root
    offset: Array3  # place of the joint in its parent's axes [m]
    turn: Array33  # axes of the joint at angle 0 to its parent's
    axis: Array3  # of the hinge, unit vector in its own axes
    mass: float  # of the link that the joint moves [kg]
    com: Array3  # its COM in its own axes [m]
    inertia: Array33  # about its COM, in its own axes [kg m^2]


class Link:
    """A joint's link in one state."""

    place: Array3  # of the joint, from O [m]
    turn: Array33  # its axes to world
    axis: Array3  # of the hinge
    com: Array3  # of the link, from O [m]
    com_inertia: Array33  # of the link about its COM [kg m^2]
    mass: float  # of all that hangs on the joint [kg]
    first: Array3  # its first moment h [kg m]
    inertia: Array33  # its inertia I about O [kg m^2]
    velocity: Array3  # of the joint's place [m/s]
    omega: Array3  # rate of the link [rad/s]
    acceleration: Array3  # of the joint's place [m/s^2]
    alpha: Array3  # rate of omega [rad/s^2]
    force: Array3  # on all that hangs on the joint [N]
    moment: Array3  # the same about O [N m]


class Frame:
    """A frame that is fixed to a link."""

    joint: int  # whose link it is fixed to
    offset: Array3  # its origin in the link's axes [m]
    turn: Array33  # its axes to the link's


class RigidBody(NamedTuple):
    """A body's tree and frames, and the arrays that one state fills."""

    tree: Records  # table of Joint
    link: Records  # table of Link, of the state that was placed last
    soles: Records  # frames of the feet
    trunk: Records  # frame of the trunk
    columns: Array  # transposed task Jacobian, (nv, R); R: momentum (6), soles (6 each), toes
    armature: Array  # rotor inertia, shape (nv,) [kg m^2]

    @classmethod
    def of(cls, model: pin.Model, soles: Sequence[int], trunk: int, toes: NDArray[np.intp]) -> "RigidBody":
        """Body of a Pinocchio model, by the numbers of frames, and the velocity indices of toe joints."""
        tree, rows = tree_of(model), 6 + 6 * len(soles) + len(toes)
        columns = np.zeros((model.nv, rows))
        columns[toes, rows - len(toes) + np.arange(len(toes))] = 1.0
        frames = frames_of(model, soles), frames_of(model, [trunk])
        return cls(tree, records(len(tree), Link), *frames, columns, np.array(model.armature))

    def place(self, q: Array) -> None:
        """See :func:`place_body`."""
        place_body(self, q)

    def places(self, frames: Records) -> tuple[Array, Array]:
        """Places of frames from the root and their axes to world, shapes (F, 3) [m] and (F, 3, 3)."""
        places, turns = np.empty((len(frames), 3)), np.empty((len(frames), 3, 3))
        place_frames(self.link, frames, places, turns)
        return places, turns


def tree_of(model: pin.Model) -> Records:
    """The tree of a Pinocchio model, one entry per joint.

    Raises InputError if the first joint is not free, or another one is not a hinge.
    """
    tree = records(model.njoints - 1, Joint)
    for i in range(len(tree)):
        source, inertia = model.joints[i + 1], model.inertias[i + 1]
        axis = _hinge_axis(source) if i else np.zeros(3)
        if axis is None or (i == 0 and source.shortname() != "JointModelFreeFlyer"):
            raise InputError(
                f"joint {model.names[i + 1]!r} is a {source.shortname()}; a body has a free root and hinges."
            )
        placement = model.jointPlacements[i + 1]
        tree["parent"][i], tree["axis"][i] = model.parents[i + 1] - 1, axis
        tree["offset"][i], tree["turn"][i] = placement.translation, placement.rotation
        tree["mass"][i], tree["com"][i], tree["inertia"][i] = inertia.mass, inertia.lever, inertia.inertia
    return tree


def _hinge_axis(joint: Any) -> Array | None:
    """Axis of a hinge in its own axes, shape (3,); None for another joint."""
    if (joint.nq, joint.nv) != (1, 1):
        return None
    data = joint.createData()
    joint.calc(data, np.zeros(joint.idx_q + 1))
    motion = np.asarray(data.S).reshape(6)
    return None if motion[:3].any() else motion[3:]


def frames_of(model: pin.Model, frames: Sequence[int], kind: type[Frame] = Frame) -> Records:
    """Frames of a Pinocchio model by their numbers, one entry each."""
    entries = records(len(frames), kind)
    for i, frame in enumerate(frames):
        source = model.frames[frame]
        entries["joint"][i] = source.parentJoint - 1
        entries["offset"][i], entries["turn"][i] = source.placement.translation, source.placement.rotation
    return entries


@compiled
def place_links(tree: Records, q: Array, link: Records) -> None:
    """Places and turns of all links."""
    put(link[0].place, ZERO)
    from_quaternion(q[3], q[4], q[5], q[6], link[0].turn)
    for i in range(1, len(tree)):
        joint, here, base = tree[i], link[i], link[tree[i].parent]
        put(here.place, plus(vector(base.place), turned(base.turn, vector(joint.offset))))
        multiply(base.turn, joint.turn, here.turn)  # at angle 0
        put(here.axis, turned(here.turn, vector(joint.axis)))
        turn_about(here.turn, vector(joint.axis), q[6 + i], here.turn)


@compiled
def sum_inertia(tree: Records, link: Records) -> None:
    """Mass, first moment and inertia about O of all that hangs on every joint."""
    for i in range(len(tree)):
        joint, here = tree[i], link[i]
        c = plus(vector(here.place), turned(here.turn, vector(joint.com)))
        m = joint.mass
        put(here.com, c)
        here.mass = m
        put(here.first, times(m, c))
        here.com_inertia[:] = 0.0
        here.inertia[:] = 0.0
        if m > 0.0:
            for r in range(3):
                row = here.turn[r, 0], here.turn[r, 1], here.turn[r, 2]
                put(here.com_inertia[r], turned(here.turn, turned(joint.inertia, row)))
            for r in range(3):  # about O: com_inertia + m (c . c - c c')
                put(here.inertia[r], minus(vector(here.com_inertia[r]), times(m * c[r], c)))
                here.inertia[r, r] += m * dot(c, c)
    for i in range(len(tree) - 1, 0, -1):
        here, base = link[i], link[tree[i].parent]
        base.mass += here.mass
        put(base.first, plus(vector(base.first), vector(here.first)))
        base.inertia[:] += here.inertia


@compiled
def com_of(link: Records) -> Vector:
    """COM of the body from O [m]; the links have their inertia."""
    return times(1.0 / link[0].mass, vector(link[0].first))


@compiled
def move_links(tree: Records, v: Array, qdd: Array, gravity: float, link: Records) -> None:
    """Velocities and accelerations of all links; the floor's push against gravity accelerates the root."""
    root = link[0]
    velocity, omega = turned(root.turn, (v[0], v[1], v[2])), turned(root.turn, (v[3], v[4], v[5]))
    acceleration = plus(turned(root.turn, (qdd[0], qdd[1], qdd[2])), cross(omega, velocity))
    put(root.velocity, velocity)
    put(root.omega, omega)
    put(root.acceleration, plus(acceleration, (0.0, 0.0, gravity)))
    put(root.alpha, turned(root.turn, (qdd[3], qdd[4], qdd[5])))
    for i in range(1, len(tree)):
        here, base = link[i], link[tree[i].parent]
        axis, arm = vector(here.axis), minus(vector(here.place), vector(base.place))
        omega, alpha, spin = vector(base.omega), vector(base.alpha), times(v[5 + i], axis)
        sweep = cross(omega, arm)
        put(here.velocity, plus(vector(base.velocity), sweep))
        put(here.omega, plus(omega, spin))
        put(here.acceleration, accelerated(vector(base.acceleration), alpha, omega, arm))
        put(here.alpha, plus(plus(alpha, times(qdd[5 + i], axis)), cross(omega, spin)))


@compiled
def angular_momentum(tree: Records, link: Records) -> Vector:
    """Angular momentum of the body about its COM [N m s]; the links have their inertia and velocities."""
    total, com = ZERO, com_of(link)
    for i in range(len(tree)):
        here, omega = link[i], vector(link[i].omega)
        sweep = cross(omega, minus(vector(here.com), vector(here.place)))
        momentum = times(tree[i].mass, plus(vector(here.velocity), sweep))
        total = plus(
            total, plus(turned(here.com_inertia, omega), cross(minus(vector(here.com), com), momentum))
        )
    return total


@compiled
def accelerated(acceleration: Vector, alpha: Vector, omega: Vector, arm: Vector) -> Vector:
    """Acceleration of a point of a link at an arm from another one [m/s^2]."""
    return plus(acceleration, plus(cross(alpha, arm), cross(omega, cross(omega, arm))))


@compiled
def start_forces(tree: Records, link: Records) -> None:
    """Force and moment that every link's own motion needs, by Newton and Euler."""
    for i in range(len(tree)):
        here = link[i]
        force, moment = ZERO, ZERO
        if tree[i].mass > 0.0:
            omega, alpha, com = vector(here.omega), vector(here.alpha), vector(here.com)
            arm = minus(com, vector(here.place))
            force = times(tree[i].mass, accelerated(vector(here.acceleration), alpha, omega, arm))
            spin = cross(omega, turned(here.com_inertia, omega))
            moment = plus(plus(turned(here.com_inertia, alpha), spin), cross(com, force))
        put(here.force, force)
        put(here.moment, moment)


@compiled
def sum_forces(tree: Records, link: Records) -> None:
    """Force and moment on all that hangs on every joint, from those on the links."""
    for i in range(len(tree) - 1, 0, -1):
        here, base = link[i], link[tree[i].parent]
        put(base.force, plus(vector(base.force), vector(here.force)))
        put(base.moment, plus(vector(base.moment), vector(here.moment)))


@compiled
def place_of(link: Records, frame: Frame) -> Vector:
    """Place of a frame from O [m]."""
    here = link[frame.joint]
    return plus(vector(here.place), turned(here.turn, vector(frame.offset)))


@compiled
def place_frames(link: Records, frames: Records, places: Array, turns: Array) -> None:
    """Places of frames from O, and their axes to world, shapes (F, 3) [m] and (F, 3, 3)."""
    for i in range(len(frames)):
        put(places[i], place_of(link, frames[i]))
        multiply(link[frames[i].joint].turn, frames[i].turn, turns[i])


@compiled
def momentum_columns(link: Records, columns: Array) -> None:
    """Momentum and angular momentum about the COM over the mass, per unit rate of every coordinate.

    Args:
        link: placed, with its inertia.
        columns: transposed Jacobian, shape (nv, 6 or more), of which the first six columns are written
            [m/s, m^2/s].
    """
    root = link[0]
    mass = root.mass
    com = com_of(link)
    for k in range(3):
        put(columns[k, 0:3], column(root.turn, k))
        put(columns[k, 3:6], ZERO)
    for j in range(3, len(columns)):
        here = link[max(j - 5, 0)]
        axis = column(root.turn, j - 3) if j < 6 else vector(here.axis)
        first = vector(here.first)
        moved = cross(vector(here.place), axis)
        linear = plus(times(here.mass, moved), cross(axis, first))
        about_root = plus(turned(here.inertia, axis), cross(first, moved))
        put(columns[j, 0:3], times(1.0 / mass, linear))
        put(columns[j, 3:6], times(1.0 / mass, minus(about_root, cross(com, linear))))


@compiled
def frame_columns(tree: Records, link: Records, joint: int, point: Vector, columns: Array) -> None:
    """Velocity and rate of a link at a point, per unit rate of every coordinate that moves it.

    Args:
        tree: of the body.
        link: placed.
        joint: that moves the link.
        point: from O [m].
        columns: transposed Jacobian, shape (nv, 6); columns of other coordinates keep their zeros.
    """
    while joint > 0:
        axis = vector(link[joint].axis)
        put(columns[5 + joint, 0:3], cross(axis, minus(point, vector(link[joint].place))))
        put(columns[5 + joint, 3:6], axis)
        joint = tree[joint].parent
    for k in range(3):
        axis = column(link[0].turn, k)
        put(columns[k, 0:3], axis)
        put(columns[3 + k, 0:3], cross(axis, point))
        put(columns[3 + k, 3:6], axis)


@compiled
def task_drift(body: RigidBody, v_momentum: Array, v_soles: Array, drift: Array) -> None:
    """Accelerations of the tasks at zero accelerations of the coordinates.

    Args:
        body: placed; the motion of its links is overwritten.
        v_momentum: velocity for the momentum, shape (nv,).
        v_soles: velocity for the soles, shape (nv,).
        drift: written, shape (R,).
    """
    tree, link, soles = body.tree, body.link, body.soles
    still = np.zeros(len(v_soles))
    move_links(tree, v_soles, still, 0.0, link)
    for i in range(len(soles)):
        here, first = link[soles[i].joint], 6 + 6 * i
        arm = turned(here.turn, vector(soles[i].offset))
        alpha, omega = vector(here.alpha), vector(here.omega)
        put(drift[first : first + 3], accelerated(vector(here.acceleration), alpha, omega, arm))
        put(drift[first + 3 : first + 6], alpha)
    move_links(tree, v_momentum, still, 0.0, link)
    start_forces(tree, link)
    sum_forces(tree, link)
    root, per_mass = link[0], 1.0 / link[0].mass
    force = vector(root.force)
    put(drift[0:3], times(per_mass, force))
    put(drift[3:6], times(per_mass, minus(vector(root.moment), cross(com_of(link), force))))


@compiled
def joint_torques(
    body: RigidBody, points: Records, gravity: float, v: Array, qdd: Array, forces: Array, torque: Array
) -> None:
    """Torques of the hinges for accelerations and forces on points of the links.

    Args:
        body: placed; motion and forces of its links are written.
        points: frames of P points.
        gravity: [m/s^2].
        v: shape (nv,).
        qdd: shape (nv,).
        forces: on the points, in axes of the world, shape (P, 3) [N].
        torque: written, shape (nv - 6,) [N m].
    """
    tree, link = body.tree, body.link
    move_links(tree, v, qdd, gravity, link)
    start_forces(tree, link)
    for i in range(len(points)):
        here, force, point = link[points[i].joint], vector(forces[i]), place_of(link, points[i])
        put(here.force, minus(vector(here.force), force))
        put(here.moment, minus(vector(here.moment), cross(point, force)))
    sum_forces(tree, link)
    for i in range(1, len(tree)):
        here = link[i]
        about = minus(vector(here.moment), cross(vector(here.place), vector(here.force)))
        torque[i - 1] = dot(vector(here.axis), about) + body.armature[5 + i] * qdd[5 + i]


@compiled
def passive_torques(passive: Array, q: Array, v: Array, direction: Array, torque: Array) -> None:
    """Torques that overcome dampers, springs and dry friction of the hinges.

    Args:
        passive: damping [N m s/rad], stiffness [N m/rad], angle of the spring at rest [rad] and dry friction
            [N m] of the hinges, shape (nv - 6, 4).
        q: shape (nq,).
        v: shape (nv,).
        direction: velocity with the direction of dry friction, shape (nv,).
        torque: written, shape (nv - 6,) [N m].
    """
    for j in range(len(passive)):
        damping, stiffness, spring, friction = passive[j]
        torque[j] = damping * v[6 + j] + stiffness * (q[7 + j] - spring)
        torque[j] += friction * math.tanh(direction[6 + j] / _STILL)


@compiled
def place_body(body: RigidBody, q: Array) -> None:
    """Fill in a configuration: places, inertia and the transposed task Jacobian."""
    tree, link, soles = body.tree, body.link, body.soles
    place_links(tree, q, link)
    sum_inertia(tree, link)
    momentum_columns(link, body.columns)
    for i in range(len(soles)):
        rows = body.columns[:, 6 + 6 * i : 12 + 6 * i]
        frame_columns(tree, link, soles[i].joint, place_of(link, soles[i]), rows)


@compiled
def moved(q: Array, change: Array) -> Array:
    """Configuration after a change of the coordinates, as Pinocchio's ``integrate``; a new array.

    Args:
        q: shape (nq,).
        change: the root's is a twist in its own axes over a unit time, shape (nv,) [m, rad].
    """
    out = np.empty(len(q))
    linear, turn = (change[0], change[1], change[2]), (change[3], change[4], change[5])
    square = dot(turn, turn)
    angle = math.sqrt(square)
    if angle < 1e-4:  # the first terms of the series, exact to rounding
        straight, along, half = 1.0 - square / 6.0, 1.0 / 6.0 - square / 120.0, 0.5 - square / 48.0
    else:
        straight, half = math.sin(angle) / angle, math.sin(0.5 * angle) / angle
        along = (1.0 - straight) / square
    shift = plus(times(straight, linear), times(2.0 * half * half, cross(turn, linear)))
    shift = plus(shift, times(along * dot(turn, linear), turn))
    rotation = np.empty((3, 3))
    from_quaternion(q[3], q[4], q[5], q[6], rotation)
    put(out[0:3], plus((q[0], q[1], q[2]), turned(rotation, shift)))
    u, w, a, b = (q[3], q[4], q[5]), q[6], times(half, turn), math.cos(0.5 * angle)
    if b < 0.0:  # of the two quaternions the one nearer to the present one
        a, b = times(-1.0, a), -b
    put(out[3:6], plus(plus(times(w, a), times(b, u)), cross(u, a)))
    out[6] = w * b - dot(u, a)
    norm = math.sqrt(out[3] ** 2 + out[4] ** 2 + out[5] ** 2 + out[6] ** 2)
    for i in range(3, 7):
        out[i] /= norm
    for i in range(7, len(q)):
        out[i] = q[i] + change[i - 1]
    return out
