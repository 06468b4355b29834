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
swing about zero: least is ``sum |m g Theta / 0.5 N m s^2|^2 + sum |d / 20 mm|^2 + sum |q / 50 mm|^2`` with
``Theta`` in the middle of every double support, ``d`` of every single support and ``q`` at the nodes.

A *map* is a matrix; that of a single support acts on its ten unknowns (x and y of each) and, by its last
column, on 1.
"""

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

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
    halfway: Array  # Theta in its middle, shape (N, 2) [m s^2]
    end: Array  # (c, v, J, Theta) at its end, shape (N, 4, 2)
    signal: Array  # (r, q) at its begin and end, shape (N, 2, 2, 2) [m]
    stands: Array  # (r, q) at the ends of the quarters of first and last double support, (2, 5, 2, 2) [m]


def _single_maps(problem: Problem, duration: Array) -> tuple[Array, Array]:
    """Single supports of durations (N,) [s].

    Returns:
        Maps to (c, v, J, Theta) at the end, shape (N, 8, 11), and to (r, q) at the begin, shape (N, 4, 11).
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
    return _from_feet(problem, move), _from_feet(problem, signal)


def _blend_maps(frequency: float, rate: Array, duration: Array) -> list[list[Array]]:
    """Blends with rates (n, 2) [1/s] and durations (n,) [s] along their axes.

    From (c, v, J, Theta) at the begin and (r, q) at begin and end to (c, v, J, Theta) at the end and Theta in
    the middle: 5 times 8 entries of shape (n, 2).
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
    return move


def _from_feet(problem: Problem, entries: list[list[Array]]) -> Array:
    """Maps in world of single supports, from entries along the axes of the feet, with c and r from there."""
    maps, place = _in_world(entries, problem.axes), problem.place
    constant = -_times(maps[:, :, :2], place)
    constant[:, :2] += place
    return np.concatenate([maps, constant[:, :, None]], axis=2)


def _quarters(frequency: float, signal: Array) -> list[Array]:
    """Four linear blends in a row, with (r, q) at the five ends as maps of six vectors, shape (5, 2, 6).

    Maps to (c, v, J, Theta) at the end: of the same at the begin, (r, q) of the support, the nodes, and the
    COM at rest, shapes (8, 8), (8, 4), (8, 6) and (8, 2).
    """
    step = np.array(_blend_maps(frequency, np.zeros((1, 2)), np.array([0.25 * SETTLING])))[:4, :, 0, 0]
    state = np.eye(4, 10)
    for ends in pairwise(signal):
        state = step[:, :4] @ state
        state[:, 4:] += step[:, 4:] @ np.concatenate(ends)
    return np.split(np.kron(state, np.eye(2)), [8, 12, 18], axis=1)


def _stand(vectors: Array) -> Array:
    """(r, q) at the ends of the quarters of the first or last double support, from rest on, shape (5, 2, m).

    The vectors (6, m) are r and q of the support; the nodes r in the middle, q at a quarter from the rest
    and in the middle; and the COM at rest.
    """
    r, q, r_middle, q_quarter, q_middle, rest = vectors
    point = [rest, 0.5 * (rest + r_middle), r_middle, 0.5 * (r_middle + r), r]
    return np.stack([point, [np.zeros_like(q), q_quarter, q_middle, 0.5 * (q_middle + q), q]], axis=1)


def _in_world(entries: list[list[Array]], axes: Array) -> Array:
    """Maps along two axes, a times b entries of shape (n, 2), as maps of vectors in world, (n, 2 a, 2 b)."""
    maps = np.moveaxis(np.array(entries), (0, 1), (2, 3))
    n, _, a, b = maps.shape
    along = axes.swapaxes(1, 2)[:, :, None, :, None, None] * axes.swapaxes(1, 2)[:, :, None, None, None, :]
    return np.asarray((maps[:, :, :, None, :, None] * along).sum(axis=1).reshape(n, 2 * a, 2 * b))


def _times(matrices: Array, vectors: Array) -> Array:
    """Products of matrices with vectors."""
    return np.asarray(np.einsum("...ij,...j->...i", matrices, vectors))


def _through(matrices: Array, maps: Array) -> Array:
    """Maps of single supports, then matrices."""
    constant = _times(matrices, maps[..., -1])
    return np.concatenate([matrices @ maps[..., :-1], constant[..., None]], axis=-1)


def _values(maps: Array, unknowns: Array) -> Array:
    """Values of maps of single supports."""
    return _times(maps[..., :-1], unknowns) + maps[..., -1]


def _between(problem: Problem, move: Array, begin: Array, end: Array) -> tuple[Array, Array]:
    """From a support to the next: eight equations of the motion, two of Theta in the middle.

    Maps of the support before and of that after, shape (N - 1, 10, 11) each; their sum is zero.
    """
    blend = _in_world(_blend_maps(problem.frequency, problem.blend, problem.double), problem.between)
    by_state, by_end, by_begin = np.split(blend, [8, 12], axis=2)
    before, after = _through(by_state, move[:-1]) + _through(by_end, end[:-1]), _through(by_begin, begin[1:])
    after[:, :8] -= np.eye(8, 11)
    return before, after


def _from_rest(problem: Problem, begin: Array) -> tuple[Array, Array]:
    """From rest to the first support: equations as above, as its map (10, 11), and one of the nodes (8, 6).

    Theta is zero in the middle of a double support that would be before this support.
    """
    by_state, by_begin, by_nodes, by_rest = _quarters(problem.frequency, _stand(np.eye(6)))
    after = np.zeros((10, 11))
    after[:8] = _through(by_begin, begin) - np.eye(8, 11)
    after[:8, -1] += _times(by_state[:, :2] + by_rest, problem.ends[0])
    half = 0.5 * float(problem.double[0]) if len(problem.double) else 0.0
    after[8:, 4:8] = np.hstack([-half * np.eye(2), np.eye(2)])
    return after, by_nodes


def _to_rest(problem: Problem, move: Array, end: Array) -> tuple[Array, Array]:
    """From the last support to rest: eight equations, as its map (8, 11) and one of the nodes (8, 6)."""
    by_state, by_end, by_nodes, by_rest = _quarters(problem.frequency, _stand(np.eye(6))[::-1])
    before = _through(by_state, move) + _through(by_end, end)
    before[:, -1] += _times(by_rest - np.eye(8, 2), problem.ends[1])
    return before, by_nodes


def solve(problem: Problem) -> Solution:
    """Solve for the unknowns of all supports, and for the nodes."""
    n, theta = len(problem.place), _THETA / problem.weight
    move, begin = _single_maps(problem, problem.single)
    end = _through(begin[:, :, :8], move)
    end[:, :, 8:] += begin[:, :, 8:]  # d and 1 remain
    before, after = _between(problem, move, begin, end)
    first, first_nodes = _from_rest(problem, begin[0])
    last, last_nodes = _to_rest(problem, move[-1], end[-1])
    after = np.concatenate([first[None], after])
    after[1:, :, -1] += before[:, :, -1]  # all constants of an equation
    for part in (before, after):
        part[:, 8:] /= theta
    # In turn: the first nodes (6); of every support the equations before it (10) and its unknowns (10);
    # equations (8) and nodes (6) of the end.
    equations = 6 + 20 * np.arange(n + 1)
    unknowns, end_nodes = equations[:-1] + 10, equations[-1] + 8
    unit, node_unit = np.repeat([1.0, _OFFSET], [8, 2]), np.repeat([1.0, _NODE], [2, 4])
    system = _Banded(20 * n + 20)
    system.put(equations[:1], [0], first_nodes[None] * node_unit)
    system.put(equations[:-1], unknowns, after[:, :, :-1] * unit, -after[:, :, -1])
    system.put(equations[1:-1], unknowns[:-1], before[:, :, :-1] * unit)
    system.put(equations[-1:], unknowns[-1:], last[None, :, :-1] * unit, -last[None, :, -1])
    system.put(equations[-1:], end_nodes, last_nodes[None] * node_unit)
    thetas, offsets = (np.add.outer(begins, [8, 9]) for begins in (equations[:-1], unknowns))
    squares = [*offsets.ravel(), 2, 3, 4, 5, *(end_nodes + np.arange(2, 6))]
    system.band[system.WIDTH, thetas], system.band[system.WIDTH, squares] = -1.0, 1.0
    x = system.solve()
    state = x[6:-14].reshape(n, 20)[:, 10:] * unit
    nodes = (np.stack([x[:6], x[-6:]]) * node_unit).reshape(2, 3, 2)
    signal = np.stack([_values(begin, state), _values(end, state)], axis=1).reshape(n, 2, 2, 2)
    rise, settle = (_stand(np.array([*signal[-k, k], *nodes[k], problem.ends[k]])) for k in (0, 1))
    halfway = _values(_single_maps(problem, 0.5 * problem.single)[0][:, 6:], state)
    ended, stands = _values(move, state).reshape(n, 4, 2), np.stack([rise, settle[::-1]])
    return Solution(problem, state.reshape(n, 5, 2), halfway, ended, signal, stands)


class _Banded:
    """Equations ``B x = b``, and least squares of ``x`` where D has a 1.

    They are one symmetric system ``[[D, B'], [B, -E]]`` in the order of the walk. A row of B whose entry of E
    is 1 is one of the least squares, too.
    """

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

    def solve(self) -> Array:
        """The solution."""
        from scipy.linalg import solve_banded  # imported here: SciPy is slow to load

        return np.asarray(solve_banded((self.WIDTH, self.WIDTH), self.band, self.right))
