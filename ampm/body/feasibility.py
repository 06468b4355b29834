"""What a body refuses before anything is solved: checks that need only the plan, the soles and the leg.

What the joints have to say (knee too straight, joint limits) needs the whole-body motion and is checked
there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from ampm.description import BodyDescription
from ampm.exceptions import BodilyRefusal
from ampm.planner.centroidal import PlanSample
from ampm.planner.feet import HEEL, FootPath, FootSample
from ampm.planner.support import StepPlan

Array = NDArray[np.float64]

FLOOR_TOLERANCE = 1e-6
"""Depth under the floor that rounding may give a planned sole point [m]."""
ROLL_TOLERANCE = 0.005
"""ZMP's distance behind the ball that a rising heel forgives [m]: the ZMP covers it in a few milliseconds, in
which the heel is still within the millimetre by which a soft contact gives way."""
LEG_ALLOWANCE = 0.02
"""Reach beyond the straight leg that is left to the pelvis, as a share of the leg's length [1]. The inverse
kinematics has the last word; this check refuses early what no turn of the pelvis can mend."""
COM_OVER_HIP = 0.037
"""Height of the COM over the hip centres when standing, as a share of stature [1] (0.567 less 0.530)."""

_INSTANTS = 200  # per phase, for what has no closed-form extremum


def check_body(plan: StepPlan, description: BodyDescription) -> None:
    """Refuse a plan that this body cannot walk, by plan, soles and leg length alone.

    The gait is periodic and symmetric, so its first step stands for all.

    Args:
        plan: centroidal motion and feet.
        description: the body.

    Raises:
        BodilyRefusal: soles overlap, leg too short, planned sole points under the floor, ZMP off the sole, or
            heel rising before the ZMP has reached the ball.
    """
    single, double = plan.contacts.phases[0], plan.contacts.phases[1]
    # Short of the last instant, at which the next phase has begun or the plan is over.
    times = np.concatenate(
        [
            single.start + np.linspace(0.0, single.duration, _INSTANTS, endpoint=False),
            double.start + np.linspace(0.0, double.duration * (1.0 - 1e-9), _INSTANTS),
        ]
    )
    sample = plan.sample(times)
    feet = plan.feet.sample(times)
    checks: tuple[Callable[[], None], ...] = (
        lambda: _check_overlap(plan, description),
        lambda: _check_roll(plan, description),
        lambda: _check_heel_rise(plan, description),
        lambda: _check_leg(plan, description, sample, feet),
        lambda: _check_floor(times, feet),
    )
    refusals = [refusal for refusal in map(_refusal, checks) if refusal is not None]
    if refusals:
        raise _together(refusals)
    _check_margin(plan, sample)  # alone: what is refused above takes the ZMP out of the support as well


def _refusal(check: Callable[[], None]) -> BodilyRefusal | None:
    try:
        check()
    except BodilyRefusal as refusal:
        return refusal
    return None


def _together(refusals: Sequence[BodilyRefusal]) -> BodilyRefusal:
    """The first refusal, with a way out that does not lead into the next one."""
    first, *others = refusals
    if not others:
        return first
    also = [f"{other.reason.replace('_', ' ')}: {other.way_out}" for other in others]
    return BodilyRefusal(
        str(first).removesuffix(f"; {first.way_out}."),
        reason=first.reason,
        value=first.value,
        limit=first.limit,
        unit=first.unit,
        way_out=f"{first.way_out}; also " + "; also ".join(also),
    )


def _check_overlap(plan: StepPlan, description: BodyDescription) -> None:
    width, limit = plan.contacts.step_width, 2.0 * description.sole.half_width
    if width < limit:
        raise BodilyRefusal(
            f"the soles overlap: gait.step_width = {width:.4g} m is less than the width of a sole, "
            f"{limit:.4g} m",
            reason="soles_overlap",
            value=width,
            limit=limit,
            unit="m",
            way_out=f"raise gait.step_width to {limit:.4g} m or more",
        )


def _check_roll(plan: StepPlan, description: BodyDescription) -> None:
    """The ZMP runs from ``-l_s/a_s`` to ``+l_s/a_s`` under the flat stance foot."""
    sole, constants = description.sole, plan.constants
    travel = constants.l_s * constants.inverse_a_s
    limit, end = min((-sole.heel_x, "heel"), (sole.tip_x, "toes"))
    if travel > limit:
        raise BodilyRefusal(
            f"the ZMP leaves the sole at the {end}: it runs l_s/a_s = {travel:.4g} m either way of the "
            f"foot's reference point, and the sole ends after {limit:.4g} m",
            reason="zmp_leaves_sole",
            value=travel,
            limit=limit,
            unit="m",
            way_out=f"raise gait.a_s to {constants.l_s / limit:.4g} or more, or shorten gait.step_length",
        )


def _check_leg(
    plan: StepPlan,
    description: BodyDescription,
    sample: PlanSample,
    feet: tuple[FootSample, FootSample],
) -> None:
    """Distance of hip and ankle centres against the straight leg, the pelvis upright under the COM."""
    sole = description.sole
    limit = description.leg_length * (1.0 + LEG_ALLOWANCE)
    longest = 0.0
    for foot, side in zip(feet, (1.0, -1.0), strict=True):
        c, s = np.cos(foot.pitch), np.sin(foot.pitch)
        ankle = foot.position + np.stack(
            [
                sole.ankle_x * c + sole.ankle_height * s,
                np.zeros_like(c),
                sole.ankle_height * c - sole.ankle_x * s,
            ],
            axis=1,
        )
        hip = sample.com + np.array(
            [0.0, side * description.hip_half_width, -COM_OVER_HIP * description.height]
        )
        longest = max(longest, float(np.linalg.norm(hip - ankle, axis=1).max()))
    if longest > limit:
        raise BodilyRefusal(
            f"the leg is too short for gait.step_length = {plan.contacts.step_length:.4g} m at "
            f"gait.com_height = {plan.centroidal.com_height:.4g} m: hip and ankle would be {longest:.4g} m "
            f"apart, and the leg reaches {limit:.4g} m",
            reason="leg_too_short",
            value=longest,
            limit=limit,
            unit="m",
            way_out="lower gait.com_height, shorten gait.step_length or raise body.height",
        )


def _check_floor(times: Array, feet: tuple[FootSample, FootSample]) -> None:
    depth = [-foot.sole_points[:, :, 2].min(axis=1) for foot in feet]
    side = int(depth[1].max() > depth[0].max())
    deepest = float(depth[side].max())
    if deepest > FLOOR_TOLERANCE:
        raise BodilyRefusal(
            f"the {('left', 'right')[side]} sole is planned {deepest * 1000:.3g} mm under the floor at "
            f"{times[depth[side].argmax()]:.3f} s; it may not be deeper than {FLOOR_TOLERANCE:g} m",
            reason="sole_under_floor",
            value=deepest,
            limit=FLOOR_TOLERANCE,
            unit="m",
            way_out="raise foot.swing_height or foot.heel_strike_angle",
        )


def _heel_rise(path: FootPath) -> float | None:
    """First time at which the foot stands on ball and tip alone, or None [s]."""
    standing = path.contact.any(axis=1) & ~path.contact[:, HEEL]
    return float(path.start[standing.argmax()]) if standing.any() else None


def _check_heel_rise(plan: StepPlan, description: BodyDescription) -> None:
    rise = _heel_rise(plan.feet.left)  # the left foot stands first
    if rise is None:
        return
    sample = plan.sample(rise)
    reached = float(sample.zmp[0, 0] - sample.left_placement[0, 0])
    ball = description.sole.ball_x
    if reached < ball - ROLL_TOLERANCE:
        constants = plan.constants
        reached = round(reached, 6) + 0.0  # a ZMP at rest is at 0 m but for rounding, and -0 is 0
        raise BodilyRefusal(
            "the ZMP has not reached the ball when the heel rises: measured from the foot's reference point "
            f"it is at {reached:.4g} m, and the ball at {ball:.4g} m",
            reason="heel_rises_before_zmp_reaches_ball",
            value=reached,
            limit=ball,
            unit="m",
            way_out=f"lower gait.a_s to {constants.l_s / ball:.4g}, lengthen gait.step_length, lower "
            "foot.heel_rise_lead, or take foot.schedule = flat",
        )


def _check_margin(plan: StepPlan, sample: PlanSample) -> None:
    margin = plan.zmp_margin(sample.time)
    # In double support the ZMP crosses the edge behind a rising heel in no time; one foot has no such excuse.
    excess = margin + np.where(sample.phase == 1, ROLL_TOLERANCE, 0.0)
    worst = int(excess.argmin())
    if excess[worst] < -FLOOR_TOLERANCE:
        raise BodilyRefusal(
            f"the ZMP leaves the soles in {sample.phase_name[worst].replace('_', ' ')}, at "
            f"{sample.time[worst]:.3f} s: it is {-margin[worst]:.4g} m outside the support polygon",
            reason="zmp_leaves_support",
            value=float(margin[worst]),
            limit=0.0,
            unit="m",
            way_out="bring gait.a_s nearer to the sole's length, shorten gait.step_length, or lower "
            "foot.full_contact",
        )
