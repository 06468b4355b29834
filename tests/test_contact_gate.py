"""Contact gate: what opens, when, how fast, and what must wait."""

from __future__ import annotations

import numpy as np
import pytest

from ampm.control.contact_gate import ContactGate
from ampm.walk import ContactState
from tests.solved import COARSE, walk_of

PERIOD, RAMP = 0.002, 0.04
RATE = PERIOD / RAMP
NEVER = np.full((2, 3), np.inf)
ALL = np.ones((2, 3), dtype=bool)
AIR = np.array([[False] * 3, [True] * 3])  # the left foot swings
HEEL, BALL, TIP = 0, 1, 2


@pytest.fixture
def robot():
    return walk_of(COARSE).robot


@pytest.fixture
def gate(robot):
    """A gate that has started with the right foot standing and the left one in the air."""
    gate = ContactGate(robot, PERIOD, RAMP)
    gate.update(ContactState(AIR, AIR, NEVER), touch(robot, right=(0, 1, 2)))
    return gate


def touch(robot, left=(), right=(), one_point=False):
    """Sensed contact of whole groups, or of one point of each."""
    sensed = np.zeros(12, dtype=bool)
    for foot, groups in enumerate((left, right)):
        for group in groups:
            points = np.flatnonzero((robot.point_foot == foot) & (robot.point_group == group))
            sensed[points[:1] if one_point else points] = True
    return sensed


def groups(robot, contact, foot=0):
    """Limits of a foot's heel, ball and tip; both points of a group have one."""
    found = []
    for group in range(3):
        pair = contact.openings.limit[(robot.point_foot == foot) & (robot.point_group == group)]
        assert pair[0] == pair[1]
        found.append(float(pair[0]))
    return found


def test_a_run_starts_on_what_is_planned(robot):
    gate = ContactGate(robot, PERIOD, RAMP)
    contact = gate.update(ContactState(AIR, AIR, NEVER), np.zeros(12, dtype=bool))
    assert groups(robot, contact) == [0.0, 0.0, 0.0]
    assert groups(robot, contact, 1) == [1.0, 1.0, 1.0]


@pytest.mark.parametrize(
    ("planned", "due", "left", "expected"),
    [
        (ALL, ALL, (), [0.0, 0.0, 0.0]),  # planned contact alone opens nothing
        (AIR, AIR, (HEEL, BALL), [0.0, 0.0, 0.0]),  # nor does touch alone
        (AIR, ALL, (HEEL,), [RATE, 0.0, 0.0]),  # a foot that lands early: not planned yet, but due
        (ALL, ALL, (TIP,), [0.0, 0.0, 0.0]),  # tips wait for the ball
        (ALL, ALL, (BALL, TIP), [0.0, RATE, RATE]),
    ],
)
def test_a_group_opens_where_it_is_due_and_has_touched(robot, gate, planned, due, left, expected):
    contact = gate.update(ContactState(planned, due, NEVER), touch(robot, left=left, right=(0, 1, 2)))
    assert groups(robot, contact) == pytest.approx(expected)
    assert contact.landing == bool(left)
    assert contact.touching[0] == [group in left for group in range(3)]


def test_a_line_that_bounces_off_is_still_landing(robot, gate):
    gate.update(ContactState(ALL, ALL, NEVER), touch(robot, left=(HEEL,), right=(0, 1, 2)))
    contact = gate.update(ContactState(ALL, ALL, NEVER), touch(robot, right=(0, 1, 2)))
    assert contact.touching[0] == [False, False, False]
    assert contact.landing


def test_a_group_opens_over_the_ramp_once_one_of_its_points_has_touched(robot, gate):
    sensed = touch(robot, left=(HEEL,), one_point=True) | touch(robot, right=(0, 1, 2))
    ticks = [gate.update(ContactState(ALL, ALL, NEVER), sensed) for _ in range(25)]
    opened = [groups(robot, contact)[HEEL] for contact in ticks]
    np.testing.assert_allclose(opened, np.minimum(RATE * np.arange(1, 26), 1.0))
    assert not ticks[-1].landing
    # It stays open when the point lifts for a moment: the force that it carries turns the foot back.
    contact = gate.update(ContactState(ALL, ALL, NEVER), touch(robot, right=(0, 1, 2)))
    assert groups(robot, contact) == [1.0, 0.0, 0.0]
    assert contact.touched[0] == [True, False, False]
    assert contact.touching[0] == [False, False, False]


@pytest.mark.parametrize("left", [0.05, 0.04, 0.02, 0.002, 0.0])
def test_a_group_closes_over_the_ramp_before_its_lift_off(robot, gate, left):
    until = np.array([[np.inf] * 3, [left, np.inf, np.inf]])
    contact = gate.update(ContactState(AIR, AIR, until), touch(robot, right=(0, 1, 2)))
    assert groups(robot, contact, 1) == pytest.approx([min(left / RAMP, 1.0), 1.0, 1.0])
    assert contact.opening[1] == [1.0, 1.0, 1.0]  # how far it has opened is another matter


def test_after_lift_off_a_group_must_touch_again(robot, gate):
    both = touch(robot, left=(0, 1, 2), right=(0, 1, 2))
    gate.update(ContactState(ALL, ALL, NEVER), both)
    gate.update(ContactState(AIR, AIR, NEVER), touch(robot, right=(0, 1, 2)))
    contact = gate.update(ContactState(ALL, ALL, NEVER), touch(robot, right=(0, 1, 2)))
    assert groups(robot, contact) == [0.0, 0.0, 0.0]
    contact = gate.update(ContactState(ALL, ALL, NEVER), both)
    assert groups(robot, contact) == pytest.approx([RATE, RATE, RATE])


def test_an_answer_stays_as_it_was_when_the_next_one_comes(robot, gate):
    standing = touch(robot, right=(0, 1, 2))
    first = gate.update(ContactState(AIR, AIR, NEVER), standing)
    kept, limit = first._replace(), first.openings.limit.copy()
    again = gate.update(ContactState(AIR, AIR, NEVER), standing)
    np.testing.assert_array_equal(again.openings.limit, limit)
    gate.update(ContactState(ALL, ALL, NEVER), standing | touch(robot, left=(HEEL,)))
    assert first == kept
    np.testing.assert_array_equal(first.openings.limit, limit)
