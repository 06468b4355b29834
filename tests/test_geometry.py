"""Hulls and distances to their edges, against shapes whose answer is known and against each other."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from ampm.geometry import convex_hull, hull_distance, polygon_margin


@given(
    points=st.lists(st.tuples(st.floats(-1, 1), st.floats(-1, 1)), min_size=3, max_size=12, unique=True),
    query=st.tuples(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5)),
)
@settings(max_examples=100, deadline=None)
def test_hull_distance_against_the_hull(points, query):
    array = np.round(np.array(points), 3)
    hull = convex_hull(array)
    q = np.round(np.array(query), 3)
    assume(len(hull) >= 3)
    edges = np.roll(hull, -1, axis=0) - hull
    length = np.hypot(*edges.T)
    signed = (edges[:, 0] * (q - hull)[:, 1] - edges[:, 1] * (q - hull)[:, 0]) / length
    along = np.clip(np.sum((q - hull) * edges, axis=1) / length**2, 0.0, 1.0)
    nearest = np.hypot(*(q - hull - along[:, None] * edges).T).min()
    expected = signed.min() if signed.min() >= 0.0 else -nearest
    assert hull_distance(array[None], q[None])[0] == pytest.approx(expected, abs=1e-9)


def test_convex_hull_drops_what_lies_inside_or_on_an_edge():
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0.5, 0.5], [0.5, 0.0], [1, 1]], dtype=float)
    np.testing.assert_array_equal(convex_hull(square), [[0, 0], [1, 0], [1, 1], [0, 1]])
    assert len(convex_hull(np.array([[0.0, 1.0], [0.0, 2.0], [0.0, 1.0]]))) == 2


def test_polygon_margin_of_known_shapes():
    square = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0], [1.0, 1.0]])
    queries = np.array([[1.0, 0.5], [1.0, 1.0], [2.0, 1.0], [3.0, 3.0], [1.0, -0.5], [np.nan, 1.0]])
    points = np.broadcast_to(square, (len(queries), 5, 2))
    active = np.ones((len(queries), 5), dtype=bool)
    expected = [0.5, 1.0, 0.0, -np.sqrt(2.0), -0.5, np.nan]
    np.testing.assert_allclose(polygon_margin(points, active, queries), expected, rtol=0.0, atol=1e-12)
    segment, point, nothing = active.copy(), active.copy(), active.copy()
    segment[:, 2:], point[:, 1:], nothing[:] = False, False, False
    np.testing.assert_allclose(polygon_margin(points, segment, queries)[:2], [-0.5, -1.0])
    np.testing.assert_allclose(polygon_margin(points, point, queries)[:1], [-np.hypot(1.0, 0.5)])
    assert np.isnan(polygon_margin(points, nothing, queries)).all()
