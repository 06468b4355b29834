"""References of a walk: the plan's own values, what follows from the contacts, one instant against many."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from ampm.reference import FIELDS
from ampm.walk import Reference, Timing
from tests.solved import COARSE, planned_walk, walk_of

EARLY, LEAD = 0.04, 0.01
TIMES = np.arange(0.0, 2.6, 0.002)


@cache
def rows(**spans) -> Reference:
    return planned_walk().table(TIMES, Timing(**spans))


def test_a_torque_that_goes_on_is_held_only_where_the_plan_jumps():
    assert planned_walk().jump_times.size == 0
    smooth = rows(hold=0.001, extrapolation=0.002)
    assert not smooth.jumps.any()
    np.testing.assert_array_equal(smooth.row, rows().row)
    jumping = walk_of(COARSE, "gait.planner=lipm").plan
    assert jumping.jump_times == pytest.approx(jumping.contacts.starts[1:])
    walk = replace(planned_walk(), phases=jumping.phases)
    held = walk.table(TIMES, Timing(hold=0.001, extrapolation=0.002))
    exact, late = (walk.table(times, Timing()) for times in (TIMES, TIMES + 0.0005))
    near = (np.abs(TIMES[:, None] - jumping.jump_times) < 0.002).any(axis=1)
    assert near.sum() == 2 * (jumping.jump_times < TIMES[-1]).sum()
    np.testing.assert_array_equal(held.jumps, near)
    np.testing.assert_array_equal(held.com_acceleration[~near], exact.com_acceleration[~near])
    np.testing.assert_array_equal(held.com_acceleration[near], late.com_acceleration[near])


def test_contacts_widen_by_lead_and_window_but_never_shrink():
    exact, wide = rows(), rows(lead=LEAD, early=EARLY)
    np.testing.assert_array_equal(exact.planned, exact.due)
    for wider, by in ((wide.planned, LEAD), (wide.due, EARLY)):
        assert (wider | exact.planned == wider).all()
        ticks = round(by / 0.002)
        np.testing.assert_array_equal(wider[:-ticks], exact.planned[:-ticks] | exact.planned[ticks:])
    assert wide.due.sum() > wide.planned.sum() > exact.planned.sum()


def test_a_walk_ends_as_if_it_went_on():
    """Or the rear foot's forces would not close at the end, and ticks there might stay unsolved."""
    timing = Timing(LEAD, EARLY)
    shorter, longer = (planned_walk(f"gait.steps={steps}") for steps in (2, 3))
    ends = [plan.table(np.arange(0.0, shorter.duration, 0.002), timing) for plan in (shorter, longer)]
    for name in ("planned", "due", "until_lift"):
        short, long = (np.minimum(getattr(end, name), 0.5) for end in ends)
        np.testing.assert_array_equal(short, long)
    last = ends[0].until_lift[-1, 1]  # the right foot stands behind
    assert np.isfinite(last[1:]).all()
    assert (last[1:] <= 0.004).all()


def test_nothing_makes_a_reference_writeable():
    """Who could write it would say what a fall is."""
    base = rows()[5].com
    while not isinstance(base, bytes):
        if isinstance(base, np.ndarray):  # of a single row it does nothing
            with pytest.raises(ValueError, match="cannot set WRITEABLE flag"):
                base.setflags(write=True)
        base = base.base


def test_a_reference_is_a_row_of_a_sequence_made_of_fields_in_their_shapes():
    table = planned_walk().table(TIMES)
    row = table[4]
    assert len(table) == len(TIMES)
    assert table[3:5][1].time == row.time == TIMES[4]
    fields = {name: getattr(row, name) for name in FIELDS}
    assert Reference.of(time=0.0, q=row.q, v=row.v).com.tolist() == [0.0, 0.0, 0.0]
    assert Reference.of(**fields).row == row.row
    with pytest.raises(ValueError, match=r"com of a reference has shape \(2,\) and must have \(3,\)"):
        Reference.of(**fields | {"com": np.zeros(2)})
    with pytest.raises(ValueError, match="no field of name zmp"):
        Reference.of(**fields, zmp=np.zeros(2))
