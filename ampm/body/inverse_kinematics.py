"""Whole-body motion from a plan: accelerations that meet the plan's constraints and keep the body upright.

At every instant (paper, section 2.3, Eqs. 8-12)

    minimise    1/2 || qdd + k (q - q0) + d qd ||^2_W
    subject to  J qdd + dJ/dt qd = lambda,     lower <= qdd <= upper,

where the rows of J are the COM (3), the angular momentum about it (2, or 3 with L_z held at zero), both feet
(6 each) and both toes (2). The sign of k is corrected: with the printed sign the posture is unstable. The
printed cost weighs loins and chest only, which leaves 40 - 20 directions with several minimisers; here every
coordinate has a weight (:data:`POSTURE_WEIGHTS`), so the minimiser is unique.

OSQP gets the QP after the change of variables ``u = W^(1/2) (qdd - qdd_0)`` and with orthonormal constraint
rows, on which ADMM converges to rounding error in a few iterations. Where no joint limit binds, the same
minimiser is the projection of zero on those rows; a search that only needs the end of the step uses this
projection (``draft``), and only the returned step uses OSQP.

The grid divides both phases exactly. After every step of the grid the state is projected back on the
constraints (position and velocity), in the metric of the same weights, which prevents drift.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from scipy.linalg import lapack

from ampm.body.robot import TASK_ROWS, Robot, TaskTerms
from ampm.qp import OsqpBackend, QPSettings

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.body.step_reference import StepReference
    from ampm.geometry import Array
    from ampm.parameters import RunParameters

POSTURE_WEIGHTS = {
    "root_linear": 1e-3,
    "root_angular": 1.0,
    "trunk": 1.0,
    "arms": 0.3,
    "legs": 1e-3,
}
"""Weights W of the posture form by group of coordinates [1]; the legs and the root's position follow from
feet and COM; their small weights only make the minimiser unique."""

ARM_BEND = 0.3
"""How far the arms' rest posture stays inside the joint limits [rad]: hanging, with slightly bent elbows."""
SHOULDER_ROLL = 1
"""Place of the joint that spreads an arm among the arm's joints."""
WIDEST = 1.2
"""Largest abduction of the arms' rest posture [rad]."""

_LIMIT_HORIZON = 0.02  # time over which a joint limit may be approached [s]
_LOST = 0.05  # error after a step of the grid at which the legs no longer follow [m, rad]
CORRECTED = 1e-9
"""Position error that a corrected grid node may keep [m, rad]."""
_L_Z = 5  # row of the angular momentum about z


@dataclass(frozen=True)
class StepTrajectory:
    """One integrated step: states and accelerations at the n + 1 times of the grid.

    Attributes:
        q: Pinocchio configurations, shape (n+1, nq).
        v: Pinocchio velocities, shape (n+1, nv).
        acceleration: Pinocchio accelerations, shape (n+1, nv).
        trunk_pitch: pitch of the trunk segment, shape (n+1,) [rad].
        angular_momentum_z: about the COM, shape (n+1,) [N m s].
        constraint_position: largest position error of any task before projection [m, rad].
        constraint_velocity: largest velocity error before projection [m/s, rad/s].
        constraint_acceleration: largest residual of the acceleration constraints [m/s^2, rad/s^2].
    """

    q: Array
    v: Array
    acceleration: Array
    trunk_pitch: Array
    angular_momentum_z: Array
    constraint_position: float
    constraint_velocity: float
    constraint_acceleration: float

    def __post_init__(self) -> None:
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)


class Unreachable(Exception):
    """The body cannot follow at one instant; a search may try elsewhere.

    Attributes:
        time: of the step [s].
        what: clause that says what cannot be done at that time.
        value: by how much, or how far, in ``unit``.
        limit: what it should have been at most or at least.
        unit: of both.
    """

    def __init__(self, time: float, what: str, value: float, limit: float, unit: str) -> None:
        super().__init__(f"at {time:.3f} s of the step {what}")
        self.time, self.what, self.value, self.limit, self.unit = time, what, value, limit, unit


