"""Solutions and integrals of the law of a phase against quadrature; test_gait integrates whole plans."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.optimize import brentq

from ampm.planner.pendulum import (
    double_support_root,
    odd_double_integral,
    position_integral,
    solution,
)


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
