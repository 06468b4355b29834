"""Evidence that needs a body: inverse kinematics of one gait, its Jacobians, its trunk, its joints."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.linalg import null_space

from ampm.body.inverse_kinematics import InverseKinematics
from ampm.body.step_reference import step_grid, step_reference
from ampm.planner.stride import plan_feet
from ampm.planner.support import StepPlan

if TYPE_CHECKING:
    from collections.abc import Iterator

    from ampm.body.motion import WholeBodyMotion
    from ampm.body.robot import Robot
    from ampm.planner.feet import FeetPlan, FootSample
    from validation.trial.plan import PlannedWalk

Array = NDArray[np.float64]

_DIFFERENCE = 1e-5  # half width of central differences [s]
_BESIDE = 1e-9  # distance at which a path is evaluated beside a switch [s]
PAPER_ROWS = 18
"""Rows of Eq. 11: COM 3, angular momentum 3, two feet of 6; the body here adds its toes."""


@dataclass(frozen=True)
class Rates:
    """A rate by Jacobian against the same rate by differences, for COM, momentum over mass, and feet.

    Attributes:
        jacobian: shape (18,).
        difference: shape (18,).
    """

    jacobian: Array
    difference: Array

    def mismatch(self, rows: slice) -> float:
        """Largest difference over some rows [SI]."""
        return float(np.abs(self.jacobian[rows] - self.difference[rows]).max())


@dataclass(frozen=True)
class BodyEvidence:
    """One gait, planned with the body and solved as a periodic motion.

    Attributes:
        planned: the gait.
    """

    planned: PlannedWalk

    @property
    def plan(self) -> StepPlan:
        """Its plan, with feet and the body's constant of L_y."""
        return self.planned.plan

    @cached_property
    def motion(self) -> WholeBodyMotion:
        """Its periodic step."""
        return self.planned.motion

    @property
    def constant(self) -> float:
        """Constant of L_y that closes its posture [N m s]."""
        return self.motion.report.angular_momentum_y_offset

    @cached_property
    def robot(self) -> Robot:
        """The body."""
        return self.planned.body.robot

    @cached_property
    def feet(self) -> FeetPlan:
        """Its planned feet."""
        return self.plan.feet

    @cached_property
    def inverse_kinematics(self) -> InverseKinematics:
        """The paper's section 2.3, as the project has it."""
        return InverseKinematics(self.robot, self.planned.request.run)

    @property
    def middle(self) -> tuple[Array, Array, Array]:
        """q, v and acceleration at the middle of the single support."""
        index = int(np.argmin(np.abs(self.motion.time - 0.5 * self.motion.double_support_start)))
        return self.motion.q[index], self.motion.v[index], self.motion.acceleration[index]

    # ------------------------------------------------------------------ trunk

    @cached_property
    def _trunk(self) -> Array:
        """Roll and pitch of the trunk over one step, shape (n+1, 2) [rad]."""
        angles = []
        for rotation in self.robot.trunk_rotations(self.motion.q):
            angles.append(
                (
                    math.atan2(rotation[2, 1], rotation[2, 2]),
                    math.atan2(rotation[0, 2], rotation[2, 2]),
                )
            )
        return np.array(angles)

    @property
    def trunk_roll(self) -> float:
        """Peak to peak roll of the trunk; the next step is this one mirrored [rad]."""
        return float(2.0 * np.abs(self._trunk[:, 0]).max())

    @property
    def trunk_pitch(self) -> float:
        """Peak to peak pitch of the trunk [rad]."""
        return float(np.ptp(self._trunk[:, 1]))

    def trunk_drift(self, constant: float, steps: int) -> float:
        """Mean trunk pitch that the body gains when it walks on with another constant of L_y.

        Args:
            constant: of L_y [N m s].
            steps: how many steps, integrated on from the periodic motion's start.

        Returns:
            Mean pitch over the last step less that over the periodic one [rad].
        """
        grid = step_grid(self.plan, self.planned.run.solver.ik_time_step)
        reference = step_reference(self.plan, grid)
        q, v = self.motion.q[0], self.motion.v[0]
        for _ in range(steps):
            trajectory = self.inverse_kinematics.integrate(reference, q, v, constant, draft=True)
            q = self.robot.mirror_q(trajectory.q[-1], -self.motion.step_length)
            v = self.robot.mirror_v(trajectory.v[-1])
        time = reference.time
        mean = float(np.trapezoid(trajectory.trunk_pitch, time) / time[-1])
        return mean - self.motion.report.mean_trunk_pitch

    # -------------------------------------------------------------- Jacobians

    @cached_property
    def jacobian(self) -> Array:
        """J_all of Eq. 11 at the middle of the single support, shape (18, nv)."""
        q, v, _ = self.middle
        return self.robot.jacobian(q, v).jacobian[:PAPER_ROWS].copy()

    def _nearby(self, h: float) -> tuple[Array, Array]:
        """State ``h`` [s] after :attr:`middle`, at its acceleration."""
        q, v, a = self.middle
        return pin.integrate(self.robot.model, q, h * v + 0.5 * h * h * a), v + h * a

    @cached_property
    def velocities(self) -> Rates:
        """``J qd`` against differences of positions; the momentum's rows against the bodies' own sum."""
        q, v, _ = self.middle
        by_jacobian = self.robot.jacobian(q, v).jacobian[:PAPER_ROWS] @ v
        places = []
        for h in (-_DIFFERENCE, _DIFFERENCE):
            terms = self.robot.jacobian(*self._nearby(h))
            places.append((terms.com, terms.soles))
        (com_0, soles_0), (com_1, soles_1) = places
        width = 2.0 * _DIFFERENCE
        rows = [(com_1 - com_0) / width, self._momentum(q, v) / self.robot.mass]
        for before, after in zip(soles_0, soles_1, strict=True):
            rows.append((after.translation - before.translation) / width)
            rows.append(pin.log3(after.rotation @ before.rotation.T) / width)
        return Rates(by_jacobian, np.concatenate(rows))

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
    def accelerations(self) -> Rates:
        """``J qdd + dJ/dt qd`` against differences of velocities."""
        q, v, a = self.middle
        jacobian = self.robot.jacobian(q, v).jacobian[:PAPER_ROWS] @ a
        by_jacobian = jacobian + self.robot.drift(q, v)[:PAPER_ROWS]
        before, after = (
            self.robot.jacobian(*state).jacobian[:PAPER_ROWS] @ state[1]
            for state in (self._nearby(-_DIFFERENCE), self._nearby(_DIFFERENCE))
        )
        return Rates(by_jacobian, (after - before) / (2.0 * _DIFFERENCE))

    # -------------------------------------------------------------- posture form

    def flat_directions(self) -> int:
        """Dimensions in which the printed cost (loins and chest) does not distinguish two accelerations.

        "Rotation of the loins" is read as generously as can be: the root's rotation and all trunk joints.
        """
        free = null_space(self.jacobian)
        weighed = free[np.concatenate([np.arange(3, 6), self.robot.trunk_joints])]
        return int(free.shape[1] - np.linalg.matrix_rank(weighed))

    def least_curvature(self) -> float:
        """Least eigenvalue of the project's cost on the directions that the constraints leave free [1]."""
        free = null_space(self.jacobian)
        weights = self.inverse_kinematics.weights
        return float(np.linalg.eigvalsh(free.T @ (weights[:, None] * free))[0])

    # -------------------------------------------------------------------- feet

    def swing_foot_jump(self, swing: str | None = None) -> tuple[float, float]:
        """Jump of the planned swing foot's velocity [m/s] and acceleration [m/s^2] at lift-off, at most.

        Args:
            swing: ``foot.swing`` to plan the feet with; None for the gait's own.
        """
        feet = self.feet
        if swing is not None:
            foot = self.planned.request.run.replace({"foot.swing": swing}).foot
            constants = self.plan.constants
            lift_speed = constants.l_s / constants.single_support_duration
            feet = plan_feet(self.plan.contacts, foot, feet.sole, lift_speed)
        lift = self.plan.constants.step_duration  # the left foot has stood, and leaves here
        before = feet.sample(lift - _BESIDE)[0]
        after = feet.sample(lift + _BESIDE)[0]
        return (
            float(np.abs(after.velocity - before.velocity).max()),
            float(np.abs(after.acceleration - before.acceleration).max()),
        )

    def joint_jump(self, foot_jump: float | None) -> float:
        """Largest jump of a hip's or knee's flexion acceleration when the right foot lifts, at t = 0.

        Args:
            foot_jump: jump of the foot's acceleration along x [m/s^2], all else continuous; None for the
                jump of everything that plan and feet ask for.

        Returns:
            [rad/s^2]
        """
        ik = self.inverse_kinematics
        if foot_jump is None:
            step = self.plan.constants.step_duration
            before, after = step_reference(
                self.plan, np.array([2.0 * step - _BESIDE, 2.0 * step + _BESIDE])
            ).acceleration
            jump = after - before
        else:
            jump = np.zeros(len(self.robot.jacobian(self.motion.q[0], self.motion.v[0]).jacobian))
            jump[12] = foot_jump  # right foot, x
        jacobian = self.robot.jacobian(self.motion.q[0], self.motion.v[0]).jacobian[ik.rows]
        scaled = jacobian / ik.weights
        change = scaled.T @ np.linalg.solve(jacobian @ scaled.T, jump[ik.rows])
        return float(np.abs(change[list(self._flexion())]).max())

    def _flexion(self) -> Iterator[int]:
        """Velocity indices of the joints of hips and knees that turn about the lateral axis."""
        for leg in self.robot.description.legs:
            yield int(self.robot.velocity_indices((leg.knee,))[0])
            hip = [name for name in leg.hip if "pitch" in name]
            yield from (int(i) for i in self.robot.velocity_indices(tuple(hip)))

    def permuted_constraints(self) -> float:
        """Largest error of the feet's entries if Eq. 11 takes them in one order and Eq. 10 in the other."""
        times = np.linspace(0.0, self.plan.constants.single_support_duration, 201)
        left, right = self.feet.sample(times)

        def turning(foot: FootSample) -> Array:
            zero = np.zeros_like(foot.pitch_acceleration)
            return np.stack([zero, foot.pitch_acceleration, zero], axis=1)

        eq_10 = np.hstack([left.acceleration, right.acceleration, turning(left), turning(right)])
        eq_11 = np.hstack([left.acceleration, turning(left), right.acceleration, turning(right)])
        return float(np.abs(eq_10 - eq_11).max())
