"""OSQP's iteration for small dense problems, compiled (Stellato et al. 2020, algorithms 1 and 2).

    (P + sigma 1 + A' R A) x~ = sigma x - q + A' (R z - y),    z~ = A x~
    x+ = alpha x~ + (1 - alpha) x
    z+ = projection of alpha z~ + (1 - alpha) z + y / R on the bounds
    y+ = y + R (alpha z~ + (1 - alpha) z - z+)

R holds the penalty of every row: rho, a thousand times as much where the bounds are equal. The matrix is
inverted once per problem, and again when rho is adapted, so an iteration is three products of a matrix and a
vector. Slacks, which are the last unknowns, each with a cost and a row of its own, are eliminated before.
Tests, tolerances and adaptation are OSQP's, so the iterates are the same but for rounding.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ampm.compiled import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

SOLVED, UNSOLVED, INFEASIBLE, REFUSED = range(4)
"""How a solve ended: REFUSED if the cost is not convex, or a number not finite."""

_SIGMA = 1e-6
_EQUAL, _EQUAL_PENALTY, _LOOSE_PENALTY = 1e-4, 1e3, 1e-6
_RHO_LEAST, _RHO_MOST, _ADAPT_EVERY, _ADAPT_FACTOR = 1e-6, 1e6, 50, 5.0
_CERTIFICATE, _TINY, _INFINITY = 1e-4, 1e-30, 1e26


@compiled
def solve(
    own: Any, P: Array, q: Array, A: Array, lower: Array, upper: Array, answer: Array
) -> tuple[int, float, int]:
    """Minimise ``1/2 x'Px + q'x`` subject to ``lower <= A x <= upper``.

    An answer that is not finite or does not exist leaves no trace: the next solve starts at zero.

    Args:
        own: of :class:`ampm.qp.AdmmBackend`: ``tolerance``, absolute and relative; ``max_iterations``;
            ``rho``, the penalty, and whether it adapts; ``alpha``, over-relaxation; ``check_every``,
            iterations between two tests; ``slack_rows``, rows of the slacks, the last unknowns. Where to
            start, overwritten by where to start next: ``x``, shape (n,), ``z``, of ``A x``, and ``y``, of
            the multipliers, shapes (m,). The other arrays have no meaning between calls.
        P: symmetric, positive semidefinite, shape (n, n).
        q: shape (n,).
        A: shape (m, n).
        lower: shape (m,), may be ``-inf``.
        upper: shape (m,), may be ``inf``.
        answer: written, shape (n,).

    Returns:
        How it ended, the residual of the constraints, and the iterations.
    """
    for i in range(len(lower)):
        if lower[i] > upper[i]:
            answer[:] = math.nan
            return INFEASIBLE, (lower - upper).max(), 0
        if not lower[i] <= upper[i]:  # one is no number
            answer[:] = math.nan
            return UNSOLVED, math.inf, 0
    end, residual, iterations = iterate(own, P, q, A, lower, upper)
    answer[:] = own.x
    if not np.isfinite(answer).all():
        end, residual = REFUSED if end == REFUSED else UNSOLVED, math.inf
    if end == INFEASIBLE or residual == math.inf:
        own.x[:], own.z[:], own.y[:] = 0.0, 0.0, 0.0
    return end, residual, iterations


@compiled
def iterate(own: Any, P: Array, q: Array, A: Array, lower: Array, upper: Array) -> tuple[int, float, int]:
    """The iteration itself, see :func:`solve`; x, z, y are the last iterates."""
    x, z, y, rho, slack_rows = own.x, own.z, own.y, own.rho, own.slack_rows
    n, m, free = len(q), len(z), len(q) - len(slack_rows)
    penalty, inverse, columns, diagonal = own.penalty, own.inverse, own.columns, own.diagonal
    right, Ax, Px, Aty, guess = own.right, own.Ax, own.Px, own.Aty, own.guess
    pull, x_step, y_step, primal = own.pull, own.x_step, own.y_step, math.inf
    columns[:] = A.T
    if not factor(P, A, lower, upper, rho, slack_rows, penalty, diagonal, inverse):
        return REFUSED, math.inf, 0
    alpha, tolerance = own.alpha, own.tolerance
    for iteration in range(1, own.max_iterations + 1):
        for i in range(m):
            pull[i] = penalty[i] * z[i] - y[i]
        combine(A, pull, right)
        for j in range(n):
            right[j] += _SIGMA * x[j] - q[j]
        for s in range(n - free):
            row = A[slack_rows[s]]
            w = penalty[slack_rows[s]] * row[free + s] / diagonal[s] * right[free + s]
            for j in range(free):
                right[j] -= w * row[j]
        combine(inverse, right[:free], guess[:free])
        combine(columns[:free], guess[:free], Ax)
        for s in range(n - free):
            i, scale = slack_rows[s], A[slack_rows[s], free + s]
            guess[free + s] = (right[free + s] - penalty[i] * scale * Ax[i]) / diagonal[s]
            Ax[i] += scale * guess[free + s]
        for j in range(n):
            x_step[j] = alpha * (guess[j] - x[j])
            x[j] = alpha * guess[j] + (1.0 - alpha) * x[j]
        for i in range(m):
            relaxed = alpha * Ax[i] + (1.0 - alpha) * z[i]
            z[i] = min(max(relaxed + y[i] / penalty[i], lower[i]), upper[i])
            y_step[i] = penalty[i] * (relaxed - z[i])
            y[i] += y_step[i]
        tests, adapts = iteration % own.check_every == 0, own.adaptive and iteration % _ADAPT_EVERY == 0
        if not (tests or adapts or iteration == own.max_iterations):
            continue
        combine(columns, x, Ax)
        combine(P, x, Px)
        combine(A, y, Aty)
        primal, dual = 0.0, 0.0
        for i in range(m):
            primal = larger(primal, abs(Ax[i] - z[i]))
        for j in range(n):
            dual = larger(dual, abs(Px[j] + q[j] + Aty[j]))
        row_size, cost_size = max(size(Ax), size(z)), max(size(Px), size(Aty), size(q))
        if tests or iteration == own.max_iterations:
            feasible = primal < tolerance + tolerance * row_size
            if feasible and dual < tolerance + tolerance * cost_size:
                return SOLVED, primal, iteration
            if (not feasible and no_point(A, lower, upper, y_step)) or no_end(
                P, q, columns, lower, upper, x_step
            ):
                return INFEASIBLE, primal, iteration
        if adapts:
            ratio = primal / (row_size + _TINY) / (dual / (cost_size + _TINY))
            better = min(max(rho * math.sqrt(ratio), _RHO_LEAST), _RHO_MOST)
            if better > _ADAPT_FACTOR * rho or better < rho / _ADAPT_FACTOR:
                rho = better
                factor(P, A, lower, upper, rho, slack_rows, penalty, diagonal, inverse)
    return UNSOLVED, primal, own.max_iterations


@compiled
def larger(a: float, b: float) -> float:
    """The larger number; b if that is none."""
    return a if a > b else b


@compiled
def size(a: Array) -> float:
    """Largest absolute value; NaN if the last one is none."""
    largest = 0.0
    for i in range(len(a)):
        largest = larger(largest, abs(a[i]))
    return largest


@compiled
def combine(rows: Array, weights: Array, out: Array) -> None:
    """``out = rows' weights``: independent sums, which processors add side by side."""
    out[:] = 0.0
    many = len(rows) - len(rows) % 4
    for i in range(0, many, 4):
        a, b, c, d = weights[i], weights[i + 1], weights[i + 2], weights[i + 3]
        for j in range(len(out)):
            out[j] = out[j] + a * rows[i, j] + b * rows[i + 1, j] + c * rows[i + 2, j] + d * rows[i + 3, j]
    for i in range(many, len(rows)):
        for j in range(len(out)):
            out[j] += weights[i] * rows[i, j]


