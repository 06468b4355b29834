"""Masses of the links, from the soles' forces.

The motion of a link gives the share of the vertical force, and of its moment about the centre of pressure,
that it needs at a tick. What the soles sense beyond the sum of the model is attributed to errors of the
masses, each with the inertia of its link, by recursive least squares; both sides pass the same low pass.
Links that the soles cannot distinguish share what is found.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ampm.body.rigid_body import place_of
from ampm.compiled import compiled
from ampm.vectors import ZERO, clip, cross, minus, plus, times, vector

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

SMOOTH = 0.08
"""Time constant of the low pass [s]."""
UNKNOWN = 0.1
"""Expected error of a mass [1]."""
ERROR_FORCE, ERROR_ZMP = 0.02, 0.004
"""Expected errors of what is sensed: of the weight [1], and of the height of the COM [1]."""
GATE = 3.0
"""Expected errors from which a moment is no mass's: the body was pushed [1]."""
LEAST_FORCE, LEAST_ZMP = 0.015, 0.0012
"""What the found masses must change for them to count, likewise: an undisturbed walk finds less."""
TAKE_TIME = 0.3
"""Time constant with which the model takes them over, and over which their effect is averaged [s]."""
MOST = 0.3
"""Largest change of a mass [1]."""


class Scale(NamedTuple):
    """What is known of the masses of n links, those that have one.

    Attributes:
        joint: that moves the link, shape (n,).
        unit: weight of the model [N], and height of its COM [m], shape (2,).
        mass: of the links by the model, shape (n,) [kg].
        inertia: likewise, shape (n, 3, 3) [kg m^2].
        needs: vertical force and two moments that each link needs over weight and weight times height; in the
            last row the sensed excess. Smoothed, shape (n + 1, 3) [1].
        found: change of each mass, shape (n,) [1].
        covariance: of it, shape (n, n).
        taken: what the model has taken over, shape (n,) [1].
        effect: mean squares of the changes of force and moments, and whether they count, shape (3,) [1].
    """

    joint: NDArray[np.int64]
    unit: Array
    mass: Array
    inertia: Array
    needs: Array
    found: Array
    covariance: Array
    taken: Array
    effect: Array


def scale_of(tree: Any, gravity: float, height: float) -> Scale:
    """Nothing known yet of a tree's masses, with the plan's height of the COM [m]."""
    joint = np.flatnonzero(tree["mass"])
    n, mass, inertia = len(joint), tree["mass"][joint], tree["inertia"][joint]
    unit, zeros = np.array([mass.sum() * gravity, height]), np.zeros((2, n))
    return Scale(
        joint, unit, mass, inertia, np.zeros((n + 1, 3)), zeros[0], UNKNOWN**2 * np.eye(n), zeros[1],
        np.zeros(3),
    )  # fmt: skip


@compiled
def weigh_links(
    tree: Any, link: Any, points: Any, sensed: Array, tick: float, age: float, scale: Scale
) -> None:
    """Compare what the links need with what the soles give, and change the tree's masses.

    Args:
        tree: of the body; its masses and inertias are written where those found count.
        link: with the force and moment that each link's own motion needs.
        points: with the forces sensed at the last tick.
        sensed: forces of this tick, shape (P,) [N].
        tick: control period [s].
        age: time over which the soles took their mean [s].
        scale: replaced.
    """
    total, at = 0.0, ZERO
    before = clip(0.5 - 0.5 * age / tick, 0.0, 0.5)  # so that the forces are of the middle of the tick
    for i in range(len(points)):
        force = before * points[i].sensed + (1.0 - before) * sensed[i]
        total += force
        at = plus(at, times(force, place_of(link, points[i])))
    if total < 0.2 * scale.unit[0]:
        return
    at = minus(times(1.0 / total, at), times(0.5 * tick, vector(link[0].velocity)))  # likewise
    n, smooth, slow = len(scale.joint), min(tick / SMOOTH, 1.0), min(tick / TAKE_TIME, 1.0)
    excess, now, rise = np.zeros(3), np.empty(3), np.empty(n)
    excess[0] = total / scale.unit[0]
    for i in range(n):
        own, per = link[scale.joint[i]], 1.0 / (scale.unit[0] * (1.0 + scale.taken[i]))
        needed = vector(own.force)
        moment = minus(vector(own.moment), cross(at, needed))
        now[0], per = per * needed[2], per / scale.unit[1]
        now[1], now[2] = per * moment[0], per * moment[1]
        for k in range(3):
            excess[k] -= now[k]
            scale.needs[i, k] += smooth * (now[k] - scale.needs[i, k])
    for k in range(3):
        needs = scale.needs[:, k]
        needs[n] += smooth * (excess[k] - needs[n])
        known = spread = 0.0
        for i in range(n):
            known += needs[i] * scale.found[i]
            rise[i] = 0.0
            for j in range(n):
                rise[i] += scale.covariance[i, j] * needs[j]
            spread += needs[i] * rise[i]
        kind = min(k, 1)
        scale.effect[kind] += slow * (known * known - scale.effect[kind])
        off, error = needs[n] - known, (ERROR_ZMP if kind else ERROR_FORCE) ** 2
        if kind and off * off > GATE**2 * (spread + error):
            continue
        per = 1.0 / (spread + error * max(2.0 * SMOOTH / tick, 1.0))
        for i in range(n):
            scale.found[i] += per * rise[i] * off
            for j in range(n):
                scale.covariance[i, j] -= per * rise[i] * rise[j]
    if scale.effect[0] > LEAST_FORCE**2 or scale.effect[1] > LEAST_ZMP**2:
        scale.effect[2] = 1.0
    if scale.effect[2] == 0.0:
        return
    for i in range(n):
        scale.taken[i] += slow * (clip(scale.found[i], -MOST, MOST) - scale.taken[i])
        joint, factor = tree[scale.joint[i]], 1.0 + scale.taken[i]
        joint.mass = factor * scale.mass[i]
        joint.inertia[:] = factor * scale.inertia[i]
