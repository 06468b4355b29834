"""The plan as a whole: continuity, an independent integration, properties; its numbers are in golden.csv."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq

from ampm.exceptions import MathematicalRefusal
from ampm.parameters import GaitParameters
from ampm.planner.pendulum import double_support_root, odd_double_integral, position_integral, solution
from ampm.planner.periodic import RESIDUAL_LIMIT, plan_gait
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


@pytest.fixture(scope="module")
def plan():
    return plan_gait(GOLDEN, MASS)


# --- conventions ---


def test_start_and_footsteps(plan):
    first = plan.sample(0.0)
    assert first.com[0] == pytest.approx([-0.21, plan.constants.beta, 0.88])
    assert first.com_velocity[0] == pytest.approx([1.0, plan.constants.lateral_switching_velocity, 0.0])
    assert (first.stance_name[0], first.phase_name[0]) == ("left", "single_support")
    steps = [(f.foot, f.position[:2]) for f in plan.contacts.footsteps]
    assert len(steps) == GOLDEN.steps + 2
    assert [foot for foot, _ in steps[:4]] == ["right", "left", "right", "left"]
    np.testing.assert_allclose([p for _, p in steps[:3]], [(-0.6, -0.09), (0.0, 0.09), (0.6, -0.09)])
    assert plan.duration == pytest.approx(GOLDEN.steps * plan.constants.step_duration)
    assert len(plan.contacts.starts) == 2 * GOLDEN.steps


def test_times_in_any_order_and_read_only(plan):
    times = np.random.default_rng(1).uniform(0.0, plan.duration, 50)
    sample = plan.sample(times)
    one_by_one = np.array([plan.sample(t).com[0] for t in times])
    np.testing.assert_array_equal(sample.com, one_by_one)
    with pytest.raises(ValueError, match="read-only"):
        sample.com[0, 0] = 1.0
    assert len(plan.sample([])) == 0


# --- laws ---


def force_law_integration(parameters, steps):
    """Integrate xdd = F/m from the ZMP and force laws alone; switch where the COM has travelled its share.

    Returns the switch times and, per phase, a dense solution of (x, y, vx, vy, L_x, L_y).
    """
    p, m = parameters, 60.0
    half = p.step_length / 2
    l_s, l_d = half * p.single_support_ratio, half * (1 - p.single_support_ratio)
    plain = p.planner == "lipm"
    a_d, c_d = (1.0, 1.0) if plain else (l_d / (half - l_s / p.a_s), (half - p.c_s * l_s) / l_d)
    constants = plan_gait(p, MASS).constants  # beta and v have no simpler definition than the root itself
    beta, s = constants.beta, constants.s
    w = p.step_width / 2

    def single(k):
        foot, side = k * p.step_length, (-1) ** k * w

        def laws(x, y):
            zmp = np.array([foot + (x - foot) / p.a_s, side])
            top = np.array([foot + p.c_s * (x - foot), side + p.c_y * (y - side)])
            return zmp, top

        return laws, foot + l_s

    def double(k):
        middle = (k + 0.5) * p.step_length

        def laws(x, y):
            zmp = np.array([middle + (x - middle) / a_d, y if plain else (beta + s) / beta * y])
            force_y = p.c_y * (y - zmp[1])  # over m g / H
            return zmp, np.array([middle + c_d * (x - middle), zmp[1] + force_y])

        return laws, middle + l_d

    state = np.array([-l_s, beta, p.switching_velocity, constants.lateral_switching_velocity, 0.0, 0.0])
    now, switches, pieces = 0.0, [], []
    for k in range(steps):
        for laws, end in (single(k), double(k)):

            def derivative(t, u, laws=laws):
                com = np.array([u[0], u[1], p.com_height])
                zmp, top = laws(u[0], u[1])
                force = m * G * np.array([*(top - zmp) / p.com_height, 1.0])
                moment = np.cross(np.array([*zmp, 0.0]) - com, force)
                return [u[2], u[3], force[0] / m, force[1] / m, moment[0], moment[1]]

            def passed(t, u, end=end):
                return u[0] - end

            passed.terminal = True  # type: ignore[attr-defined]
            found = solve_ivp(
                derivative,
                (now, now + 2.0),
                state,
                method="DOP853",
                rtol=1e-12,
                atol=1e-13,
                events=passed,
                dense_output=True,
            )
            now, state = found.t_events[0][0], found.y_events[0][0]
            switches.append(now)
            pieces.append(found.sol)
    return switches, pieces


IPM = GaitParameters(planner="lipm", com_height=0.88, a_s=math.inf, steps=4)


@pytest.mark.parametrize(
    "parameters", [GOLDEN, changed(c_s=0.9, c_y=1.2, a_s=2.5, switching_velocity=1.3), IPM]
)
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
def test_the_mean_of_angular_momentum_y_is_the_offset(plan, offset):
    shifted = plan.with_angular_momentum_offset(offset)
    nodes, weights = np.polynomial.legendre.leggauss(20)
    total = 0.0
    for phase in shifted.phases[:2]:
        t = phase.start + 0.5 * phase.duration * (nodes + 1.0)
        total += 0.5 * phase.duration * float(weights @ shifted.sample(t).angular_momentum[:, 1])
    assert total / plan.constants.step_duration == pytest.approx(offset, abs=1e-12)


# --- the plain inverted pendulum ---


def test_the_plain_pendulum_states_its_jumps_and_is_not_refused_for_them():
    plan = plan_gait(IPM, MASS)
    c, r = plan.constants, plan.residuals()
    assert max(r.position, r.velocity, r.moment, r.angular_momentum) <= 1e-14
    # Along x the ZMP jumps from the foot to below the COM and the acceleration from g l_s/H to nothing.
    assert (r.zmp, r.acceleration) == pytest.approx((c.l_s / 0.88, c.l_s / 0.88), rel=1e-12)
    before, after = (plan.sample(plan.contacts.starts[1] - beside) for beside in (1e-9, 0.0))
    driven = [G / 0.88 * c.l_s, -G / 0.88 * c.s, 0.0]
    np.testing.assert_allclose(before.com_acceleration[0], driven, atol=1e-7)
    np.testing.assert_array_equal(after.com_acceleration[0], 0.0)
    np.testing.assert_allclose(before.zmp[0], [0.0, 0.09], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(after.zmp[0], after.com[0, :2], rtol=0.0, atol=1e-12)
    whole = plan.sample(np.linspace(0.0, plan.duration, 2000))
    np.testing.assert_array_equal(whole.moment, 0.0)
    np.testing.assert_allclose(whole.com_velocity[whole.phase == 1, 0], 1.0, rtol=1e-14)
    assert plan_gait(changed(c_s=1.0), MASS).residuals().largest < 1e-13  # the AMPM has none of it


def test_the_least_speed_is_the_least_speed():
    with pytest.raises(MathematicalRefusal) as caught:
        plan_gait(changed(switching_velocity=0.3), MASS)
    least = caught.value.limit
    assert least == pytest.approx(0.21 * math.sqrt(0.95 * G / 0.88), rel=1e-15)
    # The way out names a speed that is accepted, no more than a rounding above the least accepted one.
    enough = float(caught.value.way_out.split(" to ")[1].split(" ")[0])
    plan = plan_gait(changed(switching_velocity=enough), MASS)
    slowest = plan.sample(plan.constants.single_support_duration / 2).com_velocity[0, 0]
    assert 0.2 * enough <= slowest < 0.205 * enough
    assert slowest == pytest.approx(math.sqrt(enough**2 - least**2))


TINY = 1e-60
BOUNDED = "com_height step_length switching_velocity single_support_ratio a_s c_s c_y step_width".split()


def sizable(value):
    """A number that parameters take: zero, or one of at least :data:`TINY`."""
    return 0.0 if abs(value) < TINY else value


def gaits(*bounds, steps, **fixed):
    """ClosedForm with parameters between bounds, ``a_s`` infinite as well."""
    drawn = {name: st.floats(*pair).map(sizable) for name, pair in zip(BOUNDED, bounds, strict=True)}
    drawn["a_s"] = st.one_of(st.just(math.inf), drawn["a_s"])
    return st.builds(GaitParameters, **drawn, steps=st.integers(1, steps), **fixed)


# Well beyond anything that walks: every draw is a valid plan or a named refusal.
WIDE = gaits(
    (0.05, 10), (1e-3, 5), (1e-3, 10), (1e-3, 0.999), (0.01, 1e6), (-5, 20), (-1, 20), (1e-3, 5), steps=40
)
WALKABLE = gaits(
    (0.5, 1.2), (0.1, 0.9), (0.3, 2.5), (0.3, 0.95), (2, 20), (0.7, 2), (0.01, 1.5), (0.05, 0.4), steps=12
)
NUMBERS = ((TINY, 100), (TINY, 100), (TINY, 100), (TINY, math.nextafter(1.0, 0.0)))
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
            residuals = replace(residuals, acceleration=0.0, zmp=0.0)
        assert residuals.largest <= RESIDUAL_LIMIT
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
@settings(max_examples=150, deadline=None)
def test_any_gait_has_a_plan_or_a_reason(parameters, data):
    check_plan_or_refusal(data.draw(parameters))


@given(parameters=WALKABLE)
@settings(max_examples=150, deadline=None)
def test_every_plan_keeps_the_laws(parameters):
    plan = check_plan_or_refusal(parameters)
    assume(plan is not None)
    c = plan.constants
    assert plan.residuals().largest <= 1e-11
    assert c.s + c.beta == pytest.approx(parameters.step_width / 2)
    assert 0.0 < c.beta < parameters.step_width / 2
    s = plan.sample(plan.contacts.starts[1:])
    np.testing.assert_allclose(s.com_velocity[:, 0], parameters.switching_velocity, rtol=1e-9)
    np.testing.assert_allclose(np.abs(s.com[:, 1]), c.beta, rtol=1e-7)
    properties.assert_newton_euler(plan, times := np.linspace(0.0, plan.duration, 100))
    s = plan.sample(times)
    assert s.com_velocity[:, 0].min() >= 0.2 * parameters.switching_velocity * (1 - 1e-9)
    assert (np.abs(s.zmp[:, 1]) <= parameters.step_width / 2 + 1e-12).all()


@pytest.mark.parametrize("rate", [7.3, -11.0, 1e-3, -1e-3, 2.77, -2.78])  # both sides of the series' end
def test_odd_double_integral_is_the_double_integral(rate):
    duration, odd = 0.6, 0.3
    expected = quad(lambda t: float(position_integral(rate, 0.0, odd, -0.3, t)), -0.3, 0.3, epsabs=1e-15)[0]
    assert odd_double_integral(rate, odd, duration) == pytest.approx(expected, rel=1e-10)


@given(tau=st.floats(1e-6, 1.0), half_angle=st.floats(1e-6, 100.0))
def test_the_root_of_double_support(tau, half_angle):
    def equation(rho):
        return rho * math.atan2(rho, tau) - half_angle

    rho = float(double_support_root(tau, half_angle))
    expected = brentq(equation, 0.0, 2.0 * half_angle + 2.0, xtol=1e-300, rtol=8.9e-16)
    assert rho == pytest.approx(expected, rel=2e-14)


@pytest.mark.parametrize("rate", [1e-9, -1e-9])
def test_no_rate_is_the_limit_of_a_small_one(rate):
    k, t = math.sqrt(abs(rate)), np.linspace(-0.4, 0.6, 11)
    uniform, small = solution(0.0, 0.2, 0.7, t), solution(rate, 0.2, 0.7 / k, t)
    np.testing.assert_allclose(uniform, small, atol=1e-8)
    np.testing.assert_allclose(uniform[0], 0.2 + 0.7 * t)
    integral = position_integral(0.0, 0.2, 0.7, -0.4, t)
    np.testing.assert_allclose(integral, 0.2 * (t + 0.4) + 0.35 * (t**2 - 0.16), rtol=0.0, atol=1e-15)
    assert odd_double_integral(0.0, 0.7, 1.3) == pytest.approx(
        odd_double_integral(rate, 0.7 / k, 1.3), rel=1e-8
    )
    mixed = solution(np.array([0.0, 4.0, -4.0]), 0.0, 1.0, 0.3)[0]
    np.testing.assert_allclose(mixed, [0.3, math.sinh(0.6), math.sin(0.6)])
