"""What the stabiliser that steps has planned for a tick before it senses the state of this tick.

It is the plan of the phase, at the phase's own clock and moved with the feet that stand, and the swing foot
on its way to the step that was chosen last. Nothing in it follows the COM: the reference that the controller
tracks (:func:`ampm.stepping.walker.advance`) lets the COM's error fade and gives another acceleration.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from ampm.planner.contacts import Phase
from ampm.stepping.stepper import Stepper
from ampm.vectors import Array


class PlannedTick(NamedTuple):
    """The plan then valid at one tick; with a leading axis at several.

    Attributes:
        time: on the walk's clock [s].
        stance: 0 left, 1 right, 2 both.
        com: shape (3,) [m].
        com_velocity: shape (3,) [m/s].
        com_acceleration: shape (3,) [m/s^2].
        zmp: shape (2,) [m].
        floor: height of the support [m].
        moment: about the COM, shape (2,) [N m].
        angular_momentum: about the COM, shape (3,) [N m s].
        feet: reference points of both soles, shape (2, 3) [m].
        placements: of both feet, the next one of a foot that swings, shape (2, 2) [m].
        heading: of the foot that stands, or leaves [rad].
    """

    time: Any
    stance: Any
    com: Array
    com_velocity: Array
    com_acceleration: Array
    zmp: Array
    floor: Any
    moment: Array
    angular_momentum: Array
    feet: Array
    placements: Array
    heading: Any


def planned_tick(s: Stepper, time: float, phase: Phase, following: Phase, moved: Array) -> PlannedTick:
    """The plan of a tick, from what the last tick left.

    Args:
        s: the stepper of a walk off its plan.
        time: of the tick [s].
        phase: of the plan.
        following: the one after it.
        moved: how far the phase is from its place in the plan, before any shift, shape (2,) [m].
    """
    w, table, last = s.walker[0], s.table, len(s.curves.r) - 1
    done = min(max(w["clock"] / w["duration"], 0.0), 1.0)
    i = min(int(done * last), last - 1)
    part = done * last - i

    def at(rows: Array) -> Array:
        return np.asarray((1.0 - part) * rows[i] + part * rows[i + 1])

    single, stance, rate = bool(w["single"]), int(w["stance"]), float(w["rate"])
    old, new = w["shift"][stance], w["shift"][1 - stance]
    share, speed = (0.0, 0.0) if single else (done, rate / float(w["duration"]))
    shift = old + share * (new - old)
    com, velocity, acceleration = at(table.com), rate * at(table.com_velocity), at(table.com_acceleration)
    com[:2] += shift[:2]
    velocity[:2] += speed * (new - old)[:2]
    com[2] += w["height"][0]
    velocity[2] += w["height"][1]
    feet = at(table.foot_position) + w["shift"]
    placements = np.empty((2, 2))
    for foot, step in enumerate((phase.left or following.left, phase.right or following.right)):
        place = at(table.foot_position)[foot, :2] - moved if step is None else step.position[:2]
        placements[foot] = moved + place + w["shift"][foot, :2]
    if single:
        feet[1 - stance] += w["swing"][0] - new
        placements[1 - stance] += old[:2] + w["step"] - new[:2]
    rotation = table.foot_rotation[i, stance]
    return PlannedTick(
        time=time,
        stance=stance if single else 2,
        com=com,
        com_velocity=velocity,
        com_acceleration=acceleration,
        zmp=at(s.curves.zmp) + shift[:2],
        floor=float(feet[stance, 2] if single else feet[:, 2].mean()),
        moment=rate * at(table.moment)[:2],
        angular_momentum=at(table.angular_momentum),
        feet=feet,
        placements=placements,
        heading=math.atan2(rotation[1, 0], rotation[0, 0]),
    )
