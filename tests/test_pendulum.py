"""The laws of one phase against numerical integration, and the paper's errata.

For every erratum that can be tested the printed form fails and the corrected form passes.
"""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq

from ampm.planner.pendulum import (
    AffineLaw,
    double_support_root,
    frontal_plane,
    odd_double_integral,
    position_integral,
    sagittal_plane,
    sagittal_time_constant,
    solution,
)

G = 9.81
H = 0.88
MASS = 60.0
GOLDEN = {
    "com_height": H,
    "step_length": 0.6,
    "single_support_ratio": 0.7,
    "switching_velocity": 1.0,
    "inverse_a_s": 0.25,
    "c_s": 1.2,
    "gravity": G,
}
C_Y, W = 0.6, 0.09


@pytest.fixture(scope="module")
def sagittal():
    return sagittal_plane(**GOLDEN)


@pytest.fixture(scope="module")
def frontal(sagittal):
    return frontal_plane(
        com_height=H,
        half_width=W,
        c_y=C_Y,
        single_support_duration=sagittal.single.duration,
        double_support_duration=sagittal.double.duration,
        gravity=G,
    )


def start_and_end(law):
    return law.evaluate(0.0), law.evaluate(law.duration)


# --- the laws ---


@pytest.mark.parametrize("rate", [7.3, -11.0, 1e-4])
def test_solution_solves_its_equation(rate):
    even, odd = -0.07, 0.2
    x0, v0 = solution(rate, even, odd, 0.0)
    assert (x0, v0) == pytest.approx((even, odd * math.sqrt(abs(rate))))
    found = solve_ivp(lambda t, u: [u[1], rate * u[0]], (0.0, 0.8), [x0, v0], rtol=1e-12, atol=1e-14)
    assert solution(rate, even, odd, 0.8) == pytest.approx(found.y[:, -1], rel=1e-9)


@pytest.mark.parametrize("rate", [7.3, -11.0, 1e-6, -1e-6])
def test_position_integral_is_the_integral(rate):
    def position(t):
        return float(solution(rate, -0.07, 0.2, t)[0])

    expected = quad(position, -0.3, 0.45, epsabs=1e-14)[0]
    assert position_integral(rate, -0.07, 0.2, -0.3, 0.45) == pytest.approx(expected, rel=1e-11)


@pytest.mark.parametrize("rate", [7.3, -11.0, 1e-3, -1e-3, 2.77, -2.78])  # both sides of the series' end
def test_odd_double_integral_is_the_double_integral(rate):
    duration, odd = 0.6, 0.3
    expected = quad(lambda t: float(position_integral(rate, 0.0, odd, -0.3, t)), -0.3, 0.3, epsabs=1e-15)[0]
    assert odd_double_integral(rate, odd, duration) == pytest.approx(expected, rel=1e-10)


def test_odd_double_integral_joins_where_the_series_ends():
    for sign in (1.0, -1.0):
        below, above = (odd_double_integral(sign * h**2, 1.0, 2.0) for h in (0.5 - 1e-12, 0.5 + 1e-12))
        assert below == pytest.approx(above, rel=1e-11)


@given(
    tau=st.floats(min_value=1e-6, max_value=1.0),
    half_angle=st.floats(min_value=1e-6, max_value=100.0),
)
def test_the_root_of_double_support(tau, half_angle):
    def equation(rho):
        return rho * math.atan2(rho, tau) - half_angle

    rho = float(double_support_root(tau, half_angle))
    expected = brentq(equation, 0.0, 2.0 * half_angle + 2.0, xtol=1e-300, rtol=8.9e-16)
    assert rho == pytest.approx(expected, rel=2e-14)


def test_the_root_of_double_support_vectorises():
    tau, half_angle = np.meshgrid(np.linspace(0.01, 1.0, 7), np.geomspace(1e-3, 10.0, 9))
    rho = double_support_root(tau, half_angle)
    assert rho.shape == tau.shape
    one_by_one = [double_support_root(a, b) for a, b in zip(tau.ravel(), half_angle.ravel(), strict=True)]
    np.testing.assert_allclose(rho.ravel(), one_by_one, rtol=2e-15)


