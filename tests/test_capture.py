"""The bound of pushes against brute-force simulation of a point mass on legs."""

import itertools
import math

import numpy as np
import pytest

from ampm.exceptions import InputError
from ampm.planner.capture import (
    DIRECTIONS,
    PUSH_PHASES,
    PushPhase,
    Reach,
    largest_dcm_across,
    largest_dcm_along,
    largest_velocity_change,
    push_instant,
)
from tests.solved import walk_of

OMEGA = 3.37
REACH = Reach(front=0.16, back=-0.1, half_width=0.04, along=0.9, wide=0.5, narrow=0.09, swing=0.3, speed=5.0)
STEPS = 40
FAR = 6.0


def bounded(dcm, footsteps, times, edges):
    """Whether the DCM does not run ahead of feet that land at times, with the ZMP ahead in each sole.

    Behind the feet it may be, as the ZMP need not go so far ahead. Exact by phases.
    """
    foot, now = 0.0, 0.0
    for place, time, edge in zip(footsteps, times, edges, strict=True):
        zmp = foot + edge
        dcm = zmp + (dcm - zmp) * math.exp(OMEGA * (time - now))
        if abs(dcm - foot) > FAR:
            return dcm < foot
        foot, now = place, time
    return True


def largest(walks):
    """Largest DCM that any of these walks survives, by bisection to a micrometre."""
    best = 0.0
    for walk in walks:
        low, high = best, 3.0
        if not bounded(low + 1e-6, *walk):
            continue
        while high - low > 1e-6:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if bounded(middle, *walk) else (low, middle)
        best = low
    return best


def walks_along(edge, foot, least):
    """Steps ahead: times of the first landing and of all others, share of the reach, share of the edge."""
    lands, spans, shares = (0.0, 0.03, 0.08, 0.2), (0.0, 0.03, 0.1), (1.0, 0.7)
    for wait, longer, share, part in itertools.product(lands, spans, shares, shares):
        first, span = least + wait, REACH.swing + longer
        times = [first + span * n for n in range(STEPS)]
        reach = min(REACH.along, foot + REACH.speed * first) * share
        step = min(REACH.along, 0.5 * REACH.speed * span) * share
        yield [reach + step * n for n in range(STEPS)], times, [edge * part] * STEPS


def walks_across(foot, least, inside):
    """Steps to the side, alternately wide and narrow, or one and no more."""
    lands, shares = (0.0, 0.02, 0.04, 0.064, 0.1, 0.2), (1.0, 0.6)
    for wait, share, count, longer in itertools.product(lands, shares, (1, STEPS), (0.0, 0.1)):
        first, span = least + wait, REACH.swing + longer
        times = [first + span * n for n in range(STEPS)]
        if inside:
            begin = min(REACH.wide, foot + REACH.speed * first) * share
            moves = [-REACH.narrow, REACH.wide * share]
        else:
            begin = -max(REACH.narrow, foot - REACH.speed * first)
            moves = [REACH.wide * share, -REACH.narrow]
        place, places = begin, [begin]
        for n in range(1, STEPS):
            place += moves[(n - 1) % 2] if n < count else 0.0
            places.append(place)
        yield places, times, [REACH.half_width] * STEPS
    yield [0.0] * STEPS, list(np.arange(1.0, STEPS + 1.0)), [REACH.half_width] * STEPS


@pytest.mark.parametrize(("edge", "foot", "least"), [(0.16, -0.5, 0.25), (0.16, 0.4, 0.02), (0.1, 0.5, 0.2)])
def test_along_no_walk_survives_more_and_one_as_much(edge, foot, least):
    bound = largest_dcm_along(OMEGA, edge, foot, least, REACH)
    found = largest(walks_along(edge, foot, least))
    assert found <= bound + 2e-6
    assert found == pytest.approx(bound, rel=0.02)


