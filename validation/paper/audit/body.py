"""Evidence that needs a body: inverse kinematics of one gait, its Jacobians, its trunk, its joints."""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np
import pinocchio as pin
from scipy.linalg import null_space

from ampm.body.inverse_kinematics import InverseKinematics
from ampm.body.orbit import COARSE_STEP
from ampm.body.return_map import standing
from ampm.body.step_reference import step_grid, step_reference
from ampm.geometry import Array
from ampm.planner.feet import FeetPlan, FootSample
from ampm.planner.stride import plan_feet
from ampm.planner.support import StepPlan
from validation.trial.plan import PlannedWalk

_DIFFERENCE = 1e-5  # half width of central differences [s]
_PROPORTIONAL, _INTEGRAL = 2.0, 0.5  # gains from the trunk's mean pitch to the constant of L_y [N m s/rad]
_BESIDE = 1e-9  # distance at which a path is evaluated beside a switch [s]
PAPER_ROWS = 18
"""Rows of Eq. 11: COM 3, angular momentum 3, two feet of 6; this body also has toes."""


class BodyEvidence:
    """One gait, planned with the body and solved as a periodic motion.

    Attributes:
        run: parameters of the gait.
        plan: with feet and the body's constant of L_y.
        motion: its periodic step.
        robot: the body.
        constant: constant of L_y that closes its posture [N m s].
        inverse_kinematics: the project's form of the paper's section 2.3.
    """

    def __init__(self, planned: PlannedWalk) -> None:
        self.run, self.robot, self.motion = planned.run, planned.body.robot, planned.motion
        self.plan: StepPlan = planned.plan
        self.constant = self.motion.report.angular_momentum_y_offset
        self.inverse_kinematics = InverseKinematics(self.robot, planned.run)

    @property
    def middle(self) -> tuple[Array, Array, Array]:
        """q, v and acceleration at the middle of the single support."""
        index = int(np.argmin(np.abs(self.motion.time - 0.5 * self.motion.double_support_start)))
        return self.motion.q[index], self.motion.v[index], self.motion.acceleration[index]

    # ------------------------------------------------------------------ trunk

    @cached_property
    def trunk_swing(self) -> tuple[float, float]:
        """Peak to peak roll and pitch of the trunk over a stride [rad]."""
        rotations = self.robot.trunk_rotations(self.motion.q)
        roll = [math.atan2(rotation[2, 1], rotation[2, 2]) for rotation in rotations]
        pitch = [math.atan2(rotation[0, 2], rotation[2, 2]) for rotation in rotations]
        return 2.0 * float(np.abs(roll).max()), float(np.ptp(pitch))  # the next step is this one mirrored

    def trunk_drift(self, constant: float, steps: int) -> float:
        """Change of the mean trunk pitch when the body continues with another constant of L_y.

        Args:
            constant: of L_y [N m s].
            steps: number of steps, integrated from the periodic motion's start.

        Returns:
            Mean pitch over the last step less that over the periodic one [rad].
        """
        reference = step_reference(self.plan, step_grid(self.plan, self.run.solver.ik_time_step))
        q, v = self.motion.q[0], self.motion.v[0]
        for _ in range(steps):
            trajectory = self.inverse_kinematics.integrate(reference, q, v, constant, draft=True)
            q = self.robot.mirror_q(trajectory.q[-1], -self.motion.step_length)
            v = self.robot.mirror_v(trajectory.v[-1])
        mean = np.trapezoid(trajectory.trunk_pitch, reference.time) / reference.time[-1]
        return float(mean) - self.motion.report.mean_trunk_pitch

    def trunk_feedback(self, steps: int) -> tuple[float, float]:
        """Steps integrated on from an upright start, the constant of L_y by a PI of the trunk's mean pitch.

        Args:
            steps: how many steps.

        Returns:
            Mean pitch over the last step less the gait's lean [rad], and the constant found [N m s].
        """
        reference = step_reference(self.plan, step_grid(self.plan, COARSE_STEP))
        q, v = standing(self.inverse_kinematics, reference), np.zeros(self.robot.nv)
        pitch = total = constant = 0.0
        for _ in range(steps):
            trajectory = self.inverse_kinematics.integrate(reference, q, v, constant, draft=True)
            mean = np.trapezoid(trajectory.trunk_pitch, reference.time) / reference.time[-1]
            pitch = float(mean) - self.run.body.lean
            total += pitch
            constant = -_PROPORTIONAL * pitch - _INTEGRAL * total
            q = self.robot.mirror_q(trajectory.q[-1], -self.motion.step_length)
            v = self.robot.mirror_v(trajectory.v[-1])
        return pitch, constant

    # -------------------------------------------------------------- Jacobians

    def _jacobian(self, q: Array) -> Array:
        """J_all of Eq. 11, shape (18, nv)."""
        return self.robot.jacobian(q).jacobian[:PAPER_ROWS]

    @cached_property
    def jacobian(self) -> Array:
        """J_all at the middle of the single support."""
        return self._jacobian(self.middle[0])

    def _nearby(self) -> list[tuple[Array, Array]]:
        """States just before and just after :attr:`middle`, at its acceleration."""
        q, v, a = self.middle
        steps = (-_DIFFERENCE, _DIFFERENCE)
        return [(pin.integrate(self.robot.model, q, h * v + 0.5 * h * h * a), v + h * a) for h in steps]

    @cached_property
    def velocity_errors(self) -> Array:
        """``J qd`` less differences of positions, and for the momentum less the bodies' own sum, shape (18,).

        Of COM [m/s], momentum over mass, and feet.
        """
        q, v, _ = self.middle
        before, after = (self.robot.jacobian(near) for near, _ in self._nearby())
        rows = [(after.com - before.com) / (2.0 * _DIFFERENCE), self._momentum(q, v) / self.robot.mass]
        for foot in (0, 1):
            rows.append((after.sole[foot] - before.sole[foot]) / (2.0 * _DIFFERENCE))
            turn = after.sole_turn[foot] @ before.sole_turn[foot].T
            rows.append(pin.log3(turn) / (2.0 * _DIFFERENCE))
        return np.asarray(np.abs(self.jacobian @ v - np.concatenate(rows)))

    def _momentum(self, q: Array, v: Array) -> Array:
        """Angular momentum about the COM, segment by segment, shape (3,) [N m s]."""
        model, data = self.robot.model, self.robot.data
        pin.forwardKinematics(model, data, q, v)
        com = pin.centerOfMass(model, data, q)
        total = np.zeros(3)
        for joint in range(1, model.njoints):
            inertia, pose, twist = model.inertias[joint], data.oMi[joint], data.v[joint]
            centre = pose.act(inertia.lever)
            linear = pose.rotation @ (twist.linear + np.cross(twist.angular, inertia.lever))
            spin = pose.rotation @ (inertia.inertia @ twist.angular)
            total += spin + inertia.mass * np.cross(centre - com, linear)
        return total

    @cached_property
    def acceleration_errors(self) -> Array:
        """``J qdd + dJ/dt qd`` less differences of velocities, shape (18,)."""
        q, v, a = self.middle
        by_jacobian = self.jacobian @ a + self.robot.drift(q, v)[:PAPER_ROWS]
        before, after = (self._jacobian(q) @ v for q, v in self._nearby())
        return np.asarray(np.abs(by_jacobian - (after - before) / (2.0 * _DIFFERENCE)))

    # -------------------------------------------------------------- posture form

    @cached_property
    def flat_directions(self) -> float:
        """Dimensions in which the printed cost (loins and chest) does not distinguish two accelerations.

        "Rotation of the loins" is taken in the widest sense: the root's rotation and all trunk joints.
        """
        free = null_space(self.jacobian)
        weighed = free[np.concatenate([np.arange(3, 6), self.robot.trunk_joints])]
        return float(free.shape[1] - np.linalg.matrix_rank(weighed))

    def least_curvature(self) -> float:
        """Least eigenvalue of the project's cost on the directions that the constraints leave free [1]."""
        free = null_space(self.jacobian)
        weights = self.inverse_kinematics.weights
        return float(np.linalg.eigvalsh(free.T @ (weights[:, None] * free))[0])

    # -------------------------------------------------------------------- feet

    def _feet(self, **foot: str) -> FeetPlan:
        """The feet, with some of ``foot`` changed."""
        constants, parameters = self.plan.constants, self.run.foot.model_copy(update=foot)
        lift_speed = constants.l_s / constants.single_support_duration
        return plan_feet(self.plan.contacts, parameters, self.plan.feet.sole, lift_speed)

    @property
    def rising_heel(self) -> float:
        """Rate of the foot at toe off whose ankle leaves at l_s / T_swing [rad/s]."""
        lift = self.plan.constants.step_duration
        return float(self._feet(swing="paper", v_swing_of="ankle").sample(lift)[0].pitch_velocity[0])

    def swing_foot_jump(self, **foot: str) -> tuple[float, float]:
        """Jump of the planned swing foot's velocity [m/s] and acceleration [m/s^2] at lift-off, at most.

        Args:
            foot: what is changed of the gait's own, such as ``swing="paper"``.
        """
        feet, constants = self._feet(**foot), self.plan.constants
        lift = constants.step_duration  # the left foot lifts off here
        before, after = (feet.sample(lift + beside)[0] for beside in (-_BESIDE, _BESIDE))
        return (
            float(np.abs(after.velocity - before.velocity).max()),
            float(np.abs(after.acceleration - before.acceleration).max()),
        )

    def joint_jump(self, foot_jump: float | None) -> float:
        """Largest jump of a hip's or knee's flexion acceleration when the right foot lifts, at t = 0.

        Args:
            foot_jump: jump of the foot's acceleration along x [m/s^2], all else continuous; None for the
                jump of all task accelerations of plan and feet.

        Returns:
            [rad/s^2]
        """
        ik, robot = self.inverse_kinematics, self.robot
        jacobian = robot.jacobian(self.motion.q[0]).jacobian
        if foot_jump is None:
            lift = 2.0 * self.plan.constants.step_duration
            before, after = step_reference(self.plan, lift + np.array([-_BESIDE, _BESIDE])).acceleration
            jump = after - before
        else:
            jump = np.zeros(len(jacobian))
            jump[12] = foot_jump  # right foot, x
        scaled = jacobian[ik.rows] / ik.weights
        change = scaled.T @ np.linalg.solve(jacobian[ik.rows] @ scaled.T, jump[ik.rows])
        legs = robot.description.legs
        flexions = [leg.knee for leg in legs] + [name for leg in legs for name in leg.hip if "pitch" in name]
        return float(np.abs(change[robot.velocity_indices(tuple(flexions))]).max())

    def permuted_constraints(self) -> float:
        """Largest error of the feet's entries if Eq. 11 takes them in one order and Eq. 10 in the other."""
        times = np.linspace(0.0, self.plan.constants.single_support_duration, 201)
        left, right = self.plan.feet.sample(times)

        def turning(foot: FootSample) -> Array:
            zero = np.zeros_like(foot.pitch_acceleration)
            return np.stack([zero, foot.pitch_acceleration, zero], axis=1)

        eq_10 = np.hstack([left.acceleration, right.acceleration, turning(left), turning(right)])
        eq_11 = np.hstack([left.acceleration, turning(left), right.acceleration, turning(right)])
        return float(np.abs(eq_10 - eq_11).max())
