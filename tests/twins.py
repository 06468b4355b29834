"""Plain twins of the compiled steps of a control tick, by NumPy and Pinocchio, as a textbook states them.

A twin reads the workspace ``c`` after its tick and ``old`` as it was before, see
:mod:`ampm.control.workspace`, and returns what its step has to write there.
"""

import math
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull

from ampm.control import contact_qp, forces, sole
from ampm.control.contact_gate import OFF
from ampm.control.hold import LARGEST_CHANGE
from ampm.control.tasks import HURRIED, STANCE, SWING
from ampm.control.workspace import ANGULAR, BALL, HEEL, LONGEST, TIP

ALIGNED = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
UP = np.array([0.0, 0.0, 1.0])
SCALE = np.array([1.0, 1.0, 1.0, ANGULAR, ANGULAR, ANGULAR])

# ------------------------------------------------------------------------------ the body, by Pinocchio


def frames(robot, q, numbers):
    """Places (k, 3) and rotations (k, 3, 3) of frames."""
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    return [np.array([getattr(data.oMf[k], part) for k in numbers]) for part in ("translation", "rotation")]


def frame_jacobians(robot, q, numbers):
    data = robot.model.createData()
    pin.computeJointJacobians(robot.model, data, q)
    pin.updateFramePlacements(robot.model, data)
    return [pin.getFrameJacobian(robot.model, data, number, ALIGNED) for number in numbers]


def task_jacobian(robot, q):
    """Momentum over the mass, soles, toes: shape (R, nv)."""
    momentum = pin.computeCentroidalMap(robot.model, robot.model.createData(), q) / robot.mass
    return np.vstack(
        [momentum, *frame_jacobians(robot, q, robot.sole_frames), np.eye(robot.nv)[robot.toe_joints]]
    )


def drift(robot, q, v, now):
    """Rates of momentum (at v) and soles (at ``now``) without accelerations of the coordinates."""
    model, data, still = robot.model, robot.model.createData(), np.zeros(robot.nv)
    momentum = pin.computeCentroidalMomentumTimeVariation(model, data, q, v, still).vector / robot.mass
    pin.forwardKinematics(model, data, q, now, still)
    soles = [
        pin.getFrameClassicalAcceleration(model, data, sole, ALIGNED).vector for sole in robot.sole_frames
    ]
    return np.concatenate([momentum, *soles, np.zeros(len(robot.toe_joints))])


def inverse_dynamics(robot, q, v, acceleration, point_force):
    """``M qdd + h - sum J' f``: of the root, which nothing drives, and of the hinges, shape (nv,)."""
    total = pin.rnea(robot.model, robot.model.createData(), q, v, acceleration)
    for jacobian, force in zip(frame_jacobians(robot, q, robot.point_frames), point_force, strict=True):
        total = total - jacobian[:3].T @ force
    return total


def passive(robot, q, v, direction):
    """Dampers, springs and dry friction."""
    damping, stiffness, rest, friction = robot.passive.T
    return damping * v[6:] + stiffness * (q[7:] - rest) + friction * np.tanh(direction[6:] / 0.05)


def rotation_error(wanted, actual):
    """Skew part of ``wanted actual'``."""
    turn = wanted @ actual.T
    return np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2.0


# ------------------------------------------------------------------------------ contacts and command


def gate(c, old, touching, first, close_lifted_tips):
    """Lines of this tick by their names, and whether one of them lands."""
    planned, due, until_lift = c.wanted.planned, c.wanted.due, c.wanted.until_lift
    ramp, line = c.gains.contact_ramp, old.contact.lines
    before = planned if first else line["touched"]
    opened = planned.astype(float) if first else line["opening"]
    touched = due & (before | touching)
    touched[:, TIP] &= touched[:, BALL]
    opening = np.where(touched, np.minimum(opened + 1.0 / (c.gains.frequency * ramp), 1.0), 0.0)
    limit = np.minimum(opening, until_lift / ramp)
    off = np.where(touching, 0, line["off"] + 1)
    if close_lifted_tips:
        limit[:, TIP][(off > OFF)[:, TIP] & (until_lift > ramp)[:, TIP]] = 0.0
    landing = ((opening < 1.0) & (touching | (opening > 0.0))).any()
    if not (limit > 0.0).any():
        alone = np.zeros_like(due)
        alone[:, TIP] = due[:, TIP] & touching[:, TIP]
        touched, opening, limit = touched | alone, np.where(alone, 1.0, opening), np.where(alone, 1.0, limit)
    return {"touched": touched, "opening": opening, "limit": limit, "off": off, "touching": touching}, landing


