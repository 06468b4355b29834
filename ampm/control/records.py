"""What a control tick keeps of feet, lines of sole points, and points: entries of structured arrays."""

from typing import Any

import numpy as np

from ampm.body.rigid_body import frames_of
from ampm.body.robot import Robot
from ampm.compiled import records
from ampm.parameters import ControllerParameters

HEEL, BALL, TIP = 0, 1, 2
"""Lines of a foot's points."""

PHI, CHANGE = range(2)
"""Rows of ``phi``, shape (2, U): forces of the last tick [m g], and their change from the tick before."""

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


def gains_of(gains: ControllerParameters) -> Any:
    """The gains as one entry; its fields are the numbers among the parameters."""
    numbers = {name: value for name, value in gains if isinstance(value, float)}
    entry = records(1, [(name, np.float64) for name in numbers])
    for name, value in numbers.items():
        entry[name] = value
    return entry
