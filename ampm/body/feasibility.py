"""Refusals by the body: checks of plan and soles before anything is solved, and of the solved motion."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from ampm.body.limits import (
    AT_LEAST,
    AT_MOST,
    CLEARANCE,
    KNEE_MINIMUM,
    LEG_ALLOWANCE,
    ROLL_TOLERANCE,
    Limit,
    check,
)
from ampm.description import BodyDescription
from ampm.geometry import Array
from ampm.planner.closed_form import rounded_up
from ampm.planner.feet import HEEL, FootSample
from ampm.planner.support import StepPlan, margin_on

if TYPE_CHECKING:
    from ampm.body.motion import MotionReport
    from ampm.body.robot import Robot

FLOOR_TOLERANCE = 1e-6
"""Depth under the floor that rounding may give a planned sole point [m]."""
_ROUNDING = 1e-9  # of lengths [m]
RETURN_TOLERANCE = 1e-8
"""Largest difference of a motion's mirrored end from its start [rad, m, rad/s, m/s]."""

LESS = "bring gait.c_s and gait.c_y nearer to 1, lower gait.com_height or shorten gait.step_length"
"""Way out of what a whole body cannot do."""
_JOINT_WAYS_OUT = {
    "ankle": "raise gait.com_height, shorten gait.step_length or raise foot.heel_rise_lead",
    "toe": "lower foot.toe_off_angle",
}
_TURNED = 0.2  # most heading of a foot whose ankle does not roll [rad]: the controller frees the roll about x
_INSTANTS = 200  # samples per phase, for values without a closed-form extremum


def check_body(plan: StepPlan, description: BodyDescription, phases: int | None = 2) -> None:
    """Refuse a plan that this body cannot walk, by plan, soles and leg length alone.

    Args:
        plan: it.
        description: of the body.
        phases: how many are checked; the first step is enough of a periodic gait. None for all.

    Raises:
        BodilyRefusal: soles overlap, leg too short, planned sole points under the floor, ZMP off the sole, or
            heel rising before the ZMP has reached the ball. The way out names the changes for all failed
            checks.
    """
    # Without the last instant, at which the next phase begins or the plan ends.
    ends = {"single_support": 1.0 - 1.0 / _INSTANTS, "double_support": 1.0 - 1e-9}
    checked = plan.contacts.phases[:phases]
    shares = (np.linspace(0.0, ends[phase.kind], _INSTANTS) for phase in checked)
    times = np.concatenate([p.start + share * p.duration for p, share in zip(checked, shares, strict=True)])
    *checks, margin = _plan_checks(plan, description, times)
    # A failure of another check also takes the ZMP out of the support.
    (limit, value), *others = [(limit, value) for limit, value in checks if limit.broken(value)] or [margin]
    if limit.broken(value):
        also = [f"; also {other.reason.replace('_', ' ')}: {other.way_out}" for other, _ in others]
        raise limit.refusal(value, "".join(also))


def check_ankles(plan: StepPlan, description: BodyDescription) -> None:
    """Refuse turned feet and a slope across, by a BodilyRefusal, if the ankles do not roll."""
    if description.upright is None:
        return
    what = "without a roll of the ankle a body walks straight: the largest heading of a footstep"
    straight = Limit(what, "rad", _TURNED, AT_MOST, "feet_turned", "turn the feet less")
    what = "without a roll of the ankle a body stands on a floor that is level along y: its rise"
    level = Limit(what, "1", 0.0, AT_MOST, "slope_across", "take gait.cross_slope = 0")
    heading = max(abs(step.heading) for step in plan.contacts.footsteps)
    check([(straight, heading), (level, abs(plan.contacts.slope[1]))])


def check_motion(report: MotionReport, robot: Robot) -> None:
    """Refuse a motion that is not periodic or exceeds the range of a joint, by a BodilyRefusal."""
    knee, joint, parts = report.knee_minimum, report.joint_limit_margin, report.clearance
    description = robot.description
    turn = "the motion's end is not a mirror image of its start: the largest difference"
    straight = f"the {knee.where} knee straightens at {knee.time:.3f} s of the step: its flexion"
    past = f"joint {joint.where} would pass its limit at {joint.time:.3f} s of the step: its distance from it"
    near = f"{parts.where} come too close at {parts.time:.3f} s of the step: their distance"
    of_arms = "raise body.arm_abduction" if description.spread else LESS
    apart = of_arms if robot.of_arm(parts.where) else "raise gait.step_width"
    bend = "lower gait.com_height, shorten gait.step_length or raise foot.toe_off_angle"
    group = next((name for name, names in joint_groups(description).items() if joint.where in names), "")
    way_out = _JOINT_WAYS_OUT.get(group, LESS)
    check(
        [
            (Limit(turn, "rad", RETURN_TOLERANCE, AT_MOST, "no_periodic_motion", LESS), report.residual),
            (Limit(straight, "rad", KNEE_MINIMUM, AT_LEAST, "knee_too_straight", bend), knee.value),
            (Limit(past, "rad", 0.0, AT_LEAST, "joint_limits", way_out), joint.value),
            (Limit(near, "m", CLEARANCE, AT_LEAST, "self_collision", apart), parts.value),
        ]
    )


