"""Refusals by the body: checks of plan and soles before anything is solved, and of the solved motion."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ampm.description import BodyDescription
from ampm.exceptions import BodilyRefusal
from ampm.geometry import Array
from ampm.planner.feet import HEEL
from ampm.planner.support import StepPlan

if TYPE_CHECKING:
    from ampm.body.motion import MotionReport

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
KNEE_MINIMUM = 0.1
"""Least flexion of a knee [rad]: a straighter one has lost its authority over the hip's height."""
RETURN_TOLERANCE = 1e-8
"""Largest difference of a motion's mirrored end from its start [rad, m, rad/s, m/s]."""

LESS = "bring gait.c_s and gait.c_y nearer to 1, lower gait.com_height or shorten gait.step_length"
"""Way out of what a whole body cannot do."""
_JOINT_WAYS_OUT = {
    "ankle": "raise gait.com_height, shorten gait.step_length or raise foot.heel_rise_lead",
    "toe": "lower foot.toe_off_angle",
    "trunk": "bring gait.c_s and gait.c_y nearer to 1",
    "arms": "bring gait.c_s and gait.c_y nearer to 1",
}
_INSTANTS = 200  # per phase, for what has no closed-form extremum


@dataclass(frozen=True)
class Check:
    """A measured value and its limit.

    Attributes:
        reason: short name for tables.
        what: clause that names the fault and the measured quantity.
        value: in ``unit``.
        limit: in ``unit``.
        unit: SI.
        way_out: what the user can change.
        most: whether the limit is an upper one.
        tolerance: by how much the limit may be passed.
    """

    reason: str
    what: str
    value: float
    limit: float
    unit: str
    way_out: str
    most: bool = False
    tolerance: float = 0.0

    @property
    def broken(self) -> bool:
        """Whether the value is beyond limit and tolerance, or no number."""
        beyond = self.value - self.limit if self.most else self.limit - self.value
        return not beyond <= self.tolerance

    def refusal(self, also: str = "") -> BodilyRefusal:
        """The error; ``also`` goes on with the way out."""
        side = "at most" if self.most else "at least"
        return BodilyRefusal(
            f"{self.what} is {self.value:.4g} {self.unit} and must be {side} {self.limit:.4g} {self.unit}",
            reason=self.reason,
            value=self.value,
            limit=self.limit,
            unit=self.unit,
            way_out=self.way_out + also,
        )


def check_body(plan: StepPlan, description: BodyDescription) -> None:
    """Refuse a plan that this body cannot walk, by plan, soles and leg length alone.

    The gait is periodic and symmetric, so its first step stands for all.

    Args:
        plan: centroidal motion and feet.
        description: the body.

    Raises:
        BodilyRefusal: soles overlap, leg too short, planned sole points under the floor, ZMP off the sole, or
            heel rising before the ZMP has reached the ball. Its way out does not lead into the next refusal.
    """
    single, double = plan.contacts.phases[:2]
    # Short of the last instant, at which the next phase has begun or the plan is over.
    first = single.start + np.linspace(0.0, single.duration, _INSTANTS, endpoint=False)
    second = double.start + np.linspace(0.0, double.duration * (1.0 - 1e-9), _INSTANTS)
    times = np.concatenate([first, second])
    *checks, margin = _plan_checks(plan, description, times)
    # The margin only alone: what the others refuse takes the ZMP out of the support as well.
    broken = [check for check in checks if check.broken] or ([margin] if margin.broken else [])
    if broken:
        others = [f"; also {other.reason.replace('_', ' ')}: {other.way_out}" for other in broken[1:]]
        raise broken[0].refusal("".join(others))


def check_motion(report: MotionReport, description: BodyDescription) -> None:
    """Refuse a motion that does not return, or that the body's joints cannot make.

    Raises:
        BodilyRefusal: it is one of these.
    """
    knee, joint = report.knee_minimum, report.joint_limit_margin
    turn = "the motion's end is no mirror image of its start: the largest difference"
    straight = f"the {knee.where} knee straightens at {knee.time:.3f} s of the step: its flexion"
    past = f"joint {joint.where} would pass its limit at {joint.time:.3f} s of the step: its distance from it"
    bend = "lower gait.com_height, shorten gait.step_length or raise foot.toe_off_angle"
    group = next((name for name, names in joint_groups(description).items() if joint.where in names), "")
    way_out = _JOINT_WAYS_OUT.get(group, LESS)
    for check in (
        Check("no_periodic_motion", turn, report.residual, RETURN_TOLERANCE, "rad", LESS, most=True),
        Check("knee_too_straight", straight, knee.value, KNEE_MINIMUM, "rad", bend),
        Check("joint_limits", past, joint.value, 0.0, "rad", way_out),
    ):
        if check.broken:
            raise check.refusal()


