"""Distances of a gait from the limits of formula, body and floor, by plan and periodic step alone.

The torques are those of inverse dynamics under the ground force that the plan needs.
"""

from collections.abc import Mapping

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ampm.body.feasibility import joint_groups, leg_extension
from ampm.body.limits import LIMITS
from ampm.body.motion import WholeBodyMotion
from ampm.body.return_map import Orbit
from ampm.body.robot import Robot
from ampm.body.step_kinematics import StepTrajectory
from ampm.description import BodyDescription, SoleGeometry
from ampm.geometry import Array
from ampm.parameters import GRAVITY, GaitParameters, RunParameters
from ampm.planner.centroidal import CentroidalPlan
from ampm.planner.feet import HEEL, FootSample
from ampm.planner.support import StepPlan, margin_on

_BETWEEN = np.array([0.2, 0.4, 0.6, 0.8])  # places between two nodes
_NARROW = 3  # nodes with the least distances, next to which it is also looked
_SWING_ENDS = 0.2  # share of the swing at either end in which the sole's height grows with time's cube
_RISE = 0.025  # a heel without toes that rises in less counts as turning faster, by the square [s]
_HANDOVER = 0.04  # in which the load can go from foot to foot [s]
_TWIST_LEVER = 0.03  # moment about the vertical over the force that a foot on its ball gives easily [m]


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
    sample, feet = plan.sample(times), plan.feet.sample(times)
    margin, force = margin_on(feet, sample.zmp), sample.force
    toes = description.sole.has_toes
    level = ~double & feet[0].contact[:, HEEL]  # a rising heel leaves the ZMP on the edge
    share = times / plan.contacts.phases[0].duration
    swing = plan.feet.heights(feet)[:, 1]
    double_support = plan.constants.double_support_duration
    rise = double_support + run.foot.heel_rise_lead
    quick = 1.0 if toes else max(_RISE / max(rise, 1e-3), 1.0) ** 2
    turn = max(run.foot.toe_off_rate * quick, run.foot.heel_strike_rate)
    near = np.minimum(share, 1.0 - share) / _SWING_ENDS
    ends = [(near > 0.1) & (near < 1.0) & side for side in (share < 0.5, share > 0.5)]
    handover = ["handover"] if toes else ["edge_handover", "edge_least"]
    values = {
        "mid_stance": mid_stance_share(run.gait),
        "zmp_single": [part.min() for part in np.array_split(margin[level], 2)],
        "zmp_double" if toes else "zmp_edge": [part.min() for part in np.array_split(margin[~level], 2)],
        "reach": leg_extension(sample.com, feet, description),
        "floor": [(swing[end] / near[end] ** 3).min() for end in ends],
        "clearance": swing[(share > _SWING_ENDS) & (share < 1.0 - _SWING_ENDS)].min(),
        "turn": turn if run.foot.schedule == "roll" else 0.0,
        **dict.fromkeys(handover, double_support / _HANDOVER),
        "pace": plan.constants.step_duration,
        "friction": (np.hypot(force[:, 0], force[:, 1]) / force[:, 2]).max() / run.controller.friction,
    }
    return {name: np.atleast_1d(value) for name, value in values.items()}


def tightest(values: Mapping[str, Array]) -> dict[str, float]:
    """The value with the least margin of every limit."""
    return {name: float(min(every, key=LIMITS[name].margin)) for name, every in values.items()}


def least_margin(values: Mapping[str, float]) -> float:
    """The least normalised margin of values by limit [1]."""
    return min(LIMITS[name].margin(value) for name, value in values.items())


def orbit_margins(orbit: Orbit, plan: StepPlan, robot: Robot) -> dict[str, Array]:
    """Values that the periodic step gives, by name in :data:`LIMITS`, in its unit.

    Returns:
        One or more values of each limit: of a group of joints the extremes of every joint, on either side of
        its range, in single and in double support.
    """
    time, step = orbit.reference.time, orbit.trajectory
    torque, twist = step_torques(step, time, plan, robot)
    share, angles = np.abs(torque) / robot.torque_limit, step.q[:, 7:]
    single = time < plan.constants.single_support_duration - 1e-9
    phases = single, ~single
    values = {
        "twist": np.array([np.abs(twist[phase]).max() for phase in phases]) / _TWIST_LEVER,
        "gap": _gaps(step, time, robot),
    }
    if robot.roll_rows.size:
        turns = np.stack([robot.jacobian(q).sole_turn for q in step.q[~single]])
        values["sole_roll"] = np.abs(np.arctan2(turns[..., 2, 1], turns[..., 2, 2])).max(axis=0)
    if (limited := np.isfinite(robot.speed_limit)).any():
        values["speed"] = (np.abs(step.v[:, 6:]).max(axis=0) / robot.speed_limit)[limited]
    low = np.stack([angles[phase].min(axis=0) for phase in phases])
    high = np.stack([angles[phase].max(axis=0) for phase in phases])
    most = np.stack([share[phase].max(axis=0) for phase in phases])
    for name, names in joint_groups(robot.description).items():
        joints = robot.velocity_indices(names) - 6
        margins = low[:, joints] - robot.lower[joints], robot.upper[joints] - high[:, joints]
        values[name] = np.concatenate(margins).ravel()
        values[f"{name}_torque"] = most[:, joints].ravel()
        if name == "hip":
            last_fifth = np.clip((share[:, joints] - 0.8) / 0.2, 0.0, 1.0)
            values["hip_time"] = np.trapezoid(last_fifth, time, axis=0) / time[-1]
    knee = [robot.knee_flexion(step.q[phase]).min(axis=0) for phase in phases]
    low, high = values["knee"].reshape(2, -1)  # of both ends; the flexion keeps the straight one
    bent = np.where(np.tile([leg.knee_sign > 0.0 for leg in robot.description.legs], len(phases)), high, low)
    return {**values, "knee": np.concatenate(knee), "knee_range": bent}


