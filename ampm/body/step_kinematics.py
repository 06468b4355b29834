"""One instant of the inverse kinematics, and the integration of a step, as compiled functions.

See :mod:`ampm.body.inverse_kinematics`, whose class calls them.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ampm.body.rigid_body import RigidBody, com_of, moved, place_body, place_of, task_drift
from ampm.body.robot import L_Z
from ampm.body.step_reference import StepReference
from ampm.compiled import compiled
from ampm.geometry import Array
from ampm.linear import add_combination, add_gram, solved
from ampm.vectors import column, minus, multiply, plus, put, rotation_vector, turned, vector

Rows = NDArray[np.intp]

EXACT = 1e-12
"""Position error that a corrected state may keep at the ends of a step [m, rad]."""
CORRECTED = 1e-9
"""The same at the other nodes of the grid."""
_FAR = 0.05  # error after a step of the grid at which the legs no longer follow [m, rad]
_MOST = 26  # iterations of a correction
_LONGEST = 0.3  # largest change of a coordinate in one iteration [m, rad]
_LEVEL = 20.0  # rate at which the sole of a leg without a roll of the ankle is laid flat [1/s]


class Kinematics(NamedTuple):
    """A body, the rows of its tasks that are met, and the posture that it is pulled to."""

    rigid: RigidBody
    rows: Rows  # of the tasks, shape (m,)
    position_rows: Rows  # of the tasks that a configuration has, shape (P,)
    roll_rows: Rows  # of the rolls of both soles if the legs cannot hold them, see `standing_roll`
    toes: Rows  # indices of the toe joints in q, shape (T,)
    miss: Array  # errors of the positions of the state that was placed last, by task row, shape (R,) [m, rad]
    weight: Array  # W of the coordinates, shape (nv,)
    rest: Array  # angles of the hinges at rest, shape (nu,) [rad]
    free: NDArray[np.bool_]  # hinges with a posture, those that are not of the legs, shape (nu,)
    pelvis: Array  # list and rotation of the pelvis at rest, see `posture`, shape (2,) [rad]
    stiffness: float  # k [1/s^2]
    damping: float  # d [1/s]


class StepTrajectory(NamedTuple):
    """One integrated step: states and accelerations at the n + 1 times of the grid."""

    q: Array  # Pinocchio configurations, shape (n+1, nq)
    v: Array  # Pinocchio velocities, shape (n+1, nv)
    acceleration: Array  # Pinocchio accelerations, shape (n+1, nv)
    trunk_pitch: Array  # pitch of the trunk segment, shape (n+1,) [rad]
    angular_momentum_z: Array  # about the COM, shape (n+1,) [N m s]


@compiled
def place(body: Kinematics, tasks: StepReference, k: int, q: Array) -> float:
    """Place a body; the largest error of the positions at node k [m, rad].

    The errors of COM, soles (place, then rotation vector) and toe joints are written to ``body.miss``.
    """
    place_body(body.rigid, q)
    link, soles, error = body.rigid.link, body.rigid.soles, body.miss
    root, pose = (q[0], q[1], q[2]), np.empty((3, 3))
    put(error[0:3], minus(vector(tasks.position[k, 0]), plus(root, com_of(link))))
    for i in range(len(soles)):
        sole, row = soles[i], 6 + 6 * i
        multiply(link[sole.joint].turn, sole.turn, pose)
        put(error[row : row + 3], minus(vector(tasks.position[k, 1 + i]), plus(root, place_of(link, sole))))
        put(error[row + 3 : row + 6], rotation_vector(tasks.rotation[k, i], pose))
    first = 6 + 6 * len(soles)
    for i in range(len(body.toes)):
        error[first + i] = tasks.toe[k, i] - q[body.toes[i]]
    return np.abs(error[body.position_rows]).max()


@compiled
def tasks_of(body: Kinematics, rows: Rows) -> tuple[Array, Array, Array]:
    """``J'``, ``W^-1 J'`` and ``J W^-1 J'`` of some rows of the tasks, where a body is placed."""
    columns, jacobian = body.rigid.columns, np.empty((len(body.weight), len(rows)))
    weighted, gram = np.empty_like(jacobian), np.zeros((len(rows), len(rows)))
    for j in range(len(jacobian)):  # in loops, which take half the time of numpy's expressions
        for i in range(len(rows)):
            jacobian[j, i] = columns[j, rows[i]]
            weighted[j, i] = jacobian[j, i] / body.weight[j]
    add_gram(jacobian, weighted, gram)
    return jacobian, weighted, gram


