"""Laws of one phase against numerical integration."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq

from ampm.planner.pendulum import (
    AffineLaw,
    double_support_root,
    odd_double_integral,
    position_integral,
    solution,
)

G = 9.81
H = 0.88
MASS = 60.0


# --- the laws ---


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


# --- the general law ---

# A general law a, b, c, d of section 2 with nothing zero: the ZMP is a x + b, the force (c x + d, H).
A, B, C, D, X0, V0 = 0.3, 0.02, 0.8, 0.05, -0.2, 1.1
T_E = math.sqrt(H / (C * G))


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


def general_law(duration):
    """The general law as the project writes it: about the point where the force is vertical."""
    k = 1.0 / T_E
    middle = 0.5 * duration
    x, v = X0 + D / C, V0
    position = x * math.cosh(k * middle) + v / k * math.sinh(k * middle)
    velocity = x * k * math.sinh(k * middle) + v * math.cosh(k * middle)
    origin = -D / C
    return origin, AffineLaw(k * k, A, C + A, duration, position, velocity / k, A * origin + B - origin)


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
