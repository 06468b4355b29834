"""Planners: from a run and a body to a complete walk.

What needs the inverse kinematics, which is compiled, is imported where it is needed.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ampm.body.constant_posture import ConstantPosture
from ampm.body.feasibility import check_ankles, check_body
from ampm.body.limits import AT_MOST, Limit, check
from ampm.body.motion import PeriodicPosture, RetimedPosture
from ampm.body.robot import Robot
from ampm.exceptions import BodilyRefusal, InputError, RefusedGait
from ampm.geometry import rotations
from ampm.parameters import GRAVITY, NO_PLAN, RunParameters
from ampm.planner import routes
from ampm.planner.centroidal import CentroidalPhase, CentroidalPlan, PlanConstants
from ampm.planner.contacts import TIME_TOLERANCE, Contacts, Footstep
from ampm.planner.feet import FeetPlan, FootPath
from ampm.planner.footstep_walk import plan_footstep_walk, stops, with_feet
from ampm.planner.sampled import SampledLaw, sampled_plan
from ampm.planner.step_planners import STEP_PLANNERS
from ampm.planner.stride import joined
from ampm.planner.support import StepPlan
from ampm.planner.table import closed_step, repeats, table_motion
from ampm.section import unknown
from ampm.walk import WalkPlan


class PeriodicPlanner:
    """Equal steps, and the periodic whole-body motion for them.

    Args:
        name: makes COM and feet, see :data:`ampm.planner.step_planners.STEP_PLANNERS`.

    Raises :class:`InputError` for another name.
    """

    tunes = True
    plans_footsteps = False

    def __init__(self, name: str = "ampm") -> None:
        if name not in STEP_PLANNERS:
            raise unknown(name, STEP_PLANNERS, "planner")
        self.name, self.steps = name, STEP_PLANNERS[name]

    def plan(self, run: RunParameters, robot: Robot) -> WalkPlan:
        """Plan a walk.

        Raises:
            MathematicalRefusal: the closed form has no solution.
            BodilyRefusal: the body cannot walk it.
            InputError: the grid is too coarse for the posture's gains.
        """
        level = run.gait.model_copy(update={"cross_slope": 0.0})
        steps, repeated = (
            self.steps(gait, run.body.mass, run.foot, robot.description.sole) for gait in (run.gait, level)
        )
        return periodic_walk(steps, repeated, run, robot)


def periodic_walk(steps: StepPlan, repeated: StepPlan, run: RunParameters, robot: Robot) -> WalkPlan:
    """A plan of equal steps, with the periodic motion of those that it repeats without a slope across.

    Raises BodilyRefusal and InputError as :meth:`PeriodicPlanner.plan`.
    """
    check_ankles(steps, robot.description)
    check_body(repeated, robot.description)
    from ampm.body.orbit import solve_motion, start_across

    posture = PeriodicPosture(solve_motion(repeated, run, robot), robot)
    steps = steps.with_angular_momentum_offset(posture.motion.report.angular_momentum_y_offset)
    if run.gait.cross_slope:
        posture = replace(posture, start=start_across(steps, posture, run))
    return WalkPlan.of(steps, posture=posture)


_WAYS_OUT = {
    "soles_overlap": "move the footsteps of both feet apart",
    "zmp_leaves_sole": "keep the ZMP along x nearer to the footstep of the foot that stands",
    "heel_rises_before_zmp_reaches_ball": "move the ZMP farther ahead of the footstep of the foot that "
    "stands, lower foot.heel_rise_lead, or take foot.schedule = flat",
    "leg_too_short": "lower the COM (its z, or without it gait.com_height), or take shorter steps",
    "sole_under_floor": "raise foot.swing_height or foot.heel_strike_angle, or take foot.schedule = flat",
    "zmp_leaves_support": "keep the ZMP in the soles that stand",
}
"""Ways out by the reason of a refusal, for plans of samples; how the feet swing is the gait's."""


