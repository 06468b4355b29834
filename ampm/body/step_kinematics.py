"""One instant of the inverse kinematics, and the integration of a step, as compiled functions.

See :mod:`ampm.body.inverse_kinematics`, whose class calls them.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ampm.body.rigid_body import moved, place_body, place_of, task_drift
from ampm.compiled import compiled
from ampm.linear import add_gram, eliminate, substitute, triangular
from ampm.vectors import column, minus, multiply, plus, put, rotation_vector, turned, vector

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ampm.geometry import Array

DONE, LOST, DEPENDENT, BY_QP = range(4)
"""How a compiled function ended: as wanted; too far from the tasks; tasks that depend on each other; at
accelerations that the QP has to find."""

CORRECTED = 1e-9
"""Position error that a corrected grid node may keep [m, rad]."""
LIMIT_HORIZON = 0.02
"""Time over which a joint limit may be approached [s]."""

_LOST = 0.05  # error after a step of the grid at which the legs no longer follow [m, rad]
_L_Z = 5  # row of the angular momentum about z


class Tasks(NamedTuple):
    """The body, and the rows of its tasks that are met.

    Attributes:
        tree: of the body.
        link: of the state that was placed last.
        soles: frames of the feet.
        trunk: frame of the trunk.
        columns: transposed task Jacobian of that state, shape (nv, R).
        rows: of the tasks, shape (m,).
        position_rows: of the tasks that a configuration has, shape (P,).
        toes: indices of the toe joints in q, shape (T,).
        root_weight: square roots of the coordinates' weights, shape (nv,).
    """

    tree: Any
    link: Any
    soles: Any
    trunk: Any
    columns: Array
    rows: NDArray[np.intp]
    position_rows: NDArray[np.intp]
    toes: NDArray[np.intp]
    root_weight: Array


class Rest(NamedTuple):
    """The posture that the body is pulled to, and the joints whose limits are kept.

    Attributes:
        angles: of the hinges, shape (nu,) [rad].
        free: hinges with a posture, those that are not of the legs, shape (nu,).
        stiffness: k [1/s^2].
        damping: d [1/s].
        joints: velocity indices of the limited joints, shape (L,).
        low: their lower limits [rad].
        high: their upper limits [rad].
    """

    angles: Array
    free: NDArray[np.bool_]
    stiffness: float
    damping: float
    joints: NDArray[np.intp]
    low: Array
    high: Array


class Goals(NamedTuple):
    """Wanted tasks at the nodes of a grid, see :class:`ampm.body.step_reference.StepReference`."""

    time: Array
    position: Array
    rotation: Array
    toe: Array
    velocity: Array
    acceleration: Array


class Nodes(NamedTuple):
    """The step at the nodes of the grid, written one after the other.

    Attributes:
        q: shape (n+1, nq).
        v: shape (n+1, nv).
        acceleration: shape (n+1, nv).
        pitch: of the trunk, shape (n+1,) [rad].
        yaw: angular momentum about z over the mass, shape (n+1,) [m^2/s].
        errors: of position and velocity before they were corrected, and of the acceleration, (n+1, 3).
    """

    q: Array
    v: Array
    acceleration: Array
    pitch: Array
    yaw: Array
    errors: Array


class Instant(NamedTuple):
    """What an instant leaves for the next function.

    Attributes:
        scaled: ``W^-1/2 J'`` of the rows, shape (nv, m).
        system: triangular ``J W^-1 J'``, and a right-hand side, shape (m, m + 1).
        wanted: task accelerations without their drift, shape (R,).
        posture: desired accelerations, shape (nv,).
        right: tasks less what the posture gives, shape (m,).
        miss: errors of the positions, shape (P,).
    """

    scaled: Array
    system: Array
    wanted: Array
    posture: Array
    right: Array
    miss: Array


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
def factor(columns: Array, rows: NDArray[np.intp], root_weight: Array, scaled: Array, system: Array) -> bool:
    """Prepare :func:`pull` for some rows; whether they are independent.

    Args:
        columns: transposed task Jacobian, shape (nv, R).
        rows: m of them.
        root_weight: square roots of the coordinates' weights, shape (nv,).
        scaled: ``W^-1/2 J'`` is written, shape (nv, m).
        system: triangular ``J W^-1 J'`` is written, shape (m, m + 1).
    """
    weigh(columns, rows, root_weight, scaled)
    system[:] = 0.0
    add_gram(scaled, system)
    return triangular(system)


@compiled
def weigh(columns: Array, rows: NDArray[np.intp], root_weight: Array, scaled: Array) -> None:
    """Write ``W^-1/2 J'`` of some rows, shape (nv, m)."""
    for j in range(len(columns)):
        per_weight = 1.0 / root_weight[j]
        for i in range(len(rows)):
            scaled[j, i] = columns[j, rows[i]] * per_weight


