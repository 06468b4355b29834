"""One axis of the COM as samples, and the constants of a plan that has no closed form."""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ampm.planner.centroidal import CentroidalPlan, PlanConstants
from ampm.planner.pendulum import LawState

Array = NDArray[np.float64]

NO_CONSTANTS = PlanConstants(**dict.fromkeys((item.name for item in fields(PlanConstants)), 0.0))
"""Of a plan whose constants are still to be read from its motion, see :func:`plan_constants`."""


@dataclass(frozen=True)
class SampledLaw:
    """One axis of a centroidal motion as samples: position and velocity cubic in between, the rest linear.

    Attributes:
        time: ascending, shape (N,) [s].
        position: of the COM, shape (N,) [m].
        velocity: shape (N,) [m/s].
        acceleration: shape (N,) [m/s^2].
        zmp: shape (N,) [m].
        moment_arm: distance by which the force line misses the COM, shape (N,) [m].
    """

    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    zmp: Array
    moment_arm: Array

    def evaluate(self, time: Any) -> LawState:
        """State at times since the first sample [s]; every field has the shape of the times."""
        time = np.asarray(time, dtype=np.float64) + self.time[0]
        i = np.clip(np.searchsorted(self.time, time, side="right") - 1, 0, len(self.time) - 2)
        h = self.time[i + 1] - self.time[i]
        u = (time - self.time[i]) / h

        def linear(values: Array) -> Array:
            return values[i] + u * (values[i + 1] - values[i])

        rise = self.position[i + 1] - self.position[i]
        left, right = h * self.velocity[i] - rise, rise - h * self.velocity[i + 1]
        arm = self.moment_arm
        whole = 0.5 * (arm[1:] + arm[:-1]) * np.diff(self.time)
        before = np.concatenate([[0.0], np.cumsum(whole)])[i]
        mixed = (1.0 - u) * left + u * right
        return LawState(
            position=self.position[i] + u * (rise + (1.0 - u) * mixed),
            velocity=(rise + (1.0 - 2.0 * u) * mixed + u * (1.0 - u) * (right - left)) / h,
            acceleration=linear(self.acceleration),
            zmp=linear(self.zmp),
            moment_arm=linear(arm),
            moment_arm_integral=before + 0.5 * u * h * (arm[i] + linear(arm)),
        )


def plan_constants(plan: CentroidalPlan) -> PlanConstants:
    """Constants of the first single support of any plan, and the double support after it."""
    contacts = plan.contacts
    index = next(k for k, phase in enumerate(contacts.phases) if phase.kind == "single_support")
    single, double = contacts.phases[index : index + 2]
    sample = plan.sample([single.start, double.start, double.start + double.duration])
    com, zmp, arm = (
        np.diff(values) for values in (sample.com[:, 0], sample.zmp[:, 0], -sample.moment[:, 1] / plan.weight)
    )
    lateral, speed = sample.com[1, 1], sample.com_velocity[1, 1]
    here, there = contacts.placements[index, :, 1]
    stance = here if single.right is None else there
    with np.errstate(divide="ignore", invalid="ignore"):
        return PlanConstants(
            l_s=float(0.5 * com[0]),
            l_d=float(0.5 * com[1]),
            inverse_a_s=float(zmp[0] / com[0]),
            a_d=float(com[1] / zmp[1]),
            c_d=float(1.0 + arm[1] / com[1]),
            single_support_duration=single.duration,
            double_support_duration=double.duration,
            s=float(abs(lateral - stance)),
            beta=float(abs(lateral - 0.5 * (here + there))),
            lateral_switching_velocity=float(abs(speed)),
            mean_velocity=float(com.sum() / (single.duration + double.duration)),
            angular_momentum_y_offset=0.0,
        )
