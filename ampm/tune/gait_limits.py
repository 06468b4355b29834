"""How far a gait is from the limits of formula, body and floor, by plan and periodic step alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from ampm.body.feasibility import COM_OVER_HIP, FLOOR_TOLERANCE, LEG_ALLOWANCE, ROLL_TOLERANCE
from ampm.body.inverse_kinematics import KNEE_MINIMUM
from ampm.body.step_torques import step_torques
from ampm.control.wrench_qp import TWIST_ARM, TWIST_FRICTION
from ampm.parameters import GRAVITY, GaitParameters, RunParameters
from ampm.planner.feet import HEEL
from ampm.planner.periodic import LEAST_MID_STANCE_SHARE
from ampm.planner.support import AnyPlan, StepPlan

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.body.orbit import RoughOrbit
    from ampm.body.robot import Robot
    from ampm.description import BodyDescription

    Array = NDArray[np.float64]

_KNEE_GRID = 0.015  # by how much a fine grid may find the knee straighter than the search's coarse one [rad]
RISE_TOLERANCE = 0.6 * ROLL_TOLERANCE
"""How far behind the ball the ZMP may be when the heel rises [m]: less than what a body refuses."""


@dataclass(frozen=True)
class Limit:
    """One limit of body, floor or formula.

    Attributes:
        what: what is measured.
        unit: of all three figures.
        bound: what may not be passed.
        comfort: where nothing more is asked for; beyond ``bound`` on the allowed side.
        reason: short name for tables.
    """

    what: str
    unit: str
    bound: float
    comfort: float
    reason: str

    def margin(self, value: float) -> float:
        """Normalised margin: 0 at the bound, 1 at comfort, negative beyond the bound [1]."""
        return (value - self.bound) / (self.comfort - self.bound)


_TORQUES = {
    f"{name}_torque": Limit(f"largest share of {of} torque limit", "1", 1.0, 0.8, "torque_limits")
    for name, of in (
        ("hip", "a hip joint's"),
        ("knee", "a knee's"),
        ("ankle", "an ankle joint's"),
        ("toe", "a toe joint's"),
        ("trunk", "a waist or chest joint's"),
        ("arms", "an arm joint's"),
    )
}
_JOINTS = {
    name: Limit(f"least distance of {of} joint from its limits", "rad", bound, comfort, "joint_limits")
    for name, of, bound, comfort in (
        ("hip", "a hip", 0.0, 0.06),
        ("ankle", "an ankle", 0.0, 0.045),
        ("toe", "a toe", 0.0, 0.06),
        ("trunk", "a waist or chest", 0.0, 0.12),
        ("arms", "an arm", -1e-3, 0.05),  # the inverse kinematics may hold an arm at its limit
    )
}
_SUPPORT = "least distance of the ZMP into the"
LIMITS: Mapping[str, Limit] = MappingProxyType(
    {
        "mid_stance": Limit(
            "square of the mid-stance speed over v0",
            "1",
            LEAST_MID_STANCE_SHARE**2,
            0.2,
            "mid_stance_too_slow",
        ),
        "zmp_single": Limit(f"{_SUPPORT} support on one sole", "m", 0.0, 0.006, "zmp_leaves_support"),
        "zmp_double": Limit(
            f"{_SUPPORT} double support or on the ball",
            "m",
            -ROLL_TOLERANCE,
            -RISE_TOLERANCE,
            "zmp_leaves_support",
        ),
        "reach": Limit(
            "distance of hip and ankle over the straight leg",
            "1",
            1.0 + LEG_ALLOWANCE,
            0.995,
            "leg_too_short",
        ),
        "floor": Limit("least height of a sole point", "m", -FLOOR_TOLERANCE, 0.0, "sole_under_floor"),
        "clearance": Limit("height of the sole in mid swing", "m", 0.0, 0.006, "sole_under_floor"),
        "turn": Limit("fastest turn of a foot at the floor", "rad/s", 25.0, 10.0, "foot_turns_too_fast"),
        "handover": Limit(
            "double support over the controller's contact ramp", "1", 0.5, 1.0, "double_support_too_short"
        ),
        "friction": Limit("share of the friction that the controller may use", "1", 1.0, 0.75, "friction"),
        # Beyond its bound a foot yaws; well before it the vertical moment is given up, and the ZMP suffers.
        "twist": Limit("share of the twist that the controller gives a foot", "1", 2.0, 1.0, "friction"),
        "knee": Limit("least knee flexion", "rad", KNEE_MINIMUM + _KNEE_GRID, 0.35, "knee_too_straight"),
        **_JOINTS,
        **_TORQUES,
    }
)
"""What a choice is judged by."""


def mid_stance_share(gait: GaitParameters) -> float:
    """Square of the speed over the foot as a share of v0's; negative if the COM does not pass [1]."""
    bracket = gait.c_s - 1.0 / gait.a_s
    l_s = 0.5 * gait.step_length * gait.single_support_ratio
    if bracket <= 0.0:
        return -1.0
    return 1.0 - l_s**2 * bracket * GRAVITY / (gait.com_height * gait.switching_velocity**2)


