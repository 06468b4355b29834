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

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ampm.body.rigid_body import moved, place_body, place_of, task_drift
from ampm.body.robot import Robot
from ampm.compiled import compiled
from ampm.linear import substitute, triangular
from ampm.qp import OsqpBackend, QPSettings
from ampm.vectors import column, minus, multiply, plus, put, rotation_vector, turned, vector

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

DONE, LOST, DEPENDENT, BOUND = range(4)
"""How a compiled function ended: as wanted; too far from the tasks; tasks that depend on each other; a joint
limit binds."""

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


@compiled
def position_error(
    link: Any,
    soles: Any,
    q: Array,
    toes: NDArray[np.intp],
    place: Array,
    rotation: Array,
    toe: Array,
    error: Array,
) -> float:
    """Errors of COM, soles (place, then rotation vector) and toe joints; the largest size of them.

    Args:
        link: placed, with its inertia.
        soles: frames of the feet.
        q: configuration, shape (nq,).
        toes: indices of the toe joints in q.
        place: wanted ones of COM and soles, shape (1 + F, 3) [m].
        rotation: wanted ones of the soles to world, shape (F, 3, 3).
        toe: wanted angles, shape (T,) [rad].
        error: written, shape (3 + 6 F + T,) [m, rad].
    """
    root, pose = (q[0], q[1], q[2]), np.empty((3, 3))
    mass, first = link[0].mass, vector(link[0].first)
    com = first[0] / mass, first[1] / mass, first[2] / mass
    put(error[0:3], minus(vector(place[0]), plus(root, com)))
    for i in range(len(soles)):
        multiply(link[soles[i].joint].turn, soles[i].turn, pose)
        row = 3 + 6 * i
        put(error[row : row + 3], minus(vector(place[1 + i]), plus(root, place_of(link, soles[i]))))
        put(error[row + 3 : row + 6], rotation_vector(rotation[i], pose))
    for i in range(len(toes)):
        error[len(error) - len(toes) + i] = toe[i] - q[toes[i]]
    return np.abs(error).max()


@compiled
def row_error(columns: Array, rows: NDArray[np.intp], x: Array, wanted: Array, error: Array) -> float:
    """``error = (wanted - J x)[rows]`` of a transposed Jacobian; the largest size of it."""
    largest = 0.0
    for i in range(len(rows)):
        e = wanted[rows[i]]
        for j in range(len(x)):
            e -= columns[j, rows[i]] * x[j]
        error[i] = e
        largest = max(largest, abs(e))
    return largest


@compiled
def pull(columns: Array, rows: NDArray[np.intp], root_weight: Array, error: Array, change: Array) -> bool:
    """Weighted least-norm change of the coordinates that cancels the error of some rows.

    Args:
        columns: transposed task Jacobian, shape (nv, R).
        rows: of the Jacobian, m of them.
        root_weight: square roots of the coordinates' weights, shape (nv,).
        error: shape (m,).
        change: written, shape (nv,).

    Returns:
        Whether the rows are independent.
    """
    count = len(rows)
    scaled, system = weighted(columns, rows, root_weight), np.zeros((count, count + 1))
    _gram(scaled, system)
    system[:, count] = error
    if not triangular(system):
        return False
    substitute(system)
    for j in range(len(change)):
        change[j] = 0.0
        for i in range(count):
            change[j] += scaled[j, i] * system[i, count]
        change[j] /= root_weight[j]
    return True


@compiled
def weighted(columns: Array, rows: NDArray[np.intp], root_weight: Array) -> Array:
    """``W^-1/2 J'`` of some rows, shape (nv, m)."""
    scaled = np.empty((len(columns), len(rows)))
    for j in range(len(columns)):
        for i in range(len(rows)):
            scaled[j, i] = columns[j, rows[i]] / root_weight[j]
    return scaled


@compiled
def _gram(scaled: Array, system: Array) -> None:
    """Add ``J W^-1 J'`` to a system."""
    count = len(system)
    for j in range(len(scaled)):
        row = scaled[j]
        for e in range(count):
            s = row[e]
            if s != 0.0:
                out = system[e]
                for d in range(count):
                    out[d] += s * row[d]