def test_golden_constants(sagittal, frontal):
    assert (sagittal.l_s, sagittal.l_d) == pytest.approx((0.21, 0.09))
    assert sagittal.c_d == pytest.approx(0.5333333333333333, abs=1e-12)
    assert 1.0 / sagittal.a_d == pytest.approx(2.75, abs=1e-12)
    assert sagittal.single.duration == pytest.approx(0.5134552944, abs=1e-10)
    assert sagittal.double.duration == pytest.approx(0.1692542239, abs=1e-10)
    assert frontal.beta == pytest.approx(0.01129385512, abs=1e-11)
    assert frontal.s == pytest.approx(0.07870614488, abs=1e-11)
    assert frontal.velocity == pytest.approx(0.1182626956, abs=1e-10)


def test_the_middle_form_is_the_papers_form(sagittal, frontal):
    t = np.linspace(0.0, sagittal.single.duration, 50)
    t_s = sagittal_time_constant(H, 1.2 - 0.25, G)
    expected = -sagittal.l_s * np.cosh(t / t_s) + t_s * np.sinh(t / t_s)  # v0 = 1 m/s
    np.testing.assert_allclose(sagittal.single.evaluate(t).position, expected, atol=1e-14)
    t_l = math.sqrt(H / (C_Y * G))
    expected = frontal.s * np.cosh(t / t_l) - frontal.velocity * t_l * np.sinh(t / t_l)
    np.testing.assert_allclose(-frontal.single.evaluate(t).position, expected, atol=1e-14)
    t = np.linspace(0.0, sagittal.double.duration, 50)
    t_d = math.sqrt(H / ((2.75 - sagittal.c_d) * G))
    expected = -sagittal.l_d * np.cos(t / t_d) + t_d * np.sin(t / t_d)
    np.testing.assert_allclose(sagittal.double.evaluate(t).position, expected, atol=1e-14)
    w_d = math.sqrt(G * C_Y * frontal.s / (H * frontal.beta))
    expected = -frontal.beta * np.cos(w_d * t) + frontal.velocity / w_d * np.sin(w_d * t)
    np.testing.assert_allclose(-frontal.double.evaluate(t).position, expected, atol=1e-14)
    assert math.tan(0.5 * w_d * sagittal.double.duration) == pytest.approx(
        frontal.beta * w_d / frontal.velocity, rel=1e-12
    )


def test_mid_stance_speed_near_the_least_speed_keeps_its_digits():
    t_s = sagittal_time_constant(H, 0.95, G)
    least = 0.21 / t_s
    plane = sagittal_plane(**{**GOLDEN, "switching_velocity": float(least) * (1 + 1e-9)})
    middle = plane.single.evaluate(0.5 * plane.single.duration)
    assert middle.position == pytest.approx(0.0, abs=1e-15)
    assert middle.velocity == pytest.approx(least * math.sqrt(2e-9), rel=1e-6)
    assert plane.single.evaluate(plane.single.duration).position == pytest.approx(0.21, rel=1e-12)


@given(
    inverse_a_s=st.floats(min_value=0.0, max_value=1.5),
    c_s=st.floats(min_value=0.1, max_value=3.0),
    share=st.floats(min_value=0.05, max_value=0.95),
)
@settings(max_examples=100)
def test_the_bracket_of_double_support_is_negative_where_the_other_is_positive(inverse_a_s, c_s, share):
    if c_s - inverse_a_s < 1e-3:
        return
    values = {
        "inverse_a_s": inverse_a_s,
        "c_s": c_s,
        "single_support_ratio": share,
        "switching_velocity": 50.0,
    }
    plane = sagittal_plane(**{**GOLDEN, **values})
    assert plane.double.rate < 0.0
    bracket = plane.double.force_slope - plane.double.zmp_slope
    assert plane.double.rate == pytest.approx(G / H * bracket, rel=1e-9)


