"""Distances of a gait from the limits of formula, body and floor, by plan and periodic step alone.

The torques are those of inverse dynamics under the ground force that the plan needs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from ampm.body.feasibility import (
    CLEARANCE,
    KNEE_MINIMUM,
    LEG_ALLOWANCE,
    ROLL_TOLERANCE,
    Limit,
    joint_groups,
    leg_extension,
)
from ampm.body.rigid_body import passive_torques
from ampm.parameters import GRAVITY, GaitParameters, RunParameters
from ampm.planner.centroidal import CentroidalPlan
from ampm.planner.closed_form import LEAST_MID_STANCE_SHARE
from ampm.planner.feet import HEEL
from ampm.planner.support import StepPlan

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.body.inverse_kinematics import StepTrajectory
    from ampm.body.motion import WholeBodyMotion
    from ampm.body.return_map import Orbit
    from ampm.body.robot import Robot
    from ampm.description import BodyDescription, SoleGeometry
    from ampm.geometry import Array
    from ampm.planner.feet import FootSample

# By how much a fine grid may find a knee straighter, a joint nearer to its limit and two parts nearer to each
# other than the search's coarse one [rad, rad, m].
_KNEE_GRID, _JOINT_GRID, _GAP_GRID = 0.015, 0.002, 0.0003
_BETWEEN = np.array([0.2, 0.4, 0.6, 0.8])  # places between two nodes
_NARROW = 3  # nodes with the least distances, next to which it is also looked
_SWING_ENDS = 0.2  # share of the swing at either end in which the sole's height grows with time's cube
_TWIST_LEVER = 0.03  # moment about the vertical over the force that a foot on its ball gives easily [m]
RISE_TOLERANCE = 0.6 * ROLL_TOLERANCE
"""Distance of the ZMP behind the ball allowed when the heel rises [m]: less than that of a refusal."""


_INTO = "least distance of the ZMP into the"
_ROWS: tuple[tuple[str, str, str, float, float, str], ...] = (
    ("mid_stance", "square of the mid-stance speed over v0", "1", LEAST_MID_STANCE_SHARE**2, 0.2,
     "mid_stance_too_slow"),
    ("zmp_single", f"{_INTO} support on one sole", "m", 0.0, 0.006, "zmp_leaves_support"),
    ("zmp_double", f"{_INTO} double support or on the ball", "m", -ROLL_TOLERANCE, -RISE_TOLERANCE,
     "zmp_leaves_support"),
    ("reach", "distance of hip and ankle over the straight leg", "1", 1.0 + LEG_ALLOWANCE, 0.995,
     "leg_too_short"),
    ("floor", "height of the sole at lift and landing, scaled to a fifth of the swing", "m", 0.0, 0.001,
     "sole_under_floor"),
    ("clearance", "height of the sole in mid swing", "m", 0.0, 0.006, "sole_under_floor"),
    ("turn", "fastest turn of a foot at the floor", "rad/s", 25.0, 10.0, "foot_turns_too_fast"),
    # With less than the whole ramp the foot that lands is late in taking the weight over.
    ("handover", "double support over the controller's contact ramp", "1", 0.85, 1.3,
     "double_support_too_short"),
    # The shortest of which walks are known: 0.177 s.
    ("pace", "duration of a step", "s", 0.175, 0.185, "step_too_short_in_time"),
    ("friction", "share of the friction that the controller may use", "1", 1.0, 0.75, "friction"),
    # Beyond its bound a foot yaws; well below it the vertical moment is not met, and the ZMP error grows.
    ("twist", "share of the twist that the controller gives a foot", "1", 2.0, 1.0, "friction"),
    ("knee", "least knee flexion", "rad", KNEE_MINIMUM + _KNEE_GRID, 0.35, "knee_too_straight"),
    ("hip", "least distance of a hip joint from its limits", "rad", _JOINT_GRID, 0.06, "joint_limits"),
    ("ankle", "least distance of an ankle joint from its limits", "rad", _JOINT_GRID, 0.045, "joint_limits"),
    ("toe", "least distance of a toe joint from its limits", "rad", _JOINT_GRID, 0.06, "joint_limits"),
    ("trunk", "least distance of a waist or chest joint from its limits", "rad", _JOINT_GRID, 0.12,
     "joint_limits"),
    # The inverse kinematics may hold an arm at its limit.
    ("arms", "least distance of an arm joint from its limits", "rad", -1e-3, 0.05, "joint_limits"),
    ("speed", "largest share of a joint's speed limit", "1", 1.0, 0.9, "speed_limits"),
    ("gap", "least distance of two parts of the body", "m", CLEARANCE + _GAP_GRID, 0.012, "self_collision"),
    ("hip_torque", "largest share of a hip joint's torque limit", "1", 1.0, 0.8, "torque_limits"),
    # Feedback needs what is left, above all in the hips, which stop and turn the legs of a fast gait.
    ("hip_time", "mean use of a hip motor's last fifth of torque over a step", "1", 0.045, 0.02,
     "torque_limits"),
    ("knee_torque", "largest share of a knee's torque limit", "1", 1.0, 0.8, "torque_limits"),
    ("ankle_torque", "largest share of an ankle joint's torque limit", "1", 1.0, 0.8, "torque_limits"),
    ("toe_torque", "largest share of a toe joint's torque limit", "1", 1.0, 0.8, "torque_limits"),
    ("trunk_torque", "largest share of a waist or chest joint's torque limit", "1", 1.0, 0.8,
     "torque_limits"),
    ("arms_torque", "largest share of an arm joint's torque limit", "1", 1.0, 0.8, "torque_limits"),
)  # fmt: skip
LIMITS: Mapping[str, Limit] = MappingProxyType({row[0]: Limit(*row[1:]) for row in _ROWS})
"""Limits by which a choice is judged."""


def mid_stance_share(gait: GaitParameters) -> float:
    """Square of the speed over the foot as a share of v0's; negative if the COM does not pass [1]."""
    bracket = gait.c_s - 1.0 / gait.a_s
    l_s = 0.5 * gait.step_length * gait.single_support_ratio
    if bracket <= 0.0:
        return -1.0
    return 1.0 - l_s**2 * bracket * GRAVITY / (gait.com_height * gait.switching_velocity**2)


