"""Planners: from a run and a body to a complete walk."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ampm.body.feasibility import check_body
from ampm.body.motion import PeriodicPosture, WholeBodyMotion
from ampm.body.robot import Robot
from ampm.exceptions import BodilyRefusal, InputError
from ampm.parameters import RunParameters
from ampm.planner.contacts import Footstep
from ampm.planner.footstep_walk import plan_footstep_walk, stops
from ampm.planner.replan import LiveWalk
from ampm.planner.step_planners import STEP_PLANNERS
from ampm.planner.stride import plan_feet
from ampm.planner.support import StepPlan
from ampm.planner.table import closed_step, repeats, table_plan
from ampm.walk import WalkPlan


class PeriodicPlanner:
    """Equal steps, and the periodic whole-body motion for them.

    Args:
        name: makes COM and feet, see :data:`ampm.planner.step_planners.STEP_PLANNERS`.
    """

    def __init__(self, name: str = "ampm") -> None:
        self.name, self.steps = name, STEP_PLANNERS[name]

    def plan(self, run: RunParameters, robot: Robot) -> WalkPlan:
        """Plan a walk.

        Raises:
            MathematicalRefusal: the closed form has no solution.
            BodilyRefusal: the body cannot walk it.
            InputError: the grid is too coarse for the posture's gains.
        """
        steps = self.steps(run.gait, run.body.mass, run.foot, robot.description.sole)
        return periodic_walk(steps, periodic_motion(steps, run, robot), robot)


def periodic_walk(steps: StepPlan, motion: WholeBodyMotion, robot: Robot) -> WalkPlan:
    """A plan of equal steps and its periodic motion as one plan."""
    steps = steps.with_angular_momentum_offset(motion.report.angular_momentum_y_offset)
    return WalkPlan.of(steps, posture=PeriodicPosture(motion, robot))


def periodic_motion(steps: StepPlan, run: RunParameters, robot: Robot) -> WholeBodyMotion:
    """Periodic whole-body motion of a plan's first step, checked.

    Raises:
        BodilyRefusal: the body cannot walk it.
        InputError: the grid is too coarse for the posture's gains.
    """
    check_body(steps, robot.description)
    # Imported here, as the inverse kinematics is compiled.
    from ampm.body.orbit import solve_motion

    return solve_motion(steps, run, robot)


_PLACES = "left_placement_x and right_placement_x"
_TABLE_WAYS_OUT = {
    "soles_overlap": "move left_placement_y and right_placement_y apart",
    "zmp_leaves_sole": f"keep zmp_x of the table nearer to {_PLACES} of the foot that stands",
    "heel_rises_before_zmp_reaches_ball": f"move zmp_x of the table farther ahead of {_PLACES} of the foot "
    "that stands, lower foot.heel_rise_lead, or take foot.schedule = flat",
    "leg_too_short": "lower com_z of the table (without this column gait.com_height), or take shorter steps "
    f"in {_PLACES}",
    "sole_under_floor": "raise foot.swing_height or foot.heel_strike_angle",
    "zmp_leaves_support": "keep zmp_x and zmp_y of the table in the soles that stand",
}
"""Ways out by the reason of a refusal; how the feet swing is the gait's."""
_RATE = 200.0  # rows a second of a table that is walked as the plan that wrote it


class TablePlanner:
    """COM and ZMP of a table on its footsteps, see :mod:`ampm.planner.table`; the feet swing as the gait's.

    Steps that repeat are walked with their periodic whole-body motion, others with a constant posture. From
    200 rows a second on, the walk is that of the plan that wrote the table, within 5 % of the errors.

    Args:
        table: columns by name, shape (N,) each.
        name: for reports.

    Raises:
        InputError: the table is the name of a file.
    """

    def __init__(self, table: Mapping[str, Any], name: str = "table") -> None:
        if isinstance(table, str | Path):
            raise InputError("TablePlanner takes columns, not a file; pass a file to val.walk(planner=).")
        self.table, self.name = table, name

    def plan(self, run: RunParameters, robot: Robot) -> WalkPlan:
        """Plan the walk of the table.

        Raises:
            InputError: the table makes no plan.
            BodilyRefusal: the body cannot walk it.
        """
        try:
            return self._plan(run, robot)
        except BodilyRefusal as error:
            error.way_out = _TABLE_WAYS_OUT.get(error.reason, "change the table's COM, ZMP or footsteps")
            rate = float(np.median(1.0 / np.diff(np.asarray(self.table["time"], dtype=float))))
            if rate < 0.99 * _RATE:
                error.way_out += f", or give the table {_RATE:g} rows a second instead of {rate:.3g}"
            raise

    def _plan(self, run: RunParameters, robot: Robot) -> WalkPlan:
        plan = table_plan(self.table, mass=run.body.mass, com_height=run.gait.com_height)
        lift_speed = plan.constants.l_s / plan.constants.single_support_duration
        feet = plan_feet(plan.contacts, run.foot, robot.description.sole, lift_speed)
        steps = StepPlan.of(plan, feet=feet)
        if repeats(steps):
            closed = closed_step(steps)
            momentum = closed.phases[0].angular_momentum
            steps = replace(steps, phases=(steps.phases[0]._replace(angular_momentum=momentum),))
            return periodic_walk(steps, periodic_motion(closed, run, robot), robot)
        # Imported here, as the inverse kinematics is compiled.
        from ampm.body.constant_posture import ConstantPosture

        check_body(steps, robot.description)
        return WalkPlan.of(steps, posture=ConstantPosture(steps, run, robot))


SPREAD_ARMS = 0.25
"""Least abduction of the arms over footsteps, for thighs that swing sideways [rad]."""


class FootstepPlanner:
    """The walk over the footsteps of a run, see :mod:`ampm.planner.footsteps`, with a constant posture.

    Args:
        changes: requests while walking, in their order: time [s], and footsteps from there on or None to
            stop, see :meth:`ampm.planner.replan.LiveWalk.changed`.
    """

    def __init__(self, changes: Sequence[tuple[float, Sequence[Footstep] | None]] = ()) -> None:
        self.changes = tuple(changes)
        requests = [f"{'stop' if ahead is None else 'changed'} at {at:g} s" for at, ahead in self.changes]
        self.name = ", ".join(["footsteps", *requests])

    def plan(self, run: RunParameters, robot: Robot) -> WalkPlan:
        """Plan the walk.

        Raises:
            InputError: the footsteps are no walk.
            MathematicalRefusal: the gait has no closed form.
            BodilyRefusal: the body cannot walk them.
        """
        # Imported here, as the inverse kinematics is compiled.
        from ampm.body.constant_posture import ConstantPosture
        from ampm.body.walk_motion import check_walk

        if self.changes:
            walk = LiveWalk.of(run, robot.description)
            for at, ahead in self.changes:
                walk = walk.changed(at, ahead)
            steps = walk.steps
        else:
            steps = plan_footstep_walk(run, robot.description)
        for angle in (SPREAD_ARMS, 2.0 * SPREAD_ARMS):
            spread = run.replace({"body.arm_abduction": max(run.body.arm_abduction, angle)})
            posture = ConstantPosture(steps, spread, robot, stops(steps.contacts))
            try:
                check_walk(steps, posture, spread, robot)
                break
            except BodilyRefusal as refusal:  # hands pass thighs on wide steps if they are spread further
                if refusal.reason != "arm_collision" or angle > SPREAD_ARMS:
                    raise
        return WalkPlan.of(steps, posture=posture)