# --- errata ---

# A general law a, b, c, d of section 2 with nothing zero: the ZMP is a x + b, the force (c x + d, H).
A, B, C, D, X0, V0 = 0.3, 0.02, 0.8, 0.05, -0.2, 1.1
T_E = math.sqrt(H / (C * G))
C_1, C_2 = (X0 + D / C - V0 * T_E) / 2, (X0 + D / C + V0 * T_E) / 2


def general(t):
    """COM of the general law from its equation of motion, integrated numerically."""
    found = solve_ivp(
        lambda _, u: [u[1], G / H * (C * u[0] + D)], (0.0, t), [X0, V0], rtol=1e-12, atol=1e-14
    ).y[:, -1]
    return found[0], G / H * (C * found[0] + D)


def moment_y(t):
    """(p - c) x F about the y axis, from positions and forces alone."""
    x, acceleration = general(t)
    return -H * MASS * acceleration - (A * x + B - x) * MASS * G


def exponentials(t):
    return C_1 * math.exp(-t / T_E) + C_2 * math.exp(t / T_E)


def general_law(duration):
    """The general law as the project writes it: about the point where the force is vertical."""
    k = 1.0 / T_E
    middle = 0.5 * duration
    x, v = X0 + D / C, V0
    position = x * math.cosh(k * middle) + v / k * math.sinh(k * middle)
    velocity = x * k * math.sinh(k * middle) + v * math.cosh(k * middle)
    origin = -D / C
    return origin, AffineLaw(
        rate=k * k,
        zmp_slope=A,
        force_slope=C + A,
        duration=duration,
        even=position,
        odd=velocity / k,
        zmp_offset=A * origin + B - origin,
    )


def test_the_general_law_moves_and_turns_as_integrated():
    origin, law = general_law(0.5)
    for t in (0.0, 0.2, 0.5):
        x, acceleration = general(t)
        state = law.evaluate(t)
        assert origin + state.position == pytest.approx(x, abs=1e-10)
        assert state.acceleration == pytest.approx(acceleration, abs=1e-9)
        assert origin + state.zmp == pytest.approx(A * x + B, abs=1e-10)
        assert -MASS * G * state.moment_arm == pytest.approx(moment_y(t), abs=1e-7)
        momentum = quad(moment_y, 0.0, t, epsabs=1e-10)[0]
        assert -MASS * G * state.moment_arm_integral == pytest.approx(momentum, abs=1e-7)


def test_e1_the_force_ratio_is_to_the_vertical_force(sagittal, frontal):
    state = sagittal.single.evaluate(0.1)
    forward, lateral = MASS * state.acceleration, MASS * frontal.single.evaluate(0.1).acceleration
    line = (sagittal.single.force_slope - sagittal.single.zmp_slope) * state.position
    assert forward / (MASS * G) == pytest.approx(line / H)  # F_x : F_z
    assert abs(forward / lateral - line / H) > 1.0  # printed: F_x : F_y


def test_e2_the_sign_of_d_over_c_in_the_moment():
    for t in (0.0, 0.3):
        force = -MASS * H / T_E**2 * exponentials(t)
        printed = force - MASS * G * ((A - 1) * (exponentials(t) + D / C) + B)
        corrected = force - MASS * G * ((A - 1) * (exponentials(t) - D / C) + B)
        assert corrected == pytest.approx(moment_y(t), abs=1e-7)
        assert printed - corrected == pytest.approx(2 * D * G * MASS * (1 - A) / C)


def test_e3_the_same_sign_in_the_angular_momentum():
    def momentum(t, sign):
        rates = -C_1 * math.exp(-t / T_E) + C_2 * math.exp(t / T_E)
        drift = G * (sign * (A - 1) * D / C + B) * t
        return MASS * (rates * (-H / T_E - G * T_E * (A - 1)) - drift)

    expected = quad(moment_y, 0.0, 0.4, epsabs=1e-10)[0]
    assert momentum(0.4, -1.0) - momentum(0.0, -1.0) == pytest.approx(expected, abs=1e-7)
    printed = momentum(0.4, 1.0) - momentum(0.0, 1.0)
    assert abs(printed - expected) > 1.0