def _gaps(step: StepTrajectory, time: Array, robot: Robot) -> Array:
    """Least distance of an arm and of the legs from another part, also between two nodes [m]."""
    at_nodes, between = robot.step_gaps(step.q), []
    for k in np.argsort(at_nodes.distance, kind="stable")[:_NARROW]:
        ends = max(k - 1, 0), min(k + 1, len(time) - 1)
        for t in np.concatenate([(time[end] - time[k]) * _BETWEEN for end in ends]):
            change = t * step.v[k] + 0.5 * t**2 * step.acceleration[k]
            between.append(pin.integrate(robot.model, step.q[k], change))
    more = robot.step_gaps(np.array(between))
    distance, parts = np.append(at_nodes.distance, more.distance), at_nodes.parts + more.parts
    arms = np.array([robot.of_arm(names) for names in parts])
    return np.array([distance[those].min(initial=LIMITS["gap"].target) for those in (arms, ~arms)])


def step_torques(
    step: StepTrajectory | WholeBodyMotion, time: Array, plan: StepPlan, robot: Robot
) -> tuple[Array, Array]:
    """Joint torques of a periodic step, and its twisting moment on the floor.

    In single support the force is known from the motion; in double support it is shared by the lateral place
    of the ZMP where the points in contact allow. The rear foot then carries at its ball if it can; without
    toes, both feet carry as far before their reference points if they can.

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
    feet, right = plan.feet.sample(time), plan.sample(time).right_load
    unsupported = robot.unsupported(step.q, step.v, step.acceleration)
    torque, force, moment, _ = unsupported
    # The moment about the origin is zmp x force, and the twist about the vertical through the ZMP.
    x, y = -moment[:, 1] / force[:, 2], moment[:, 0] / force[:, 2]
    twist = moment[:, 2] - x * force[:, 1] + y * force[:, 0]
    sole = robot.description.sole
    right, points = shared_load(feet, np.stack([x, y], axis=1), right, sole)
    for foot, share in ((0, 1.0 - right), (1, right)):
        place, load = feet[foot].position, share[:, None] * force
        turning = np.cross(points[foot] - place, load)
        turning[:, 2] += share * twist
        torque -= unsupported.taken(foot, load, turning)
        if sole.has_toes:
            axis = place[:, 0] + sole.ball_x * np.cos(feet[foot].pitch)
            torque[:, robot.toe_joints[foot] - 6] += np.maximum(0.0, points[foot][:, 0] - axis) * load[:, 2]
    return torque, twist / force[:, 2]


def shared_load(
    feet: tuple[FootSample, FootSample], zmp: Array, wanted: Array, sole: SoleGeometry
) -> tuple[Array, Array]:
    """Shares of two feet in the load and the points at which they carry it, so that the ZMP is met.

    Args:
        feet: left (rear) and right (front) one, at n instants.
        zmp: shape (n, 2) [m].
        wanted: share of the right foot, shape (n,) [1].
        sole: of the feet.

    Returns:
        Share of the right foot, without toes the nearest to the wanted one that the points in contact allow,
        shape (n,) [1]; points of both on z = 0, shape (2, n, 3) [m], for a foot without load the ZMP.
    """
    right, x, both = wanted, zmp[:, 0], (wanted > 0.0) & (wanted < 1.0)
    rear_x, front_x = (foot.position[:, 0] for foot in feet)
    (rear_low, rear_high), (front_low, front_high) = map(_extent, feet)
    with np.errstate(divide="ignore", invalid="ignore"):
        if not sole.has_toes:  # with toes the heel rises as the ZMP comes to the ball
            least = np.where(front_high > rear_high, (x - rear_high) / (front_high - rear_high), 0.0)
            most = np.where(front_low > rear_low, (x - rear_low) / (front_low - rear_low), 1.0)
            right = np.where(both, np.clip(right, least.clip(0.0, 1.0), most.clip(0.0, 1.0)), right)
        left = 1.0 - right
        ahead = sole.ball_x * np.cos(feet[0].pitch) if sole.has_toes else x - left * rear_x - right * front_x
        rear = np.clip(rear_x + ahead, rear_low, rear_high)
        front = np.clip((x - left * rear) / right, front_low, front_high)
        rear = np.clip((x - right * front) / left, rear_low, rear_high)
    both &= (right > 0.0) & (right < 1.0)
    points = np.zeros((2, len(zmp), 3))
    points[..., :2] = zmp
    points[:, both, 0] = rear[both], front[both]
    places = np.stack([foot.position[:, 1] for foot in feet])
    points[:, both, 1] = (places + (wanted - right) * (places[1] - places[0]))[:, both]
    return right, points


def _extent(foot: FootSample) -> tuple[Array, Array]:
    """First and last x of a foot's points in contact, of its heel where none is, shape (n,) each [m]."""
    x, touching = foot.sole_points[:, :, 0], np.repeat(foot.contact, 2, axis=1)
    touching = touching | (~touching.any(axis=1, keepdims=True) & (np.arange(x.shape[1]) == 0))
    return np.where(touching, x, np.inf).min(axis=1), np.where(touching, x, -np.inf).max(axis=1)
