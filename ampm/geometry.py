"""The floor plane: headings, support polygons and distances to their edges."""

from collections.abc import Iterator
from functools import reduce

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_BLOCK = 500  # sets at a time: their (k, k, n) arrays stay in the processor's cache
_TINY = 1e-12  # points nearer than this are one, points farther right than this are right of a line [m]


class ReadOnly:
    """Base of dataclasses whose arrays cannot be written to."""

    def __post_init__(self) -> None:
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)


def blocks(rows: int, size: int = 4096) -> Iterator[slice]:
    """Slices of rows, a block after another, as intermediate results of all would need much memory."""
    return (slice(first, min(first + size, rows)) for first in range(0, max(rows, 1), size))


def rotations(heading: ArrayLike) -> Array:
    """Axes along and across headings (...) [rad], by columns, shape (..., 2, 2)."""
    c, s = np.cos(heading), np.sin(heading)
    return np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=-2)


def convex_hull(points: Array) -> Array:
    """Corners of the convex hull of points (n, 2) [m], anticlockwise, shape (k, 2) [m].

    It has no points on the edges; of points on a line it is the ends.
    """
    from scipy.spatial import ConvexHull, QhullError  # imported here: SciPy is slow to load

    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except (QhullError, ValueError):  # fewer than three points, or all on a line
        ordered = np.unique(points, axis=0)
        return ordered[[0, -1][: len(ordered)]]


def polygon_margin(points: Array, active: NDArray[np.bool_], query: Array) -> Array:
    """Signed distance of each query point to the convex hull of the active points, inside positive.

    Args:
        points: shape (N, M, 2) [m].
        active: which of them span the hull, shape (N, M).
        query: shape (N, 2) [m].

    Returns:
        Shape (N,) [m]; NaN where no point is active or the query is NaN. A hull without area has no inside.
    """
    margin = np.full(len(query), np.nan)
    # Few patterns of contact occur in a walk, and each has few points: far cheaper than all M points at once.
    code = active @ (1 << np.arange(active.shape[1]))
    for number in sorted(set(code[code > 0].tolist())):
        rows = np.flatnonzero(code == number)
        columns = np.flatnonzero(active[rows[0]])
        for block in blocks(rows.size, _BLOCK):
            part = rows[block]
            margin[part] = hull_distance(points[np.ix_(part, columns)], query[part])
    return margin


def hull_distance(points: Array, query: Array) -> Array:
    """Signed distance of each query point to the edge of the convex hull of its own k points.

    No hull is built: an ordered pair of points is an edge where every point lies on its left. Outside, the
    nearest point of the hull lies on a segment between two of its points.

    Args:
        points: shape (N, k, 2), k >= 1 [m].
        query: shape (N, 2) [m].

    Returns:
        Positive inside, negative outside, NaN where the query is NaN, shape (N,) [m].
    """
    # The sets lie along the last axis: numpy's inner loops are then long.
    x, y = np.ascontiguousarray(points.T)  # [i, n]
    arm_x, arm_y = x - x[:, None], y - y[:, None]  # [i, j, n] from i to j
    length = np.hypot(arm_x, arm_y)
    proper = length > _TINY
    unit_x, unit_y = (arm / np.where(proper, length, 1.0) for arm in (arm_x, arm_y))
    # How far every point m lies to the left of the line i -> j.
    left = (unit_x * arm_y[:, m, None] - unit_y * arm_x[:, m, None] for m in range(len(x)))
    is_edge = proper & (reduce(np.minimum, left) >= -_TINY)
    to_x, to_y = (query.T[:, None] - (x, y))[:, :, None]  # [i, 1, n] from i to the query
    side = unit_x * to_y - unit_y * to_x
    inside = np.where(is_edge, side, np.inf).min(axis=(0, 1))
    # A point paired with itself has unit and length zero: its segment is that point.
    along = np.clip(unit_x * to_x + unit_y * to_y, 0.0, length)
    outside = np.hypot(to_x - unit_x * along, to_y - unit_y * along).min(axis=(0, 1))
    enclosed = (inside >= 0.0) & np.isfinite(inside)
    return np.where(enclosed, inside, -outside)