def _plan_checks(plan: StepPlan, description: BodyDescription, times: Array) -> Iterator[tuple[Limit, float]]:
    """Limits and values of a plan, the ZMP margin's last."""
    sole, l_s, contacts = description.sole, plan.constants.l_s, plan.contacts
    width = 2.0 * sole.half_width
    what = "the soles overlap: the width of a step"
    wider = f"raise gait.step_width to {width:.4g} m or more"
    yield Limit(what, "m", width, AT_LEAST, "soles_overlap", wider), contacts.step_width

    # The AMPM's ZMP runs from -l_s/a_s to +l_s/a_s under the flat stance foot.
    sample, feet = plan.sample(times), plan.feet.sample(times)
    margin = margin_on(feet, sample.zmp)
    place = np.where((sample.stance == 1)[:, None], sample.right_placement, sample.left_placement)
    travel = np.where(sample.phase == 0, np.abs(sample.zmp - place)[:, 0], 0.0)
    most = int(travel.argmax())
    end, side = min((-sole.heel_x, "heel"), (sole.tip_x, "toes"))
    when = f"the ZMP leaves the sole at the {side} at {times[most]:.3f} s"
    what = f"{when}: its travel either way of the reference point"
    less = f"raise gait.a_s to {rounded_up(l_s / end)} or more, or shorten gait.step_length"
    yield Limit(what, "m", end, AT_MOST, "zmp_leaves_sole", less, _ROUNDING), float(travel[most])

    left = plan.feet.left  # the left foot stands first
    risen = left.contact.any(axis=1) & ~left.contact[:, HEEL]
    if risen.any():
        rise = plan.sample(float(left.start[risen.argmax()]))
        # Rounding: a resting ZMP is at 0 m, and -0 becomes 0.
        reached = round(float(rise.zmp[0, 0] - rise.left_placement[0, 0]), 6) + 0.0
        reason = "heel_rises_before_zmp_reaches_ball"
        what = "the heel rises before the ZMP has reached the ball: its distance from the reference point"
        less, rolls = "lower foot.heel_rise_lead, or ", l_s * plan.constants.inverse_a_s
        if rolls < sole.ball_x - ROLL_TOLERANCE:  # nor does it reach it before the switch
            on_time = " and foot.heel_rise_lead to 0" if rise.phase == 0 else ""
            # With a_s of 1 or less it would not be a pendulum, and a planner whose ZMP rests has none.
            less = f"lower gait.a_s to {l_s / sole.ball_x:.4g}{on_time}, " if l_s > sole.ball_x else ""
            less = f"{less}lengthen gait.step_length, or " if rolls else ""
        less += "take foot.schedule = flat"
        yield Limit(what, "m", sole.ball_x, AT_LEAST, reason, less, ROLL_TOLERANCE), reached

    reach = description.leg_length * (1.0 + LEG_ALLOWANCE)
    longest = leg_extension(sample.com, feet, description) * description.leg_length
    what = (
        f"the leg is too short for steps of {contacts.step_length:.4g} m with the COM at "
        f"{plan.com_height:.4g} m: the largest distance of hip and ankle"
    )
    less = "lower gait.com_height or shorten gait.step_length"
    yield Limit(what, "m", reach, AT_MOST, "leg_too_short", less), longest

    depth = -plan.feet.heights(feet).T
    foot, at = np.unravel_index(int(depth.argmax()), depth.shape)
    what = f"the {('left', 'right')[foot]} sole is planned under the floor at {times[at]:.3f} s: its depth"
    more = "raise foot.swing_height or foot.heel_strike_angle, or take foot.schedule = flat"
    yield Limit(what, "m", FLOOR_TOLERANCE, AT_MOST, "sole_under_floor", more), float(depth.max())

    # In double support the ZMP crosses the edge behind a rising heel in milliseconds; single support has no
    # tolerance.
    allowed = np.where(sample.phase == 1, ROLL_TOLERANCE, 0.0) + FLOOR_TOLERANCE
    worst = int((margin + allowed).argmin())
    what = (
        f"the ZMP leaves the soles in {sample.phase_name[worst].replace('_', ' ')}, at {times[worst]:.3f} s: "
        "its distance into the support polygon"
    )
    less = "bring gait.a_s nearer to the sole's length, shorten gait.step_length, or lower foot.full_contact"
    limit = Limit(what, "m", 0.0, AT_LEAST, "zmp_leaves_support", less, float(allowed[worst]))
    yield limit, float(margin[worst])


def leg_extension(com: Array, feet: tuple[FootSample, FootSample], description: BodyDescription) -> float:
    """Largest distance of hip and ankle centres over the straight leg's; the pelvis upright under the COM.

    COM, shape (N, 3) [m], and feet at the same times.
    """
    sole, longest = description.sole, 0.0
    heading = 0.5 * (feet[0].heading + feet[1].heading)  # of the pelvis
    for foot, side in zip(feet, (1.0, -1.0), strict=True):
        c, s = np.cos(foot.pitch), np.sin(foot.pitch)
        forward, up = sole.ankle_x * c + sole.ankle_height * s, sole.ankle_height * c - sole.ankle_x * s
        lever = np.stack([forward * np.cos(foot.heading), forward * np.sin(foot.heading), up], axis=1)
        aside, below = side * description.hip_half_width, np.full_like(c, description.com_over_hip)
        hip = com + np.stack([-aside * np.sin(heading), aside * np.cos(heading), -below], axis=1)
        longest = max(longest, float(np.linalg.norm(hip - foot.position - lever, axis=1).max()))
    return longest / description.leg_length


def joint_groups(description: BodyDescription) -> dict[str, tuple[str, ...]]:
    """Names of the hinges by group: hip, knee, ankle, toe, trunk, arms; those that the body has."""
    legs = description.legs
    groups = {
        "hip": tuple(joint for leg in legs for joint in leg.hip),
        "knee": tuple(leg.knee for leg in legs),
        "ankle": tuple(joint for leg in legs for joint in leg.ankle),
        "toe": tuple(toe for leg in legs for toe in leg.toes),
        "trunk": description.trunk,
        "arms": description.arms,
    }
    return {name: joints for name, joints in groups.items() if joints}