@compiled
def factor(
    P: Array,
    A: Array,
    lower: Array,
    upper: Array,
    rho: float,
    slack_rows: NDArray[np.intp],
    penalty: Array,
    diagonal: Array,
    inverse: Array,
) -> bool:
    """Penalties of the rows, and the inverse of ``P + sigma 1 + A' R A``; whether there is one.

    With the slack of a row eliminated, whose entry is c and whose diagonal is d, the row counts with
    ``r - (r c)^2 / d``.
    """
    free = len(inverse)
    for i in range(len(lower)):
        if upper[i] - lower[i] < _EQUAL:
            penalty[i] = min(_EQUAL_PENALTY * rho, _RHO_MOST)
        elif lower[i] < -_INFINITY and upper[i] > _INFINITY:
            penalty[i] = _LOOSE_PENALTY
        else:
            penalty[i] = rho
    left = penalty.copy()
    for s in range(len(slack_rows)):
        i, j = slack_rows[s], free + s
        diagonal[s] = P[j, j] + _SIGMA + penalty[i] * A[i, j] ** 2
        left[i] -= (penalty[i] * A[i, j]) ** 2 / diagonal[s]
    for j in range(free):
        for k in range(free):
            inverse[j, k] = P[j, k]
        inverse[j, j] += _SIGMA
    for i in range(len(A)):
        for j in range(free):
            w = left[i] * A[i, j]
            if w != 0.0:
                for k in range(free):
                    inverse[j, k] += w * A[i, k]
    return invert(inverse)