def _plan_checks(plan: StepPlan, description: BodyDescription, times: Array) -> Iterator[Check]:
    sole, l_s, contacts = description.sole, plan.constants.l_s, plan.contacts
    width = 2.0 * sole.half_width
    wider = f"raise gait.step_width to {width:.4g} m or more"
    yield Check("soles_overlap", "the soles overlap: gait.step_width", contacts.step_width, width, "m", wider)

    # The ZMP runs from -l_s/a_s to +l_s/a_s under the flat stance foot.
    end, side = min((-sole.heel_x, "heel"), (sole.tip_x, "toes"))
    what = f"the ZMP leaves the sole at the {side}: its travel l_s/a_s either way of the reference point"
    less = f"raise gait.a_s to {l_s / end:.4g} or more, or shorten gait.step_length"
    yield Check("zmp_leaves_sole", what, l_s * plan.constants.inverse_a_s, end, "m", less, most=True)

    left = plan.feet.left  # the left foot stands first
    risen = left.contact.any(axis=1) & ~left.contact[:, HEEL]
    if risen.any():
        sample = plan.sample(float(left.start[risen.argmax()]))
        # A ZMP at rest is at 0 m but for rounding, and -0 is 0.
        reached = round(float(sample.zmp[0, 0] - sample.left_placement[0, 0]), 6) + 0.0
        reason = "heel_rises_before_zmp_reaches_ball"
        what = "the heel rises before the ZMP has reached the ball: its distance from the reference point"
        less = (
            f"lower gait.a_s to {l_s / sole.ball_x:.4g}, lengthen gait.step_length, lower "
            "foot.heel_rise_lead, or take foot.schedule = flat"
        )
        yield Check(reason, what, reached, sole.ball_x, "m", less, tolerance=ROLL_TOLERANCE)

    reach = description.leg_length * (1.0 + LEG_ALLOWANCE)
    longest = leg_extension(plan, description, times) * description.leg_length
    what = (
        f"the leg is too short for gait.step_length = {contacts.step_length:.4g} m at gait.com_height = "
        f"{plan.centroidal.com_height:.4g} m: the largest distance of hip and ankle"
    )
    less = "lower gait.com_height, shorten gait.step_length or raise body.height"
    yield Check("leg_too_short", what, longest, reach, "m", less, most=True)

    depth = np.stack([-foot.sole_points[:, :, 2].min(axis=1) for foot in plan.feet.sample(times)])
    foot, at = np.unravel_index(int(depth.argmax()), depth.shape)
    what = f"the {('left', 'right')[foot]} sole is planned under the floor at {times[at]:.3f} s: its depth"
    more = "raise foot.swing_height or foot.heel_strike_angle"
    yield Check("sole_under_floor", what, float(depth.max()), FLOOR_TOLERANCE, "m", more, most=True)

    sample, margin = plan.sample(times), plan.zmp_margin(times)
    # In double support the ZMP crosses the edge behind a rising heel in no time; one foot has no such excuse.
    allowed = np.where(sample.phase == 1, ROLL_TOLERANCE, 0.0) + FLOOR_TOLERANCE
    worst = int((margin + allowed).argmin())
    what = (
        f"the ZMP leaves the soles in {sample.phase_name[worst].replace('_', ' ')}, at {times[worst]:.3f} s: "
        "its distance into the support polygon"
    )
    less = "bring gait.a_s nearer to the sole's length, shorten gait.step_length, or lower foot.full_contact"
    value, tolerance = float(margin[worst]), float(allowed[worst])
    yield Check("zmp_leaves_support", what, value, 0.0, "m", less, tolerance=tolerance)


def leg_extension(plan: StepPlan, description: BodyDescription, times: Array) -> float:
    """Largest distance of hip and ankle centres over the straight leg's; the pelvis upright under the COM."""
    sole, com = description.sole, plan.sample(times).com
    longest = 0.0
    for foot, side in zip(plan.feet.sample(times), (1.0, -1.0), strict=True):
        c, s = np.cos(foot.pitch), np.sin(foot.pitch)
        forward, up = sole.ankle_x * c + sole.ankle_height * s, sole.ankle_height * c - sole.ankle_x * s
        lever = np.stack([forward, np.zeros_like(c), up], axis=1)
        hip = com + np.array([0.0, side * description.hip_half_width, -COM_OVER_HIP * description.height])
        longest = max(longest, float(np.linalg.norm(hip - foot.position - lever, axis=1).max()))
    return longest / description.leg_length


def joint_groups(description: BodyDescription) -> dict[str, tuple[str, ...]]:
    """Names of the hinges by what they are: hip, knee, ankle, toe, trunk, arms."""
    legs = description.legs
    return {
        "hip": tuple(joint for leg in legs for joint in leg.hip),
        "knee": tuple(leg.knee for leg in legs),
        "ankle": tuple(joint for leg in legs for joint in leg.ankle),
        "toe": tuple(leg.toe for leg in legs),
        "trunk": description.trunk,
        "arms": description.arms,
    }
