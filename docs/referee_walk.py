"""The walk of a motion that the referee of refused gaits found, see referee.py."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from scipy.interpolate import CubicSpline

from ampm.body.inverse_kinematics import InverseKinematics
from ampm.body.motion import Extreme, MotionReport, PeriodicPosture, WholeBodyMotion
from ampm.body.robot import Robot
from ampm.body.step_reference import step_reference
from ampm.geometry import Array
from ampm.parameters import RunParameters
from ampm.planner.support import plan_steps
from ampm.walk import WalkPlan

if TYPE_CHECKING:
    from referee import Motion, Problem

_FINE, _SHORT = 201, 1e-4  # instants of the grid; time of differences [s]


class Found:
    """A planner that walks a motion that was found.

    Args:
        problem: of the motion.
        motion: at the nodes.
    """

    def __init__(self, problem: Problem, motion: Motion) -> None:
        self.problem, self.found = problem, motion

    def run(self, steps: int) -> RunParameters:
        """The run with the choices of the motion."""
        problem, found = self.problem, self.found
        pitch = [np.arctan2(turn[0, 2], turn[2, 2]) for turn in problem.robot.trunk_rotations(found.q)]
        x = dict(zip(problem.space.names, found.x.tolist(), strict=True))
        run = problem.space.parameters({**problem.base, **x, "lean": float(np.mean(pitch))})
        return run.as_is().replace({"gait.steps": steps})

    def plan(self, run: RunParameters, robot: Robot) -> WalkPlan:
        """The plan of a run, with the motion as its posture; it begins in a state that meets the plan."""
        steps = plan_steps(run.gait, run.body.mass, run.foot, robot.description.sole)
        steps = steps.with_angular_momentum_offset(self.found.offset * robot.mass)
        motion = self.motion()
        start = InverseKinematics(robot, run).project(
            step_reference(steps, np.zeros(1)), 0, motion.q[0].copy(), motion.v[0].copy()
        )
        return WalkPlan.of(steps, posture=PeriodicPosture(motion, self.problem.robot, start))

    def motion(self) -> WholeBodyMotion:
        """The step on a fine grid: cubic splines through the nodes of five steps."""
        problem, found, model = self.problem, self.found, self.problem.model
        robot, times = problem.robot, problem.tasks(found.x).time
        time, q = [], []
        for step in range(-2, 3):
            side = found.q.copy() if step % 2 == 0 else robot.mirror_q(found.q)
            side[:, 0] += step * problem.way
            time.append(times[:-1] + step * times[-1])
            q.append(side)
        nodes = np.concatenate(q)
        turns = np.array([pin.log3(pin.Quaternion(place[3:7]).matrix()) for place in nodes])
        spline = CubicSpline(np.concatenate(time), np.hstack([nodes[:, :3], turns, nodes[:, 7:]]))

        def states(at: Array) -> tuple[Array, Array]:
            q, v = np.empty((len(at), robot.nq)), spline(at, 1)
            for row, value in enumerate(spline(at)):
                turn = pin.exp3(value[3:6])
                q[row] = np.concatenate([value[:3], pin.Quaternion(turn).coeffs(), value[6:]])
                v[row, :3], v[row, 3:6] = turn.T @ v[row, :3], pin.Jexp3(value[3:6]) @ v[row, 3:6]
            return q, v

        grid = np.linspace(0.0, times[-1], _FINE)
        (q, v), (before, after) = states(grid), (states(grid + shift)[1] for shift in (-_SHORT, _SHORT))
        momenta = [
            pin.computeCentroidalMomentum(model, problem.data, *at).angular[2]
            for at in zip(q, v, strict=True)
        ]
        turn, none = robot.trunk_rotations(q), Extreme(0.0)
        pitch = np.arctan2(turn[:, 0, 2], turn[:, 2, 2])
        report = MotionReport(found.offset * robot.mass, 0.0, float(pitch.mean()), (), none, none, none)
        step = grid, q, v, (after - before) / (2.0 * _SHORT), pitch, np.array(momenta)
        return WholeBodyMotion(robot.joint_names, *step, problem.way, 0.0, report)
