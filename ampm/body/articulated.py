"""How a body moves where its root does not move as commanded."""

import numpy as np

from ampm.body.rigid_body import Link, Records
from ampm.compiled import compiled
from ampm.geometry import Array
from ampm.vectors import Vector, cross, dot, put, vector


@compiled
def respond(tree: Records, armature: Array, link: Records, velocity: Vector, rate: Vector) -> Array:
    """How hinges follow a change of the root's motion while their torques stay as they are.

    Articulated inertias are summed inwards, then the motions outwards (Featherstone, 1983), all about O.

    Args:
        tree: of the body.
        armature: of every coordinate, shape (nv,) [kg m^2].
        link: placed, with its inertia.
        velocity: change of the root's velocity at O, in world [m/s].
        rate: change of its rate, in world [rad/s].

    Returns:
        Changes of the hinges' rates, shape (nv - 6,) [rad/s].
    """
    axis, push, twist = np.empty((len(tree), 6)), np.empty((len(tree), 6)), np.empty((len(tree), 6))
    inertia, change = np.empty((len(tree), 6, 6)), np.empty(len(tree) - 1)
    put(twist[0, 0:3], velocity)
    put(twist[0, 3:6], rate)
    for i in range(len(tree)):
        here = link[i]
        put(axis[i, 0:3], cross(vector(here.place), vector(here.axis)))
        put(axis[i, 3:6], vector(here.axis))
        spatial_inertia(tree[i].mass, here, inertia[i])
    for i in range(len(tree) - 1, 0, -1):
        base, push[i] = inertia[tree[i].parent], 0.0
        for k in range(6):
            push[i] += axis[i, k] * inertia[i, k]
        share = 1.0 / ((axis[i] * push[i]).sum() + armature[5 + i])
        for k in range(6):
            base[k] += inertia[i, k] - share * push[i, k] * push[i]
        push[i] *= share
    for i in range(1, len(tree)):
        base = twist[tree[i].parent]
        change[i - 1] = -(push[i] * base).sum()
        twist[i] = base + change[i - 1] * axis[i]
    return change


@compiled
def spatial_inertia(mass: float, here: Link, inertia: Array) -> None:
    """Write the inertia of a link about O, shape (6, 6): ``(m u + w x h, I w + h x u)`` of a twist (u, w)."""
    c = vector(here.com)
    inertia[:] = 0.0
    inertia[3:6, 3:6] = here.com_inertia
    for r in range(3):
        after, last = (r + 1) % 3, (r + 2) % 3
        inertia[r, r] = mass
        inertia[3 + r, last] = inertia[last, 3 + r] = mass * c[after]
        inertia[3 + r, after] = inertia[after, 3 + r] = -mass * c[last]
        inertia[3 + r, 3 + r] += mass * dot(c, c)
        for k in range(3):
            inertia[3 + r, 3 + k] -= mass * c[r] * c[k]
