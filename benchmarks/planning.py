"""What is done once per gait: the plan, and the periodic whole-body motion."""

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
from ampm.planner.centroidal import CentroidalPlan
from ampm.planner.periodic import plan_gait
from ampm.planner.support import StepPlan, plan_steps
from benchmarks.clock import Statistics, least, repeat
from validation.trial.plan import Body

PLANS = 200
"""How often a plan is made."""

STEPS = 5
"""How often a step of the inverse kinematics is integrated."""


class PlanBenchmark:
    """Planning of one gait.

    Args:
        run: the gait.
        body: supplies the sole.
    """

    def __init__(self, run: RunParameters, body: Body) -> None:
        self.run, self.sole = run, body.model.description.sole

    def pure(self) -> CentroidalPlan:
        """The closed form alone."""
        return plan_gait(self.run.gait, self.run.body.mass)

    def with_feet(self) -> StepPlan:
        """The closed form and the feet's motion."""
        return plan_steps(self.run.gait, self.run.body.mass, self.run.foot, self.sole)

    def time_pure(self) -> Statistics:
        """Time of :meth:`pure` [s]."""
        return repeat(self.pure, PLANS)

    def time_with_feet(self) -> Statistics:
        """Time of :meth:`with_feet` [s]."""
        return repeat(self.with_feet, PLANS)


class MotionBenchmark:
    """The periodic motion of one gait, and a tick of the inverse kinematics within it.

    Args:
        run: posture and grid.
        robot: the body.
        plan: with feet.
    """

    def __init__(self, run: RunParameters, robot: Robot, plan: StepPlan) -> None:
        self.run, self.robot, self.plan = run, robot, plan
        self._motion: WholeBodyMotion | None = None

    @property
    def motion(self) -> WholeBodyMotion:
        """The periodic motion; solved by the first who asks."""
        if self._motion is None:
            self._motion = solve_motion(self.plan, self.run, self.robot, cache=None)
        return self._motion

    def time_orbit(self) -> Statistics:
        """Time of the whole search for the periodic motion, without a cache [s]."""
        start = time.perf_counter()
        self._motion = solve_motion(self.plan, self.run, self.robot, cache=None)
        return Statistics.of([time.perf_counter() - start])

    def time_tick(self) -> Statistics:
        """Time of one tick: drift correction, QP and integration over one interval of the grid [s]."""
        kinematics = _TimedKinematics(self.robot, self.run)
        reference = step_reference(self.plan, step_grid(self.plan, self.run.solver.ik_time_step))
        return Statistics.of(least([kinematics.ticks(reference, self.motion) for _ in range(STEPS)]))


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
