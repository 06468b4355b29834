"""References of a walk: the plan's own values, what follows from the contacts, one instant against many."""

from dataclasses import replace
from functools import cache

import numpy as np
import pinocchio as pin
import pytest

from ampm.control.workspace import rows_of
from ampm.planners import periodic_walk
from ampm.reference import FIELDS
from ampm.walk import Reference, ReferenceTable, Timing
from tests.solved import COARSE, motion_of, walk_of

EARLY, LEAD = 0.04, 0.01
TIMES = np.arange(0.0, 2.6, 0.002)


@cache
def plan():
    walk = walk_of(COARSE)
    return periodic_walk(walk.plan, motion_of(COARSE), walk.robot)


@cache
def rows(**spans) -> ReferenceTable:
    return plan().table(TIMES, Timing(**spans))


def test_com_and_momentum_are_the_plans_and_yaw_is_the_motions():
    sample, reference = plan().sample(TIMES), rows()
    for name in ("time", "com", "com_velocity", "com_acceleration"):
        np.testing.assert_array_equal(getattr(reference, name), getattr(sample, name))
    np.testing.assert_array_equal(reference.angular_momentum[:, :2], sample.angular_momentum)
    np.testing.assert_array_equal(reference.moment[:, :2], sample.moment)
    body = motion_of(COARSE).sample(TIMES, walk_of(COARSE).robot)
    np.testing.assert_array_equal(reference.angular_momentum[:, 2], body.angular_momentum_z)
    rate = reference.moment[:, 2]
    drawn = np.concatenate([[0.0], np.cumsum(0.002 * 0.5 * (rate[1:] + rate[:-1]))])
    swing = reference.angular_momentum[:, 2] - reference.angular_momentum[0, 2]
    np.testing.assert_allclose(drawn, swing, atol=0.01 * np.ptp(swing))
    for name in ("q", "v", "acceleration"):
        np.testing.assert_array_equal(getattr(reference, name), getattr(body, name))


def test_feet_are_the_plans():
    for foot, sample in enumerate(plan().feet.sample(TIMES)):
        feet = rows()
        for name in ("position", "velocity", "acceleration"):
            np.testing.assert_array_equal(getattr(feet, f"foot_{name}")[:, foot], getattr(sample, name))
        toe = np.stack([sample.toe, sample.toe_velocity, sample.toe_acceleration], axis=1)
        np.testing.assert_array_equal(feet.foot_toe[:, foot], toe)
        np.testing.assert_array_equal(feet.foot_angular_velocity[:, foot, 1], sample.pitch_velocity)
        np.testing.assert_array_equal(feet.foot_angular_acceleration[:, foot, 1], sample.pitch_acceleration)
        for k in (0, 200, 330):
            turn = pin.exp3(np.array([0.0, sample.pitch[k], 0.0]))
            np.testing.assert_allclose(feet.foot_rotation[k, foot], turn, rtol=0.0, atol=1e-14)


def test_a_torque_that_goes_on_is_held_only_where_the_plan_jumps():
    assert plan().jump_times.size == 0
    smooth = rows(hold=0.001, slope=0.002)
    assert not smooth.jumps.any()
    np.testing.assert_array_equal(smooth.row, rows().row)
    jumping = walk_of(COARSE, "gait.planner=lipm").plan
    assert jumping.jump_times == pytest.approx(jumping.contacts.starts[1:])
    walk = replace(plan(), phases=jumping.phases)
    held, exact, late = (
        walk.table(times, timing)
        for times, timing in (
            (TIMES, Timing(hold=0.001, slope=0.002)),
            (TIMES, Timing()),
            (TIMES + 0.0005, Timing()),
        )
    )
    near = (np.abs(TIMES[:, None] - jumping.jump_times) < 0.002).any(axis=1)
    assert near.sum() == 2 * (jumping.jump_times < TIMES[-1]).sum()
    np.testing.assert_array_equal(held.jumps, near)
    np.testing.assert_array_equal(held.com_acceleration[~near], exact.com_acceleration[~near])
    np.testing.assert_array_equal(held.com_acceleration[near], late.com_acceleration[near])


def test_accelerations_of_a_held_torque_are_those_of_its_middle():
    held, middle = rows(hold=0.002), plan().table(TIMES + 0.001)
    np.testing.assert_array_equal(held.com_acceleration, middle.com_acceleration)
    np.testing.assert_array_equal(held.foot_angular_acceleration, middle.foot_angular_acceleration)
    np.testing.assert_array_equal(held.acceleration, middle.acceleration)
    np.testing.assert_array_equal(held.com, rows().com)
    np.testing.assert_array_equal(held.q, rows().q)