def make_plan(
    run: RunParameters,
    robot: Robot,
    *,
    times: ArrayLike,
    com: ArrayLike,
    contacts: Contacts,
    zmp: ArrayLike | None = None,
    com_velocity: ArrayLike | None = None,
    com_acceleration: ArrayLike | None = None,
    moment: ArrayLike | None = None,
    angular_momentum: ArrayLike | None = None,
    after: WalkPlan | None = None,
) -> WalkPlan:
    """A complete plan from samples of the COM and footsteps: the first one, or one made while walking.

    The feet swing as the gait says. In a first plan, steps that repeat get their periodic whole-body motion,
    others a constant posture. A plan made ``after`` another one begins in any state of the COM; its feet go
    on from where they are, and the other plan's posture goes on with the phases of the new contacts.

    What is left out of ZMP, acceleration and moment follows from the others by Newton's law; the moment is 0
    where two are left out, so that the force passes through the COM. If all are given, all remain.
    Between samples the COM is cubic and the rest linear; a jump is two samples some microseconds apart.
    All arrays are copied.

    Args:
        run: parameters of body, gait and feet.
        robot: the body.
        times: ascending to the end of the contacts, at 100 a second or more, shape (N,) [s]. A first plan
            begins at 0, a later one now, on the walk's clock.
        com: in world; without z in the height of ``after`` or the gait over the floor; over a slope z
            may only follow it. Shape (N, 2) or (N, 3) [m].
        contacts: of the whole walk, what has passed included, see :meth:`ampm.Contacts.in_turn`.
        zmp: on the floor. Over footsteps of different heights, on the level plane of the standing foot, in
            double support between both by their shares of the load. Shape (N, 2) [m].
        com_velocity: by default from differences of ``com``, shape (N, 2) or (N, 3) [m/s].
        com_acceleration: shape (N, 2) [m/s^2]; with shape (N, 3) its z column belongs to a height that
            varies, else it follows by differences.
        moment: of the ground force about the COM, (M_x, M_y), shape (N, 2) [N m].
        angular_momentum: about the COM at the first time, (L_x, L_y); by default that of ``after``, or 0. A
            first plan of steps that repeat gets the one that repeats [N m s].
        after: the plan in force.

    Raises:
        InputError: arrays do not fit each other, end before the contacts, or contradict Newton's law by more
            than 0.2 mm of ZMP; or what has passed is changed.
        BodilyRefusal: the body cannot walk it.
    """
    if not isinstance(contacts, Contacts):
        raise InputError(f"contacts are a {type(contacts).__name__}; give ampm.Contacts.in_turn(...).")
    if not isinstance(after, WalkPlan | None):
        raise InputError(f"after is a {type(after).__name__}; give the WalkPlan in force, or leave it out.")
    contacts = replace(contacts, slope=run.gait.slopes)
    bare = CentroidalPlan(run.body.mass, GRAVITY, run.gait.com_height, 1.0, contacts, (), PlanConstants())
    plan = sampled_plan(
        replace(after, contacts=contacts) if after else bare,
        times,
        com=com,
        zmp=zmp,
        com_velocity=com_velocity,
        com_acceleration=com_acceleration,
        moment=moment,
        angular_momentum=angular_momentum,
    )
    try:
        return _next_walk(after, plan, run, robot) if after else _first_walk(plan, run, robot)
    except BodilyRefusal as error:
        error.way_out = _WAYS_OUT.get(error.reason, "change COM, ZMP or footsteps")
        raise


def _first_walk(plan: CentroidalPlan, run: RunParameters, robot: Robot) -> WalkPlan:
    """A plan of samples with feet, and a posture that its steps allow."""
    left, right = plan.contacts.placements[0, :, :2]
    if (left - right) @ rotations(plan.contacts.headings[:1])[0, :, 1] < 0.0:
        raise InputError("the left foot is to the right of the right one; exchange them, or the sign of y.")
    steps = with_feet(plan, run, robot.description)
    if plan.contacts.phases[0].stance == "both":
        return _walk_over(steps, run, robot)
    along = replace(plan, contacts=replace(plan.contacts, slope=(run.gait.slope, 0.0)))
    if repeats(along):
        closed = closed_step(with_feet(along, run, robot.description))
        momentum = closed.phases[0].angular_momentum
        steps = replace(steps, phases=(steps.phases[0]._replace(angular_momentum=momentum),))
        return periodic_walk(steps, closed, run, robot)
    check_ankles(steps, robot.description)
    check_body(steps, robot.description, phases=None)
    return WalkPlan.of(steps, posture=ConstantPosture(steps, run, robot))


def _next_walk(after: WalkPlan, plan: CentroidalPlan, run: RunParameters, robot: Robot) -> WalkPlan:
    """A plan of samples: feet, which roll by the ZMP walked before too, and posture go on from before."""
    now, new, old = plan.phases[0].start, plan.contacts, after.contacts
    passed, planned = (int(np.searchsorted(one.starts, now + TIME_TOLERANCE)) for one in (new, old))
    if passed != planned or not np.array_equal(new.stance_codes[:passed], old.stance_codes[:passed]):
        raise InputError(f"the contacts up to {now:g} s differ from those of the plan in force; keep them.")
    landed = min([*new.starts[passed:][new.kind_codes[passed:] == 1], plan.duration])
    walked, before = [phase for phase in after.phases if phase.start < now], after.feet
    feet = with_feet(replace(plan, phases=(*walked, *plan.phases)), run, robot.description).feet
    left, right = joined(before.left, feet.left, now, landed), joined(before.right, feet.right, now, landed)
    posture, ahead = after.posture, slice(passed, 1 + min(len(new.starts), len(old.starts)))
    if not np.array_equal(new.switches[ahead], old.switches[ahead]):
        posture = RetimedPosture(posture, *(np.append(now, one.switches[ahead]) for one in (new, old)))
    return WalkPlan.of(plan, feet=replace(feet, left=left, right=right), posture=posture)


