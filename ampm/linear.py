"""Small sums and systems of equations, compiled: symmetric ones with their right-hand sides beside them.

Unlike BLAS they have the same bits on every processor; searches that end elsewhere after a difference in the
last bit need that.
"""

import numpy as np

from ampm.compiled import compiled
from ampm.geometry import Array


@compiled
def add_combination(factor: float, rows: Array, x: Array, out: Array) -> None:
    """``out = out + factor rows' x``: x says how much of every row is added."""
    for j in range(len(x)):
        for e in range(len(out)):
            out[e] += factor * rows[j, e] * x[j]


@compiled
def add_gram(a: Array, weighted: Array, out: Array) -> None:
    """``out = out + a' D a`` of a, with many zeros, and of ``weighted = D a``, D diagonal, shapes (k, n)."""
    count, n = a.shape
    for j in range(count):
        end = n
        while end > 0 and a[j, end - 1] == 0.0:
            end -= 1
        for i in range(end):
            factor = a[j, i]
            if factor != 0.0:
                for e in range(end):
                    out[i, e] += factor * weighted[j, e]


@compiled
def solved(matrix: Array, right: Array) -> Array:
    """Solution of a symmetric positive definite system, shapes (n, n) and (n,).

    Raises LinAlgError if it is not positive definite.
    """
    system = np.empty((len(matrix), len(matrix) + 1))
    system[:, :-1] = matrix
    system[:, -1] = right
    if not triangular(system):
        raise np.linalg.LinAlgError("the matrix is not positive definite")
    substitute(system)
    return system[:, -1].copy()


@compiled
def triangular(system: Array) -> bool:
    """Eliminate below the diagonal; whether the matrix is positive definite.

    The system is matrix and right-hand sides, shape (n, n + r); of the matrix, the upper half is used.
    """
    count, width = system.shape
    for c in range(count):
        pivot = system[c, c]
        if not pivot > 0.0:
            return False
        for r in range(c + 1, count):
            factor = system[c, r] / pivot
            if factor != 0.0:
                for d in range(width):  # of a fixed length, which takes less time than from r on
                    system[r, d] -= factor * system[c, d]
    return True


@compiled
def substitute(system: Array) -> None:
    """Turn the right-hand sides of a triangular system into its solutions."""
    count, width = system.shape
    for c in range(count - 1, -1, -1):
        right = system[c, count:]
        for r in range(c + 1, count):
            factor, other = system[c, r], system[r, count:]
            for d in range(width - count):
                right[d] -= factor * other[d]
        for d in range(width - count):
            right[d] /= system[c, c]
