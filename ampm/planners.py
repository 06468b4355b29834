"""Planners: from a request to a complete walk."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ampm.body.feasibility import check_body, check_motion
from ampm.body.motion import PeriodicPosture, WholeBodyMotion
from ampm.body.motion_cache import known_motion
from ampm.body.robot import Robot
from ampm.exceptions import InputError
from ampm.parameters import RunParameters
from ampm.planner.support import StepPlan, plan_steps
from ampm.walk import Boundary, WalkPlan


@dataclass(frozen=True)
class WalkRequest:
    """Request to a planner.

    Attributes:
        run: parameters of gait, body, feet and controller.
        robot: the body.
        progress: called with a line of text now and then; None: no progress.
        cache: folder that keeps solved motions; None keeps nothing.
    """

    run: RunParameters
    robot: Robot
    progress: Callable[[str], None] | None = None
    cache: Path | None = None


@dataclass(frozen=True)
class PeriodicWalk(WalkPlan):
    """A walk of equal steps.

    Attributes:
        posture: the periodic step, mirrored from step to step.
    """

    posture: PeriodicPosture


def periodic_walk(steps: StepPlan, motion: WholeBodyMotion, robot: Robot) -> PeriodicWalk:
    """A plan of equal steps and its periodic motion as one plan."""
    return PeriodicWalk.of(steps, posture=PeriodicPosture(motion, robot))


class AmpmPeriodic:
    """The paper's planner: equal steps in closed form, and the periodic whole-body motion for them."""

    def plan(self, request: WalkRequest, begin: Boundary | None = None) -> PeriodicWalk:
        """Plan a walk.

        Args:
            request: run and body.
            begin: must be None: a periodic walk begins on its own motion.

        Raises:
            MathematicalRefusal: the closed form has no solution.
            BodilyRefusal: the body cannot walk it.
            InputError: a boundary was given, or the grid is too coarse for the posture's gains.
        """
        if begin is not None:
            raise InputError("a periodic walk begins on its own motion; plan it without a boundary.")
        run, robot = request.run, request.robot
        steps = plan_steps(run.gait, run.body.mass, run.foot, robot.description.sole)
        check_body(steps, robot.description)
        motion = known_motion(steps, run, robot, request.cache)
        if motion is None:
            # Imported here: SciPy and the solver are loaded only where a motion is not known.
            from ampm.body.orbit import solve_motion

            motion = solve_motion(steps, run, robot, progress=request.progress, cache=request.cache)
        check_motion(motion.report, robot.description)
        return periodic_walk(steps, motion, robot)