class InverseKinematics:
    """Integrates one step of a plan for one body.

    Args:
        robot: the body.
        run: supplies posture gains, rest of the arms and the choice for L_z.

    Attributes:
        integrations: steps that were integrated.
    """

    def __init__(self, robot: Robot, run: RunParameters) -> None:
        self.robot = robot
        self.stiffness, self.damping = run.body.posture_stiffness, run.body.posture_damping
        rows = np.arange(TASK_ROWS)
        self.position_rows = np.delete(rows, [3, 4, 5])  # a configuration has no angular momentum
        self.rows = rows if run.body.angular_momentum_z == "zero" else np.delete(rows, _L_Z)
        self.weights = robot.by_group(POSTURE_WEIGHTS)
        self._root_weight = np.sqrt(self.weights)
        self.rest = np.zeros(robot.nu)
        arms = robot.arm_joints - 6
        inside = np.minimum(ARM_BEND, 0.5 * (robot.upper - robot.lower))
        self.rest[arms] = np.clip(0.0, (robot.lower + inside)[arms], (robot.upper - inside)[arms])
        spread = run.body.arm_abduction + run.body.arm_abduction_roll * abs(1.0 - run.gait.c_y)
        for arm, side in ((robot.description.left_arm, 1.0), (robot.description.right_arm, -1.0)):
            self.rest[robot.velocity_indices(arm)[SHOULDER_ROLL] - 6] = side * min(spread, WIDEST)
        # Joint limits bind only where there is freedom to respect them; the legs' are checked on the orbit.
        self.limited = np.concatenate([robot.trunk_joints, robot.arm_joints])
        m = len(self.rows)
        self._A = np.zeros((m + len(self.limited), robot.nv))
        self._A[m + np.arange(len(self.limited)), self.limited] = 1.0
        mask = self._A != 0.0
        mask[:m] = True
        self._P, self._q = np.eye(robot.nv), np.zeros(robot.nv)
        self.integrations = 0
        self.tolerance = 1e-12
        settings = QPSettings(
            self.tolerance, max_iterations=4000, rho=1.0, adaptive_rho=False, alpha=1.0, check_every=2
        )
        self._solver = OsqpBackend(np.eye(robot.nv, dtype=bool), mask, settings)
        self._toes, self._limited_q = robot.toe_joints + 1, self.limited + 1
        self._still = np.zeros(robot.nv)
        self._legs = np.concatenate(robot.leg_joints)
        self._limits_low, self._limits_high = robot.lower[self.limited - 6], robot.upper[self.limited - 6]

    # ------------------------------------------------------------- one instant

    def _factor(self, jacobian: Array, rows: NDArray[np.intp], time: float) -> tuple[Array, Array]:
        """Scaled rows J W^(-1/2) and the Cholesky factor of their Gram matrix; refuses dependent rows."""
        scaled = jacobian.take(rows, axis=0) / self._root_weight
        factor, info = lapack.dpotrf(scaled @ scaled.T, lower=1)
        if info != 0:
            what = "feet, COM and angular momentum cannot be chosen independently: a leg is straight"
            raise Unreachable(time, what, 0.0, 0.0, "1")
        return scaled, factor

    def _position_error(self, reference: StepReference, k: int, q: Array, terms: TaskTerms) -> Array:
        """Task errors of a configuration and its terms, in the order of ``position_rows``."""
        com, left, right = reference.position[k]
        turn_left, turn_right = reference.rotation[k]
        at_left, at_right = terms.sole
        now_left, now_right = terms.sole_turn
        return np.concatenate(
            [
                com - terms.com,
                left - at_left,
                pin.log3(turn_left @ now_left.T),
                right - at_right,
                pin.log3(turn_right @ now_right.T),
                reference.toe[k] - q[self._toes],
            ]
        )

    def _miss(self, reference: StepReference, k: int, error: Array) -> Unreachable:
        """Message for an error of the position rows at node k."""
        com, left, right = (float(np.abs(part).max()) for part in (error[:3], error[3:9], error[9:15]))
        side = "left" if left >= right else "right"
        size = max(com, left, right)
        what = f"the {side} leg does not reach from the hip to the planned foot (it misses by {size:.2g} m)"
        return Unreachable(float(reference.time[k]), what, size, 0.0, "m")

    def _check_knees(self, reference: StepReference, k: int, q: Array) -> None:
        for foot, joint in enumerate(self.robot.knee_joints):
            if q[joint + 1] < 0.0:
                what = f"the {('left', 'right')[foot]} knee would bend backwards: the leg is too short"
                raise Unreachable(float(reference.time[k]), what, float(q[joint + 1]), 0.0, "rad")

    def project(
        self, reference: StepReference, k: int, q: Array, v: Array, offset: float
    ) -> tuple[Array, Array]:
        """Nearest state on the constraints at grid node k, by Newton in the metric of the posture weights.

        Raises:
            Unreachable: Newton does not converge; the legs are too short for this instant.
        """
        robot, time = self.robot, float(reference.time[k])
        for iteration in range(26):
            terms = robot.jacobian(q)
            error = self._position_error(reference, k, q, terms)
            size = float(np.abs(error).max())
            if size < (1e-13 if iteration < 6 else 1e-11 if iteration < 25 else 1e-10):
                break
            if iteration == 25:
                raise self._miss(reference, k, error)
            step = self._pull(*self._factor(terms.jacobian, self.position_rows, time), error)
            largest = float(np.abs(step).max())
            q = pin.integrate(robot.model, q, step * min(1.0, 0.3 / largest) if largest > 0.3 else step)
        self._check_knees(reference, k, q)
        scaled, factor = self._factor(terms.jacobian, self.rows, time)
        v = v + self._pull(scaled, factor, self._velocity_error(reference, k, terms.jacobian, v, offset))
        return q, v

    def upright(self, reference: StepReference, k: int, q: Array) -> Array:
        """Configuration on the constraints at grid node k that is nearest to the upright posture.

        Raises:
            Unreachable: no such configuration was found.
        """
        robot, still, rows = self.robot, self._still, self.position_rows
        for _ in range(60):
            terms = robot.jacobian(q)
            error = self._position_error(reference, k, q, terms)
            wanted = self._posture(q, still) / self.stiffness
            scaled, factor = self._factor(terms.jacobian, rows, float(reference.time[k]))
            step = wanted + self._pull(scaled, factor, error - terms.jacobian[rows] @ wanted)
            largest = float(np.abs(step).max())
            q = pin.integrate(robot.model, q, step * min(1.0, 0.2 / max(largest, 1e-300)))
            if largest < 1e-6:
                break
        return self.project(reference, k, q, still, 0.0)[0]

    def _pull(self, scaled: Array, factor: Array, error: Array) -> Array:
        """Weighted least-norm change of the coordinates that cancels a task error."""
        multiplier, _ = lapack.dpotrs(factor, error, lower=1)
        return (scaled.T @ multiplier) / self._root_weight

    def _velocity_error(
        self, reference: StepReference, k: int, jacobian: Array, v: Array, offset: float
    ) -> Array:
        error = reference.velocity[k] - jacobian @ v
        error[4] += offset / self.robot.mass
        return error[self.rows]

    def _posture(self, q: Array, v: Array) -> Array:
        """Desired acceleration of the posture: -k (q - q0) - d qd (Eq. 12, sign corrected)."""
        wanted = -self.damping * v
        wanted[:3] = 0.0
        vector, w = q[3:6], float(q[6])
        norm = math.sqrt(vector @ vector)
        angle = 2.0 * math.atan2(norm, w) / norm if norm > 1e-12 else 2.0
        wanted[3:6] -= (self.stiffness * angle) * vector
        wanted[6:] -= self.stiffness * (q[7:] - self.rest)
        wanted[self._legs] = 0.0
        return wanted

    # ---------------------------------------------------------------- one step

    def integrate(
        self, reference: StepReference, q: Array, v: Array, offset: float, *, draft: bool = False
    ) -> StepTrajectory:
        """Integrate a step from a state that is projected on the constraints first.

        Args:
            reference: the step's tasks on its grid.
            q: start configuration, shape (nq,).
            v: start velocity, shape (nv,).
            offset: constant of L_y [N m s].
            draft: take the minimiser in closed form where no joint limit binds, instead of from OSQP.

        Raises:
            Unreachable: the legs cannot follow, or joint limits and constraints contradict each other.
        """
        self.integrations += 1
        robot, time = self.robot, reference.time
        n = len(time) - 1
        qs, (vs, accelerations) = np.empty((n + 1, robot.nq)), np.empty((2, n + 1, robot.nv))
        pitch, yaw_momentum = np.empty(n + 1), np.empty(n + 1)
        worst_position = worst_velocity = worst_acceleration = 0.0
        q, v = self.project(reference, 0, q, v, offset)
        last_step = 0.0
        for k in range(n + 1):
            if k > 0:
                q, size = self._correct(reference, k, q, v, 1e-12 if k == n else CORRECTED)
                worst_position = max(worst_position, size)
                self._check_knees(reference, k, q)
            terms = robot.jacobian(q)
            jacobian = terms.jacobian
            scaled, factor = self._factor(jacobian, self.rows, float(time[k]))
            if k > 0:
                velocity_error = self._velocity_error(reference, k, jacobian, v, offset)
                worst_velocity = max(worst_velocity, float(np.abs(velocity_error).max()))
                v = v + self._pull(scaled, factor, velocity_error)
            wanted = reference.acceleration[k] - robot.drift(q, v)
            parts = scaled, factor, wanted[self.rows]
            acceleration = self._accelerate(*parts, q, v, float(time[k]), draft=draft)
            residual = (jacobian @ acceleration - wanted)[self.rows]
            worst_acceleration = max(worst_acceleration, float(np.abs(residual).max()))
            qs[k], vs[k], accelerations[k] = q, v, acceleration
            yaw_momentum[k] = robot.mass * float(jacobian[_L_Z] @ v)
            pitch[k] = math.atan2(terms.trunk[0, 2], terms.trunk[2, 2])
            if k < n:
                dt = time[k + 1] - time[k]
                # Second order (Adams-Bashforth): the slope of the acceleration from the last interval.
                slope = (acceleration - accelerations[k - 1]) / last_step if k > 0 else self._still
                move = dt * v + (0.5 * dt**2) * acceleration + (dt**3 / 6.0) * slope
                q = pin.integrate(robot.model, q, move)
                v = v + dt * acceleration + (0.5 * dt**2) * slope
                last_step = dt
        worst = worst_position, worst_velocity, worst_acceleration
        return StepTrajectory(qs, vs, accelerations, pitch, yaw_momentum, *worst)

    def _correct(
        self, reference: StepReference, k: int, q: Array, v: Array, tolerance: float
    ) -> tuple[Array, float]:
        """Correct the drift of the integration; returns the largest error before [m, rad].

        One Newton step is enough unless the grid is coarse.
        """
        first, time = 0.0, float(reference.time[k])
        for iteration in range(4):
            terms = self.robot.jacobian(q)
            error = self._position_error(reference, k, q, terms)
            size = float(np.abs(error).max())
            if iteration == 0:
                first = size
            if not size < _LOST:
                raise self._miss(reference, k, error)
            if size < tolerance:
                break
            step = self._pull(*self._factor(terms.jacobian, self.position_rows, time), error)
            q = pin.integrate(self.robot.model, q, step)
            if size * size < tolerance:  # quadratic convergence: the remaining error is about size^2
                break
        return q, first

    def _accelerate(
        self, scaled: Array, factor: Array, wanted: Array, q: Array, v: Array, time: float, *, draft: bool
    ) -> Array:
        """The QP of one instant, in u = W^(1/2) (qdd - posture) with orthonormal rows."""
        posture = self._posture(q, v)
        rhs = wanted - scaled @ (posture * self._root_weight)
        joints, h = self.limited, _LIMIT_HORIZON
        reach = q.take(self._limited_q) + h * v.take(joints)
        low = (2.0 / h**2) * (self._limits_low - reach)
        high = (2.0 / h**2) * (self._limits_high - reach)
        if draft:
            acceleration = posture + self._pull(scaled, factor, rhs)
            bounded = acceleration.take(joints)
            if (bounded >= low).all() and (bounded <= high).all():
                return acceleration
        m = len(self.rows)
        rows, _ = lapack.dtrtrs(factor, scaled, lower=1)
        level, _ = lapack.dtrtrs(factor, rhs, lower=1)
        self._A[:m] = rows
        scale, shift = self._root_weight.take(joints), posture.take(joints)
        lower, upper = (np.concatenate([level, (bound - shift) * scale]) for bound in (low, high))
        solution = self._solver.solve(self._P, self._q, self._A, lower, upper)
        if not solution.solved:
            what = "the joint limits of trunk and arms leave no acceleration that meets the plan"
            raise Unreachable(time, what, solution.residual, self.tolerance, "1")
        return posture + solution.x / self._root_weight
