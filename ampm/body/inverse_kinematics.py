"""Whole-body motion from a plan: accelerations that meet the plan's constraints and keep the body upright.

At every instant (paper, section 2.3, Eqs. 8-12)

    minimise    1/2 || qdd + k (q - q0) + d qd ||^2_W
    subject to  J qdd + dJ/dt qd = lambda,     lower <= qdd <= upper,

where the rows of J are the COM (3), the angular momentum about it (2, or 3 with L_z held at zero), both feet
(6 each) and both toes (2, if there are any). The sign of k is corrected: with the printed sign the posture is
unstable. The printed cost weighs loins and chest only, which leaves 40 - 20 directions with several
minimisers; here every coordinate has a weight (:data:`POSTURE_WEIGHTS`), so the minimiser is unique.

OSQP gets the QP after the change of variables ``u = W^(1/2) (qdd - qdd_0)`` and with orthonormal constraint
rows, on which ADMM converges to rounding error in a few iterations. Where no joint limit binds, the same
minimiser is the projection of zero on those rows; a search that only needs the end of the step uses this
projection (``draft``), and only the returned step uses OSQP.

The grid divides both phases exactly. After every step of the grid the state is projected back on the
constraints (position and velocity), in the metric of the same weights, which prevents drift.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ampm.body.rigid_body import moved
from ampm.body.robot import Robot
from ampm.body.step_kinematics import (
    BY_QP,
    DONE,
    LIMIT_HORIZON,
    LOST,
    Goals,
    Instant,
    Nodes,
    Rest,
    Tasks,
    accelerate,
    factor,
    follow,
    limits_of,
    orthonormal,
    position_error,
    posture_pull,
    pull,
    row_error,
    weigh,
)
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
WIDEST = 1.2
"""Largest abduction of the arms' rest posture [rad]."""

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
        what: clause on what cannot be done at that time.
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
        rows = np.arange(robot.task_rows)
        self.position_rows = np.delete(rows, [3, 4, 5])  # a configuration has no angular momentum
        self.rows = rows if run.body.angular_momentum_z == "zero" else np.delete(rows, _L_Z)
        self.weights = robot.by_group(POSTURE_WEIGHTS)
        self._root_weight = np.sqrt(self.weights)
        self.rest = np.zeros(robot.nu)
        arms = robot.arm_joints - 6
        inside = np.minimum(ARM_BEND, 0.5 * (robot.upper - robot.lower))
        self.rest[arms] = np.clip(0.0, (robot.lower + inside)[arms], (robot.upper - inside)[arms])
        self.spread_arms(run)
        for joint, angle in robot.description.rest:
            self.rest[robot.velocity_indices((joint,)) - 6] = angle
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
        free = np.ones(robot.nu, dtype=bool)
        free[np.concatenate(robot.leg_joints) - 6] = False
        limits = robot.lower[self.limited - 6], robot.upper[self.limited - 6]
        self._posture = Rest(self.rest, free, self.stiffness, self.damping, self.limited, *limits)
        body = robot.rigid_body
        own = body.tree, body.link, body.soles, body.trunk, body.columns
        self._tasks = Tasks(*own, self.rows, self.position_rows, robot.toe_joints + 1, self._root_weight)
        self._level, errors = np.zeros(m), np.zeros(len(self.position_rows))
        system = np.zeros((robot.nv, m)), np.zeros((m, m + 1))
        self._instant = Instant(*system, np.zeros(len(rows)), np.zeros(robot.nv), np.zeros(m), errors)

    def spread_arms(self, run: RunParameters) -> None:
        """Spread the arms' rest posture by a run's abduction."""
        spread = run.body.arm_abduction + run.body.arm_abduction_roll * (1.0 - run.gait.c_y) ** 2
        for joint, sign in self.robot.description.spread:
            self.rest[self.robot.velocity_indices((joint,)) - 6] = sign * min(spread, WIDEST)

    # ------------------------------------------------------------- one instant

    def _error(self, reference: StepReference, k: int, q: Array) -> float:
        """Place the body; fill in its task errors, in the order of ``position_rows``. The largest one."""
        tasks = self._tasks
        self.robot.rigid_body.place(q)
        wanted = reference.position[k], reference.rotation[k], reference.toe[k]
        return position_error(tasks.link, tasks.soles, q, tasks.toes, *wanted, self._instant.miss)

    def _pull(self, rows: NDArray[np.intp], error: Array, time: float) -> Array:
        """Weighted least-norm change of the coordinates that cancels an error; refuses dependent rows."""
        nv, m = self.robot.nv, len(rows)
        change, system = np.empty(nv), (np.empty((nv, m)), np.empty((m, m + 1)))
        if not factor(self._tasks.columns, rows, self._root_weight, *system):
            raise _dependent(time)
        pull(*system, self._root_weight, error, change)
        return change

    def _miss(self, reference: StepReference, k: int) -> Unreachable:
        """Message for the errors of the position rows at node k."""
        error = self._instant.miss
        com, left, right = (float(np.abs(part).max()) for part in (error[:3], error[3:9], error[9:15]))
        side = "left" if left >= right else "right"
        size = max(com, left, right)
        what = f"the {side} leg does not reach from the hip to the planned foot (it misses by {size:.2g} m)"
        return Unreachable(float(reference.time[k]), what, size, 0.0, "m")

    def _check_knees(self, time: Array, q: Array) -> None:
        """Refuse the first of some configurations, shape (n, nq), with a knee that is bent backwards."""
        flexion = self.robot.knee_flexion(q)
        for k, foot in np.argwhere(flexion < 0.0):
            what = f"the {('left', 'right')[foot]} knee would bend backwards: the leg is too short"
            raise Unreachable(float(time[k]), what, float(flexion[k, foot]), 0.0, "rad")

    def project(
        self, reference: StepReference, k: int, q: Array, v: Array, offset: float
    ) -> tuple[Array, Array]:
        """Nearest state on the constraints at grid node k, by Newton in the metric of the posture weights.

        Raises:
            Unreachable: Newton does not converge; the legs are too short for this instant.
        """
        time = float(reference.time[k])
        for iteration in range(26):
            size = self._error(reference, k, q)
            if size < (1e-13 if iteration < 6 else 1e-11 if iteration < 25 else 1e-10):
                break
            if iteration == 25:
                raise self._miss(reference, k)
            step = self._pull(self.position_rows, self._instant.miss, time)
            largest = float(np.abs(step).max())
            q = moved(q, step * min(1.0, 0.3 / largest) if largest > 0.3 else step)
        self._check_knees(reference.time[k : k + 1], q[None])
        wanted, error = self._velocity(reference, offset)[k], np.empty(len(self.rows))
        row_error(self._tasks.columns, self.rows, v, wanted, error)
        return q, v + self._pull(self.rows, error, time)

    def upright(self, reference: StepReference, k: int, q: Array) -> Array:
        """Configuration on the constraints at grid node k that is nearest to the upright posture.

        Raises:
            Unreachable: no such configuration was found.
        """
        still, rows, error = np.zeros(self.robot.nv), self.position_rows, np.empty(len(self.position_rows))
        wanted = np.empty(self.robot.nv)
        for _ in range(60):
            self._error(reference, k, q)
            posture_pull(q, still, self._posture, wanted)
            wanted, task = wanted / self.stiffness, np.zeros(self.robot.task_rows)
            task[rows] = self._instant.miss
            row_error(self._tasks.columns, rows, wanted, task, error)
            step = wanted + self._pull(rows, error, float(reference.time[k]))
            largest = float(np.abs(step).max())
            q = moved(q, step * min(1.0, 0.2 / max(largest, 1e-300)))
            if largest < 1e-6:
                break
        return self.project(reference, k, q, still, 0.0)[0]

    def _velocity(self, reference: StepReference, offset: float) -> Array:
        """Task velocities with the constant of L_y, shape (n+1, 20)."""
        velocity = reference.velocity.copy()
        velocity[:, 4] += offset / self.robot.mass
        return velocity

    def accelerate(
        self, reference: StepReference, k: int, q: Array, v: Array, *, draft: bool = False
    ) -> Array:
        """Accelerations at grid node k of a state on the constraints, shape (nv,).

        Raises:
            Unreachable: the constraints depend on each other, or contradict the joint limits.
        """
        tasks, instant, acceleration = self._tasks, self._instant, np.empty(self.robot.nv)
        self.robot.rigid_body.place(q)
        if not factor(tasks.columns, self.rows, self._root_weight, instant.scaled, instant.system):
            raise _dependent(float(reference.time[k]))
        free = accelerate(tasks, self._posture, reference.acceleration[k], q, v, instant, acceleration)
        return acceleration if draft and free else self._minimise(q, v, float(reference.time[k]))

    def _minimise(self, q: Array, v: Array, time: float) -> Array:
        """Accelerations of one instant, which is prepared, by the QP.

        Its unknowns are u = W^(1/2) (qdd - posture), its rows orthonormal.
        """
        rest, instant, m = self._posture, self._instant, len(self.rows)
        weigh(self._tasks.columns, self.rows, self._root_weight, instant.scaled)
        orthonormal(instant.scaled, instant.right, self._A[:m], self._level)
        scale, shift = self._root_weight.take(rest.joints), instant.posture.take(rest.joints)
        reach = q.take(rest.joints + 1) + LIMIT_HORIZON * v.take(rest.joints)
        bounds = limits_of(reach, rest.low, rest.high)
        lower, upper = (np.concatenate([self._level, (bound - shift) * scale]) for bound in bounds)
        solution = self._solver.solve(self._P, self._q, self._A, lower, upper)
        if not solution.solved:
            what = "the joint limits of trunk and arms leave no acceleration that meets the plan"
            raise Unreachable(time, what, solution.residual, self.tolerance, "1")
        return instant.posture + solution.x / self._root_weight

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
        nv, time = self.robot.nv, reference.time
        count = len(time)
        states = np.empty((count, nv + 1)), np.empty((count, nv)), np.empty((count, nv))
        nodes = Nodes(*states, np.empty(count), np.empty(count), np.zeros((count, 3)))
        tasks = reference.position, reference.rotation, reference.toe
        goals = Goals(time, *tasks, self._velocity(reference, offset), reference.acceleration)
        nodes.q[0], nodes.v[0] = self.project(reference, 0, q, v, offset)
        nodes.acceleration[0] = self.accelerate(reference, 0, nodes.q[0], nodes.v[0], draft=draft)
        k, end = 0, BY_QP
        while end == BY_QP:
            end, k = follow(self._tasks, self._posture, goals, k, draft, self._instant, nodes)
            if end == BY_QP:
                nodes.acceleration[k] = self._minimise(nodes.q[k], nodes.v[k], float(time[k]))
        self._check_knees(time, nodes.q[: k if end != DONE else count])
        if end != DONE:
            raise self._miss(reference, k) if end == LOST else _dependent(float(time[k]))
        worst = nodes.errors.max(axis=0).tolist()
        yaw_momentum = self.robot.mass * nodes.yaw
        return StepTrajectory(nodes.q, nodes.v, nodes.acceleration, nodes.pitch, yaw_momentum, *worst)


def _dependent(time: float) -> Unreachable:
    what = "feet, COM and angular momentum cannot be chosen independently: a leg is straight"
    return Unreachable(time, what, 0.0, 0.0, "1")
