"""Small symmetric systems of equations, compiled: a matrix with its right-hand sides beside it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ampm.compiled import compiled

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


@compiled
def triangular(system: Array) -> bool:
    """Eliminate below the diagonal; whether the matrix is positive definite.

    Args:
        system: matrix and right-hand sides, shape (n, n + r). Of the matrix, the upper half is used.
    """
    count, width = system.shape
    for c in range(count):
        pivot = system[c, c]
        if not pivot > 0.0:
            return False
        for r in range(c + 1, count):
            factor = system[c, r] / pivot
            if factor != 0.0:
                for d in range(r, width):
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