@compiled
def orthonormal(
    columns: Array, rows: NDArray[np.intp], root_weight: Array, right: Array, out: Array, level: Array
) -> None:
    """Orthonormal rows with the span of ``J W^-1/2``, and their right-hand sides.

    Args:
        columns: transposed task Jacobian, shape (nv, R).
        rows: of the Jacobian, m of them, independent.
        root_weight: square roots of the coordinates' weights, shape (nv,).
        right: right-hand sides of the rows, shape (m,).
        out: written, shape (m, nv).
        level: written, shape (m,).
    """
    count, nv = len(rows), len(columns)
    scaled, system = weighted(columns, rows, root_weight), np.zeros((count, count + nv + 1))
    _gram(scaled, system)
    for i in range(count):
        for j in range(nv):
            system[i, count + j] = scaled[j, i]
        system[i, count + nv] = right[i]
    triangular(system)
    for i in range(count):
        size = math.sqrt(system[i, i])
        for j in range(nv):
            out[i, j] = system[i, count + j] / size
        level[i] = system[i, count + nv] / size


@compiled
def posture_pull(
    q: Array, v: Array, rest: Array, free: NDArray[np.bool_], stiffness: float, damping: float, wanted: Array
) -> None:
    """Desired acceleration of the posture: -k (q - q0) - d qd (Eq. 12, sign corrected).

    Args:
        q: shape (nq,).
        v: shape (nv,).
        rest: angles of the hinges, shape (nu,) [rad].
        free: hinges with a posture, those that are not of the legs, shape (nu,).
        stiffness: k [1/s^2].
        damping: d [1/s].
        wanted: written, shape (nv,).
    """
    wanted[0:3] = 0.0
    size = math.sqrt(q[3] ** 2 + q[4] ** 2 + q[5] ** 2)
    angle = 2.0 * math.atan2(size, q[6]) / size if size > 1e-12 else 2.0
    for k in range(3, 6):
        wanted[k] = -stiffness * angle * q[k] - damping * v[k]
    for j in range(len(rest)):
        pulled = -stiffness * (q[7 + j] - rest[j]) - damping * v[6 + j]
        wanted[6 + j] = pulled if free[j] else 0.0


@compiled
def settle(
    tree: Any,
    link: Any,
    soles: Any,
    columns: Array,
    rows: NDArray[np.intp],
    position_rows: NDArray[np.intp],
    toes: NDArray[np.intp],
    root_weight: Array,
    k: int,
    position: Array,
    rotation: Array,
    toe: Array,
    velocity: Array,
    tolerance: float,
    q: Array,
    v: Array,
    errors: Array,
) -> tuple[int, float, float]:
    """Correct the drift of the integration at a node of the grid.

    Args:
        tree: of the body.
        link: placed at the end.
        soles: frames of the feet.
        columns: transposed task Jacobian, of the state at the end.
        rows: of the tasks.
        position_rows: of the tasks that a configuration has.
        toes: indices of the toe joints in q.
        root_weight: square roots of the coordinates' weights, shape (nv,).
        k: the node.
        position: of :class:`~ampm.body.step_reference.StepReference`.
        rotation: of the same.
        toe: of the same.
        velocity: wanted task velocities, shape (n+1, R).
        tolerance: of the position error [m, rad].
        q: corrected, shape (nq,).
        v: corrected, shape (nv,).
        errors: of the positions when the node was lost, shape (P,).

    Returns:
        How it ended, and the largest errors of position and velocity before.
    """
    first, change = 0.0, np.empty(len(v))
    for iteration in range(4):
        place_body(tree, link, soles, q, columns)
        size = position_error(link, soles, q, toes, position[k], rotation[k], toe[k], errors)
        if iteration == 0:
            first = size
        if not size < _LOST:
            return LOST, first, 0.0
        if size < tolerance:
            break
        if not pull(columns, position_rows, root_weight, errors, change):
            return DEPENDENT, first, 0.0
        q[:] = moved(q, change)
        if size * size < tolerance:  # quadratic convergence: the remaining error is about size^2
            place_body(tree, link, soles, q, columns)
            break
    error = np.empty(len(rows))
    speed = row_error(columns, rows, v, velocity[k], error)
    if not pull(columns, rows, root_weight, error, change):
        return DEPENDENT, first, speed
    for j in range(len(v)):
        v[j] += change[j]
    return DONE, first, speed