def test_contacts_widen_by_lead_and_window_but_never_shrink():
    exact, wide = rows(), rows(lead=LEAD, early=EARLY)
    np.testing.assert_array_equal(exact.planned, exact.due)
    for wider, by in ((wide.planned, LEAD), (wide.due, EARLY)):
        assert (wider | exact.planned == wider).all()
        ticks = round(by / 0.002)
        np.testing.assert_array_equal(wider[:-ticks], exact.planned[:-ticks] | exact.planned[ticks:])
    assert wide.due.sum() > wide.planned.sum() > exact.planned.sum()


def test_time_until_lift_off():
    contact, until = rows().planned, rows(lead=LEAD).until_lift
    assert (until > 0.0).all()
    for foot, group in np.ndindex(2, 3):
        planned = contact[:, foot, group]
        lifts = 1 + np.flatnonzero(planned[:-1] & ~planned[1:])
        for k in range(0, len(TIMES), 37):
            if (lifts > k).any():
                expected = min(TIMES[lifts[lifts > k]]) - TIMES[k]
                assert until[k, foot, group] == pytest.approx(expected, abs=1e-12)
            else:  # after the last tick
                exact = plan().table(TIMES[k : k + 1]).until_lift[0, foot, group]
                found = until[k, foot, group]
                assert found == exact or exact - 1e-9 <= found < exact + 0.002


def test_a_walk_ends_as_if_it_went_on():
    """Or the rear foot's forces would not close at the end, and ticks there might stay unsolved."""
    timing = Timing(LEAD, EARLY)
    shorter, longer = (
        periodic_walk(walk_of(COARSE, f"gait.steps={steps}").plan, motion_of(COARSE), walk_of(COARSE).robot)
        for steps in (2, 3)
    )
    ticks = np.arange(0.0, shorter.duration, 0.002)
    ends = [plan.table(ticks, timing) for plan in (shorter, longer)]
    for name in ("planned", "due", "until_lift"):
        short, long = (np.minimum(getattr(end, name), 0.5) for end in ends)
        np.testing.assert_array_equal(short, long)
    last = ends[0].until_lift[-1, 1]  # the right foot stands behind
    assert np.isfinite(last[1:]).all()
    assert (last[1:] <= 0.004).all()


@pytest.mark.parametrize("k", [0, 140, 290, 700])
def test_one_instant_is_a_row_of_the_table(k):
    timing = Timing(LEAD, EARLY, 0.001)
    table = plan().table(TIMES, timing)
    instant, row = plan().table(TIMES[k : k + 1], timing)[0], table[k]
    until, by_ticks = instant.until_lift, row.until_lift
    seen = np.isfinite(by_ticks)
    late = by_ticks[seen] - until[seen]
    assert (late >= -1e-9).all()
    assert (late < 0.002).all()
    for name in row.row.dtype.names:
        if name not in ("moment", "until_lift"):
            np.testing.assert_array_equal(instant.row[name], row.row[name], err_msg=name)


def test_a_table_is_a_sequence_and_cannot_be_changed():
    table = plan().table(TIMES)
    assert len(table) == len(TIMES)
    assert table.part(3, 5)[1].time == table[4].time == TIMES[4]
    for changed in (table.com, table.row, table[4].com, table[4].foot_position):
        with pytest.raises(ValueError, match="read-only"):
            changed[...] = 0
    moved = table[4].replace(com=np.ones(3))
    assert (moved.com == 1.0).all()
    assert (table[4].com != 1.0).any()
    one = plan().table(np.zeros(1))[0]
    assert one.moment[2] == 0.0


def test_a_reference_is_made_of_fields_in_their_shapes():
    row = plan().table(TIMES)[4]
    fields = {name: getattr(row, name) for name in FIELDS}
    assert Reference.of(time=0.0, q=row.q, v=row.v).com.tolist() == [0.0, 0.0, 0.0]
    assert Reference.of(**fields).row == row.row
    with pytest.raises(ValueError, match=r"com of a reference has shape \(2,\) and must have \(3,\)"):
        Reference.of(**fields | {"com": np.zeros(2)})
    with pytest.raises(ValueError, match="no field of name zmp"):
        Reference.of(**fields, zmp=np.zeros(2))


def test_smooth_fields_are_one_run_of_numbers_for_compiled_functions():
    table = plan().table(TIMES)
    rows, smooth = rows_of(table.row), [name for name, field in FIELDS.items() if field.smooth]
    parts = [getattr(table, name).reshape(len(table), -1) for name in smooth]
    np.testing.assert_array_equal(rows.smooth, np.hstack(parts))
