"""The linear problem of a walk over footsteps from rest to rest, and its solution.

With given durations and a given ``1/a_s`` of every support, a walk is linear in the states at the begin of
its single supports. In world, with ``w^2 = g/H``:

- ``c`` COM, ``p`` ZMP, ``r = c - c''/w^2``, ``q = p - r`` the arm of the moment about the COM,
- ``J`` the integral of ``q`` (``L_x = m g J_y``, ``L_y = -m g J_x``), ``Theta`` that of ``J``: it turns the
  trunk,
- ``d`` the offset of a support's force line, the paper's own: it changes ``q``, not the ZMP.

Unknown are ``(c, v, J, Theta, d)`` of every single support and the nodes of the first and the last double
support, in which ``r`` and ``q`` are piecewise linear. Equations are the motion from each support to the
next one, and rest at both ends. What they leave free (``d`` and the nodes of ``q``) lets the angular momentum
swing about zero: least squares on ``Theta`` in the middle of every double support, on ``d`` and these nodes.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ampm.geometry import Array
from ampm.planner.blend import shape

SETTLING = 0.8
"""Duration of the first and of the last double support [s]."""
_OFFSET, _NODE, _THETA = 0.02, 0.05, 0.5  # units of the least squares [m, m, N m s^2]


class Problem(NamedTuple):
    """What is solved: N single supports, and the double supports between them."""

    place: Array  # of the standing foot, shape (N, 2) [m]
    axes: Array  # of that foot in world, by columns, shape (N, 2, 2)
    single: Array  # durations, shape (N,) [s]
    double: Array  # durations in between, shape (N - 1,) [s]
    between: Array  # axes of the mean heading of both feet, shape (N - 1, 2, 2)
    blend: Array  # rates k of the blends along these axes, shape (N - 1, 2) [1/s]
    frequency: float  # w = sqrt(g / H) [1/s]
    inverse_a: Array  # `1/a_s` of every single support, shape (N,) [1]
    slopes: Array  # (c_s, c_y) of every single support, shape (N, 2)
    ends: Array  # COM at rest before and after the walk, shape (2, 2) [m]
    weight: float  # of the body [N]


class Solution(NamedTuple):
    """A solved walk, in world."""

    problem: Problem  # what was solved
    state: Array  # (c, v, J, Theta, d) at the begin of every single support, shape (N, 5, 2)
    end: Array  # (c, v, J, Theta) at its end, shape (N, 4, 2)
    signal: Array  # (r, q) at its begin and end, shape (N, 2, 2, 2) [m]
    # of the first and the last double support: r at the middle; q at a quarter from the rest and at the
    # middle; shape (2, 3, 2) [m]
    nodes: Array


def single_maps(problem: Problem, duration: Array) -> tuple[Array, Array]:
    """Single supports in the axes of their feet.

    Returns:
        From (u, v, J, Theta, d) at the begin to (u, v, J, Theta) at the end, shape (N, 2, 4, 5); and to
        (r, q) from the foot at the same instant, shape (N, 2, 2, 5).
    """
    square, c = problem.frequency**2, problem.slopes
    rate = square * np.stack([c[:, 0] - problem.inverse_a, c[:, 1]], axis=1)
    T = np.broadcast_to(duration[:, None], rate.shape)
    k = np.sqrt(np.abs(rate))
    ch = np.where(rate > 0.0, np.cosh(k * T), np.cos(k * T))
    sh = np.where(rate > 0.0, np.sinh(k * T), np.sin(k * T)) / k
    lever, zero, one = c - 1.0, np.zeros_like(rate), np.ones_like(rate)
    once, twice = (ch - 1.0) / rate, (sh - T) / rate  # integrals of ch, twice and thrice
    offset = square * once, square * sh, square * twice, square * (once - 0.5 * T * T) / rate
    move = [
        [ch, sh, zero, zero, offset[0]],
        [rate * sh, ch, zero, zero, offset[1]],
        [lever * sh, lever * once, one, zero, lever * offset[2] + T],
        [lever * once, lever * twice, T, one, lever * offset[3] + 0.5 * T * T],
    ]
    signal = [[one - rate / square, zero, zero, zero, -one], [lever, zero, zero, zero, one]]
    return _stacked(move), _stacked(signal)


def _blend_maps(frequency: float, rate: Array, duration: Array) -> Array:
    """Blends with rates (n, 2) [1/s] and durations (n,) [s] along their axes.

    From (c, v, J, Theta) at the begin and (r, q) at begin and end to (c, v, J, Theta) at the end and Theta in
    the middle, shape (n, 2, 5, 8).
    """
    T, w = np.broadcast_to(duration[:, None], rate.shape), frequency
    end, middle = shape(rate, T, T), shape(rate, T, 0.5 * T)
    ch, sh, gain = np.cosh(w * T), np.sinh(w * T) / w, w**2 / (w**2 + rate**2)
    zero, one = np.zeros_like(T), np.ones_like(T)
    # COM and velocity per mean and per difference of r.
    mean = 1.0 - ch, -(w**2) * sh
    rise = gain * (0.5 * (1.0 + ch) - sh * end.rate), gain * (end.rate * (1.0 - ch) + 0.5 * w**2 * sh)
    move = [
        [ch, sh, zero, zero, 0.5 * mean[0] - rise[0], zero, 0.5 * mean[0] + rise[0], zero],
        [w**2 * sh, ch, zero, zero, 0.5 * mean[1] - rise[1], zero, 0.5 * mean[1] + rise[1], zero],
        [zero, zero, one, zero, zero, 0.5 * T, zero, 0.5 * T],
    ]
    for since, bend in ((T, end.double_integral), (0.5 * T, middle.double_integral)):
        half = 0.25 * since * since
        move.append([zero, zero, since, one, zero, half - bend, zero, half + bend])
    return _stacked(move)


def _quarters(frequency: float, point: Array, arm: Array) -> Array:
    """Four linear blends in a row, with r and q at the five ends as maps of m numbers, shape (5, m) each.

    From (c, v, J, Theta) at the begin and the m numbers to (c, v, J, Theta) at the end, for vectors, shape
    (8, 8 + 2 m).
    """
    step = _blend_maps(frequency, np.zeros((1, 2)), np.array([0.25 * SETTLING]))[0, 0, :4]
    state = np.hstack([np.eye(4), np.zeros((4, point.shape[1]))])
    for i in range(4):
        state = step[:, :4] @ state
        state[:, 4:] += step[:, 4:] @ np.stack([point[i], arm[i], point[i + 1], arm[i + 1]])
    return np.asarray(np.kron(state, np.eye(2)), dtype=np.float64)


def stand_nodes(
    r: Array, q: Array, r_middle: Array, q_quarter: Array, q_middle: Array, rest: Array
) -> tuple[Array, Array]:
    """Values of r and q at the ends of the quarters of a double support, from rest on, shape (5, m) each.

    All arguments have the shape (m,): r and q at the single support, r at the middle, q at a quarter from the
    rest and at the middle, and the COM at rest.
    """
    point = [rest, 0.5 * (rest + r_middle), r_middle, 0.5 * (r_middle + r), r]
    return np.array(point), np.array([np.zeros_like(q), q_quarter, q_middle, 0.5 * (q_middle + q), q])


def _stacked(entries: list[list[Array]]) -> Array:
    """Matrices of entries of shape (n, 2), shape (n, 2, a, b)."""
    return np.moveaxis(np.array(entries), (0, 1), (2, 3))


def in_world(maps: Array, axes: Array) -> Array:
    """Maps along two axes, (n, 2, a, b), as one of vectors in world, (n, 2 a, 2 b)."""
    n, _, a, b = maps.shape
    along = axes.swapaxes(1, 2)[:, :, None, :, None, None] * axes.swapaxes(1, 2)[:, :, None, None, None, :]
    return np.asarray((maps[:, :, :, None, :, None] * along).sum(axis=1).reshape(n, 2 * a, 2 * b))


def times(matrices: Array, vectors: Array) -> Array:
    """Products of matrices with vectors."""
    return np.asarray(np.einsum("...ij,...j->...i", matrices, vectors))


def solve(problem: Problem) -> Solution:
    """Solve for the states of all supports."""
    n, place, theta = len(problem.place), problem.place, _THETA / problem.weight
    move, signal = (in_world(m, problem.axes) for m in single_maps(problem, problem.single))
    # The maps of a support count from its foot. In world they get constants: of the state at its end (moved),
    # of the signal at its begin (begun) and end (ended). The signal at its end per state is `leaving`.
    moved, begun = -times(move[:, :, :2], place), -times(signal[:, :, :2], place)
    moved[:, :2] += place
    begun[:, :2] += place
    ended = begun + times(signal[:, :, :8], moved)
    leaving = signal[:, :, :8] @ move
    leaving[:, :, 8:] += signal[:, :, 8:]

    # From a support to the next: eight equations of the motion, two of Theta in the middle.
    blend = in_world(_blend_maps(problem.frequency, problem.blend, problem.double), problem.between)
    by_state, by_signal, by_next = blend[:, :, :8], blend[:, :, 8:12], blend[:, :, 12:]
    before = by_state @ move[:-1] + by_signal @ leaving[:-1]
    after = by_next @ signal[1:]
    after[:, :8, :8] -= np.eye(8)
    known = times(by_state, moved[:-1]) + times(by_signal, ended[:-1]) + times(by_next, begun[1:])
    for part in (before, after, known):
        part[:, 8:] /= theta

    # The ends as maps of: r and q of the support, r and two q of the nodes, the COM at rest.
    point, arm = stand_nodes(*np.eye(6))
    up = _quarters(problem.frequency, point, arm)
    down = _quarters(problem.frequency, point[::-1], arm[::-1])
    first = np.zeros((10, 10))
    first[:8] = up[:, 8:12] @ signal[0] - np.eye(8, 10)
    half = 0.5 * float(problem.double[0]) if n > 1 else 0.0  # Theta is zero in the middle of double support
    first[8:, 6:8], first[8:, 4:6] = np.eye(2) / theta, -half / theta * np.eye(2)
    first_known = times(up[:, :2] + up[:, 18:], problem.ends[0]) + times(up[:, 8:12], begun[0])
    last = down[:, :8] @ move[-1] + down[:, 8:12] @ leaving[-1]
    last_known = times(down[:, :8], moved[-1]) + times(down[:, 8:12], ended[-1])
    last_known += times(down[:, 18:] - np.eye(8, 2), problem.ends[1])

    # Nodes, then in turn the equations before a support and its state; equations and nodes of the end.
    system = _Banded(20 * n + 20)
    offset, node = np.repeat([1.0, _OFFSET], [8, 2]), np.repeat([1.0, _NODE], [2, 4])
    row = 6 + 20 * np.arange(n + 1)
    system.put(row[:1], [0], up[None, :, 12:18] * node, -first_known[None])
    system.put(row[:1], row[:1] + 10, first[None] * offset)
    system.put(row[1:-1], row[1:-1] - 10, before * offset, -known)
    system.put(row[1:-1], row[1:-1] + 10, after * offset)
    system.put(row[-1:], row[-1:] - 10, last[None] * offset, -last_known[None])
    system.put(row[-1:], row[-1:] + 8, down[None, :, 12:18] * node)
    system.diagonal((row[:-1, None] + np.array([8, 9])).ravel(), -1.0)
    system.diagonal((row[:-1, None] + np.array([18, 19])).ravel(), 1.0)
    system.diagonal(np.array([2, 3, 4, 5, *(row[-1] + np.arange(10, 14))]), 1.0)
    x = system.solve()
    state = x[6:-14].reshape(n, 20)[:, 10:] * offset
    end = times(move, state) + moved
    both = np.stack([times(signal, state) + begun, times(leaving, state) + ended], axis=1)
    nodes = np.stack([x[:6], x[-6:]]) * node
    shapes = (n, 5, 2), (n, 4, 2), (n, 2, 2, 2), (2, 3, 2)
    return Solution(problem, *map(np.reshape, (state, end, both, nodes), shapes))


class _Banded:
    """A symmetric indefinite system ``[[D, B'], [B, -I]]`` whose unknowns are in the order of the walk."""

    WIDTH = 19
    """Largest distance of an entry from the diagonal."""

    def __init__(self, size: int) -> None:
        self.band, self.right = np.zeros((2 * self.WIDTH + 1, size)), np.zeros(size)

    def put(self, row: Any, column: Any, blocks: Array, right: Array | None = None) -> None:
        """Put blocks of B, (k, a, b), with their first rows and columns, and their right sides, (k, a)."""
        _, a, b = blocks.shape
        rows = np.broadcast_to(np.reshape(row, (-1, 1, 1)) + np.arange(a)[:, None], blocks.shape)
        columns = np.broadcast_to(np.reshape(column, (-1, 1, 1)) + np.arange(b), blocks.shape)
        self.band[self.WIDTH + rows - columns, columns] = blocks
        self.band[self.WIDTH + columns - rows, rows] = blocks
        if right is not None:
            self.right[rows[:, :, 0]] = right

    def diagonal(self, at: NDArray[np.intp], value: float) -> None:
        """Put entries of D or -I."""
        self.band[self.WIDTH, at] = value

    def solve(self) -> Array:
        """The solution."""
        from scipy.linalg import solve_banded  # imported here: SciPy is slow to load

        return np.asarray(solve_banded((self.WIDTH, self.WIDTH), self.band, self.right))