class MeanTilt:
    """Mean of the trunk's tilt over a window in the body's axes, and the integral of this mean."""

    def __init__(self, gains):
        self.gains, self.past, self.integral, self.longest = gains, [], np.zeros(2), 0

    def update(self, tilt, trunk, window):
        """The tilt that is fed back."""
        ticks = min(round(window * self.gains.frequency), math.ceil(LONGEST * self.gains.frequency))
        if ticks == 0:
            self.past, self.integral, self.longest = [], np.zeros(2), 0
            return tilt
        x = trunk[:2, 0] / np.linalg.norm(trunk[:2, 0])
        axes = np.array([x, [-x[1], x[0]]])
        self.longest = max(self.longest, ticks)
        self.past.append(axes @ tilt[:2])
        mean = np.sum(self.past[-self.longest :], axis=0) / self.longest
        self.integral += mean / self.gains.frequency
        slow = axes.T @ (mean + self.gains.trunk_integral * self.integral)
        share = ticks / self.longest
        return np.array([*(share * slow + (1.0 - share) * tilt[:2]), tilt[2]])


def command_wrench(c, tilt):
    """Force and moment of the ground, and angular momentum."""
    g, m, rates, wanted = c.gains, c.body.mass, c.tasks.rates, c.wanted
    feedback = g.com_damping * (wanted.com_velocity - rates[:3]) + g.com_stiffness * (wanted.com - c.body.com)
    force = m * (wanted.com_acceleration + c.body.gravity * UP + feedback)
    momentum = wanted.angular_momentum + g.trunk_gain * tilt * [1.0, 1.0, 0.0]
    return force, wanted.moment + g.momentum_gain * (momentum - m * rates[3:6]), momentum


def zmp(com, force, moment):
    """Where the wrench has no horizontal moment on z = 0."""
    at_origin = moment + np.cross(com, force)
    return np.array([-at_origin[1], at_origin[0]]) / force[2]


def shared(c, force, moment):
    """Force and moment that the sole can give, and whether these are others than wanted."""
    state, wanted, com, m = c.stepping[0], c.wanted, c.body.com, c.body.mass
    force = state["force_factor"] * force
    if not state["active"]:
        return force, moment, False
    points = (com + c.body.points["arm"])[c.body.points["limit"] > sole.OPEN, :2]
    if force[2] < 0.2 * m * c.body.gravity or not len(points):
        return force, moment, False
    cos, sin = state["heading"]
    axes = np.array([[cos, sin], [-sin, cos]])
    points, down = points @ axes.T, c.body.gravity + wanted.com_acceleration[2]
    height = com[2] - state["floor"]
    planned_r = wanted.com[:2] - (wanted.com[2] - state["floor"]) / down * wanted.com_acceleration[:2]
    planned_arm = np.array([-wanted.moment[1], wanted.moment[0]]) / (m * down)
    r_shift = axes @ (com[:2] - height * force[:2] / force[2] - planned_r)
    arm_shift = axes @ (np.array([-moment[1], moment[0]]) / force[2] - planned_arm)
    planned = axes @ (planned_r + planned_arm)
    low, high = points.min(axis=0) - planned, points.max(axis=0) - planned
    if state["off_plan"]:
        wish = planned + r_shift + arm_shift
        held = nearest(points, wish)
        low, high = (
            np.where(held > wish, held - planned, low),
            np.where(held < wish, held - planned, high),
        )
    else:
        low, high = np.minimum(low, 0.0), np.maximum(high, 0.0)
    r, arm = np.transpose(
        [share_axis(*axis, state["com_first"]) for axis in zip(r_shift, arm_shift, low, high, strict=True)]
    )
    force = force - np.array([*(axes.T @ (r - r_shift)) * force[2] / height, 0.0])
    change = axes.T @ (arm - arm_shift) * force[2]
    changed = (r != r_shift).any() or (arm != arm_shift).any()
    return force, moment + np.array([change[1], -change[0], 0.0]), changed


def share_axis(r, arm, low, high, com_first):
    """Shifts of r and of the moment's arm with their sum, and r itself, within the sole."""
    if low <= r + arm <= high and low <= r <= high:
        return r, arm
    if com_first:
        r = np.clip(r, low, high)
        return r, np.clip(r + arm, low, high) - r
    least = sole.TRUNK_LEAST
    arm = np.clip(arm, min(sole.TRUNK_SHARE * low, -least), max(sole.TRUNK_SHARE * high, least))
    return np.clip(r + arm, low, high) - arm, arm