def test_e4_force_and_zmp_each_need_their_condition(sagittal):
    l_s, l_d, c_s, c_d = sagittal.l_s, sagittal.l_d, 1.2, sagittal.c_d
    end, start = sagittal.single.evaluate(sagittal.single.duration), sagittal.double.evaluate(0.0)
    assert c_s * l_s + c_d * l_d == pytest.approx(l_s + l_d)
    assert l_s * 0.25 + l_d / sagittal.a_d == pytest.approx(l_s + l_d)
    assert end.acceleration == pytest.approx(start.acceleration)
    printed = l_d / (l_s + l_d - l_s / c_s)  # the c_d that l_s/c_s + l_d/c_d = l_s + l_d asks for
    jump = G / H * (printed - 1.0 / sagittal.a_d) * -l_d - end.acceleration
    assert abs(jump) > 0.1


def test_e5_the_zmp_of_double_support_starts_where_single_support_left_it(sagittal):
    half = sagittal.l_s + sagittal.l_d
    start, end = start_and_end(sagittal.single)
    begin, finish = start_and_end(sagittal.double)
    assert half + begin.zmp == pytest.approx(end.zmp)  # Z_1
    assert half + begin.zmp != pytest.approx(start.zmp, abs=0.05)  # printed: Z_0
    assert half + finish.zmp == pytest.approx(2 * half + start.zmp)  # Z_0' of the next foot


def test_e6_v_ex_is_a_length(frontal):
    law = frontal.single
    t_l = math.sqrt(H / (C_Y * G))
    duration = law.duration
    v_ex = (frontal.s * math.cosh(duration / t_l) - frontal.s) / math.sinh(duration / t_l)
    assert v_ex == pytest.approx(frontal.velocity * t_l)
    assert v_ex != pytest.approx(frontal.velocity, rel=0.2)
    # Read as a velocity in the double support, as printed, it makes the speed jump at the switch.
    w_d = math.sqrt(-frontal.double.rate)
    assert frontal.double.evaluate(0.0).velocity == pytest.approx(law.evaluate(duration).velocity)
    assert abs(v_ex * w_d - frontal.velocity) > 0.1


def test_e7_the_zmp_slope_of_the_lateral_double_support(frontal):
    beta, s = frontal.beta, frontal.s
    start = frontal.double.evaluate(0.0)
    assert start.position == pytest.approx(beta)
    assert start.zmp == pytest.approx(beta + s)  # where single support left it: at the foot
    assert abs(beta / (beta + s) * start.position - (beta + s)) > 0.08  # printed


@pytest.mark.parametrize("rate", [1e-9, -1e-9])
def test_no_rate_is_the_limit_of_a_small_one(rate):
    k, t = math.sqrt(abs(rate)), np.linspace(-0.4, 0.6, 11)
    uniform, small = solution(0.0, 0.2, 0.7, t), solution(rate, 0.2, 0.7 / k, t)
    np.testing.assert_allclose(uniform, small, atol=1e-8)
    np.testing.assert_allclose(uniform[0], 0.2 + 0.7 * t)
    integral = position_integral(0.0, 0.2, 0.7, -0.4, t)
    np.testing.assert_allclose(integral, 0.2 * (t + 0.4) + 0.35 * (t**2 - 0.16), atol=1e-15)
    assert odd_double_integral(0.0, 0.7, 1.3) == pytest.approx(
        odd_double_integral(rate, 0.7 / k, 1.3), rel=1e-8
    )
    mixed = solution(np.array([0.0, 4.0, -4.0]), 0.0, 1.0, 0.3)[0]
    np.testing.assert_allclose(mixed, [0.3, math.sinh(0.6), math.sin(0.6)])


