"""COM, momentum, ground force and ZMP of the whole-body motion, and its distance from the plan.

The motion has no contact forces. What the ground would have to give follows from its own momentum rates, so
its ZMP is no copy of the plan's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ampm.body.robot import Robot
from ampm.planner.support import StepPlan
from ampm.walk import PostureState

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Centroidal:
    """Centre of mass and momentum of a body's motion, at n times.

    Attributes:
        com: shape (n, 3) [m].
        acceleration: of the COM, shape (n, 3) [m/s²].
        force: that the ground has to give, shape (n, 3) [N].
        zmp: on the floor z = 0, shape (n, 2) [m].
        angular_momentum: about the COM, shape (n, 3) [N m s].
    """

    com: Array
    acceleration: Array
    force: Array
    zmp: Array
    angular_momentum: Array


def of_motion(sample: PostureState, robot: Robot, plan: StepPlan) -> Centroidal:
    """Evaluate a motion.

    Args:
        sample: of the whole-body motion.
        robot: its body.
        plan: for mass and gravity.
    """
    model, data = robot.model, robot.model.createData()
    com, rate, momentum, turning = (np.empty((len(sample.q), 3)) for _ in range(4))
    for row, (q, v, a) in enumerate(zip(sample.q, sample.v, sample.acceleration, strict=True)):
        pin.computeCentroidalMomentumTimeVariation(model, data, q, v, a)
        com[row], momentum[row] = data.com[0], data.hg.angular
        rate[row], turning[row] = data.dhg.linear, data.dhg.angular
    force = rate + np.array([0.0, 0.0, plan.mass * plan.gravity])
    # About the ZMP the ground force has no horizontal moment.
    zmp = com[:, :2] - com[:, 2:] * force[:, :2] / force[:, 2:]
    zmp += np.column_stack([-turning[:, 1], turning[:, 0]]) / force[:, 2:]
    return Centroidal(com, rate / plan.mass, force, zmp, momentum)


@dataclass(frozen=True)
class DeviationFromPlan:
    """Distance of one quantity from the plan over a stride.

    Attributes:
        motion: of the whole-body motion, shape (n, d).
        simulation: shape (strides, n, d).
    """

    motion: Array
    simulation: Array

    def component(self, index: int, rows: slice | NDArray[np.bool_] = np.s_[:]) -> tuple[Array, Array]:
        """One component of both, shapes (n,) and (strides, n)."""
        return self.motion[rows, index], self.simulation[:, rows, index]


def agreement(error: Array, unit: str) -> dict[str, float | str]:
    """RMSE and largest value of an error, for the figures' numbers."""
    rmse, maximum = float(np.sqrt(np.mean(error**2))), float(np.abs(error).max())
    return {"rmse": rmse, "maximum": maximum, "unit": unit}


def peak(items: Mapping[str, tuple[Array, Array]], unit: str) -> dict[str, dict[str, float | str]]:
    """:func:`agreement` of motion and of simulation with the plan."""
    return {
        f"{name}: {who} less plan": agreement(values, unit)
        for name, both in items.items()
        for who, values in zip(("motion", "simulation"), both, strict=True)
    }
