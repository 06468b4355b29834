"""Everything a controller follows that does not depend on the state, evaluated once per run.

A tick of the closed loop only looks up a row: the plan, the feet and the periodic motion are sampled at all
control ticks beforehand.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from ampm.exceptions import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.body.motion import WholeBodyMotion
    from ampm.body.robot import Robot
    from ampm.planner.gait import GaitPlan


@dataclass(frozen=True)
class TrackingReference:
    """References at T control ticks, world frame.

    Attributes:
        time: shape (T,) [s].
        com, com_velocity, com_acceleration: shape (T, 3) [m, m/s, m/s^2].
        angular_momentum: about the COM; x and y the plan's, z the motion's, shape (T, 3) [N m s].
        moment: its rate, shape (T, 3) [N m].
        foot_position, foot_velocity, foot_acceleration: sole reference points, shape (T, 2, 3).
        pitch, pitch_velocity, pitch_acceleration: of the feet, shape (T, 2) [rad].
        toe, toe_velocity, toe_acceleration: toe joints, shape (T, 2) [rad].
        contact: heel, ball, tip of each foot planned in contact, shape (T, 2, 3), bool.
        due: groups whose contact is planned now or shortly: what touches early is taken as contact,
            shape (T, 2, 3), bool.
        until_lift: time until the group's planned lift-off, infinite if none comes, shape (T, 2, 3) [s].
        right_load: share of the weight planned on the right foot, shape (T,) [1].
        q, v, acceleration: the periodic motion in Pinocchio's coordinates, shapes (T, nq), (T, nv), (T, nv).
        trunk: its trunk segment's orientation, shape (T, 3, 3).
    """

    time: NDArray[np.float64]
    com: NDArray[np.float64]
    com_velocity: NDArray[np.float64]
    com_acceleration: NDArray[np.float64]
    angular_momentum: NDArray[np.float64]
    moment: NDArray[np.float64]
    foot_position: NDArray[np.float64]
    foot_velocity: NDArray[np.float64]
    foot_acceleration: NDArray[np.float64]
    pitch: NDArray[np.float64]
    pitch_velocity: NDArray[np.float64]
    pitch_acceleration: NDArray[np.float64]
    toe: NDArray[np.float64]
    toe_velocity: NDArray[np.float64]
    toe_acceleration: NDArray[np.float64]
    contact: NDArray[np.bool_]
    due: NDArray[np.bool_]
    until_lift: NDArray[np.float64]
    right_load: NDArray[np.float64]
    q: NDArray[np.float64]
    v: NDArray[np.float64]
    acceleration: NDArray[np.float64]
    trunk: NDArray[np.float64]

    def __post_init__(self) -> None:
        for value in vars(self).values():
            value.setflags(write=False)

    def __len__(self) -> int:
        return len(self.time)


def tracking_reference(
    plan: GaitPlan,
    motion: WholeBodyMotion,
    robot: Robot,
    times: NDArray[np.float64],
    *,
    lead: float = 0.0,
    early: float = 0.0,
    hold: float = 0.0,
) -> TrackingReference:
    """Sample plan, feet and motion at the control ticks.

    Args:
        plan: carries the motion's constant of L_y, and feet.
        motion: the periodic whole-body step.
        robot: the body.
        times: control ticks, ascending, shape (T,) [s].
        lead: time by which a foot is let down before its planned contact [s].
        early: time before planned contact from which a touch counts as contact [s].
        hold: how long after the tick the last force of its command acts [s]: zero if every tick makes one
            step of the physics. Accelerations are taken from the middle of that time.

    Raises:
        InputError: the plan has no feet, or a time lies outside it.
    """
    if plan.feet is None:
        raise InputError("the plan has no feet; plan the gait with the body's sole and foot parameters")
    plan_feet = plan.feet
    sample, feet, body = plan.sample(times), plan_feet.sample(times), motion.sample(times, robot)
    momentum_z = body.angular_momentum_z
    yaw_moment = np.gradient(momentum_z, times) if len(times) > 1 else np.zeros(len(times))
    middle = np.minimum(times + 0.5 * hold, plan.duration)
    held, held_feet, held_body = plan.sample(middle), plan_feet.sample(middle), motion.sample(middle, robot)
    contact = np.stack([f.contact for f in feet], axis=1)

    def within(span: float) -> NDArray[np.bool_]:
        """Contact now or at the end of a time span."""
        ahead = plan_feet.sample(np.minimum(times + span, plan.duration))
        return contact | np.stack([f.contact for f in ahead], axis=1)

    return TrackingReference(
        time=np.array(times),
        com=sample.com.copy(),
        com_velocity=sample.com_velocity.copy(),
        com_acceleration=held.com_acceleration.copy(),
        angular_momentum=np.hstack([sample.angular_momentum, momentum_z[:, None]]),
        moment=np.hstack([held.moment, yaw_moment[:, None]]),
        foot_position=np.stack([f.position for f in feet], axis=1),
        foot_velocity=np.stack([f.velocity for f in feet], axis=1),
        foot_acceleration=np.stack([f.acceleration for f in held_feet], axis=1),
        pitch=np.stack([f.pitch for f in feet], axis=1),
        pitch_velocity=np.stack([f.pitch_velocity for f in feet], axis=1),
        pitch_acceleration=np.stack([f.pitch_acceleration for f in held_feet], axis=1),
        toe=np.stack([f.toe for f in feet], axis=1),
        toe_velocity=np.stack([f.toe_velocity for f in feet], axis=1),
        toe_acceleration=np.stack([f.toe_acceleration for f in held_feet], axis=1),
        contact=within(lead),
        due=within(early),
        until_lift=_until_lift(times, contact),
        right_load=_right_load(sample.zmp, sample.left_placement, sample.right_placement, sample.stance),
        q=body.q,
        v=body.v,
        acceleration=held_body.acceleration,
        trunk=_trunk_orientation(robot, body.q),
    )


def _trunk_orientation(robot: Robot, q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation of the trunk segment at configurations (T, nq), shape (T, 3, 3)."""
    model, data = robot.model, robot.model.createData()
    trunk = np.empty((len(q), 3, 3))
    for k, configuration in enumerate(q):
        pin.forwardKinematics(model, data, configuration)
        trunk[k] = pin.updateFramePlacement(model, data, robot.trunk_frame).rotation
    return trunk


def _until_lift(times: NDArray[np.float64], contact: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Time from each tick to the end of the present contact, or of the next one."""
    until = np.full(contact.shape, np.inf)
    ticks = np.arange(len(times))
    for foot, group in np.ndindex(contact.shape[1:]):
        planned = contact[:, foot, group]
        lifts = 1 + np.flatnonzero(planned[:-1] & ~planned[1:])
        at = np.append(times[lifts], np.inf)
        until[:, foot, group] = at[np.searchsorted(lifts, ticks, side="right")] - times
    return until


def _right_load(
    zmp: NDArray[np.float64],
    left: NDArray[np.float64],
    right: NDArray[np.float64],
    stance: NDArray[np.int8],
) -> NDArray[np.float64]:
    """Share of the right foot: where the planned ZMP lies between the feet's centre lines."""
    share = (left[:, 1] - zmp[:, 1]) / (left[:, 1] - right[:, 1])
    return np.where(stance == 0, 0.0, np.where(stance == 1, 1.0, np.clip(share, 0.0, 1.0)))
