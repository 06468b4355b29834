"""Torques that act on joints and are not commanded: a motor's bias, or what of the body the model misses.

Beyond a joint whose links touch nothing, the measured acceleration tells the torque that has acted. Its mean
difference from the commanded one is added to the commands that follow. Joints of a leg that stands keep what
was found as it swung.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ampm.body.rigid_body import joint_torques
from ampm.compiled import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

BIAS_TIME = 0.25
"""Time over which the torques are averaged, of that in which the joint is free [s]."""
FREE = 4
"""Ticks after which a joint is taken for free: between them contact is not sensed [1]."""
NEAR = 0.02
"""Distance from the end of a joint's range within which it is not free [rad]."""
TOLERATED = 0.1
"""Bias that is taken for none: an undisturbed walk has up to 0.06 [N m]."""

BEFORE, EXTRA, TICKS, COUNT = range(4)
"""Rows of ``bias``, shape (4, nv): last tick's velocity, mean torque that was missing [N m], ticks since the
joint became free, ticks of which the mean is."""


@compiled
def sense_bias(
    tree: Any,
    link: Any,
    points: Any,
    gravity: float,
    armature: Array,
    tick: float,
    hold: float,
    q: Array,
    velocity: Array,
    hinges: Array,
    passive: Array,
    missing: Array,
    bias: Array,
    first: bool,
) -> None:
    """Compare what the last tick has done with what it should have.

    Args:
        tree: of the body.
        link: placed by the last tick, with its inertia; its motion and forces are overwritten.
        points: with the last tick's contact.
        gravity: [m/s^2].
        armature: of every coordinate, shape (nv,) [kg m^2].
        tick: control period [s].
        hold: time in which the torque has changed at its rate [s].
        q: measured, shape (nq,).
        velocity: measured, shape (nv,).
        hinges: range and last torque with its rate, see :mod:`ampm.control.controller`, shape (5, nu).
        passive: torque that overcame the passive ones and what was missing, shape (nu,) [N m].
        missing: mean torque that acts beside the commanded one; replaced, shape (nu,) [N m].
        bias: see :data:`BEFORE`, shape (4, nv).
        first: there is no last tick.
    """
    _, low, high, applied, rate = hinges
    joints = len(applied)
    if not first:
        acceleration, needed = (velocity - bias[BEFORE]) / tick, np.empty(joints)
        none = np.empty((0, 3))
        joint_torques(tree, armature, link, bias[BEFORE], acceleration, gravity, points[:0], none, needed)
        bias[TICKS] += 1.0
        for i in range(len(points)):
            joint = points[i].joint
            while points[i].touching and joint > 0:
                bias[TICKS, 5 + joint] = 0.0
                joint = tree[joint].parent
        for j in range(joints):
            if q[7 + j] < low[j] + NEAR or q[7 + j] > high[j] - NEAR:
                bias[TICKS, 6 + j] = 0.0
            if bias[TICKS, 6 + j] > FREE:
                bias[COUNT, 6 + j] += 1.0
                gain = max(tick / BIAS_TIME, 1.0 / bias[COUNT, 6 + j])
                acted = needed[j] + passive[j] + missing[j] - applied[j] - 0.5 * hold * rate[j]
                bias[EXTRA, 6 + j] += gain * (acted - bias[EXTRA, 6 + j])
    bias[BEFORE] = velocity
    for j in range(joints):
        mean = bias[EXTRA, 6 + j]
        missing[j] = mean if abs(mean) > TOLERATED else 0.0
