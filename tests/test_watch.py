"""How a walk ends: each kind by what was seen, and by what came first."""

import math

import numpy as np
import pytest

from ampm.walk import LIMITED, SOLVED, UNSOLVED
from validation.trial.outcome import OutcomeName
from validation.trial.watch import BLOW_UP, CALM, FALL_TIME, Stance, Watch

PERIOD = 0.002
PLANNED = (0.0, 0.0, 0.88)
UP = (0.0, 0.0, 1.0)
STILL = (0.0, 0.0, 0.0)
SOLES = np.array([[0.1, 0.09, 0.0], [-0.1, -0.09, 0.03]])
FALL_TICK = 1 + round(FALL_TIME / PERIOD)  # of a QP that is unsolved from the first tick on


def leaning(degrees, axis=0):
    """A trunk's axis, turned from the vertical."""
    angle = math.radians(degrees)
    return (math.sin(angle), 0.0, math.cos(angle)) if axis == 0 else (0.0, math.sin(angle), math.cos(angle))


def watched(ticks, limit=0.05, until=3000, soles=SOLES):
    """The end of a walk and its tick; ``ticks(k)`` gives (com error, trunk, status)."""
    stance = Stance(np.array(PLANNED), np.array(UP), soles, np.array(PLANNED), np.array(UP), SOLES)
    watch = Watch(stance, limit)
    for k in range(until):
        error, stance.trunk[:], status = ticks(k)
        stance.com[:] = np.array(PLANNED) + error
        end = watch.check(k * PERIOD, status, residual=0.5, limit="knee at 100%")
        if end is not None:
            return end, k
    return None, until


def test_a_walk_on_the_plan_goes_on():
    assert watched(lambda k: ((1e-3, -1e-3, 0.0), leaning(3.0), k % 2)) == (None, 3000)


FAR = ((0.85, 0.0, 0.0), (0.0, -0.85, 0.0), (0.0, 0.0, -0.23), (0.0, 0.0, 0.31))
FASTEST = BLOW_UP * PERIOD
OFF = "COM 50 mm off"
LATE = "QP at 0.200 s"


@pytest.mark.parametrize(
    ("ticks", "name", "tick", "sign"),
    [
        *(
            (lambda k, e=e: (tuple(min(k / 500, 1.0) * i for i in e), UP, SOLVED), OutcomeName.FELL, None, "")
            for e in FAR
        ),
        (lambda k: (STILL, leaning(0.1 * k, 0), SOLVED), OutcomeName.FELL, 601, "trunk 1"),
        (lambda k: (STILL, leaning(0.1 * k, 1), SOLVED), OutcomeName.FELL, 601, "trunk 1"),
        (lambda k: (STILL, (0.0, 0.0, -1.0), SOLVED), OutcomeName.FELL, 0, "trunk 1"),
        (lambda k: ((1e-3, 0, 0), UP, UNSOLVED if k >= 100 else SOLVED), OutcomeName.INFEASIBLE, 125, LATE),
        (lambda k: ((0.05, 0, 0), UP, UNSOLVED if k else SOLVED), OutcomeName.INFEASIBLE, FALL_TICK, OFF),
        (lambda k: ((math.nan if k == 7 else 0.0, 0, 0), UP, SOLVED), OutcomeName.DIVERGED, 7, ""),
        (lambda k: ((math.inf if k == 7 else 0.0, 0, 0), UP, SOLVED), OutcomeName.DIVERGED, 7, ""),
        (lambda k: (STILL, (0.0, math.nan, 1.0), SOLVED), OutcomeName.DIVERGED, 0, ""),
        (lambda k: ((1.01 * FASTEST * max(0, k - 4), 0, 0), UP, UNSOLVED), OutcomeName.DIVERGED, 5, ""),
        (lambda k: ((0.91 * FASTEST * k, 0, 0), UP, SOLVED), OutcomeName.FELL, None, ""),
    ],
)
def test_how_a_walk_ends(ticks, name, tick, sign):
    end, k = watched(ticks)
    assert end.name == name
    assert k == tick or tick is None
    assert sign in end.cause


def test_a_sign_that_was_got_over_is_not_the_cause_of_what_comes_later():
    calm = round(CALM / PERIOD)

    def late(k):
        early = k == 10
        return (0.0, 0.0, 0.0 if k < 3 * calm else -1e-3 * (k - 3 * calm)), UP, LIMITED if early else SOLVED

    end, _ = watched(late, until=4 * calm)
    assert end.name == OutcomeName.FELL
    assert "knee" not in end.cause
    end, _ = watched(lambda k: (*late(k + 3 * calm - 100)[:2], LIMITED if k == 10 else SOLVED))
    assert "0.020 s (knee at 100%)" in end.cause


def test_a_body_that_stepped_off_the_plan_and_stands_has_not_fallen():
    """It stands 0.5 m beside the plan, and 0.4 m lower, where the real floor is."""
    away = np.array([0.3, 0.5, -0.4])
    assert watched(lambda k: (tuple(away), UP, SOLVED), soles=SOLES + away)[0] is None
    end, _ = watched(lambda k: (tuple(away), UP, SOLVED))
    assert end.name == OutcomeName.FELL
    assert "0.48 m over the soles" in end.cause