def step_instants(plan: CentroidalPlan) -> tuple[Array, NDArray[np.bool_]]:
    """Times of the first step, and which lie in double support."""
    single, double = plan.contacts.phases[:2]
    end = double.start + double.duration * (1.0 - 1e-9)
    times = [np.linspace(0.0, single.duration, 120, endpoint=False), np.linspace(double.start, end, 80)]
    if isinstance(plan, StepPlan):  # a margin is least just before or after a contact changes
        changes = np.concatenate([plan.feet.left.start, plan.feet.right.start])
        changes = changes[(changes > 1e-6) & (changes < end - 1e-6)]
        times += [changes - 1e-8, changes + 1e-8]
    together = np.sort(np.concatenate(times))
    return together, together >= double.start - 1e-12


def plan_margins(plan: StepPlan, run: RunParameters, description: BodyDescription) -> dict[str, Array]:
    """Values that plan and feet alone give, by name in :data:`LIMITS`, in its unit; one or more of each."""
    times, double = step_instants(plan)
    margin, force = plan.zmp_margin(times), plan.sample(times).force
    feet = plan.feet.sample(times)
    level = ~double & feet[0].contact[:, HEEL]  # a rising heel leaves the ZMP on the edge
    share = times / plan.contacts.phases[0].duration
    swing = feet[1].sole_points[:, :, 2].min(axis=1)
    turn = max(run.foot.toe_off_rate, run.foot.heel_strike_rate)
    near = np.minimum(share, 1.0 - share) / _SWING_ENDS
    ends = [(near > 0.1) & (near < 1.0) & side for side in (share < 0.5, share > 0.5)]
    values = {
        "mid_stance": mid_stance_share(run.gait),
        "zmp_single": [part.min() for part in np.array_split(margin[level], 2)],
        "zmp_double": [part.min() for part in np.array_split(margin[~level], 2)],
        "reach": leg_extension(plan, description, times),
        "floor": [(swing[end] / near[end] ** 3).min() for end in ends],
        "clearance": swing[(share > _SWING_ENDS) & (share < 1.0 - _SWING_ENDS)].min(),
        "turn": turn if run.foot.schedule == "roll" else 0.0,
        "handover": plan.constants.double_support_duration / run.controller.contact_ramp,
        "pace": plan.constants.step_duration,
        "friction": (np.hypot(force[:, 0], force[:, 1]) / force[:, 2]).max() / run.controller.friction,
    }
    return {name: np.atleast_1d(value) for name, value in values.items()}