class TablePlanner:
    """COM and ZMP of a table on its footsteps, see :mod:`ampm.planner.table`, by :func:`make_plan`.

    A table that begins with a double support is walked from standing to standing, as over footsteps. With
    at least 200 rows a second, errors are within 5 % of those of the plan that wrote the table.

    Args:
        table: columns by name, shape (N,) each.
        name: for reports.

    Raises:
        InputError: the table is the name of a file.
    """

    plans_footsteps = False
    gait_keys = ("gait.com_height", "gait.slope", "gait.cross_slope")

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
        return make_plan(run, robot, **table_motion(self.table))


class StandingPlanner:
    """A body that stands, upright on both feet, for a walk without a plan (``gait.planner = none``).

    Args:
        com_height: of the COM [m]; 0: lower than with straight legs by 3 % of the height of the hips.
    """

    plans_footsteps = False
    gait_keys = ()
    name = NO_PLAN

    def __init__(self, com_height: float = 0.0) -> None:
        self.com_height = com_height

    def plan(self, run: RunParameters, robot: Robot) -> WalkPlan:
        """Stand for the duration of the command, the COM over the middle of the feet.

        Raises:
            InputError: the height is below 0.
            BodilyRefusal: the body cannot stand.
        """
        if not self.com_height >= 0.0:
            raise InputError(f"planner.options.com_height = {self.com_height} must be 0 m or more; raise it.")
        from ampm.body.inverse_kinematics import InverseKinematics

        q, duration, sole = pin.neutral(robot.model), run.command.duration, robot.description.sole
        q[7:] = InverseKinematics(robot, run).rest
        q[robot.knee_joints + 1] = robot.straight_knees
        straight = robot.jacobian(q)
        height = straight.com[2] - straight.sole[:, 2].min() - 0.03 * robot.description.hip_height
        half = 0.5 * float(straight.sole[0, 1] - straight.sole[1, 1])
        left, right = Footstep("left", (0.0, half, 0.0)), Footstep("right", (0.0, -half, 0.0))
        still = SampledLaw(np.array([0.0, duration]), *np.zeros((5, 2)))
        steps = StepPlan(
            mass=robot.mass,
            gravity=robot.gravity,
            com_height=float(self.com_height or height),
            switching_velocity=0.0,
            contacts=Contacts((left, right), np.array([0.0, duration])),
            phases=(CentroidalPhase(0.0, duration, (0.0, 0.0), still, still, (0.0, 0.0)),),
            constants=PlanConstants(),
            feet=FeetPlan(sole, FootPath.still(sole, left), FootPath.still(sole, right), duration),
        )
        try:
            posture = ConstantPosture(steps, run, robot, [(0.0, math.inf)])
        except BodilyRefusal as refusal:
            refusal.way_out = "lower planner.options.com_height, or leave it out"
            raise
        beyond = np.maximum(robot.lower - posture.q[7:], posture.q[7:] - robot.upper)
        what = f"at this height the angle of {robot.joint_names[beyond.argmax()]} beyond its range"
        less = "raise planner.options.com_height, or leave it out"
        check([(Limit(what, "rad", 0.0, AT_MOST, "joint_limits", less), float(beyond.max()))])
        return WalkPlan.of(steps, posture=posture, command=run.command)


SPREAD_ARMS = 0.25
"""Least abduction of the arms over footsteps, for thighs that swing sideways [rad]."""


class FootstepPlanner:
    """The walk over the footsteps of a run, see :mod:`ampm.planner.footsteps`, with a constant posture."""

    name = "footsteps"

    def plan(self, run: RunParameters, robot: Robot) -> WalkPlan:
        """Plan the walk.

        Raises:
            InputError: the footsteps are not a walk.
            MathematicalRefusal: the gait has no closed form.
            BodilyRefusal: the body cannot walk them; with a share of them that it can.
        """

        def plan(run: RunParameters) -> WalkPlan:
            return _walk_over(plan_footstep_walk(run, robot.description), run, robot)

        try:
            return plan(run)
        except RefusedGait as refusal:
            if less := routes.easier(run, plan):
                known = [refusal.way_out] if refusal.way_out else []
                refusal.way_out = "; ".join([*known, f"{less} (tried and accepted)"])
            raise


def _walk_over(steps: StepPlan, run: RunParameters, robot: Robot) -> WalkPlan:
    """A walk from rest to rest with a constant posture; BodilyRefusal if the body cannot walk it."""
    from ampm.body.walk_motion import check_walk

    for angle in (SPREAD_ARMS, 2.0 * SPREAD_ARMS):
        spread = run.replace({"body.arm_abduction": max(run.body.arm_abduction, angle)})
        posture = ConstantPosture(steps, spread, robot, stops(steps.contacts))
        try:
            check_walk(steps, posture, spread, robot)
            break
        except BodilyRefusal as refusal:  # hands pass thighs on wide steps if they are spread further
            if refusal.reason != "arm_collision" or angle > SPREAD_ARMS or not robot.description.spread:
                raise
    return WalkPlan.of(steps, posture=posture)