@compiled
def pull(scaled: Array, system: Array, root_weight: Array, error: Array, change: Array) -> None:
    """Weighted least-norm change of the coordinates that cancels the error of some rows.

    Args:
        scaled: of :func:`factor`.
        system: of :func:`factor`.
        root_weight: square roots of the coordinates' weights, shape (nv,).
        error: shape (m,).
        change: written, shape (nv,).
    """
    count = len(system)
    system[:, count] = error
    eliminate(system, count)
    substitute(system)
    for j in range(len(change)):
        total = 0.0
        for i in range(count):
            total += scaled[j, i] * system[i, count]
        change[j] = total / root_weight[j]


@compiled
def orthonormal(scaled: Array, right: Array, out: Array, level: Array) -> None:
    """Orthonormal rows with the span of ``J W^-1/2``, and their right-hand sides.

    Args:
        scaled: ``W^-1/2 J'`` of independent rows, shape (nv, m).
        right: right-hand sides of the rows, shape (m,).
        out: written, shape (m, nv).
        level: written, shape (m,).
    """
    nv, count = scaled.shape
    system = np.zeros((count, count + nv + 1))
    add_gram(scaled, system)
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
def posture_pull(q: Array, v: Array, rest: Rest, wanted: Array) -> None:
    """Desired acceleration of the posture: -k (q - q0) - d qd (Eq. 12, sign corrected), shape (nv,)."""
    stiffness, damping = rest.stiffness, rest.damping
    wanted[0:3] = 0.0
    size = math.sqrt(q[3] ** 2 + q[4] ** 2 + q[5] ** 2)
    angle = 2.0 * math.atan2(size, q[6]) / size if size > 1e-12 else 2.0
    for k in range(3, 6):
        wanted[k] = -stiffness * angle * q[k] - damping * v[k]
    for j in range(len(rest.angles)):
        pulled = -stiffness * (q[7 + j] - rest.angles[j]) - damping * v[6 + j]
        wanted[6 + j] = pulled if rest.free[j] else 0.0


@compiled
def settle(
    tasks: Tasks, goals: Goals, k: int, tolerance: float, q: Array, v: Array, instant: Instant
) -> tuple[int, float, float]:
    """Correct the drift of the integration at a node of the grid.

    Args:
        tasks: of the state at the end.
        goals: of all nodes.
        k: the node.
        tolerance: of the position error [m, rad].
        q: corrected, shape (nq,).
        v: corrected, shape (nv,).
        instant: factor of the rows, and the errors of the positions, are written.

    Returns:
        How it ended, and the largest errors of position and velocity before.
    """
    tree, link, soles, columns, root_weight = (
        tasks.tree,
        tasks.link,
        tasks.soles,
        tasks.columns,
        tasks.root_weight,
    )
    first, change, miss, count = 0.0, np.empty(len(v)), instant.miss, len(instant.miss)
    scaled, system = np.empty((len(v), count)), np.empty((count, count + 1))
    for iteration in range(4):
        place_body(tree, link, soles, q, columns)
        wanted = goals.position[k], goals.rotation[k], goals.toe[k]
        size = position_error(link, soles, q, tasks.toes, *wanted, miss)
        if iteration == 0:
            first = size
        if not size < _LOST:
            return LOST, first, 0.0
        if size < tolerance:
            break
        if not factor(columns, tasks.position_rows, root_weight, scaled, system):
            return DEPENDENT, first, 0.0
        pull(scaled, system, root_weight, miss, change)
        q[:] = moved(q, change)
        if size * size < tolerance:  # quadratic convergence: the remaining error is about size^2
            place_body(tree, link, soles, q, columns)
            break
    error = np.empty(len(tasks.rows))
    speed = row_error(columns, tasks.rows, v, goals.velocity[k], error)
    if not factor(columns, tasks.rows, root_weight, instant.scaled, instant.system):
        return DEPENDENT, first, speed
    pull(instant.scaled, instant.system, root_weight, error, change)
    for j in range(len(v)):
        v[j] += change[j]
    return DONE, first, speed