def least(values: Mapping[str, Array]) -> dict[str, float]:
    """Of every limit the value with the least margin."""
    return {name: float(min(every, key=LIMITS[name].margin)) for name, every in values.items()}


def orbit_margins(orbit: Orbit, plan: StepPlan, robot: Robot) -> dict[str, Array]:
    """Values that the periodic step gives, by name in :data:`LIMITS`, in its unit.

    Returns:
        Of every limit the extreme values of each joint, on either side of its range, in single and in double
        support, or another number of values.
    """
    time, angles = orbit.reference.time, orbit.trajectory.q[:, 7:]
    torque, twist = step_torques(orbit.trajectory, time, plan, robot)
    share = np.abs(torque) / robot.torque_limit
    single = time < plan.constants.single_support_duration - 1e-9
    phases = single, ~single
    values = {
        "twist": np.array([np.abs(twist[phase]).max() for phase in phases]) / _TWIST_LEVER,
        "gap": _gaps(orbit, robot),
    }
    if robot.description.speed_limits:
        fastest = dict(robot.description.speed_limits)
        rates = np.abs(orbit.trajectory.v[:, robot.velocity_indices(tuple(fastest))])
        values["speed"] = rates.max(axis=0) / np.array(list(fastest.values()))
    low = np.stack([angles[phase].min(axis=0) for phase in phases])
    high = np.stack([angles[phase].max(axis=0) for phase in phases])
    most = np.stack([share[phase].max(axis=0) for phase in phases])
    knee = np.stack([robot.knee_flexion(orbit.trajectory.q[phase]).min(axis=0) for phase in phases])
    for name, names in joint_groups(robot.description).items():
        joints = robot.velocity_indices(names) - 6
        margins = low[:, joints] - robot.lower[joints], robot.upper[joints] - high[:, joints]
        values[name] = knee.ravel() if name == "knee" else np.concatenate(margins).ravel()
        values[f"{name}_torque"] = most[:, joints].ravel()
        if name == "hip":
            last = np.clip((share[:, joints] - 0.8) / 0.2, 0.0, 1.0)
            values["hip_time"] = np.trapezoid(last, time, axis=0) / time[-1]
    return values


def _gaps(orbit: Orbit, robot: Robot) -> Array:
    """Least distance of an arm and of the legs from another part, also between two nodes [m]."""
    trajectory, time = orbit.trajectory, orbit.reference.time
    between = []
    for k in np.argsort(robot.shapes.gaps(trajectory.q).distance, kind="stable")[:_NARROW]:
        v, a = trajectory.v[k], trajectory.acceleration[k]
        ends = max(k - 1, 0), min(k + 1, len(time) - 1)
        later = np.concatenate([(time[end] - time[k]) * _BETWEEN for end in ends])
        between += [pin.integrate(robot.model, trajectory.q[k], t * v + 0.5 * t**2 * a) for t in later]
    gaps = robot.shapes.gaps(np.concatenate([trajectory.q, between]))
    arms = np.array([any(part in parts for part in ("arm", "hand")) for parts in gaps.parts])
    return np.array([gaps.distance[those].min(initial=LIMITS["gap"].target) for those in (arms, ~arms)])