@compiled
def unbounded(
    tree: Any,
    link: Any,
    soles: Any,
    columns: Array,
    rows: NDArray[np.intp],
    root_weight: Array,
    still: Array,
    wanted: Array,
    q: Array,
    v: Array,
    rest: Array,
    free: NDArray[np.bool_],
    stiffness: float,
    damping: float,
    joints: NDArray[np.intp],
    low: Array,
    high: Array,
    posture: Array,
    right: Array,
    acceleration: Array,
) -> int:
    """Accelerations that meet the tasks and are closest to the posture's, where no joint limit binds.

    Args:
        tree: of the body.
        link: placed.
        soles: frames of the feet.
        columns: transposed task Jacobian.
        rows: of the tasks.
        root_weight: square roots of the coordinates' weights, shape (nv,).
        still: zeros, shape (nv,).
        wanted: task accelerations, of which the drift is taken, shape (R,).
        q: shape (nq,).
        v: shape (nv,).
        rest: see :func:`posture_pull`.
        free: see :func:`posture_pull`.
        stiffness: see :func:`posture_pull`.
        damping: see :func:`posture_pull`.
        joints: velocity indices of the limited joints.
        low: their lower limits [rad].
        high: their upper limits [rad].
        posture: desired ones, written, shape (nv,).
        right: tasks less what the posture gives, written, shape (m,).
        acceleration: written, shape (nv,).

    Returns:
        DONE, DEPENDENT, or BOUND where a joint limit binds.
    """
    drift = np.zeros(len(wanted))
    task_drift(tree, link, soles, v, v, still, drift)
    for e in range(len(wanted)):
        wanted[e] -= drift[e]
    posture_pull(q, v, rest, free, stiffness, damping, posture)
    row_error(columns, rows, posture, wanted, right)
    if not pull(columns, rows, root_weight, right, acceleration):
        return DEPENDENT
    for j in range(len(v)):
        acceleration[j] += posture[j]
    for i in range(len(joints)):
        j = joints[i]
        least, most = limits_of(q[j + 1] + _LIMIT_HORIZON * v[j], low[i], high[i])
        if not least <= acceleration[j] <= most:
            return BOUND
    return DONE


@compiled
def limits_of(reach: float, low: float, high: float) -> tuple[float, float]:
    """Accelerations between which a joint keeps its range, from where it gets within the horizon [rad]."""
    scale = 2.0 / _LIMIT_HORIZON**2
    return scale * (low - reach), scale * (high - reach)


@compiled
def advance(q: Array, v: Array, acceleration: Array, before: Array, dt: float, last: float) -> Array:
    """Configuration after an interval, of second order (Adams-Bashforth); v becomes that after it.

    Args:
        q: shape (nq,).
        v: overwritten, shape (nv,).
        acceleration: shape (nv,).
        before: that of the node before, shape (nv,).
        dt: the interval [s].
        last: the interval before, 0 at the first node [s].
    """
    change = np.empty(len(v))
    for j in range(len(v)):
        slope = (acceleration[j] - before[j]) / last if last > 0.0 else 0.0
        change[j] = dt * v[j] + 0.5 * dt**2 * acceleration[j] + dt**3 / 6.0 * slope
        v[j] += dt * acceleration[j] + 0.5 * dt**2 * slope
    return moved(q, change)


