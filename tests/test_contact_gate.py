"""Contact gate: what opens, when, how fast, and what must wait."""

import numpy as np
import pytest

from ampm.compiled import refer
from ampm.control.contact_gate import land, update_contacts
from ampm.control.controller import TrackingController
from ampm.control.workspace import gains_of
from ampm.controller_parameters import ControllerParameters
from ampm.parameters import RunParameters
from ampm.planner.feet import BALL, HEEL, TIP
from tests.solved import COARSE, walk_of

GAINS = gains_of(ControllerParameters())
RATE = 1.0 / (GAINS.frequency * GAINS.contact_ramp)
ALL = np.ones((2, 3), dtype=bool)
AIR = np.array([[False] * 3, [True] * 3])  # the left foot swings


class Gate:
    """Lines and points of a body."""

    def __init__(self):
        self.work = work = TrackingController(walk_of(COARSE).robot, RunParameters()).workspace
        self.lines, self.points, self.wanted = work.contact.lines, work.body.points, work.wanted
        self.first = True
        self.wanted.until_lift[:] = np.inf

    def update(self, planned, due, sensed, missed=0.0):
        self.work.sensed.contact[:] = sensed
        self.work.sensed.threshold[0] = missed * self.work.body.mass * self.work.body.gravity
        self.wanted.planned[:], self.wanted.due[:] = planned, due
        update_contacts(refer(self.work), self.first)
        self.first = False

    def limits(self):
        """Limits of the left heel, ball and tip; both points of a line have its limit."""
        for point in self.points:
            line = self.lines[point["foot"], point["line"]]
            assert point["limit"] == line["limit"]
        return self.lines["limit"][0].tolist()


@pytest.fixture
def gate():
    """A gate that has started with the right foot standing and the left one in the air."""
    gate = Gate()
    gate.update(AIR, AIR, touch(right=(0, 1, 2)))
    return gate


def touch(left=(), right=(), one_point=False):
    """Sensed contact of whole groups, or of one point of each."""
    robot, sensed = walk_of(COARSE).robot, np.zeros(12, dtype=bool)
    for foot, groups in enumerate((left, right)):
        for group in groups:
            points = np.flatnonzero((robot.point_foot == foot) & (robot.point_group == group))
            sensed[points[:1] if one_point else points] = True
    return sensed


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
def test_a_group_opens_where_it_is_due_and_has_touched(gate, planned, due, left, expected):
    gate.update(planned, due, touch(left=left, right=(0, 1, 2)))
    assert gate.limits() == pytest.approx(expected)
    assert gate.lines["touching"][0].tolist() == [group in left for group in range(3)]


def test_a_planned_line_whose_touch_may_be_missed_opens_a_little(gate):
    for _ in range(3):
        gate.update(ALL, ALL, touch(right=(0, 1, 2)), missed=0.03)
    assert gate.limits() == pytest.approx([0.03, 0.03, 0.0])
    assert not gate.lines["touched"][0].any()
    gate.update(ALL, ALL, touch(left=(HEEL,), right=(0, 1, 2)), missed=0.03)
    assert gate.limits() == pytest.approx([0.03 + RATE, 0.03, 0.0])


def test_a_group_opens_over_the_ramp_once_one_of_its_points_has_touched(gate):
    sensed = touch(left=(HEEL,), one_point=True) | touch(right=(0, 1, 2))
    opened = []
    for _ in range(25):
        gate.update(ALL, ALL, sensed)
        opened.append(gate.limits()[HEEL])
    np.testing.assert_allclose(opened, np.minimum(RATE * np.arange(1, 26), 1.0))
    # It stays open when the point lifts for a moment: the force that it carries turns the foot back.
    gate.update(ALL, ALL, touch(right=(0, 1, 2)))
    assert gate.limits() == [1.0, 0.0, 0.0]
    assert gate.lines["touched"][0].tolist() == [True, False, False]
    assert not gate.lines["touching"][0].any()


@pytest.mark.parametrize("foot", ["lands", "rolls", "leaves", "lets go"])
def test_the_force_under_a_foot_is_given_as_it_lands_and_expected_as_it_leaves(gate, foot):
    """The torques for a given force press the foot down: one that leaves would stay on the floor."""
    due = {"lands": [True] * 3, "rolls": [False, False, True]}.get(foot, [False] * 3)
    gate.work.sensed.normal_force[:] = 0.1 * gate.work.body.mass * gate.work.body.gravity
    gate.update(AIR, np.array([due, [True] * 3]), touch(left=(BALL,), right=(0, 1, 2)))
    gate.points["least"] = gate.points["largest"] = 0.0
    contact = gate.work.contact
    contact.forces[:] = float(foot == "lets go")  # it is still commanded to push
    contact.wrench_map[:], contact.wrench[:] = 1.0, 0.0
    gate.work.sensed.force_age[0] = 1.0
    land(refer(gate.work))
    ball, share = (gate.points["foot"] == 0) & (gate.points["line"] == BALL), 0.1 * GAINS.landing_share
    given = np.where(ball & (foot == "lands"), share, 0.0)
    assert gate.points["least"].tolist() == pytest.approx(given.tolist())
    assert gate.points["largest"].tolist() == gate.points["least"].tolist()
    assert contact.wrench.tolist() == pytest.approx([-2.0 * share * (foot == "leaves")] * 6)
