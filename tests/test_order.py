"""Sequences of known order: what is called asymptotic, and whether its uncertainty covers the limit."""

import math
import re

import numpy as np
import pytest

from validation.study.convergence.order import CONFIRMED, UNCONFIRMED, Kind, estimate, observed_orders

STEPS = 2e-3 / 2.0 ** np.arange(4)


@pytest.mark.parametrize(("order", "ratio"), [(0.7, 2.0), (1.0, 2.0), (1.5, 2.0), (2.0, 2.0), (1.0, 10.0)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_exact_power_has_its_order_and_its_limit(order, ratio, sign):
    found = estimate(3.0 + sign * 40.0 * (2e-3 / ratio ** np.arange(4)) ** order, ratio)
    assert found.kind is Kind.ASYMPTOTIC
    assert found.orders == pytest.approx((order, order))
    assert found.order == pytest.approx(order)
    assert found.extrapolated == pytest.approx(3.0)
    error = 40.0 * STEPS[0] ** order
    assert error * CONFIRMED * 0.999 <= found.uncertainty <= error * CONFIRMED * 1.1


def test_a_higher_order_term_that_dies_away_leaves_the_leading_one():
    found = estimate(2.0 + 10.0 * STEPS + 300.0 * STEPS**2, 2.0)
    assert found.kind is Kind.ASYMPTOTIC
    assert found.order == pytest.approx(1.0, abs=0.05)
    assert found.extrapolated == pytest.approx(2.0, abs=1e-3)
    assert abs((found.extrapolated or 0.0) - 2.0) < found.finest


def test_the_grid_convergence_index_of_first_order_is_the_textbook_s():
    found = estimate([1.8, 1.4, 1.2, 1.1], 2.0)  # 1 + 0.8 h
    assert found.finest == pytest.approx(1.25 * 0.1)  # Fs |f2 - f1| / (r^p - 1)
    assert found.uncertainty == pytest.approx(1.25 * 0.8)
    second = estimate(1.0 + STEPS**2, 2.0)  # claims no less than first order would, not a third of it
    assert second.finest == pytest.approx(CONFIRMED * (STEPS[2] ** 2 - STEPS[3] ** 2))


@pytest.mark.parametrize(
    ("values", "why"),
    [
        ([1.0, 2.0, 1.4, 1.7], "from one side"),  # oscillating, converging
        ([1.0, 1.2, 0.8, 1.6], "from one side"),  # oscillating, diverging
        ([1.0, 1.1, 1.3, 1.7], "grow"),  # diverging
        ([1.0, 2.0, 2.1, 2.19], "do not agree|not those"),  # two triplets, two orders
        ([1.0, 2.0, 2.01, 2.0101], "not those"),  # an order of 6.6
        ([1.0, 2.0, 2.5, 2.5], "from one side"),  # nothing left at the end: no triplet
    ],
)
def test_what_has_no_asymptotic_range_is_called_so_and_bounded_by_its_spread(values, why):
    found = estimate(values, 2.0)
    assert found.kind is Kind.NO_RANGE
    assert found.order is None
    assert found.extrapolated is None
    assert re.search(why, found.reason), found.reason
    spread = max(values) - min(values)
    last, before = abs(values[-1] - values[-2]), abs(values[-2] - values[-3])
    assert found.uncertainty == pytest.approx(spread + UNCONFIRMED * max(last, before / 2.0))
    assert spread <= found.uncertainty <= 4.0 * spread


def test_noise_is_hardly_ever_taken_for_an_order():
    draws = np.random.default_rng(1).normal(size=(2000, 4))
    kinds = [estimate(draw, 2.0).kind for draw in draws]
    assert kinds.count(Kind.ASYMPTOTIC) < 0.03 * len(kinds)


def test_an_extreme_is_never_extrapolated_however_well_it_converges():
    values = 1.0 + 40.0 * STEPS
    found = estimate(values, 2.0, forbidden="an extreme")
    assert found.kind is Kind.NO_RANGE
    assert found.extrapolated is None
    assert found.orders == pytest.approx((1.0, 1.0))  # reported all the same
    assert found.uncertainty > np.ptp(values)


@pytest.mark.parametrize(
    ("values", "kind", "uncertainty"),
    [
        ([0.0] * 4, Kind.CONSTANT, 0.0),
        ([7.0, 7.0 + 1e-14, 7.0, 7.0], Kind.CONSTANT, 1e-14),
        ([1.0, 2.0, math.nan, 2.0], Kind.UNKNOWN, math.inf),
        ([1.0, math.nan, 1.0, 1.0], Kind.UNKNOWN, math.inf),
        ([math.nan] * 4, Kind.UNKNOWN, math.nan),
        (1.0 + STEPS[:3], Kind.NO_RANGE, 0.003),  # three levels cannot confirm an order
    ],
)
def test_constant_unknown_and_too_short_sequences(values, kind, uncertainty):
    found = estimate(values, 2.0)
    assert found.kind is kind
    assert found.uncertainty == pytest.approx(uncertainty, abs=1e-14, nan_ok=True)


def test_orders_of_triplets():
    assert observed_orders([1 + 1, 1 + 0.5, 1 + 0.25], 2.0) == pytest.approx((1.0,))
    assert np.isnan(observed_orders([1.0, 2.0, 1.0], 2.0)).all()
    assert observed_orders([0.0, 1.0, 3.0], 2.0) == pytest.approx((-1.0,))  # growing


def test_the_uncertainty_covers_the_limit_of_disturbed_sequences():
    """First order with noise of a tenth of the first change: asymptotic or not, the limit is within."""
    rng = np.random.default_rng(3)
    covered = []
    for _ in range(500):
        values = 10.0 + 100.0 * STEPS + rng.normal(scale=0.01, size=4)
        covered.append(abs(values[0] - 10.0) <= estimate(values, 2.0).uncertainty)
    assert np.mean(covered) > 0.95