def test_e8_the_bracket_of_the_lateral_double_support(frontal):
    beta, s = frontal.beta, frontal.s
    state = frontal.double.evaluate(0.02)
    y, z = state.position, state.zmp
    c_3 = (beta + (1 - C_Y) * s) / beta
    assert c_3 > 0.0  # printed as negative
    assert state.acceleration == pytest.approx(G / H * C_Y * (y - z))
    assert state.acceleration == pytest.approx(G / H * (c_3 * y - z))
    assert c_3 * y - z < 0.0 < y
    assert abs(G / H * c_3 * (y - z) - state.acceleration) > 0.1  # printed


def test_e9_and_e10_the_lateral_double_support_starts_at_beta_and_has_no_constant(frontal):
    end = W + frontal.single.evaluate(frontal.single.duration).position
    start, finish = start_and_end(frontal.double)
    assert start.position == pytest.approx(end) == pytest.approx(frontal.beta)
    assert frontal.beta + frontal.s != pytest.approx(end, abs=0.05)  # printed E9
    assert finish.position == pytest.approx(-start.position, abs=1e-15)  # a constant would break the symmetry


def test_e11_the_frontal_moment_has_consistent_signs(frontal):
    for law, foot in ((frontal.single, W), (frontal.double, 0.0)):
        state = law.evaluate(0.3 * law.duration)
        arm = np.array([0.0, foot + state.zmp - (foot + state.position), -H])
        force = np.array([0.0, MASS * state.acceleration, MASS * G])
        expected = np.cross(arm, force)[0]
        assert MASS * G * state.moment_arm == pytest.approx(expected)
        assert expected == pytest.approx(MASS * G * (C_Y - 1) * (state.position - state.zmp))
    y, f_y = frontal.single.evaluate(0.1)[0], MASS * frontal.single.evaluate(0.1)[2]
    printed = y * (-MASS * G) - H * f_y
    assert abs(printed - MASS * G * frontal.single.evaluate(0.1).moment_arm) > 1.0


def test_e12_the_frontal_moment_falls_towards_c_y_one(sagittal):
    def peak(c_y):
        plane = frontal_plane(
            com_height=H,
            half_width=W,
            c_y=c_y,
            single_support_duration=sagittal.single.duration,
            double_support_duration=sagittal.double.duration,
            gravity=G,
        )
        return abs(float(plane.single.evaluate(plane.single.duration).moment_arm_integral))

    peaks = [peak(c_y) for c_y in (0.1, 0.4, 0.7)]
    assert peaks == sorted(peaks, reverse=True)
    assert peak(1.0) == 0.0


def test_e13_a_free_beta_breaks_the_duration(frontal):
    t_ss, t_ds = frontal.single.duration, frontal.double.duration
    k = math.sqrt(C_Y * G / H)

    def lateral_duration(beta):
        s = W - beta
        w_d = k * math.sqrt(s / beta)
        return 2.0 / w_d * math.atan2(beta * w_d, s * k * math.tanh(0.5 * k * t_ss))

    assert lateral_duration(frontal.beta) == pytest.approx(t_ds, rel=1e-12)
    assert abs(lateral_duration(2.0 * frontal.beta) - t_ds) > 0.05


def test_e15_the_lateral_double_support_has_its_own_time_constant(frontal):
    t_c = math.sqrt(H / G)
    w_d = math.sqrt(-frontal.double.rate)
    assert w_d == pytest.approx(math.sqrt(G * C_Y * frontal.s / (H * frontal.beta)))
    assert abs(w_d * t_c - 1.0) > 0.5


def test_e14_the_printed_sign_makes_the_posture_run_away():
    for k in (1.0, 100.0):
        for d in (0.0, 5.0, 50.0):
            printed = np.array([[0.0, 1.0], [k, -d]])  # minimiser of qdd - k q + d qd
            corrected = np.array([[0.0, 1.0], [-k, -d]])
            assert np.linalg.eigvals(printed).real.max() > 0.0
            assert np.linalg.eigvals(corrected).real.max() <= 0.0
