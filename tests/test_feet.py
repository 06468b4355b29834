"""Foot paths: derivatives, smoothness over key-frames, pivots that rest, soles over the floor."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from ampm import load_run
from ampm.description import SoleGeometry
from ampm.geometry import convex_hull, hull_distance
from ampm.parameters import FootParameters
from ampm.planner.stride import plan_feet
from ampm.planner.support import plan_steps

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


def feet_of(**change):
    """Feet of a gait's contacts with something else in them."""
    return plan_feet(replace(planned(SCHEDULES["roll"]).contacts, **change), SCHEDULES["roll"], SOLE)


@pytest.mark.parametrize("foot", SCHEDULES.values(), ids=SCHEDULES)
def test_no_instant_undercuts_the_least_margin(foot):
    plan = planned(foot)
    least, time = plan.least_zmp_margin()
    assert plan.zmp_margin(time)[0] == least
    beside = np.concatenate([plan.contacts.starts[1:] + shift for shift in (-1e-9, 0.0, 1e-9)])
    assert least <= plan.zmp_margin(beside).min() + 1e-12
    # What a grid sees approaches it from above.
    grid = plan.zmp_margin(np.linspace(0.0, plan.duration, 20001)).min()
    assert least - 1e-12 <= grid


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