def nearest(points, place):
    """The point of the points' hull nearest to a place, in a metric that counts distances across thrice."""
    metric = np.array([1.0, sole.ACROSS])
    corners, place = points * metric, place * metric
    if len(points) > 2:
        hull = ConvexHull(corners)
        if (hull.equations @ [*place, 1.0] <= 0.0).all():
            return place / metric
        corners = corners[hull.vertices]
    found = []
    for a, b in pairwise([*corners, corners[0]]):
        part = np.clip((place - a) @ (b - a) / max((b - a) @ (b - a), 1e-30), 0.0, 1.0)
        found.append(a + part * (b - a))
    return min(found, key=lambda at: np.linalg.norm(at - place)) / metric


# ------------------------------------------------------------------------------ tasks


def sole_task(c, old, i):
    """Acceleration wanted of a sole (6,), its softness, upward speed of the line that holds it or None."""
    g, wanted, lines, was = c.gains, c.wanted, c.contact.lines[i], old.body.feet[i]
    pose, place = c.body.feet[i]["pose"], c.body.feet[i]["place"]
    velocity, omega = c.tasks.rates[6 + 6 * i : 12 + 6 * i].reshape(2, 3)
    error = rotation_error(wanted.foot_rotation[i], pose)
    touched = lines["touched"]
    on = lines["planned"] | touched
    if not on.any():  # it swings
        linear = g.swing_stiffness * (wanted.foot_position[i] - c.body.com - place)
        linear += g.swing_damping * (wanted.foot_velocity[i] - velocity) + wanted.foot_acceleration[i]
        angular = g.swing_stiffness * error + wanted.foot_angular_acceleration[i]
        angular += g.swing_damping * (wanted.foot_angular_velocity[i] - omega)
        return np.hstack([linear, angular]), HURRIED if c.stepping[0]["off_plan"] else SWING, None
    opening = max(lines["opening"][HEEL], lines["opening"][BALL])
    press = 1.0 - opening if lines["planned"].any() else 0.0
    damping = (1.0 - press) * g.stance_damping + press * g.touchdown_damping

    def vertical(speed):
        asked = -damping * (speed + press * g.touchdown_velocity)
        same = was["on_heel"] == touched[HEEL] and was["on_ball"] == touched[BALL]
        yields = press * g.landing_yield * (was["stood"] and same and lines["touching"].any())
        return (1.0 - yields) * asked + yields * (speed - was["speed"]) * g.frequency

    whole = on[HEEL] and on[BALL] and (on[TIP] or c.body.feet[i]["toe"] < 0)
    if whole and touched[HEEL] and touched[BALL]:  # it stands flat
        linear = np.array([*-damping * velocity[:2], vertical(velocity[2])])
        return np.hstack([linear, -g.stance_damping * omega]), STANCE, velocity[2]
    cos, sin = wanted.foot_rotation[i, 1, 1], -wanted.foot_rotation[i, 0, 1]
    heading = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    angular = heading.T @ (g.roll_stiffness * error - g.roll_damping * omega)
    if whole:  # a line is late: the sole turns to the floor
        towards = 0.0 if not touched.any() else 1.0 if touched[HEEL] else -1.0
        angular[1] = g.roll_damping * (towards * g.touchdown_rate - (heading.T @ omega)[1])
    else:  # it rolls
        angular[1] += (heading.T @ wanted.foot_angular_acceleration[i])[1]
        angular[1] += g.roll_damping * (heading.T @ wanted.foot_angular_velocity[i])[1]
        angular[1] -= 0.0 if on[BALL] else g.roll_stiffness * g.roll_down_bias
    angular = heading @ angular
    on_heel = touched[HEEL] if touched.any() else on[HEEL]
    points = c.body.points
    line = (points["foot"] == i) & (points["line"] == (HEEL if on_heel else BALL))
    pivot = points["arm"][line].mean(axis=0) - place
    speed = velocity + np.cross(omega, pivot)
    still = np.array([*-damping * speed[:2], vertical(speed[2])])  # of the line, about which the sole turns
    linear = still - np.cross(angular, pivot) - np.cross(omega, np.cross(omega, pivot))
    return np.hstack([linear, angular]), STANCE, speed[2]


