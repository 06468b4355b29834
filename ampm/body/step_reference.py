"""Tasks of a body over one step of a plan, on a grid of times."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ampm.body.robot import TASK_ROWS
from ampm.planner.feet import foot_rotation, foot_turning

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from ampm.geometry import Array
    from ampm.planner.support import StepPlan


@dataclass(frozen=True)
class StepReference:
    """Tasks at the n + 1 times of a step's grid.

    Attributes:
        time: shape (n+1,) [s], the first step of the plan.
        position: com, left sole, right sole, shape (n+1, 3, 3) [m].
        velocity: the task velocities in the order of the task rows, shape (n+1, R).
        acceleration: the same for accelerations, shape (n+1, R).
        pitch: pitch of left and right foot, shape (n+1, 2) [rad].
        heading: of left and right foot, shape (n+1, 2) [rad].
        toe: angles of left and right toe joint, shape (n+1, 2) [rad].
    """

    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    pitch: Array
    heading: Array
    toe: Array

    def __post_init__(self) -> None:
        for value in vars(self).values():
            value.setflags(write=False)

    @cached_property
    def rotation(self) -> Array:
        """Orientation of left and right sole, shape (n+1, 2, 3, 3)."""
        rotation = foot_rotation(self.heading, self.pitch)
        rotation.setflags(write=False)
        return rotation

    def eased(self, drop: float, share: float) -> StepReference:
        """The same step with the COM lower by ``drop`` [m] and only a ``share`` [1] of the angular momentum.

        It is easier for legs and trunk; feet and times are the same.
        """
        position, velocity = self.position.copy(), self.velocity.copy()
        acceleration = self.acceleration.copy()
        position[:, 0, 2] -= drop
        velocity[:, 3:6] *= share
        acceleration[:, 3:6] *= share
        return replace(self, position=position, velocity=velocity, acceleration=acceleration)

    def turned(self, heading: ArrayLike) -> StepReference:
        """The same tasks in axes that are turned about the vertical by one or n + 1 angles [rad]."""
        angle = np.reshape(heading, -1)
        back = np.zeros((len(angle), 3, 3))
        back[:, 0, 0] = back[:, 1, 1] = np.cos(angle)
        back[:, 1, 0] = np.sin(angle)
        back[:, 0, 1] = -back[:, 1, 0]
        back[:, 2, 2] = 1.0
        velocity, acceleration = self.velocity.copy(), self.acceleration.copy()
        for rows in (velocity, acceleration):
            vectors = rows[:, :TASK_ROWS].reshape(len(rows), -1, 3)
            rows[:, :TASK_ROWS] = (vectors @ back).reshape(len(rows), -1)
        feet = self.heading - angle[:, None]
        return replace(
            self,
            position=self.position @ back,
            velocity=velocity,
            acceleration=acceleration,
            heading=feet,
        )

    def part(self, rows: slice) -> StepReference:
        """Some of the times."""
        return StepReference(**{item.name: getattr(self, item.name)[rows] for item in fields(self)})


def step_grid(plan: StepPlan, largest_step: float) -> Array:
    """Times of the first step, uniform within each phase, with a node on every switch [s]."""
    single, double = plan.constants.single_support_duration, plan.constants.double_support_duration
    n1, n2 = (max(2, int(np.ceil(duration / largest_step))) for duration in (single, double))
    return phase_grid(plan, n1, n2)


def phase_grid(plan: StepPlan, n1: int, n2: int) -> Array:
    """Times of the first step with n1 intervals in single and n2 in double support [s]."""
    single, double = plan.constants.single_support_duration, plan.constants.double_support_duration
    return np.concatenate([single * np.arange(n1) / n1, single + double * np.arange(n2 + 1) / n2])


def step_reference(plan: StepPlan, time: Array) -> StepReference:
    """Evaluate a plan and its feet as task references, without the plan's constant of L_y."""
    feet, mass = plan.feet.sample(time), plan.mass
    sample = plan.with_angular_momentum_offset(0.0).sample(time)
    n, has_toes = len(time), plan.feet.sole.has_toes
    position, (velocity, acceleration) = np.zeros((n, 3, 3)), np.zeros((2, n, TASK_ROWS + 2 * has_toes))
    position[:, 0] = sample.com
    velocity[:, 0:3], acceleration[:, 0:3] = sample.com_velocity, sample.com_acceleration
    velocity[:, 3:5], acceleration[:, 3:5] = sample.angular_momentum / mass, sample.moment / mass
    for foot, motion in enumerate(feet):
        row = 6 + 6 * foot
        position[:, 1 + foot] = motion.position
        velocity[:, row : row + 3], acceleration[:, row : row + 3] = motion.velocity, motion.acceleration
        velocity[:, row + 3 : row + 6], acceleration[:, row + 3 : row + 6] = foot_turning(motion)
        if has_toes:
            row = TASK_ROWS + foot
            velocity[:, row], acceleration[:, row] = motion.toe_velocity, motion.toe_acceleration
    return StepReference(
        time=np.array(time),
        position=position,
        velocity=velocity,
        acceleration=acceleration,
        pitch=np.stack([f.pitch for f in feet], axis=1),
        heading=np.stack([f.heading for f in feet], axis=1),
        toe=np.stack([f.toe for f in feet], axis=1),
    )