def step_instants(plan: AnyPlan) -> tuple[Array, NDArray[np.bool_]]:
    """Times of the first step, and which lie in double support."""
    single, double = plan.contacts.phases[0], plan.contacts.phases[1]
    end = double.start + double.duration * (1.0 - 1e-9)
    times = [np.linspace(0.0, single.duration, 120, endpoint=False), np.linspace(double.start, end, 80)]
    if isinstance(plan, StepPlan):  # a margin is least just before or after a contact changes
        changes = np.concatenate([plan.feet.left.start, plan.feet.right.start])
        changes = changes[(changes > 1e-6) & (changes < end - 1e-6)]
        times += [changes - 1e-8, changes + 1e-8]
    together = np.sort(np.concatenate(times))
    return together, together >= double.start - 1e-12


def leg_extension(plan: StepPlan, description: BodyDescription, times: Array) -> float:
    """Largest distance of hip and ankle centres over the straight leg's; the pelvis upright under the COM."""
    sole, com = description.sole, plan.sample(times).com
    longest = 0.0
    for foot, side in zip(plan.feet.sample(times), (1.0, -1.0), strict=True):
        c, s = np.cos(foot.pitch), np.sin(foot.pitch)
        lever = np.stack(
            [
                sole.ankle_x * c + sole.ankle_height * s,
                np.zeros_like(c),
                sole.ankle_height * c - sole.ankle_x * s,
            ],
            axis=1,
        )
        hip = com + np.array([0.0, side * description.hip_half_width, -COM_OVER_HIP * description.height])
        longest = max(longest, float(np.linalg.norm(hip - foot.position - lever, axis=1).max()))
    return longest / description.leg_length


def plan_margins(plan: StepPlan, run: RunParameters, description: BodyDescription) -> dict[str, float]:
    """What plan and feet alone say, by name in :data:`LIMITS`, in its unit."""
    times, double = step_instants(plan)
    margin = plan.zmp_margin(times)
    sample = plan.sample(times)
    level = ~double & plan.feet.sample(times)[0].contact[:, HEEL]  # a rising heel leaves the ZMP on the edge
    swing = plan.feet.sample(times[~double])[1].sole_points[:, :, 2].min(axis=1)
    points = np.stack([f.sole_points[:, :, 2].min(axis=1) for f in plan.feet.sample(times)])
    share = times[~double] / plan.contacts.phases[0].duration
    middle = (share > 0.2) & (share < 0.8)
    force = sample.force
    roll = run.foot.schedule == "roll"
    return {
        "mid_stance": mid_stance_share(run.gait),
        "zmp_single": float(margin[level].min()),
        "zmp_double": float(margin[~level].min()),
        "reach": leg_extension(plan, description, times),
        "floor": float(points.min()),
        "clearance": float(swing[middle].min()),
        "turn": max(run.foot.toe_off_rate, run.foot.heel_strike_rate) if roll else 0.0,
        "handover": plan.constants.double_support_duration / run.controller.contact_ramp,
        "friction": float((np.hypot(force[:, 0], force[:, 1]) / force[:, 2]).max()) / run.controller.friction,
    }


def orbit_margins(orbit: RoughOrbit, plan: StepPlan, robot: Robot) -> dict[str, float]:
    """What the periodic step says, by name in :data:`LIMITS`, in its unit."""
    angles = orbit.trajectory.q[:, 7:]
    margin = np.minimum(angles - robot.lower, robot.upper - angles).min(axis=0)
    torque, twist = step_torques(orbit, plan, robot)
    share = (np.abs(torque) / robot.torque_limit).max(axis=0)
    groups = joint_groups(robot)
    values = {name: float(margin[joints].min()) for name, joints in groups.items() if name != "knee"}
    values["knee"] = float(angles[:, groups["knee"]].min())
    values["twist"] = float(np.abs(twist).max()) / (TWIST_ARM * TWIST_FRICTION)
    return values | {f"{name}_torque": float(share[joints].max()) for name, joints in groups.items()}


def joint_groups(robot: Robot) -> dict[str, NDArray[np.intp]]:
    """Indices of the hinges by what they are: hip, knee, ankle, toe, trunk, arms."""
    legs = robot.description.legs
    names = {
        "hip": [joint for leg in legs for joint in leg.hip],
        "knee": [leg.knee for leg in legs],
        "ankle": [joint for leg in legs for joint in leg.ankle],
        "toe": [leg.toe for leg in legs],
        "trunk": robot.description.trunk,
        "arms": robot.description.arms,
    }
    return {name: robot.velocity_indices(tuple(joints)) - 6 for name, joints in names.items()}
