"""Planners: from a run and a body to a complete walk."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from ampm.body.feasibility import check_body
from ampm.body.motion import PeriodicPosture, WholeBodyMotion
from ampm.body.robot import Robot
from ampm.exceptions import BodilyRefusal, InputError, RefusedGait
from ampm.parameters import RunParameters
from ampm.planner.contacts import TIME_TOLERANCE, Footstep
from ampm.planner.footstep_walk import plan_footstep_walk, stops, with_feet
from ampm.planner.replan import LiveWalk
from ampm.planner.step_planners import STEP_PLANNERS
from ampm.planner.stride import plan_feet
from ampm.planner.support import StepPlan
from ampm.planner.table import closed_step, repeats, table_plan
from ampm.walk import State, Touch, WalkPlan


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

    Steps that repeat are walked with their periodic whole-body motion, others with a constant posture. A
    table that begins with a double support is walked from standing to standing, as over footsteps. From 200
    rows a second on, the walk is that of the plan that wrote the table, within 5 % of the errors.

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
        if plan.contacts.phases[0].stance == "both":
            return _walk_over([with_feet(plan, run, robot.description)], run, robot)[0]
        feet = plan_feet(plan.contacts, run.foot, robot.description.sole)
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


MEASURED_OFF = 0.01
"""Distance of the measured DCM from the plan's from which a walk over footsteps is planned again [m]."""


class FootstepPlanner:
    """The walk over the footsteps of a run, see :mod:`ampm.planner.footsteps`, with a constant posture.

    Args:
        changes: requests while walking, in their order: time [s], and footsteps from there on or None to
            stop, see :meth:`ampm.planner.replan.LiveWalk.changed`. Each is met by a new plan at its time.
        measured: plan again where a single support begins and the measured DCM is off its plan by more than
            :data:`MEASURED_OFF`: the walk goes on from the measured COM and its velocity, and the next
            footsteps move with them. At no other time does it plan: a push later in a support is answered
            when the next one begins.
    """

    def __init__(
        self, changes: Sequence[tuple[float, Sequence[Footstep] | None]] = (), *, measured: bool = False
    ) -> None:
        if changes and measured:
            raise InputError("a walk takes changes or goes on from what is measured; leave out one of them.")
        self.changes, self.measured = tuple(changes), measured
        requests = [f"{'stop' if ahead is None else 'changed'} at {at:g} s" for at, ahead in self.changes]
        self.name = ", ".join(["footsteps", *requests, *(["measured"] if measured else [])])
        self.replan_period = 0.0 if changes or measured else math.inf
        self._answers: list[tuple[float, WalkPlan]] = []

    def plan(self, run: RunParameters, robot: Robot) -> WalkPlan:
        """Plan the walk as it begins, and what meets the requests: they are refused before the walk.

        Raises:
            InputError: the footsteps are no walk.
            MathematicalRefusal: the gait has no closed form.
            BodilyRefusal: the body cannot walk them.
        """
        if self.replan_period == math.inf:
            return _walk_over([plan_footstep_walk(run, robot.description)], run, robot)[0]
        walks = [LiveWalk.of(run, robot.description)]
        for at, ahead in self.changes:
            walks.append(walks[-1].changed(at, ahead))
        first, *others = _walk_over([walk.steps for walk in walks], run, robot)
        self._answers = [(at, plan) for (at, _), plan in zip(self.changes, others, strict=True)]
        self._walk, self._robot, self._support = walks[0], robot, -1
        return first

    def replan(self, time: float, state: State, touch: Touch, plan: WalkPlan) -> WalkPlan | None:
        """The plan that meets the last request so far, or one from the measured COM."""
        if self.measured:
            return self._from_measured(time, state, plan)
        due = [answer for at, answer in self._answers if at <= time + TIME_TOLERANCE]
        return due[-1] if due else None

    def _from_measured(self, time: float, state: State, plan: WalkPlan) -> WalkPlan | None:
        """Plan again at the begin of a single support, if it is needed and there is such a walk."""
        contacts = self._walk.walk.contacts
        support = int(np.searchsorted(contacts.starts[1::2], time + TIME_TOLERANCE, side="right")) - 1
        ahead = contacts.footsteps[support + 2 :]
        if support == self._support or support < 0 or len(ahead) < 2:
            return None
        self._support = support
        model = self._robot.model
        data = model.createData()
        pin.centerOfMass(model, data, state.q, state.v)
        measured = np.stack([data.com[0][:2], data.vcom[0][:2]])
        sample = plan.sample([time])
        omega = math.sqrt(plan.gravity / plan.com_height)
        if np.linalg.norm(measured[0] + measured[1] / omega - sample.dcm[0]) < MEASURED_OFF:
            return None
        try:
            self._walk = self._walk.changed(time, ahead, measured)
        except (RefusedGait, InputError):
            return None
        return WalkPlan.of(self._walk.steps, posture=plan.posture)


def _walk_over(walks: Sequence[StepPlan], run: RunParameters, robot: Robot) -> list[WalkPlan]:
    """Walks over footsteps with constant postures, all with the same arms.

    Raises:
        BodilyRefusal: the body cannot walk one of them.
    """
    # Imported here, as the inverse kinematics is compiled.
    from ampm.body.constant_posture import ConstantPosture
    from ampm.body.walk_motion import check_walk

    for angle in (SPREAD_ARMS, 2.0 * SPREAD_ARMS):
        spread = run.replace({"body.arm_abduction": max(run.body.arm_abduction, angle)})
        postures = [ConstantPosture(steps, spread, robot, stops(steps.contacts)) for steps in walks]
        try:
            for steps, posture in zip(walks, postures, strict=True):
                check_walk(steps, posture, spread, robot)
            break
        except BodilyRefusal as refusal:  # hands pass thighs on wide steps if they are spread further
            if refusal.reason != "arm_collision" or angle > SPREAD_ARMS:
                raise
    return [WalkPlan.of(steps, posture=posture) for steps, posture in zip(walks, postures, strict=True)]