@pytest.mark.parametrize(("foot", "least"), [(0.18, 0.25), (0.18, 0.0), (0.3, 0.1)])
@pytest.mark.parametrize("inside", [True, False])
def test_across_no_walk_survives_more_and_one_as_much(foot, least, inside):
    bound = largest_dcm_across(OMEGA, foot, least, REACH)[0 if inside else 1]
    found = largest(walks_across(foot, least, inside))
    assert found <= bound + 2e-6
    assert found == pytest.approx(bound, rel=0.02)


@pytest.mark.parametrize("phase", PUSH_PHASES)
@pytest.mark.parametrize("direction", DIRECTIONS)
def test_the_velocity_change_is_that_of_a_force_over_its_time(phase, direction):
    """A pushed pendulum stays behind the best walk's just below the bound, and leaves it above."""
    plan, duration = walk_of().plan, 0.1
    push = push_instant(plan.contacts, direction, phase, 2)
    bound = largest_velocity_change(plan, push, REACH, duration)
    assert bound > 0.0
    state = plan.sample([push.time])
    omega = math.sqrt(plan.gravity / state.com[0, 2])
    start = (state.com[0, :2] + state.com_velocity[0, :2] / omega) @ push.direction
    # All that the best walk's ZMP does is in one number: where the DCM may be without a push.
    impulse = -math.expm1(-omega * duration) / (omega * duration)
    level = start + bound * impulse / omega
    for share, stays in ((0.995, True), (1.005, False)):
        behind, dt = start - level, 1e-5  # of the best walk's DCM, so its ZMP cancels
        for _ in range(round(duration / dt)):
            behind += dt * (omega * behind + share * bound / duration / omega)
        assert bool(behind < 0.0) is stays


def test_a_lower_pendulum_a_slower_foot_and_a_chest_bear_less():
    plan = walk_of().plan
    for direction, phase in itertools.product(DIRECTIONS, PUSH_PHASES):
        push = push_instant(plan.contacts, direction, phase, 2)
        free = largest_velocity_change(plan, push, REACH)
        chest = largest_velocity_change(plan, push, REACH, lever=0.4)
        height = plan.sample([push.time]).com[0, 2]
        assert free / chest == pytest.approx(1.0 + 0.4 / height)
        slow = Reach(0.16, -0.1, 0.04, 0.9, 0.5, 0.09, swing=0.5, speed=1.0)
        assert largest_velocity_change(plan, push, slow) <= free


def test_directions_go_by_the_foot_after_the_push():
    contacts = walk_of().plan.contacts
    stances = [phase.stance for phase in contacts.phases]
    assert stances[0] == "left"
    over_left, over_right = np.array([0.0, 1.0]), np.array([0.0, -1.0])
    over: dict[PushPhase, np.ndarray] = {
        "early": over_left,
        "mid": over_left,
        "late": over_right,
        "double": over_right,
    }
    for phase, side in over.items():
        narrower, wider = (push_instant(contacts, name, phase, 1) for name in ("narrower", "wider"))
        np.testing.assert_allclose(narrower.direction, side, rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(wider.direction, -side, rtol=0.0, atol=1e-12)
    single = contacts.phases[0].duration
    assert push_instant(contacts, "forward", "mid", 1).time == pytest.approx(0.5 * single)
    assert push_instant(contacts, "forward", "mid", 1, shift=0.1).time == pytest.approx(0.6 * single)
    np.testing.assert_allclose(
        push_instant(contacts, "backward", "mid", 1).direction, [-1.0, 0.0], rtol=0.0, atol=1e-12
    )
    with pytest.raises(InputError, match="step 99"):
        push_instant(contacts, "forward", "mid", 99)


def test_the_reach_of_the_human_is_that_of_its_legs():
    walk = walk_of()
    reach = Reach.of(walk.robot.description, walk.run.gait.com_height)
    assert walk.run.gait.step_length < reach.along < 2.0 * walk.robot.description.leg_length
    assert reach.narrow > 2.0 * reach.half_width
    assert reach.narrow < walk.run.gait.step_width < reach.wide