@compiled
def nearest(tasks: tuple[Array, Array, Array], x: Array, wanted: Array) -> Array:
    """The vector nearest to another one, in the metric of the weights, that meets the tasks.

    It minimises ``1/2 || y - x ||^2_W`` subject to ``J y = wanted``:
    ``y = x + W^-1 J' (J W^-1 J')^-1 (wanted - J x)``.

    Args:
        tasks: m of them, see :func:`tasks_of`.
        x: change, velocity or acceleration of the coordinates, shape (nv,).
        wanted: shape (m,).
    """
    jacobian, weighted, gram = tasks
    out, missing = x.copy(), wanted.copy()
    add_combination(-1.0, jacobian, x, missing)
    add_combination(1.0, weighted.T, solved(gram, missing), out)
    return out


@compiled
def limited(change: Array, most: float) -> Array:
    """A change of the coordinates, shortened so that none changes by more than ``most`` [m, rad]."""
    return change * min(1.0, most / max(np.abs(change).max(), 1e-300))


@compiled
def posture(body: Kinematics, q: Array, v: Array, phase: float, rate: float) -> Array:
    """Desired acceleration of the posture: -k (q - q0) - d qd (Eq. 12, sign corrected), shape (nv,).

    The pelvis lists towards the swing foot by a sine of the phase, which goes from 0 to pi in a step, and
    turns the hip of the front foot forward by its cosine.

    Args:
        body: supplies q0, k and d.
        q: shape (nq,).
        v: shape (nv,).
        phase: of the step [rad].
        rate: of the phase; 0 where the body stands [rad/s].
    """
    wanted = np.zeros(len(v))
    vector_part = q[3:6]
    size = math.sqrt((vector_part**2).sum())
    twice = math.copysign(2.0, q[6])  # of two opposite quaternions that with the smaller angle
    angle_over_size = twice * math.atan2(size, abs(q[6])) / size if size > 1e-12 else twice
    sine, cosine = body.pelvis[0] * math.sin(phase), body.pelvis[1] * math.cos(phase)
    rest = np.array([sine, 0.0, -cosine])
    turning = np.array([body.pelvis[0] * math.cos(phase), 0.0, body.pelvis[1] * math.sin(phase)])
    wanted[3:6] = -body.stiffness * angle_over_size * vector_part - body.damping * v[3:6]
    wanted[3:6] += (body.stiffness - rate**2) * rest + body.damping * rate * turning
    wanted[6:] = body.free * (-body.stiffness * (q[7:] - body.rest) - body.damping * v[6:])
    return wanted


@compiled
def correct(body: Kinematics, tasks: StepReference, k: int, q: Array, tolerance: float, far: float) -> bool:
    """Bring a configuration onto the tasks at node k by Newton's method.

    Args:
        body: is placed in the corrected configuration.
        tasks: of all nodes.
        k: the node.
        q: corrected, shape (nq,).
        tolerance: of the position error [m, rad].
        far: position error at which it gives up [m, rad].

    Returns:
        Whether it converged.
    """
    rows, still, size = body.position_rows, np.zeros(len(body.weight)), place(body, tasks, k, q)
    for iteration in range(_MOST):
        if size < tolerance:
            break
        if not size < far or iteration == _MOST - 1:
            return False
        change = nearest(tasks_of(body, rows), still, body.miss[rows])
        q[:] = moved(q, limited(change, _LONGEST))
        converged = size * size < tolerance  # Newton's next error is about the square of the last
        size = place(body, tasks, k, q)
        if converged:
            break
    return True


