"""TSID's inverse dynamics as controller, for gaits on flat feet. It needs the extra ``tsid``.

ampm validate flat --controller docs.examples.tsid_controller:TsidController
"""

import time
from typing import Any

import numpy as np
import pinocchio as pin

from ampm.body.robot import Robot
from ampm.exceptions import InputError
from ampm.parameters import RunParameters
from ampm.walk import LIMITED, SOLVED, UNSOLVED, ControlOutput, Reference, State, Touch

try:
    from tsid import tsid_pywrap as tsid
except ImportError:
    tsid = None

MOMENTUM, FOOT, POSTURE, FORCE = 1e4, 1e3, 1.0, 1e-5
"""Weights: COM and angular momentum, swinging feet, joints and root, contact forces."""


class TsidController:
    """Follows COM, angular momentum, swinging feet and posture with the run's gains, on rigid soles."""

    def __init__(self, robot: Robot, run: RunParameters) -> None:
        if tsid is None:
            raise InputError("TSID is not installed; in a new environment, run pip install 'ampm[tsid]'.")
        if run.foot.schedule != "flat":
            raise InputError(
                f"foot.schedule = {run.foot.schedule!r} rolls the feet, but TSID's contacts are whole soles; "
                "set foot.schedule = flat."
            )
        self.robot, self.gain, model, gain = robot, run.controller, robot.model, run.controller
        self.body = body = tsid.RobotWrapper(model, tsid.FLOATING_BASE_SYSTEM, False)
        self.work = tsid.InverseDynamicsFormulationAccForce("walk", body, False)
        self.work.computeProblemData(0.0, pin.neutral(model), np.zeros(robot.nv))
        self.limits = tsid.TaskActuationBounds("torques", body)  # kept: TSID only refers to its tasks
        self.limits.setBounds(-robot.torque_limit, robot.torque_limit)
        self.work.addActuationTask(self.limits, 1.0, 0, 0.0)
        soles = [model.frames[frame].name for frame in robot.sole_frames]
        self.com, self.momentum = tsid.TaskComEquality("com", body), tsid.TaskAMEquality("momentum", body)
        self.joints = tsid.TaskJointPosture("joints", body)
        self.root, *self.feet = (tsid.TaskSE3Equality(name, body, name) for name in (model.names[1], *soles))
        self.root.setMask(np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0]))  # only its rotation
        posture = POSTURE, gain.posture_stiffness, gain.posture_damping
        tasks: list[tuple[Any, float, float, float]] = [
            (self.com, MOMENTUM, gain.com_stiffness, gain.com_damping),
            (self.momentum, MOMENTUM, gain.momentum_gain, 0.0),
            (self.joints, *posture),
            (self.root, *posture),
            *((foot, FOOT, gain.swing_stiffness, gain.swing_damping) for foot in self.feet),
        ]
        for task, weight, stiffness, damping in tasks:
            task.setKp(np.full(len(task.Kp), stiffness))
            task.setKd(np.full(len(task.Kp), damping))
            self.work.addMotionTask(task, weight, 1, 0.0)
        self.contacts, self.points = [], []
        pyramid, up = gain.friction / np.sqrt(2.0), np.array([0.0, 0.0, 1.0])
        for foot, name in enumerate(soles):
            flat = np.flatnonzero((robot.point_foot == foot) & (robot.point_group < 2))  # heel and ball
            sole = model.frames[robot.sole_frames[foot]].placement
            places = [model.frames[robot.point_frames[k]].placement for k in flat]
            corners = np.array([sole.actInv(place).translation for place in places]).T
            contact = tsid.Contact6d(f"{name}_contact", body, name, corners, up, pyramid, 0.0, 1.0)
            contact.setKp(np.zeros(6))
            contact.setKd(np.full(6, gain.stance_damping))
            self.contacts.append(contact)
            self.points.append(flat)
        self.solver, self.size = tsid.SolverHQuadProgFast("qp"), (0, 0, 0)
        self.stands, self.opening = [False, False], [0.0, 0.0]  # the latter is a share of the weight
        self.torque, self.acceleration = np.zeros(robot.nu), np.zeros(robot.nv)

    def update(self, state: State, touch: Touch, reference: Reference) -> ControlOutput:
        """One tick."""
        robot, plan, zero = self.robot, reference, np.zeros(3)
        q, v = state.q, state.v + state.velocity_lag * self.acceleration
        pin.framesForwardKinematics(robot.model, robot.data, q)
        places = robot.data.oMf
        for foot, frame in enumerate(robot.sole_frames):
            self._place(foot, places[frame], bool(touch.contact[self.points[foot]].any()), plan)
        tilt = pin.log3(plan.trunk @ places[robot.trunk_frame].rotation.T)
        momentum = plan.angular_momentum + self.gain.trunk_gain * np.array([tilt[0], tilt[1], 0.0])
        turn = pin.Quaternion(plan.q[3:7]).matrix()
        turning = turn @ plan.v[3:6], turn @ plan.acceleration[3:6]
        self.com.setReference(_sample(plan.com, plan.com_velocity, plan.com_acceleration))
        self.momentum.setReference(_sample(momentum, plan.moment, zero))
        self.joints.setReference(_sample(plan.q[7:], plan.v[6:], plan.acceleration[6:]))
        self.root.setReference(_sample([*zero, *turn.T.flat], *([*zero, *rate] for rate in turning)))
        problem = self.work.computeProblemData(state.time, q, v)
        if (size := (self.work.nVar, self.work.nEq, self.work.nIn)) != self.size:
            self.solver.resize(*size)
            self.size = size
        start = time.perf_counter()
        answer = self.solver.solve(problem)
        seconds = time.perf_counter() - start
        if answer.status != 0:
            return ControlOutput(self.torque, status=UNSOLVED, seconds=seconds)
        self.acceleration = self.work.getAccelerations(answer)
        damping, stiffness, rest, friction = robot.passive.T  # of hinges, which TSID does not know
        passive = damping * v[6:] + stiffness * (q[7:] - rest) + friction * np.sign(plan.v[6:])
        limit = robot.torque_limit
        self.torque = np.clip(self.work.getActuatorForces(answer) + passive, -limit, limit)
        force = np.zeros((len(robot.point_frames), 3))
        for foot, frame in enumerate(robot.sole_frames):
            if self.stands[foot]:
                in_sole = self.work.getContactForce(self.contacts[foot].name, answer).reshape(-1, 3)
                force[self.points[foot]] = in_sole @ places[frame].rotation.T
        net, point = force.sum(axis=0), np.array([places[frame].translation for frame in robot.point_frames])
        zmp = force[:, 2] @ point[:, :2] / net[2] if net[2] > 0.0 else None
        status = LIMITED if (np.abs(self.torque) > 0.999 * limit).any() else SOLVED
        return ControlOutput(self.torque, net, zmp, momentum, force, status, seconds=seconds)

    def _place(self, foot: int, place: pin.SE3, touches: bool, plan: Reference) -> None:
        """Let a foot stand or swing. What it may carry grows from touch-down on and shrinks to lift-off."""
        contact, task, gain, first = self.contacts[foot], self.feet[foot], self.gain, plan.time == 0.0
        stands = bool(plan.due[foot, :2].all()) and (self.stands[foot] or touches or first)
        if stands and not self.stands[foot]:
            contact.setReference(place)
            self.work.addRigidContact(contact, FORCE)
            self.opening[foot] = 2.0 if first else 0.0
        elif self.stands[foot] and not stands:
            self.work.removeRigidContact(contact.name, 0.0)
        self.stands[foot] = stands
        self.opening[foot] = min(self.opening[foot] + 1.0 / (gain.frequency * gain.contact_ramp), 2.0)
        share = min(self.opening[foot], plan.until_lift[foot, :2].min() / gain.contact_ramp)
        contact.setMaxNormalForce(share * self.robot.mass * self.robot.gravity)
        self.work.updateTaskWeight(task.name, 0.0 if stands else FOOT)
        pose = [*plan.foot_position[foot], *plan.foot_rotation[foot].T.flat]
        velocity = [*plan.foot_velocity[foot], *plan.foot_angular_velocity[foot]]
        acceleration = [*plan.foot_acceleration[foot], *plan.foot_angular_acceleration[foot]]
        task.setReference(_sample(pose, velocity, acceleration))


def _sample(*parts: Any) -> Any:
    """Reference of a task, its rate and the rate of that."""
    made = tsid.TrajectorySample(len(parts[0]), len(parts[1]))
    for give, part in zip((made.value, made.derivative, made.second_derivative), parts, strict=True):
        give(np.array(part))
    return made
