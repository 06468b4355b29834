"""The plan as a whole: continuity, an independent integration, properties; its numbers are in golden.csv.

Foot paths: derivatives, smoothness over key-frames, pivots that rest, soles over the floor.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from ampm import GaitParameters, MathematicalRefusal, load_run
from ampm.description import SoleGeometry
from ampm.geometry import convex_hull, hull_distance
from ampm.parameters import FootParameters
from ampm.planner.periodic import RESIDUAL_LIMIT, plan_gait
from ampm.planner.stride import plan_feet
from ampm.planner.support import plan_steps
from tests import properties

G, MASS = 9.81, 60.0
GOLDEN = GaitParameters(
    com_height=0.88,
    step_length=0.6,
    single_support_ratio=0.7,
    switching_velocity=1.0,
    a_s=4.0,
    c_s=1.2,
    c_y=0.6,
    step_width=0.18,
    steps=6,
)


def changed(**values):
    return GOLDEN.model_copy(update=values)


def force_law_integration(p, steps):
    """Switch times and solutions (x, y, vx, vy, L_x, L_y) of xdd = F/m, from the ZMP and force laws alone."""
    half, w, plain = p.step_length / 2, p.step_width / 2, p.planner == "lipm"
    l_s, l_d = half * p.single_support_ratio, half * (1 - p.single_support_ratio)
    a_d, c_d = (1.0, 1.0) if plain else (l_d / (half - l_s / p.a_s), (half - p.c_s * l_s) / l_d)
    constants = plan_gait(p, MASS).constants  # beta and v have no simpler definition than the root itself
    slope = 1.0 if plain else (constants.beta + constants.s) / constants.beta

    def laws(k, x, y):
        """ZMP, and the point over it through which the force passes, in phase k."""
        foot, side, middle = k // 2 * p.step_length, (-1) ** (k // 2) * w, (k // 2 + 0.5) * p.step_length
        if k % 2 == 0:
            return (foot + (x - foot) / p.a_s, side), (foot + p.c_s * (x - foot), side + p.c_y * (y - side))
        zmp = middle + (x - middle) / a_d, slope * y
        return zmp, (middle + c_d * (x - middle), zmp[1] + p.c_y * (y - zmp[1]))

    def rates(t, u, k):
        zmp, top = np.array(laws(k, u[0], u[1]))
        force = MASS * G * np.array([*(top - zmp) / p.com_height, 1.0])
        moment = np.cross([*zmp - u[:2], -p.com_height], force)
        return [u[2], u[3], force[0] / MASS, force[1] / MASS, moment[0], moment[1]]

    def passed(t, u, k):
        return u[0] - (k // 2 * p.step_length + (p.step_length - l_s if k % 2 else l_s))

    passed.terminal = True  # type: ignore[attr-defined]
    state = [-l_s, constants.beta, p.switching_velocity, constants.lateral_switching_velocity, 0.0, 0.0]
    now, switches, pieces = 0.0, [], []
    for k in range(2 * steps):
        how = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-13, "dense_output": True}
        found = solve_ivp(rates, (now, now + 2.0), state, events=passed, args=(k,), **how)
        now, state = found.t_events[0][0], found.y_events[0][0]
        switches.append(now)
        pieces.append(found.sol)
    return switches, pieces


IPM = GaitParameters(planner="lipm", com_height=0.88, a_s=math.inf, steps=4)


@pytest.mark.parametrize("parameters", [GOLDEN, changed(c_s=0.9, c_y=1.2, switching_velocity=1.3), IPM])
def test_an_independent_integration_of_force_and_zmp_laws(parameters):
    steps = 3
    plan = plan_gait(parameters, MASS)
    switches, pieces = force_law_integration(parameters, steps)
    np.testing.assert_allclose(switches[:-1], plan.contacts.starts[1 : 2 * steps], rtol=0.0, atol=1e-10)
    start = plan.sample(0.0).angular_momentum[0]
    for begin, end, piece in zip([0.0, *switches[:-1]], switches, pieces, strict=True):
        t = np.linspace(begin, end - 1e-9, 40)
        s = plan.sample(t)
        x, y, vx, vy, lx, ly = piece(t)
        # Lateral errors grow by the pendulum's own instability, e^(T_SS/T_l) a step.
        np.testing.assert_allclose(s.com[:, :2], np.stack([x, y], axis=1), atol=2e-8)
        np.testing.assert_allclose(s.com_velocity[:, :2], np.stack([vx, vy], axis=1), atol=1e-7)
        np.testing.assert_allclose(s.angular_momentum - start, np.stack([lx, ly], axis=1), atol=1e-5)


@pytest.mark.parametrize("offset", [0.0, 0.45])
def test_the_mean_of_angular_momentum_y_is_the_offset(offset):
    plan = plan_gait(GOLDEN, MASS).with_angular_momentum_offset(offset)
    nodes, weights = np.polynomial.legendre.leggauss(20)
    total = 0.0
    for phase in plan.phases[:2]:
        t = phase.start + 0.5 * phase.duration * (nodes + 1.0)
        total += 0.5 * phase.duration * float(weights @ plan.sample(t).angular_momentum[:, 1])
    assert total / plan.constants.step_duration == pytest.approx(offset, abs=1e-12)


TINY = 1e-60
BOUNDED = "com_height step_length switching_velocity single_support_ratio a_s c_s c_y step_width".split()


def gaits(*bounds, steps, **fixed):
    """Parameters between bounds, ``a_s`` infinite as well; what is smaller than :data:`TINY` is zero."""
    drawn = {
        name: st.floats(*pair).map(lambda value: value if abs(value) >= TINY else 0.0)
        for name, pair in zip(BOUNDED, bounds, strict=True)
    }
    drawn["a_s"] = st.one_of(st.just(math.inf), drawn["a_s"])
    return st.builds(GaitParameters, **drawn, steps=st.integers(1, steps), **fixed)


# Well beyond anything that walks: every draw is a valid plan or a named refusal.
WIDE = gaits(
    (0.05, 10), (1e-3, 5), (1e-3, 10), (1e-3, 0.999), (0.01, 1e6), (-5, 20), (-1, 20), (1e-3, 5), steps=40
)
WALKABLE = gaits(
    (0.5, 1.2), (0.1, 0.9), (0.3, 2.5), (0.3, 0.95), (2, 20), (0.7, 2), (0.01, 1.5), (0.05, 0.4), steps=12
)
NUMBERS = ((TINY, 10), (TINY, 100), (TINY, 100), (TINY, math.nextafter(1.0, 0.0)))
EDGE = gaits(*NUMBERS, (TINY, None), (-100, 100), (-100, 100), (TINY, 100), steps=5)
PLAIN = gaits(*NUMBERS, (math.inf, math.inf), (1, 1), (1, 1), (TINY, 100), steps=5, planner=st.just("lipm"))


def check_plan_or_refusal(parameters):
    try:
        plan = plan_gait(parameters, MASS)
    except MathematicalRefusal as caught:
        refusal = caught
    else:
        residuals = plan.residuals()
        if parameters.planner == "lipm":  # its acceleration and ZMP jump at every switch
            residuals |= dict.fromkeys(("com_acceleration", "zmp"), 0.0)
        assert max(residuals.values()) <= RESIDUAL_LIMIT
        s = plan.sample(np.linspace(0.0, plan.duration, 60))
        for name in "com com_velocity com_acceleration zmp force moment angular_momentum".split():
            assert np.isfinite(getattr(s, name)).all(), name
        assert np.diff(s.com[:, 0]).min() >= 0.0
        return plan
    assert refusal.reason
    assert refusal.way_out in str(refusal)
    assert not math.isnan(refusal.limit)
    return None


@pytest.mark.parametrize("parameters", [WIDE, EDGE, PLAIN], ids=["wide", "edge", "plain"])
@given(data=st.data())
@settings(max_examples=100, deadline=None)
def test_any_gait_has_a_plan_or_a_reason(parameters, data):
    check_plan_or_refusal(data.draw(parameters))


@given(parameters=WALKABLE)
@settings(max_examples=100, deadline=None)
def test_every_plan_keeps_the_laws(parameters):
    plan = check_plan_or_refusal(parameters)
    assume(plan is not None)
    c = plan.constants
    assert max(plan.residuals().values()) <= 1e-11
    assert c.s + c.beta == pytest.approx(parameters.step_width / 2)
    assert 0.0 < c.beta < parameters.step_width / 2
    s = plan.sample(plan.contacts.starts[1:])
    np.testing.assert_allclose(s.com_velocity[:, 0], parameters.switching_velocity, rtol=1e-9)
    np.testing.assert_allclose(np.abs(s.com[:, 1]), c.beta, rtol=1e-7)
    properties.assert_newton_euler(plan, times := np.linspace(0.0, plan.duration, 100))
    s = plan.sample(times)
    assert s.com_velocity[:, 0].min() >= 0.2 * parameters.switching_velocity * (1 - 1e-9)
    assert (np.abs(s.zmp[:, 1]) <= parameters.step_width / 2 + 1e-12).all()


SOLE = SoleGeometry(-0.1, 0.09, 0.16, 0.03, 0.04, 0.035, -0.035, 0.066)
SCHEDULES = {
    "flat": FootParameters(schedule="flat"),
    "roll": FootParameters(swing_height=0.08, swing_lag=0.05, toe_return=0.8, heel_strike_rate=0.0),
    "turning": FootParameters(
        swing_height=0.08, swing_lag=-0.1, toe_return=1.0, heel_strike_rate=2.0, full_contact=1.0
    ),
    "early": FootParameters(swing_height=0.08, toe_return=0.3, heel_rise_lead=0.05, full_contact=0.5),
}


def planned(foot, **values):
    gait = load_run("normal", ["gait.steps=5"]).gait.model_copy(update=values)
    return plan_steps(gait, 60.0, foot, SOLE)


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
