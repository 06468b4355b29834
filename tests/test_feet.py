"""Foot paths: derivatives, smoothness over key-frames, pivots that rest, soles over the floor."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from ampm.description import SoleGeometry
from ampm.exceptions import InputError
from ampm.geometry import convex_hull, hull_distance, polygon_margin
from ampm.parameters import FootParameters
from ampm.planner.stride import plan_feet, quintic
from ampm.planner.support import plan_steps
from ampm.presets import preset_names
from ampm.run_file import load_run
from models.human import sole_geometry

SOLE = SoleGeometry(-0.1, 0.09, 0.16, 0.03, 0.04, 0.035, -0.035, 0.066)
SCHEDULES = {
    "flat": FootParameters(schedule="flat"),
    "roll": FootParameters(swing_height=0.08, swing_lag=0.05, toe_return=0.8, heel_strike_rate=0.0),
    "turning": FootParameters(
        swing_height=0.08, swing_lag=-0.1, toe_return=1.0, heel_strike_rate=2.0, full_contact=1.0
    ),
    "early": FootParameters(swing_height=0.08, toe_return=0.3, heel_rise_lead=0.05, full_contact=0.5),
}
STEPS = 5


def gait(**values):
    return load_run("normal", [f"gait.steps={STEPS}"]).gait.model_copy(update=values)


def planned(foot, **values):
    return plan_steps(gait(**values), 60.0, foot, SOLE)


@pytest.fixture(scope="module", params=SCHEDULES)
def plan(request):
    return planned(SCHEDULES[request.param])


@pytest.mark.parametrize("name", preset_names())
def test_soles_stay_over_the_floor(name):
    run = load_run(name, ["gait.steps=4"])
    plan = plan_steps(run.gait, 60.0, run.foot, sole_geometry(run.body.height))
    for foot in plan.feet.sample(np.linspace(0.0, plan.duration, 20001)):
        assert foot.sole_points[..., 2].min() > -1e-12


@given(
    values=st.lists(st.floats(-3, 3), min_size=6, max_size=6),
    durations=st.lists(st.floats(0.05, 3.0), min_size=2, max_size=2),
)
def test_quintics_meet_both_ends(values, durations):
    start, end = np.reshape(values, (2, 3))
    both = quintic(np.stack([start, start], axis=1), np.stack([end, end], axis=1), durations)
    assert both.shape == (2, 6)
    for coefficients, duration in zip(both, durations, strict=True):
        polynomial = np.polynomial.Polynomial(coefficients)
        size = (1.0 + np.abs(values).max() * (1.0 + duration**2)) * max(1.0, duration**-2)
        for time, wanted in ((0.0, start), (duration, end)):
            found = [polynomial.deriv(k)(time) if k else polynomial(time) for k in range(3)]
            np.testing.assert_allclose(found, wanted, atol=1e-11 * size)


def test_what_has_no_feet_is_refused():
    foot = SCHEDULES["roll"]
    plan = planned(foot)
    contacts, steps = plan.contacts, plan.contacts.footsteps
    turned = (*steps[:-1], steps[-1]._replace(heading=0.1))
    for wrong in (replace(contacts, phases=contacts.phases[1:]), replace(contacts, footsteps=turned)):
        with pytest.raises(InputError):
            plan_feet(wrong, foot, SOLE)


# --------------------------------------------------------------------------------- the support polygon


def test_the_support_polygon_of_flat_feet():
    plan = planned(SCHEDULES["flat"], step_length=0.4, switching_velocity=0.8)
    single = plan.support_polygon(0.1)
    np.testing.assert_allclose([single[:, 0].min(), single[:, 0].max()], [-0.1, 0.16])
    np.testing.assert_allclose([single[:, 1].min(), single[:, 1].max()], [0.05, 0.13])
    double = plan.support_polygon(plan.contacts.starts[1] + 0.01)
    np.testing.assert_allclose([double[:, 0].min(), double[:, 0].max()], [-0.1, 0.56])
    times = np.linspace(0.0, plan.duration, 300)
    margin = plan.zmp_margin(times)
    assert margin.min() > 0.0
    # In single support the nearest edge is the heel, the toe or a side.
    middle = plan.zmp_margin(plan.constants.single_support_duration / 2)[0]
    assert 0.03 < middle < 0.04


def test_no_instant_undercuts_the_least_margin(plan):
    least, time = plan.least_zmp_margin()
    assert plan.zmp_margin(time)[0] == least
    beside = np.concatenate([plan.contacts.starts[1:] + shift for shift in (-1e-9, 0.0, 1e-9)])
    assert least <= plan.zmp_margin(beside).min() + 1e-12
    # What a grid sees approaches it from above.
    grid = plan.zmp_margin(np.linspace(0.0, plan.duration, 20001)).min()
    assert least - 1e-12 <= grid
    part, time = plan.least_zmp_margin(0.1)
    assert 0.0 <= time <= 0.1
    assert part >= least
    assert np.isfinite(plan.least_zmp_margin(0.0)[0])
    with pytest.raises(InputError, match="outside"):
        plan.least_zmp_margin(plan.duration + 1.0)


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
