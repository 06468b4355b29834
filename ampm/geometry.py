"""Convex hulls of a few points in the floor plane: support polygons and distances to their edges."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_BLOCK = 2000  # sets at a time: bounds the memory of their (n, k, k, k) arrays
_TINY = 1e-12  # points nearer than this are one, points farther right than this are right of a line [m]


def convex_hull(points: Array) -> Array:
    """Corners of the convex hull, anticlockwise from the least x (Andrew's monotone chain).

    Args:
        points: shape (n, 2) [m].

    Returns:
        Shape (k, 2) [m], without points on the edges.
    """
    order = sorted({(float(x), float(y)) for x, y in points})
    if len(order) < 3:
        return np.array(order).reshape(-1, 2)

    def chain(ordered: list[tuple[float, float]]) -> list[tuple[float, float]]:
        kept: list[tuple[float, float]] = []
        for p in ordered:
            while len(kept) >= 2:
                (ax, ay), (bx, by) = kept[-2], kept[-1]
                if (bx - ax) * (p[1] - ay) - (by - ay) * (p[0] - ax) > 0.0:
                    break
                kept.pop()
            kept.append(p)
        return kept[:-1]

    return np.array(chain(order) + chain(order[::-1]))


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
    patterns, which = np.unique(active, axis=0, return_inverse=True)
    for number, pattern in enumerate(patterns):
        if not pattern.any():
            continue
        rows, columns = np.flatnonzero(which.ravel() == number), np.flatnonzero(pattern)
        for first in range(0, rows.size, _BLOCK):
            part = rows[first : first + _BLOCK]
            margin[part] = hull_distance(points[np.ix_(part, columns)], query[part])
    return margin


def hull_distance(points: Array, query: Array) -> Array:
    """Signed distance of each query point to the edge of the convex hull of its own k points.

    No hull is built: an ordered pair of points is an edge where every point lies on its left. Outside, the
    nearest point of the hull lies on a segment between two of its points. Memory grows with N k^3.

    Args:
        points: shape (N, k, 2), k >= 1 [m].
        query: shape (N, 2) [m].

    Returns:
        Positive inside, negative outside, NaN where the query is NaN, shape (N,) [m].
    """
    arm = points[:, None, :, :] - points[:, :, None, :]  # [n, i, j] from i to j
    length = np.hypot(arm[..., 0], arm[..., 1])
    proper = length > _TINY
    unit = arm / np.where(proper, length, 1.0)[..., None]
    # How far every point m lies to the left of the line i -> j, [n, i, j, m].
    left = unit[:, :, :, None, 0] * arm[:, :, None, :, 1] - unit[:, :, :, None, 1] * arm[:, :, None, :, 0]
    is_edge = proper & (left >= -_TINY).all(axis=-1)
    to_query = query[:, None, None, :] - points[:, :, None, :]  # [n, i, 1]
    side = unit[..., 0] * to_query[..., 1] - unit[..., 1] * to_query[..., 0]
    inside = np.where(is_edge, side, np.inf).min(axis=(1, 2))
    # A point paired with itself has unit and length zero: its segment is that point.
    along = np.clip(unit[..., 0] * to_query[..., 0] + unit[..., 1] * to_query[..., 1], 0.0, length)
    rest = to_query - unit * along[..., None]
    outside = np.hypot(rest[..., 0], rest[..., 1]).min(axis=(1, 2))
    enclosed = (inside >= 0.0) & np.isfinite(inside)
    return np.where(enclosed, inside, -outside)
