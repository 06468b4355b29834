"""Recorded control ticks for inverse dynamics by other libraries, and how near their answers are."""

import time
from typing import Any

import numpy as np
import pinocchio as pin

from ampm.body.robot import Robot
from ampm.control.controller import TrackingController
from ampm.geometry import Array
from ampm.walk import ControlOutput, PostureState, Reference, State, Touch
from benchmarks.clock import least
from benchmarks.peers.body import sole_corners, urdf_of
from validation.progress import Progress
from validation.trial.plan import PlannedWalk, load_request, plan_walk
from validation.trial.simulate import simulate

_WALKS = 3


def record(progress: Progress) -> tuple[Robot, dict[str, Any]]:
    """Ticks of a walk with flat feet, with our own answers and the least of their times.

    Arrays: the recorded state q and v; the command com_a [m/s^2] and moment [N m]; planned com, feet (place,
    turn, foot_v, foot_a), trunk and posture; contact (T, 2); our acceleration, torque and seconds. Gains: of
    swinging feet (two), stance feet, posture (two).
    """
    walk = plan_walk(load_request("flat", ["gait.steps=3", "controller.landing_compensation=0"]), progress)
    with progress.stage("recorded ticks"):
        rounds = [_walk(walk) for _ in range(_WALKS)]
    robot, gains = walk.body.robot, walk.run.controller
    ticks = {name: np.stack([tick[name] for tick in rounds[0][0]]) for name in rounds[0][0][0]}
    names = [robot.model.frames[frame].name for frame in robot.sole_frames]
    return robot, ticks | {
        "seconds": least([seconds for _, seconds in rounds]),
        "urdf": urdf_of(robot),
        "hinges": np.array(robot.joint_names),
        "soles": np.array(names),
        "trunk_frame": robot.model.frames[robot.trunk_frame].name,
        "corners": sole_corners(robot),
        "torque_limit": robot.torque_limit,
        "friction": gains.friction,
        "weight": walk.plan.weight,
        "time_step": 1.0 / gains.frequency,
        "gains": np.array(
            [
                gains.swing_stiffness,
                gains.swing_damping,
                gains.stance_damping,
                gains.posture_stiffness,
                gains.posture_damping,
            ]
        ),
    }


def _walk(walk: PlannedWalk) -> tuple[list[dict[str, Any]], list[float]]:
    """Ticks of one walk and their times [s]."""
    ticks: list[dict[str, Any]] = []
    seconds: list[float] = []

    class Recorded(TrackingController):
        def update(self, state: State, touch: Touch, reference: Reference) -> ControlOutput:
            start = time.perf_counter()
            output = super().update(state, touch, reference)
            seconds.append(time.perf_counter() - start)
            command, feet, posture = self.workspace.command, reference.feet, reference.posture
            turning = _trunk_rates(self.robot, posture)
            planned = reference.contacts.planned[:, :2].all(axis=1)  # heel and ball
            ticks.append(
                {
                    "q": state.q.copy(),
                    "v": state.v.copy(),
                    "com_a": command.force / self.robot.mass - [0.0, 0.0, self.robot.gravity],
                    "moment": command.moment.copy(),
                    "com": reference.com,
                    "place": feet.position,
                    "turn": feet.rotation,
                    "foot_v": np.hstack([feet.velocity, feet.angular_velocity]),
                    "foot_a": np.hstack([feet.acceleration, feet.angular_acceleration]),
                    "trunk": posture.trunk,
                    "trunk_v": turning[0],
                    "trunk_a": turning[1],
                    "posture_q": posture.q[7:],
                    "posture_v": posture.v[6:],
                    "posture_a": posture.acceleration[6:],
                    "contact": planned & touch.contact.reshape(2, -1).any(axis=1),
                    "acceleration": self.workspace.motion.acceleration.copy(),
                    "torque": output.torque.copy(),
                }
            )
            return output

    simulate(walk.plan, walk.run, walk.body.model, controller=Recorded)
    return ticks, seconds


def _trunk_rates(robot: Robot, posture: PostureState) -> tuple[Array, Array]:
    """Angular velocity and acceleration of the trunk in world, shape (3,) each."""
    model, data, frame = robot.model, robot.data, (robot.trunk_frame, pin.LOCAL_WORLD_ALIGNED)
    pin.forwardKinematics(model, data, posture.q, posture.v, posture.acceleration)
    velocity, acceleration = pin.getFrameVelocity, pin.getFrameAcceleration
    return velocity(model, data, *frame).angular, acceleration(model, data, *frame).angular


def command_errors(robot: Robot, ticks: dict[str, Any], acceleration: Array) -> tuple[Array, Array]:
    """How far net force [N] and ZMP [m] of accelerations are from those commanded, each shape (T,)."""
    force, zmp = np.empty((2, len(acceleration)))
    up = np.array([0.0, 0.0, robot.gravity])
    for k, (q, v, a) in enumerate(zip(ticks["q"], ticks["v"], acceleration, strict=True)):
        terms = robot.jacobian(q)
        rates = robot.mass * (terms.jacobian[:6] @ a + robot.drift(q, v)[:6])
        rates[:3] += robot.mass * up
        wanted = np.concatenate([robot.mass * (ticks["com_a"][k] + up), ticks["moment"][k]])
        force[k] = np.linalg.norm((rates - wanted)[:3])
        zmp[k] = np.linalg.norm(_zmp(rates, terms.com[2]) - _zmp(wanted, terms.com[2]))
    return force, zmp


def _zmp(wrench: Array, height: float) -> Array:
    """ZMP of net force and moment about the COM, relative to the COM, shape (2,) [m]."""
    f, n = wrench[:3], wrench[3:]
    return np.array([-n[1] - height * f[0], n[0] - height * f[1]]) / f[2]