def step_torques(
    step: StepTrajectory | WholeBodyMotion, time: Array, plan: StepPlan, robot: Robot
) -> tuple[Array, Array]:
    """Joint torques of a periodic step, and its twisting moment on the floor.

    In single support the force is known from the motion; in double support it is shared by the lateral place
    of the ZMP. The rear foot then carries at its ball where its contact allows; without toes, both feet carry
    as far before their reference points where theirs allow.

    Args:
        step: configurations, velocities and accelerations of a periodic step.
        time: their times, shape (n+1,) [s].
        plan: its first step.
        robot: the body.

    Returns:
        Torques, shape (n+1, nu) [N m], and the moment about the vertical through the ZMP over the vertical
        force, shape (n+1,) [m].
    """
    time = np.minimum(time, plan.duration)
    time[-1] = np.nextafter(time[-1], 0.0) - 1e-9  # the step's end, not the next one's start
    sample, feet = plan.sample(time), plan.feet.sample(time)
    shares = sample.right_load
    torque, twist, rest = np.empty((len(time), robot.nu)), np.empty(len(time)), np.empty(robot.nu)
    for k in range(len(time)):
        q, v = step.q[k], step.v[k]
        terms = robot.jacobian(q)
        soles = terms.jacobian[6:12], terms.jacobian[12:18]
        total = pin.rnea(robot.model, robot.data, q, v, step.acceleration[k])
        wrench = robot.floor_wrench(terms, q, total, 0)
        reference = [feet[0].position[k], feet[1].position[k]]
        share = float(shares[k])
        centre = _centre(reference[0], wrench)
        places = _places(feet, k, centre[0], share, robot.description.sole)
        yaw = (
            wrench[5] - (centre[0] - reference[0][0]) * wrench[1] + (centre[1] - reference[0][1]) * wrench[0]
        )
        passive_torques(robot.passive, q, v, v, rest)
        rest += total[6:]
        for foot, part in ((0, 1.0 - share), (1, share)):
            if part <= 0.0:
                continue
            force = part * wrench[:3]
            y = centre[1] if share in (0.0, 1.0) else reference[foot][1]
            x, y, z = places[foot] - reference[foot][0], y - reference[foot][1], -reference[foot][2]
            fx, fy, fz = force
            load = [fx, fy, fz, y * fz - z * fy, z * fx - x * fz, x * fy - y * fx + part * yaw]
            rest -= np.asarray(load) @ soles[foot][:, 6:]
            if robot.description.sole.has_toes:
                toe = robot.toe_joints[foot] - 6
                axis = reference[foot][0] + robot.description.sole.ball_x * math.cos(feet[foot].pitch[k])
                rest[toe] += max(0.0, places[foot] - axis) * force[2]
        torque[k], twist[k] = rest, yaw / wrench[2]
    return torque, twist


def _centre(point: Array, wrench: Array) -> tuple[float, float]:
    """Where on the floor a wrench about ``point`` has no horizontal moment [m]."""
    fx, fy, fz, mx, my = wrench[:5].tolist()
    # Moment about a floor point c: m - (c - p) x f.
    height = point[2]
    return point[0] - (my + height * fx) / fz, point[1] + (mx - height * fy) / fz


def _places(
    feet: tuple[FootSample, FootSample], k: int, centre: float, share: float, sole: SoleGeometry
) -> tuple[float, float]:
    """X at which left (rear) and right (front) foot carry, so that together they carry at ``centre`` [m]."""
    if share in (0.0, 1.0):
        return centre, centre
    (rear_low, rear_high), (front_low, front_high) = (_carrying(f, k) for f in feet)
    here, there = (float(f.position[k, 0]) for f in feet)
    ahead = sole.ball_x * math.cos(feet[0].pitch[k])
    if not sole.has_toes:
        ahead = centre - (1.0 - share) * here - share * there
    rear = float(np.clip(here + ahead, rear_low, rear_high))
    front = float(np.clip((centre - (1.0 - share) * rear) / share, front_low, front_high))
    rear = float(np.clip((centre - share * front) / (1.0 - share), rear_low, rear_high))
    return rear, front


def _carrying(foot: FootSample, k: int) -> tuple[float, float]:
    """First and last x of a foot's points in contact."""
    points = foot.sole_points[k, :, 0]
    touching = points[np.repeat(foot.contact[k], 2)]
    return (float(touching.min()), float(touching.max())) if touching.size else (float(points[0]),) * 2
