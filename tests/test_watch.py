"""How a walk ends: each kind by what was seen, and by what came first."""

from __future__ import annotations

import math

import pytest

from ampm.walk import LIMITED, SOLVED, UNSOLVED
from validation.trial.outcome import OutcomeName
from validation.trial.watch import BLOW_UP, CALM, FALL_TIME, Watch

PERIOD = 0.002
PLANNED = (0.0, 0.0, 0.88)
UP = (0.0, 0.0, 1.0)


def leaning(degrees, axis=0):
    """A trunk's axis, turned from the vertical."""
    angle = math.radians(degrees)
    return (math.sin(angle), 0.0, math.cos(angle)) if axis == 0 else (0.0, math.sin(angle), math.cos(angle))


def watched(ticks, limit=0.05, until=3000):
    """The end of a walk and its tick; ``ticks(k)`` gives (com error, trunk, status)."""
    watch = Watch(limit)
    for k in range(until):
        error, trunk, status = ticks(k)
        com = tuple(a + b for a, b in zip(PLANNED, error, strict=True))
        end = watch.check(k * PERIOD, com, trunk, PLANNED, UP, status, residual=0.5, limit="knee at 100%")
        if end is not None:
            return end, k
    return None, until


def test_a_walk_on_the_plan_goes_on():
    assert watched(lambda k: ((1e-3, -1e-3, 0.0), leaning(3.0), k % 2)) == (None, 3000)


def test_a_sinking_body_fell_although_its_qp_failed_on_the_way():
    """Off the plan from 0.19 s, unsolved from 0.25 s, down at 0.5 s: the COM was the first sign."""

    def falling(k):
        sunk = max(0.0, k * PERIOD - 0.06) ** 2 * 1.2
        return (0.0, 0.0, -sunk), UP, UNSOLVED if k * PERIOD > 0.25 else SOLVED

    end, k = watched(falling)
    assert end.name == OutcomeName.FELL
    assert 0.4 < k * PERIOD < 0.6
    assert "sank to 0.66 m" in end.cause
    assert "first sign was a COM 20 mm off the plan, mostly along z" in end.cause


@pytest.mark.parametrize("error", [(0.31, 0.0, 0.0), (0.0, -0.31, 0.0), (0.0, 0.0, -0.23), (0.0, 0.0, 0.31)])
def test_a_body_far_off_the_plan_fell(error):
    end, _ = watched(lambda k: (tuple(min(k / 500, 1.0) * e for e in error), UP, SOLVED))
    assert end.name == OutcomeName.FELL


@pytest.mark.parametrize(
    ("trunk", "tick"),
    [
        (lambda k: leaning(0.1 * k, 0), 601),
        (lambda k: leaning(0.1 * k, 1), 601),
        (lambda k: (0.0, 0.0, -1.0), 0),
    ],
)
def test_a_trunk_that_lies_over_fell(trunk, tick):
    end, k = watched(lambda k: ((0.0, 0.0, 0.0), trunk(k), SOLVED))
    assert (end.name, k) == (OutcomeName.FELL, tick)
    assert "first sign was a trunk 1" in end.cause


def test_a_qp_that_stays_unsolved_on_the_plan_is_infeasible():
    end, k = watched(lambda k: ((1e-3, 0.0, 0.0), UP, UNSOLVED if k >= 100 else SOLVED))
    assert end.name == OutcomeName.INFEASIBLE
    assert k * PERIOD == pytest.approx(0.25)
    assert "from 0.200 to 0.250 s" in end.cause
    assert "first sign was an unsolved QP at 0.200 s (residual 0.5)" in end.cause


def test_a_qp_that_recovers_is_no_end():
    assert watched(lambda k: ((0.0, 0.0, 0.0), UP, UNSOLVED if k % 25 else SOLVED))[0] is None


def test_a_body_off_the_plan_that_neither_falls_nor_finds_an_answer_is_infeasible():
    end, k = watched(lambda k: ((0.05, 0.0, 0.0), UP, UNSOLVED if k else SOLVED))
    assert end.name == OutcomeName.INFEASIBLE
    assert k * PERIOD == pytest.approx(FALL_TIME, abs=2 * PERIOD)
    assert "first sign was a COM 50 mm off the plan, mostly along x" in end.cause


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_state_that_is_no_number_diverged(value):
    end, k = watched(lambda k: ((value if k == 7 else 0.0, 0.0, 0.0), UP, SOLVED))
    assert (end.name, k) == (OutcomeName.DIVERGED, 7)
    end, _ = watched(lambda k: ((0.0, 0.0, 0.0), (0.0, value, 1.0), SOLVED))
    assert end.name == OutcomeName.DIVERGED


def test_a_com_faster_than_any_body_diverged_wherever_it_is():
    step = 1.01 * BLOW_UP * PERIOD
    end, k = watched(lambda k: ((step * max(0, k - 4), 0.0, 0.0), UP, UNSOLVED))
    assert (end.name, k) == (OutcomeName.DIVERGED, 5)
    end, _ = watched(lambda k: ((0.9 * step * k, 0.0, 0.0), UP, SOLVED))
    assert end.name == OutcomeName.FELL


def test_a_sign_that_was_got_over_is_not_the_cause_of_what_comes_later():
    calm = round(CALM / PERIOD)

    def late(k):
        early = k == 10
        return (0.0, 0.0, 0.0 if k < 3 * calm else -1e-3 * (k - 3 * calm)), UP, LIMITED if early else SOLVED

    end, _ = watched(late, until=4 * calm)
    assert end.name == OutcomeName.FELL
    assert "knee" not in end.cause
    end, _ = watched(lambda k: (*late(k + 3 * calm - 100)[:2], LIMITED if k == 10 else SOLVED))
    assert "first sign was a torque or joint limit at 0.020 s (knee at 100%)" in end.cause
