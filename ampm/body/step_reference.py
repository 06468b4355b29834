"""Tasks of a body over a plan, on the grid of one step or at any times."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ampm.body.robot import MOMENTUM, TASK_ROWS
from ampm.geometry import Array, rotations
from ampm.planner.feet import foot_rotation, foot_turning
from ampm.planner.support import StepPlan


class StepReference(NamedTuple):
    """Tasks at n + 1 times of a plan; F = 2 soles, T toe joints, R = 18 + T rows."""

    time: Array  # shape (n+1,) [s]
    position: Array  # com, left sole, right sole, shape (n+1, 1 + F, 3) [m]
    rotation: Array  # of the soles to world, shape (n+1, F, 3, 3)
    toe: Array  # angles of the toe joints, shape (n+1, 2) [rad]
    velocity: Array  # of the tasks in the order of their rows, shape (n+1, R)
    acceleration: Array  # of the same rows, shape (n+1, R)

    def easier(self, drop: float, share: float) -> "StepReference":
        """The step with the COM lower by ``drop`` [m], for the legs, and less L, for trunk and arms."""
        position, velocity = self.position.copy(), self.velocity.copy()
        acceleration = self.acceleration.copy()
        position[:, 0, 2] -= drop
        velocity[:, MOMENTUM] *= share
        acceleration[:, MOMENTUM] *= share
        return self._replace(position=position, velocity=velocity, acceleration=acceleration)

    def with_angular_momentum(self, constant: Array | tuple[float, float]) -> "StepReference":
        """The same step with constants more of L_x and L_y over the mass, shape (2,) [m^2/s]."""
        velocity = self.velocity.copy()
        velocity[:, MOMENTUM] += constant
        return self._replace(velocity=velocity)

    def turned(self, heading: ArrayLike) -> "StepReference":
        """The same tasks in axes that are turned about the vertical by one or n + 1 angles [rad]."""
        angle = np.reshape(heading, -1)
        turn = np.zeros((len(angle), 3, 3))
        turn[:, :2, :2], turn[:, 2, 2] = rotations(angle), 1.0
        velocity, acceleration = self.velocity.copy(), self.acceleration.copy()
        for rows in (velocity, acceleration):
            vectors = rows[:, :TASK_ROWS].reshape(len(rows), -1, 3)
            rows[:, :TASK_ROWS] = (vectors @ turn).reshape(len(rows), -1)
        return self._replace(
            position=self.position @ turn,
            rotation=turn.swapaxes(1, 2)[:, None] @ self.rotation,
            velocity=velocity,
            acceleration=acceleration,
        )

    def part(self, rows: slice) -> "StepReference":
        """Some of the times."""
        return StepReference._make(values[rows] for values in self)


def step_grid(plan: StepPlan, largest_step: float) -> Array:
    """Times of the first step, uniform within each phase, with a node on every switch [s]."""
    durations = plan.constants.single_support_duration, plan.constants.double_support_duration
    return phase_grid(plan, *(max(2, int(np.ceil(duration / largest_step))) for duration in durations))


def phase_grid(plan: StepPlan, n1: int, n2: int) -> Array:
    """Times of the first step with n1 intervals in single and n2 in double support [s]."""
    single, double = plan.constants.single_support_duration, plan.constants.double_support_duration
    return np.concatenate([single * np.arange(n1) / n1, single + double * np.arange(n2 + 1) / n2])


def step_reference(plan: StepPlan, time: Array) -> StepReference:
    """Evaluate a plan and its feet as task references, without the plan's constant of L_y."""
    feet, mass = plan.feet.sample(time), plan.mass
    sample = plan.with_angular_momentum_offset(0.0).sample(time)
    n, has_toes = len(time), plan.feet.sole.has_toes
    velocity, acceleration = np.zeros((2, n, TASK_ROWS + 2 * has_toes))
    velocity[:, 0:3], acceleration[:, 0:3] = sample.com_velocity, sample.com_acceleration
    velocity[:, MOMENTUM], acceleration[:, MOMENTUM] = sample.angular_momentum / mass, sample.moment / mass
    for foot, motion in enumerate(feet):
        row = 6 + 6 * foot
        velocity[:, row : row + 3], acceleration[:, row : row + 3] = motion.velocity, motion.acceleration
        velocity[:, row + 3 : row + 6], acceleration[:, row + 3 : row + 6] = foot_turning(motion)
        if has_toes:
            row = TASK_ROWS + foot
            velocity[:, row], acceleration[:, row] = motion.toe_velocity, motion.toe_acceleration
    return StepReference(
        time=np.array(time),
        position=np.stack([sample.com, *(foot.position for foot in feet)], axis=1),
        rotation=np.stack([foot_rotation(foot.heading, foot.pitch, foot.roll) for foot in feet], axis=1),
        toe=np.stack([foot.toe for foot in feet], axis=1),
        velocity=velocity,
        acceleration=acceleration,
    )