@compiled
def yaw_rate_and_pitch(link: Any, trunk: Any, columns: Array, v: Array) -> tuple[float, float]:
    """Angular momentum about z over the mass [m^2/s], and pitch of the trunk [rad]."""
    total = 0.0
    for j in range(len(v)):
        total += columns[j, _L_Z] * v[j]
    axis = turned(link[trunk[0].joint].turn, column(trunk[0].turn, 2))
    return total, math.atan2(axis[0], axis[2])


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
        spread = run.body.arm_abduction + run.body.arm_abduction_roll * abs(1.0 - run.gait.c_y)
        for joint, sign in robot.description.spread:
            self.rest[robot.velocity_indices((joint,)) - 6] = sign * min(spread, WIDEST)
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
        self._still, self._toes = np.zeros(robot.nv), robot.toe_joints + 1
        free = np.ones(robot.nu, dtype=bool)
        free[np.concatenate(robot.leg_joints) - 6] = False
        self._rest = self.rest, free, self.stiffness, self.damping
        self._errors, self._right, self._level = np.zeros(len(self.position_rows)), np.zeros(m), np.zeros(m)
        body = self._body = robot.rigid_body
        own = body.tree, body.link, body.soles, body.columns, self.rows
        self._tasks: Any = *own, self.position_rows, self._toes, self._root_weight
        self._free_tasks: Any = *own, self._root_weight
        self._limits = self.limited, robot.lower[self.limited - 6], robot.upper[self.limited - 6]

    # ------------------------------------------------------------- one instant

    def _error(self, reference: StepReference, k: int, q: Array) -> float:
        """Place the body; fill in its task errors, in the order of ``position_rows``. The largest one."""
        body = self._body
        body.place(q)
        wanted = reference.position[k], reference.rotation[k], reference.toe[k]
        return position_error(body.link, body.soles, q, self._toes, *wanted, self._errors)

    def _pull(self, rows: NDArray[np.intp], error: Array, time: float) -> Array:
        """Weighted least-norm change of the coordinates that cancels an error; refuses dependent rows."""
        change = np.empty(self.robot.nv)
        if not pull(self._body.columns, rows, self._root_weight, error, change):
            raise _dependent(time)
        return change

    def _miss(self, reference: StepReference, k: int) -> Unreachable:
        """Message for the errors of the position rows at node k."""
        error = self._errors
        com, left, right = (float(np.abs(part).max()) for part in (error[:3], error[3:9], error[9:15]))
        side = "left" if left >= right else "right"
        size = max(com, left, right)
        what = f"the {side} leg does not reach from the hip to the planned foot (it misses by {size:.2g} m)"
        return Unreachable(float(reference.time[k]), what, size, 0.0, "m")

    def _check_knees(self, reference: StepReference, k: int, q: Array) -> None:
        for foot, angle in enumerate(self.robot.knee_flexion(q).tolist()):
            if angle < 0.0:
                what = f"the {('left', 'right')[foot]} knee would bend backwards: the leg is too short"
                raise Unreachable(float(reference.time[k]), what, angle, 0.0, "rad")

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
            step = self._pull(self.position_rows, self._errors, time)
            largest = float(np.abs(step).max())
            q = moved(q, step * min(1.0, 0.3 / largest) if largest > 0.3 else step)
        self._check_knees(reference, k, q)
        wanted = self._velocity(reference, offset)[k]
        row_error(self._body.columns, self.rows, v, wanted, self._right)
        return q, v + self._pull(self.rows, self._right, time)

    def upright(self, reference: StepReference, k: int, q: Array) -> Array:
        """Configuration on the constraints at grid node k that is nearest to the upright posture.

        Raises:
            Unreachable: no such configuration was found.
        """
        still, rows, error = self._still, self.position_rows, np.empty(len(self.position_rows))
        for _ in range(60):
            self._error(reference, k, q)
            wanted, task = self._posture(q, still) / self.stiffness, np.zeros(self.robot.task_rows)
            task[rows] = self._errors
            row_error(self._body.columns, rows, wanted, task, error)
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

    def _posture(self, q: Array, v: Array) -> Array:
        """Desired acceleration of the posture, shape (nv,)."""
        wanted = np.empty(self.robot.nv)
        posture_pull(q, v, *self._rest, wanted)
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
        robot, body, time, columns = self.robot, self._body, reference.time, self._body.columns
        n = len(time) - 1
        qs, (vs, accelerations) = np.empty((n + 1, robot.nq)), np.empty((2, n + 1, robot.nv))
        pitch, yaw_momentum = np.empty(n + 1), np.empty(n + 1)
        worst_position = worst_velocity = worst_acceleration = 0.0
        velocity = self._velocity(reference, offset)
        q, v = self.project(reference, 0, q, v, offset)
        last_step = 0.0
        for k in range(n + 1):
            if k > 0:
                place, speed = self._settle(reference, k, velocity, 1e-12 if k == n else CORRECTED, q, v)
                worst_position, worst_velocity = max(worst_position, place), max(worst_velocity, speed)
                self._check_knees(reference, k, q)
            wanted = reference.acceleration[k].copy()
            acceleration = self._accelerate(wanted, q, v, float(time[k]), draft=draft)
            residual = row_error(columns, self.rows, acceleration, wanted, self._right)
            worst_acceleration = max(worst_acceleration, residual)
            qs[k], vs[k], accelerations[k] = q, v, acceleration
            yaw_rate, pitch[k] = yaw_rate_and_pitch(body.link, body.trunk, columns, v)
            yaw_momentum[k] = robot.mass * yaw_rate
            if k < n:
                dt = float(time[k + 1] - time[k])
                q = advance(q, v, acceleration, accelerations[k - 1], dt, last_step)
                last_step = dt
        worst = worst_position, worst_velocity, worst_acceleration
        return StepTrajectory(qs, vs, accelerations, pitch, yaw_momentum, *worst)

    def _settle(
        self, reference: StepReference, k: int, velocity: Array, tolerance: float, q: Array, v: Array
    ) -> tuple[float, float]:
        """Correct the drift of the integration in place; the largest errors before [m, rad, m/s, rad/s]."""
        goals = reference.position, reference.rotation, reference.toe, velocity
        state = tolerance, q, v, self._errors
        end, place, speed = settle(*(*self._tasks, k, *goals, *state))
        if end == LOST:
            raise self._miss(reference, k)
        if end == DEPENDENT:
            raise _dependent(float(reference.time[k]))
        return place, speed

    def _accelerate(self, wanted: Array, q: Array, v: Array, time: float, *, draft: bool) -> Array:
        """Accelerations of one instant, the body placed; the drift is taken off the wanted ones.

        Where a joint limit binds, and at every instant of the step that is returned, by the QP in
        u = W^(1/2) (qdd - posture) with orthonormal rows.
        """
        posture, acceleration = np.empty((2, self.robot.nv))
        given = self._still, wanted, q, v, *self._rest, *self._limits, posture, self._right, acceleration
        end = unbounded(*(*self._free_tasks, *given))
        if end == DEPENDENT:
            raise _dependent(time)
        if draft and end == DONE:
            return acceleration
        m, (joints, *ends) = len(self.rows), self._limits
        orthonormal(self._body.columns, self.rows, self._root_weight, self._right, self._A[:m], self._level)
        scale, shift = self._root_weight.take(joints), posture.take(joints)
        reach = q.take(joints + 1) + _LIMIT_HORIZON * v.take(joints)
        bounds = np.array([limits_of(*limit) for limit in zip(reach, *ends, strict=True)]).T
        lower, upper = (np.concatenate([self._level, (bound - shift) * scale]) for bound in bounds)
        solution = self._solver.solve(self._P, self._q, self._A, lower, upper)
        if not solution.solved:
            what = "the joint limits of trunk and arms leave no acceleration that meets the plan"
            raise Unreachable(time, what, solution.residual, self.tolerance, "1")
        return posture + solution.x / self._root_weight


def _dependent(time: float) -> Unreachable:
    what = "feet, COM and angular momentum cannot be chosen independently: a leg is straight"
    return Unreachable(time, what, 0.0, 0.0, "1")
