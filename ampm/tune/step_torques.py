"""What a planned step asks of joints and floor: inverse dynamics under the ground force it needs."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.body.return_map import Orbit
    from ampm.body.robot import Robot
    from ampm.planner.feet import FootSample
    from ampm.planner.support import StepPlan

    Array = NDArray[np.float64]


def step_torques(orbit: Orbit, plan: StepPlan, robot: Robot) -> tuple[Array, Array]:
    """Joint torques of a periodic step, and how hard it twists on the floor.

    In single support the force is known from the motion; in double support it is shared by the lateral place
    of the ZMP, the rear foot carrying at its ball where its contact allows.

    Args:
        orbit: the step.
        plan: its first step.
        robot: the body.

    Returns:
        Torques, shape (n+1, nu) [N m], and the moment about the vertical through the ZMP over the vertical
        force, shape (n+1,) [m].
    """
    trajectory, time = orbit.trajectory, np.minimum(orbit.reference.time, plan.duration)
    time = time.copy()
    time[-1] = np.nextafter(time[-1], 0.0) - 1e-9  # the step's end, not the next one's start
    sample, feet = plan.sample(time), plan.feet.sample(time)
    torque, twist = np.empty((len(time), robot.nu)), np.empty(len(time))
    for k in range(len(time)):
        q, v = trajectory.q[k], trajectory.v[k]
        jacobian = robot.jacobian(q, v).jacobian
        soles = [jacobian[6:12].copy(), jacobian[12:18].copy()]
        total = pin.rnea(robot.model, robot.data, q, v, trajectory.acceleration[k])
        wrench = np.linalg.solve(soles[0][:, :6].T, total[:6])  # force and moment about the left sole
        reference = [feet[0].position[k], feet[1].position[k]]
        share = _right_share(
            sample.phase[k], sample.zmp[k], sample.left_placement[k], sample.right_placement[k]
        )
        centre = _centre(reference[0], wrench)
        places = _places(feet, k, centre[0], share, robot.description.sole.ball_x)
        yaw = (
            wrench[5] - (centre[0] - reference[0][0]) * wrench[1] + (centre[1] - reference[0][1]) * wrench[0]
        )
        rest = total[6:].copy()
        for foot, part in ((0, 1.0 - share), (1, share)):
            if part <= 0.0:
                continue
            force = part * wrench[:3]
            y = centre[1] if share in (0.0, 1.0) else reference[foot][1]
            at = np.array([places[foot], y, 0.0])
            moment = np.cross(at - reference[foot], force)
            moment[2] += part * yaw
            rest -= soles[foot][:3, 6:].T @ force + soles[foot][3:, 6:].T @ moment
            toe = robot.toe_joints[foot] - 6
            axis = reference[foot][0] + robot.description.sole.ball_x * math.cos(feet[foot].pitch[k])
            rest[toe] += max(0.0, places[foot] - axis) * force[2]
        torque[k], twist[k] = rest, yaw / wrench[2]
    return torque, twist


def _right_share(phase: int, zmp: Array, left: Array, right: Array) -> float:
    """Share of the ground force under the right foot; the left one stands first."""
    if phase == 0:
        return 0.0
    return float(np.clip((left[1] - zmp[1]) / (left[1] - right[1]), 0.0, 1.0))


def _centre(point: Array, wrench: Array) -> tuple[float, float]:
    """Where on the floor a wrench about ``point`` has no horizontal moment [m]."""
    fx, fy, fz, mx, my = wrench[:5].tolist()
    # Moment about a floor point c: m - (c - p) x f.
    height = point[2]
    return point[0] - (my + height * fx) / fz, point[1] + (mx - height * fy) / fz


def _places(
    feet: tuple[FootSample, FootSample], k: int, centre: float, share: float, ball: float
) -> tuple[float, float]:
    """X at which left (rear) and right (front) foot carry, so that together they carry at ``centre`` [m]."""
    if share in (0.0, 1.0):
        return centre, centre
    (rear_low, rear_high), (front_low, front_high) = (_carrying(f, k) for f in feet)
    rear = float(np.clip(feet[0].position[k, 0] + ball * math.cos(feet[0].pitch[k]), rear_low, rear_high))
    front = float(np.clip((centre - (1.0 - share) * rear) / share, front_low, front_high))
    rear = float(np.clip((centre - share * front) / (1.0 - share), rear_low, rear_high))
    return rear, front


def _carrying(foot: FootSample, k: int) -> tuple[float, float]:
    """First and last x of a foot's points in contact."""
    points = foot.sole_points[k, :, 0]
    touching = points[np.repeat(foot.contact[k], 2)]
    return (float(touching.min()), float(touching.max())) if touching.size else (float(points[0]),) * 2