def toe_task(c, i, angle, rate):
    g, (wanted, wanted_rate, acceleration) = c.gains, c.wanted.foot_toe[i]
    return acceleration + g.swing_stiffness * (wanted - angle) + g.swing_damping * (wanted_rate - rate)


def posture_task(c, q, now):
    """PD on hinges and root; of the root's rotation twice the vector of the quaternion's error."""
    error = pin.Quaternion(q[3:7]).conjugate() * pin.Quaternion(c.wanted.q[3:7])
    off = np.concatenate([np.zeros(3), 2.0 * error.vec(), c.wanted.q[7:] - q[7:]])
    return (
        c.wanted.acceleration + c.gains.posture_damping * (c.wanted.v - now) + c.gains.posture_stiffness * off
    )


# ------------------------------------------------------------------------------ elimination and QP


class Eliminated(NamedTuple):
    """Of six unit net wrenches, and of the rows without one."""

    accelerations: Any  # (nv, 7)
    multipliers: Any  # (R, 7)


def eliminate(weights, jacobian, rhs, posture, softness):
    """min 1/2 |a - posture|^2_W + 1/2 sum e^2 / softness    with    jacobian a = rhs + (wrench, 0) + e"""
    nv = len(weights)
    system = np.block([[np.diag(weights), jacobian.T], [jacobian, -np.diag(softness)]])
    right = np.zeros((len(system), 7))
    right[nv : nv + 6, :6] = np.eye(6)
    right[:, 6] = [*weights * posture, *rhs]
    solution = np.linalg.solve(system, right)
    return Eliminated(solution[:nv], -solution[nv:])


def share(c, old):
    """Share of every point in its foot's tangential forces."""
    points, limit = c.body.points, np.maximum(c.body.points["limit"], 1e-3)
    if c.stepping[0]["off_plan"]:
        limit = np.maximum(by_foot(c, old.contact.forces)[:, :-3].ravel(), 1e-3)
    return limit / np.array([limit[points["foot"] == foot].sum() for foot in points["foot"]])


def by_foot(c, values):
    return values.reshape(len(c.body.feet), -1)


def force_map(c, old):
    """Forces at the points for the unknowns, shape (P, 3, U), and the points' levers (P,) [m]."""
    points, feet = c.body.points, len(c.body.feet)
    per_foot, part = len(points) // feet, share(c, old)
    out, lever = np.zeros((len(points), 3, feet * (per_foot + 3))), np.zeros(len(points))
    for foot in range(feet):
        mine = np.arange(per_foot * foot, per_foot * (foot + 1))
        first, arm = (per_foot + 3) * foot, points["arm"][mine] * [1.0, 1.0, 0.0]
        arm = arm - part[mine] @ arm
        out[mine, 2, first + np.arange(per_foot)] = 1.0
        out[mine, 0, first + per_foot] = out[mine, 1, first + per_foot + 1] = part[mine]
        twist = part[mine, None] * np.cross(UP, arm)
        out[mine, :, first + per_foot + 2] = forces.TWIST_ARM * twist / np.cross(arm, twist)[:, 2].sum()
        lever[mine] = np.linalg.norm(arm, axis=1)
    return out, lever


def wrench_map(c, by_point):
    """Net force and moment about the COM of the unknowns, shape (6, U)."""
    moment = ANGULAR * np.cross(c.body.points["arm"][:, :, None], by_point, axisa=1, axisb=1, axisc=1)
    return np.vstack([by_point.sum(axis=0), moment.sum(axis=0)])


def bounds(c, old, landing, load_age):
    """Least and largest normal forces (P,), and what landing points miss of their force (P,) [m g]."""
    g, points, weight = c.gains, c.body.points, c.body.mass * c.body.gravity
    least = forces.LEAST_NORMAL * points["limit"]
    most = forces.LARGEST_PUSHED if c.stepping[0]["off_plan"] else forces.LARGEST_NORMAL
    largest, missing = np.maximum(most * points["limit"], least), np.zeros(len(points))
    if landing:
        opens = (points["opening"] > 0.0) & (points["opening"] < 1.0)
        pushed = points["touching"] & (points["opening"] < 1.0)
        given = np.where(pushed, g.landing_share * points["sensed"] / weight, 0.0)
        given = np.where(opens & (points["line"] != TIP), np.maximum(given, g.landing_force), given)
        least = np.maximum(least, given)
        since = 1.0 - load_age * g.frequency if c.extrapolates else 0.0
        asked = by_foot(c, old.contact.forces + since * old.contact.change)[:, :-3].ravel()
        missing = np.where(opens, g.landing_compensation * (points["sensed"] / weight - asked), 0.0)
    return least, np.maximum(largest, least), missing


