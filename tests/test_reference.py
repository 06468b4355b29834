"""References at the control ticks: the plan's own values, and what is derived from the contacts."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pinocchio as pin
import pytest

from ampm.control.reference import TrackingReference, tracking_reference
from ampm.exceptions import InputError
from ampm.planner.gait import plan_gait
from tests.solved import COARSE, motion_of, walk_of

EARLY, LEAD = 0.04, 0.01
TIMES = np.arange(0.0, 2.6, 0.002)


@pytest.fixture(scope="module")
def plan():
    offset = motion_of(COARSE).report.angular_momentum_y_offset
    return walk_of(COARSE).plan.with_angular_momentum_offset(offset)


def make(plan, **spans) -> TrackingReference:
    return tracking_reference(plan, motion_of(COARSE), walk_of(COARSE).robot, TIMES, **spans)


@pytest.fixture(scope="module")
def reference(plan):
    return make(plan, lead=LEAD, early=EARLY)


def test_com_and_momentum_are_the_plans(plan, reference):
    sample = plan.sample(TIMES)
    for name in ("com", "com_velocity", "com_acceleration"):
        np.testing.assert_array_equal(getattr(reference, name), getattr(sample, name))
    np.testing.assert_array_equal(reference.angular_momentum[:, :2], sample.angular_momentum)
    np.testing.assert_array_equal(reference.moment[:, :2], sample.moment)
    np.testing.assert_array_equal(reference.time, TIMES)
    assert len(reference) == len(TIMES)


def test_yaw_is_the_motions(plan, reference):
    body = motion_of(COARSE).sample(TIMES, walk_of(COARSE).robot)
    np.testing.assert_array_equal(reference.angular_momentum[:, 2], body.angular_momentum_z)
    drawn = np.concatenate(
        [[0.0], np.cumsum(0.002 * 0.5 * (reference.moment[1:, 2] + reference.moment[:-1, 2]))]
    )
    swing = reference.angular_momentum[:, 2] - reference.angular_momentum[0, 2]
    np.testing.assert_allclose(drawn, swing, atol=0.01 * np.ptp(swing))
    for name in ("q", "v", "acceleration"):
        np.testing.assert_array_equal(getattr(reference, name), getattr(body, name))


def test_feet_are_the_plans(plan, reference):
    for foot, sample in enumerate(plan.feet.sample(TIMES)):
        np.testing.assert_array_equal(reference.foot_position[:, foot], sample.position)
        np.testing.assert_array_equal(reference.foot_acceleration[:, foot], sample.acceleration)
        np.testing.assert_array_equal(reference.pitch[:, foot], sample.pitch)
        np.testing.assert_array_equal(reference.toe_velocity[:, foot], sample.toe_velocity)


def test_trunk_is_where_the_motion_has_it(reference):
    robot = walk_of(COARSE).robot
    data = robot.model.createData()
    for k in (0, 300, 1000):
        pin.framesForwardKinematics(robot.model, data, reference.q[k])
        np.testing.assert_allclose(reference.trunk[k], data.oMf[robot.trunk_frame].rotation, atol=1e-14)


def test_contacts_widen_by_lead_and_window_but_never_shrink(plan, reference):
    exact = make(plan)
    np.testing.assert_array_equal(exact.contact, exact.due)
    for wider, by in ((reference.contact, LEAD), (reference.due, EARLY)):
        assert (wider | exact.contact == wider).all()
        ticks = round(by / 0.002)
        np.testing.assert_array_equal(wider[:-ticks], exact.contact[:-ticks] | exact.contact[ticks:])
    assert reference.due.sum() > reference.contact.sum() > exact.contact.sum()


def test_time_until_lift_off(reference, plan):
    contact = make(plan).contact
    until = reference.until_lift
    assert (until > 0.0).all()
    for foot in (0, 1):
        for group in range(3):
            for k in range(0, len(TIMES), 37):
                later = [
                    j
                    for j in range(k, len(TIMES) - 1)
                    if contact[j, foot, group] and not contact[j + 1, foot, group]
                ]
                expected = TIMES[later[0] + 1] - TIMES[k] if later else np.inf
                assert until[k, foot, group] == pytest.approx(expected, abs=1e-12)


def test_load_moves_from_foot_to_foot_with_the_zmp(plan, reference):
    stance = plan.sample(TIMES).stance
    load = reference.right_load
    assert (load[stance == 0] == 0.0).all()
    assert (load[stance == 1] == 1.0).all()
    both = stance == 2
    assert ((load[both] >= 0.0) & (load[both] <= 1.0)).all()
    first = np.flatnonzero(both)[: np.flatnonzero(np.diff(np.flatnonzero(both)) > 1)[0]]
    assert (np.diff(load[first]) > 0.0).all()  # to the right foot, steadily


def test_a_reference_cannot_be_changed(reference):
    for item in fields(reference):
        with pytest.raises(ValueError, match="read-only"):
            getattr(reference, item.name)[0] = 0


def test_a_single_tick_is_a_reference_too(plan):
    one = tracking_reference(plan, motion_of(COARSE), walk_of(COARSE).robot, np.zeros(1))
    assert len(one) == 1
    assert (one.moment[:, 2] == 0.0).all()
    assert np.isinf(one.until_lift).all()


def test_plans_without_feet_and_times_outside_are_refused(plan):
    walk = walk_of(COARSE)
    with pytest.raises(InputError, match="no feet"):
        tracking_reference(plan_gait(walk.run.gait, mass=60.0), motion_of(COARSE), walk.robot, TIMES)
    with pytest.raises(InputError):
        tracking_reference(plan, motion_of(COARSE), walk.robot, np.array([0.0, plan.duration + 1.0]))