@compiled
def invert(matrix: Array) -> bool:
    """Invert a symmetric matrix in place, by Gauss and Jordan; whether it is positive definite."""
    n = len(matrix)
    for c in range(n):
        if not matrix[c, c] > 0.0:
            return False
        top, pivot = matrix[c], 1.0 / matrix[c, c]
        top[c] = 1.0
        for k in range(n):
            top[k] *= pivot
        for r in range(n):
            row = matrix[r]
            w = row[c]
            if r != c:  # to look for zeros would take longer
                row[c] = 0.0
                for k in range(n):
                    row[k] -= w * top[k]
    return True


@compiled
def no_point(A: Array, lower: Array, upper: Array, step: Array) -> bool:
    """Whether a step of the multipliers proves that the bounds leave no point."""
    direction, support = step.copy(), 0.0
    for i in range(len(step)):
        if upper[i] > _INFINITY:
            direction[i] = 0.0 if lower[i] < -_INFINITY else min(step[i], 0.0)
        elif lower[i] < -_INFINITY:
            direction[i] = max(step[i], 0.0)
    scale = size(direction)
    if not scale > _TINY:
        return False
    for i in range(len(step)):
        if direction[i] > 0.0:
            support += upper[i] * direction[i]
        elif direction[i] < 0.0:
            support += lower[i] * direction[i]
    if not support < 0.0:
        return False
    balance = np.empty(A.shape[1])
    combine(A, direction, balance)
    return size(balance) < _CERTIFICATE * scale


@compiled
def no_end(P: Array, q: Array, columns: Array, lower: Array, upper: Array, step: Array) -> bool:
    """Whether a step of x proves that the cost has no lower bound."""
    scale, slope = size(step), 0.0
    for j in range(len(q)):
        slope += q[j] * step[j]
    if not (scale > _TINY and slope < 0.0):
        return False
    curved, moved = np.empty(len(q)), np.empty(len(lower))
    combine(P, step, curved)
    if not size(curved) < _CERTIFICATE * scale:
        return False
    combine(columns, step, moved)
    for i in range(len(moved)):
        if upper[i] < _INFINITY and moved[i] > _CERTIFICATE * scale:
            return False
        if lower[i] > -_INFINITY and moved[i] < -_CERTIFICATE * scale:
            return False
    return True
