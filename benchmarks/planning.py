"""Times of what is done once per gait: the plan, and the periodic whole-body motion."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ampm.body.inverse_kinematics import InverseKinematics
from ampm.body.motion import WholeBodyMotion
from ampm.body.orbit import solve_motion
from ampm.body.robot import Robot
from ampm.body.step_reference import StepReference, step_grid, step_reference
from ampm.parameters import RunParameters
from ampm.planner.periodic import plan_gait
from ampm.planner.support import StepPlan, plan_steps
from benchmarks.clock import Statistics, least, repeat
from validation.trial.plan import Body

PLANS = 200
"""How often a plan is made."""

STEPS = 5
"""How often a step of the inverse kinematics is integrated."""


def time_plan(run: RunParameters, body: Body) -> tuple[Statistics, Statistics]:
    """Time of one plan: the closed form alone, and with the feet's motion [s]."""
    gait, mass, sole = run.gait, run.body.mass, body.model.description.sole
    return repeat(lambda: plan_gait(gait, mass), PLANS), repeat(
        lambda: plan_steps(gait, mass, run.foot, sole), PLANS
    )


def time_motion(run: RunParameters, robot: Robot, plan: StepPlan) -> tuple[WholeBodyMotion, Statistics]:
    """The periodic motion, and the time of the whole search for it, without a cache [s]."""
    start = time.perf_counter()
    motion = solve_motion(plan, run, robot, cache=None)
    return motion, Statistics.of([time.perf_counter() - start])


def time_ik_tick(run: RunParameters, robot: Robot, plan: StepPlan, motion: WholeBodyMotion) -> Statistics:
    """Time of one tick: drift correction, QP and integration over one interval of the grid [s]."""
    kinematics = _TimedKinematics(robot, run)
    reference = step_reference(plan, step_grid(plan, run.solver.ik_time_step))
    return Statistics.of(least([kinematics.ticks(reference, motion) for _ in range(STEPS)]))


class _TimedKinematics(InverseKinematics):
    """Notes when each tick reaches its QP; from one to the next is a whole tick."""

    def __init__(self, robot: Robot, run: RunParameters) -> None:
        super().__init__(robot, run)
        self._times: list[float] = []

    def _accelerate(self, *arguments: Any, **named: Any) -> NDArray[np.float64]:
        self._times.append(time.perf_counter())
        return super()._accelerate(*arguments, **named)

    def ticks(self, reference: StepReference, motion: WholeBodyMotion) -> NDArray[np.float64]:
        """Integrate one step from the periodic motion's start; time of every tick [s]."""
        self._times.clear()
        self.integrate(reference, motion.q[0], motion.v[0], motion.report.angular_momentum_y_offset)
        return np.diff(self._times)