@compiled
def upright(body: Kinematics, tasks: StepReference, k: int, q: Array) -> Array:
    """Configuration near the tasks at node k and nearest to the posture at rest, from a first guess."""
    still = np.zeros(len(body.weight))
    for _ in range(60):
        place(body, tasks, k, q)
        pull = posture(body, q, still, 0.0, 0.0) / body.stiffness
        change = nearest(tasks_of(body, body.position_rows), pull, body.miss[body.position_rows])
        q = moved(q, limited(change, 0.2))
        if np.abs(change).max() < 1e-6:
            break
    return q


@compiled
def standing_roll(body: Kinematics, tasks: StepReference, k: int) -> int:
    """Task row of the roll of the foot that stands alone, if the ankles do not roll; else -1.

    Of two feet on the floor neither is held flat: the distance of the legs changes as the pelvis lists.
    """
    if len(body.roll_rows) == 0:
        return -1
    left, right = tasks.velocity[k, 6:12].any(), tasks.velocity[k, 12:18].any()
    return -1 if left == right else body.roll_rows[0 if right else 1]


@compiled
def advance(step: StepTrajectory, time: Array, k: int) -> None:
    """Write the state of node k + 1 by an interval of second order (Adams-Bashforth)."""
    dt, v, a = time[k + 1] - time[k], step.v[k], step.acceleration[k]
    slope = np.zeros(len(v))
    if k > 0:
        slope = (a - step.acceleration[k - 1]) / (time[k] - time[k - 1])
    step.v[k + 1] = v + dt * a + 0.5 * dt**2 * slope
    step.q[k + 1] = moved(step.q[k], dt * v + 0.5 * dt**2 * a + dt**3 / 6.0 * slope)


@compiled
def follow(body: Kinematics, tasks: StepReference, step: StepTrajectory) -> int:
    """Integrate a step from its first state.

    Returns:
        Number of nodes that were reached; a leg does not reach at the next one.
    """
    last = len(tasks.time) - 1
    rate, rigid = math.pi / tasks.time[last], body.rigid
    for k in range(last + 1):
        if k > 0:
            advance(step, tasks.time, k - 1)
        q, v, drift = step.q[k], step.v[k], np.zeros(tasks.velocity.shape[1])
        tolerance, far = EXACT if k in (0, last) else CORRECTED, _FAR if k else np.inf
        if not correct(body, tasks, k, q, tolerance, far):
            return k
        rows, velocity, acceleration = body.rows, tasks.velocity[k].copy(), tasks.acceleration[k].copy()
        roll = standing_roll(body, tasks, k)
        if roll >= 0:  # brought to zero
            rows = np.append(rows, roll)
            velocity[roll] = (rigid.columns[:, roll] * v).sum()
            acceleration[roll] = _LEVEL**2 * body.miss[roll] - 2.0 * _LEVEL * velocity[roll]
        met = tasks_of(body, rows)
        v[:] = nearest(met, v, velocity[rows])
        # Eqs. 8-12: minimise 1/2 || a - p ||^2_W subject to J a = wanted - dJ/dt v, p the posture's.
        task_drift(rigid, v, v, drift)
        wanted = (acceleration - drift)[rows]
        step.acceleration[k] = nearest(met, posture(body, q, v, rate * tasks.time[k], rate), wanted)
        step.angular_momentum_z[k] = rigid.link[0].mass * (rigid.columns[:, L_Z] * v).sum()
        axis = turned(rigid.link[rigid.trunk[0].joint].turn, column(rigid.trunk[0].turn, 2))
        step.trunk_pitch[k] = math.atan2(axis[0], axis[2])
    return last + 1