def qp(c, command, by_point, lever, limits, curvature, gradient):
    """P, q, A, lower, upper of the contact forces and six slacks.

    The costs: slacks, forces, the feet's load, and the vertical moment, of which ``curvature`` and
    ``gradient`` are those of the posture's cost.
    """
    points, feet = c.body.points, len(c.body.feet)
    per_foot, wrench, mu = len(points) // feet, wrench_map(c, by_point), c.gains.friction
    unknowns = wrench.shape[1]
    index = np.arange(unknowns).reshape(feet, -1)
    normal, tangent = index[:, :-3].ravel(), index[:, -3:].ravel()
    loads = np.array([1.0 - c.wanted.right_load[0], c.wanted.right_load[0]])
    tip = points["line"] == TIP
    diagonal = np.ones(unknowns + 6)
    diagonal[normal] = np.where(tip, contact_qp.TIP_COST, forces.NORMAL_COST)
    diagonal[tangent] = np.repeat(contact_qp.TANGENT_COST / np.maximum(loads, contact_qp.LEAST_LOAD), 3)
    right, yaw = np.zeros((2, unknowns + 6))
    right[index[1, :-3]], yaw[tangent] = 1.0, wrench[5, tangent]
    P = np.diag(diagonal) + contact_qp.LOAD_COST * np.outer(right, right)
    P += contact_qp.YAW_COST * curvature * np.outer(yaw, yaw)
    q = contact_qp.YAW_COST * gradient * yaw - contact_qp.LOAD_COST * loads[1] * right
    open_share = np.where(tip, 0.0, np.maximum(points["limit"], 1e-3))
    open_share = by_foot(c, open_share) / by_foot(c, open_share).sum(axis=1, keepdims=True)
    q[normal] -= forces.NORMAL_COST * (loads[:, None] * open_share).ravel()
    rows = [np.hstack([wrench, -np.diag(contact_qp.MOMENTUM_SLACK)])]
    for foot in range(feet):  # |x| + |y| <= mu sum n, |twist| <= share mu sum lever n
        for x, y, turn in ((1, 1, 0), (1, -1, 0), (-1, 1, 0), (-1, -1, 0), (0, 0, 1), (0, 0, -1)):
            row = np.zeros(unknowns + 6)
            arm = lever[per_foot * foot : per_foot * (foot + 1)] / forces.TWIST_ARM
            row[index[foot, :-3]] = -mu * (contact_qp.TWIST_SHARE * arm if turn else 1.0)
            row[index[foot, -3:]] = x, y, turn
            rows.append(row[None])
    rows.append(np.eye(unknowns + 6)[normal])
    least, largest, missing = limits
    momentum = SCALE * np.hstack([command.force, command.moment]) / (c.body.mass * c.body.gravity)
    momentum = momentum - wrench[:, normal] @ missing
    lower = np.hstack([momentum, np.full(6 * feet, -np.inf), least])
    return P, q, np.vstack(rows), lower, np.hstack([momentum, np.zeros(6 * feet), largest])


# ------------------------------------------------------------------------------ after the QP


def breaks_limit(c, torque):
    """Whether a torque is too large, or a joint too fast in 10 ms to brake with 500 rad/s^2 in its range."""
    q, joints = c.sensed.q[7:], c.joints
    rate = c.sensed.v[6:] + 0.01 * c.motion.acceleration[6:]
    up, down = (np.sqrt(1000.0 * np.maximum(room, 0.0)) for room in (joints.upper - q, q - joints.lower))
    return (np.abs(torque) > joints.torque_limit).any() or (rate > up).any() or (-rate > down).any()


def rate(c, old, still):
    """Rates at which the torques go on."""
    lines, was = c.contact.lines, old.contact.lines
    opens = lines["touching"] & (lines["opening"] > 0.0) & (lines["opening"] < 1.0)
    if still:
        return np.zeros_like(c.joints.rate)
    if (lines["planned"] != was["was_planned"]).any() or (opens != was["was_opening"]).any():
        return old.joints.rate
    largest = LARGEST_CHANGE * c.joints.torque_limit
    return np.clip(c.joints.torque - old.joints.last_torque, -largest, largest) * c.gains.frequency