@compiled
def accelerate(
    tasks: Tasks, rest: Rest, wanted: Array, q: Array, v: Array, instant: Instant, acceleration: Array
) -> bool:
    """Accelerations that meet the tasks and are closest to the posture's; whether no joint limit binds there.

    Args:
        tasks: of the state.
        rest: of the body.
        wanted: task accelerations, shape (R,).
        q: shape (nq,).
        v: shape (nv,).
        instant: factor of the rows; what the QP needs besides is written.
        acceleration: written, shape (nv,).
    """
    drift, still, posture, right = np.zeros(len(wanted)), np.zeros(len(v)), instant.posture, instant.right
    task_drift(tasks.tree, tasks.link, tasks.soles, v, v, still, drift)
    instant.wanted[:] = wanted - drift
    posture_pull(q, v, rest, posture)
    row_error(tasks.columns, tasks.rows, posture, instant.wanted, right)
    pull(instant.scaled, instant.system, tasks.root_weight, right, acceleration)
    for j in range(len(v)):
        acceleration[j] += posture[j]
    for i in range(len(rest.joints)):
        j = rest.joints[i]
        least, most = limits_of(q[j + 1] + LIMIT_HORIZON * v[j], rest.low[i], rest.high[i])
        if not least <= acceleration[j] <= most:
            return False
    return True


@compiled
def limits_of(reach: Any, low: Any, high: Any) -> tuple[Any, Any]:
    """Accelerations between which a joint keeps its range, from where it gets within the horizon [rad]."""
    scale = 2.0 / LIMIT_HORIZON**2
    return scale * (low - reach), scale * (high - reach)


@compiled
def note(tasks: Tasks, instant: Instant, k: int, nodes: Nodes) -> None:
    """Write what else is known of node k, whose state was placed last."""
    columns, v, residual = tasks.columns, nodes.v[k], np.empty(len(tasks.rows))
    nodes.errors[k, 2] = row_error(columns, tasks.rows, nodes.acceleration[k], instant.wanted, residual)
    nodes.yaw[k] = 0.0
    for j in range(len(v)):
        nodes.yaw[k] += columns[j, _L_Z] * v[j]
    axis = turned(tasks.link[tasks.trunk[0].joint].turn, column(tasks.trunk[0].turn, 2))
    nodes.pitch[k] = math.atan2(axis[0], axis[2])


@compiled
def advance(nodes: Nodes, time: Array, k: int) -> None:
    """Write the state of node k + 1 by an interval of second order (Adams-Bashforth)."""
    dt, v, acceleration, change = (
        time[k + 1] - time[k],
        nodes.v[k],
        nodes.acceleration[k],
        np.empty(len(nodes.v[k])),
    )
    for j in range(len(v)):
        slope = (acceleration[j] - nodes.acceleration[k - 1, j]) / (time[k] - time[k - 1]) if k > 0 else 0.0
        change[j] = dt * v[j] + 0.5 * dt**2 * acceleration[j] + dt**3 / 6.0 * slope
        nodes.v[k + 1, j] = v[j] + (dt * acceleration[j] + 0.5 * dt**2 * slope)
    nodes.q[k + 1] = moved(nodes.q[k], change)


@compiled
def follow(
    tasks: Tasks, rest: Rest, goals: Goals, k: int, draft: bool, instant: Instant, nodes: Nodes
) -> tuple[int, int]:
    """Integrate from node k, which has its acceleration, to the next one that needs the QP, or to the end.

    Args:
        tasks: placed at node k.
        rest: of the body.
        goals: of all nodes.
        k: where to start.
        draft: whether only nodes at which a joint limit binds need the QP.
        instant: for the QP.
        nodes: written from node k on.

    Returns:
        How it ended, and at which node.
    """
    last = len(goals.time) - 1
    while True:
        note(tasks, instant, k, nodes)
        if k == last:
            return DONE, k
        advance(nodes, goals.time, k)
        k += 1
        q, v, tolerance = nodes.q[k], nodes.v[k], 1e-12 if k == last else CORRECTED
        end, nodes.errors[k, 0], nodes.errors[k, 1] = settle(tasks, goals, k, tolerance, q, v, instant)
        if end != DONE:
            return end, k
        free = accelerate(tasks, rest, goals.acceleration[k], q, v, instant, nodes.acceleration[k])
        if not (free and draft):
            return BY_QP, k
