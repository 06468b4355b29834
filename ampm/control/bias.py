"""Torques that act on a foot's joints and are not commanded: a motor's bias.

Beyond a joint whose links touch nothing, the measured acceleration gives the torque that has acted. Its
difference from the commanded one, as a line over the joint's rate, has its value at rate zero taken off the
commands that follow; the rest is damping, which a tick cannot take off a toe of so little inertia. A foot
that stands keeps what was found as it swung.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ampm.body.rigid_body import hinge_torques, move_links, start_forces
from ampm.compiled import compiled
from ampm.control.masses import Scale, weigh_links
from ampm.vectors import clip

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

BIAS_TIME = 0.25
"""Time over which the torques are averaged, of that in which the joint is free [s]."""
FREE = 4
"""Ticks after which a joint is taken for free: between them contact is not sensed [1]."""
NEAR = 0.02
"""Distance from the end of a joint's range within which it is not free [rad]."""
END_TIME = 0.01
"""Time over which a bias that holds a joint at the end of its range is found [s]."""
TOLERATED = 2e-4
"""Bias that is taken for none over weight times COM height: an undisturbed walk has up to 1.2e-4 [1]."""

LIGHT = 0.03
"""Mass beyond a joint of a foot, as a share of the body's: a bias hardly turns more, and noise of the rate
would be taken for torque [1]."""
LARGEST, MOST = 0.03, 0.026
"""Largest bias, as a share of the motor's limit [1], and largest damping that is set apart, over weight times
COM height over omega [1]."""
SLOW = 0.0044
"""Variance of a rate that tells little of the damping, over omega^2 [rad^2]."""

BEFORE, EXTRA, TICKS, COUNT, RATE, SPREAD, SHARED, FOOT = range(8)
"""Rows of ``bias``, shape (8, nv): last tick's velocity, mean torque that was missing [N m], ticks since the
joint became free, ticks of which the mean is, mean rate, its variance, its covariance with the torque, and
whether it is a joint of a foot."""


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
    sensed: Array,
    scale: Scale,
    age: float,
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
        hinges: range and last torque with its rate, see :mod:`ampm.control.tick`, shape (5, nu).
        passive: torque that overcame the passive ones and what was missing, shape (nu,) [N m].
        missing: constant torque that acts beside the commanded one; replaced, shape (nu,) [N m].
        bias: see :data:`BEFORE`, shape (8, nv).
        sensed: normal forces of the points, shape (P,) [N].
        scale: what is known of the links' masses.
        age: of the forces [s].
        first: there is no last tick.
    """
    limit, low, high, applied, rate = hinges
    joints = len(applied)
    if not first:
        acceleration, needed = (velocity - bias[BEFORE]) / tick, np.empty(joints)
        move_links(tree, bias[BEFORE], acceleration, gravity, link)
        start_forces(tree, link)
        weigh_links(tree, link, points, sensed, tick, age, scale)
        hinge_torques(tree, armature, link, acceleration, needed)
        bias[TICKS] += 1.0
        for i in range(len(points)):
            joint = points[i].joint
            while link[joint].mass < LIGHT * link[0].mass:
                bias[FOOT, 5 + joint] = 1.0
                if points[i].touching:
                    bias[TICKS, 5 + joint] = 0.0
                joint = tree[joint].parent
        for j in range(joints):
            if bias[FOOT, 6 + j] == 0.0:
                continue
            if bias[TICKS, 6 + j] > FREE:
                acted = needed[j] + passive[j] + missing[j] - applied[j] - 0.5 * hold * rate[j]
                here, speed = bias[:, 6 + j], 0.5 * (velocity[6 + j] + bias[BEFORE, 6 + j])
                more, faster = acted - here[EXTRA], speed - here[RATE]
                if not low[j] + NEAR <= q[7 + j] <= high[j] - NEAR:  # the end can only push back
                    if (more > 0.0) == (q[7 + j] > high[j] - NEAR):
                        here[EXTRA] += min(tick / END_TIME, 1.0) * more
                    continue
                here[COUNT] += 1.0
                gain = max(tick / BIAS_TIME, 1.0 / here[COUNT])
                here[EXTRA] += gain * more
                here[RATE] += gain * faster
                here[SPREAD] += gain * ((1.0 - gain) * faster * faster - here[SPREAD])
                here[SHARED] += gain * ((1.0 - gain) * more * faster - here[SHARED])
    bias[BEFORE] = velocity
    moment, square = scale.unit[0] * scale.unit[1], gravity / scale.unit[1]
    most = MOST * moment / math.sqrt(square)
    for j in range(joints):
        here = bias[:, 6 + j]
        damping = clip(here[SHARED] / (here[SPREAD] + SLOW * square), -most, 0.0)
        constant = clip(here[EXTRA] - damping * here[RATE], -LARGEST * limit[j], LARGEST * limit[j])
        missing[j] = constant if abs(constant) > TOLERATED * moment else 0.0
