"""Feedback of the trunk's tilt: of an instant, or its mean over a time, with an integral."""

import math

import numpy as np
import pytest

from ampm.control.trunk import fed_back_tilt
from ampm.control.workspace import LONGEST, Tilt, gains_of
from ampm.controller_parameters import ControllerParameters

FREQUENCY, INTEGRAL = 100.0, 0.5


class Feedback:
    """The function with its memory."""

    def __init__(self, integral=INTEGRAL):
        self.gains = gains_of(ControllerParameters(frequency=FREQUENCY, trunk_integral=integral))
        past = np.zeros((math.ceil(LONGEST * FREQUENCY), 2))
        self.memory = Tilt(past, np.zeros(2), *np.zeros((2, 1), dtype=np.int64))

    def __call__(self, tilt, window, heading=0.0):
        c, s = math.cos(heading), math.sin(heading)
        trunk = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return np.array(fed_back_tilt(self.gains, tilt, trunk, window, self.memory))


def test_a_swing_of_one_period_is_no_tilt_and_its_mean_is():
    feedback, window = Feedback(integral=0.0), 0.8
    ticks = round(3 * window * FREQUENCY)
    for k in range(ticks):
        swing = math.sin(2.0 * math.pi * k / (window * FREQUENCY))
        got = feedback((0.02 + 0.2 * swing, -0.01 + 0.1 * swing, 0.0), window)
    np.testing.assert_allclose(got, [0.02, -0.01, 0.0], rtol=0.0, atol=1e-12)


def test_the_integral_of_the_mean_is_added_and_closes_with_the_window():
    feedback, window, tilt = Feedback(), 0.5, 0.04
    ticks = round(window * FREQUENCY)
    means = [tilt * min(k + 1, ticks) / ticks for k in range(200)]
    for _ in means:
        got = feedback((tilt, 0.0, 0.0), window)
    assert got[0] == pytest.approx(tilt + INTEGRAL * sum(means) / FREQUENCY, rel=1e-12)
    for k in range(ticks - 1, 0, -1):
        got = feedback((-tilt, 0.0, 0.0), k / FREQUENCY)
    assert got[0] == pytest.approx(-tilt, abs=0.1 * tilt)
    np.testing.assert_array_equal(feedback((0.3, 0.0, 0.0), 0.0), [0.3, 0.0, 0.0])
    assert feedback.memory.longest == 0


def test_a_turning_body_is_averaged_in_its_own_axes():
    straight, turning = Feedback(), Feedback()
    for k in range(150):
        heading = 0.02 * k
        c, s = math.cos(heading), math.sin(heading)
        tilt = 0.03 * math.sin(0.1 * k), 0.02
        one = straight((*tilt, 0.0), 0.6)
        other = turning((c * tilt[0] - s * tilt[1], s * tilt[0] + c * tilt[1], 0.0), 0.6, heading)
    back = c * other[0] + s * other[1], c * other[1] - s * other[0]
    np.testing.assert_allclose(back, one[:2], rtol=0.0, atol=1e-14)
