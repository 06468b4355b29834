"""A record is lossless and immutable; a replay notices every number that was changed, however little.

What is damaged or of another run is refused.
"""

import json
import os
import shutil
from dataclasses import replace
from functools import partial
from unittest.mock import patch

import numpy as np
import pyarrow.parquet as pq
import pytest

import validation as val
from ampm.exceptions import InputError
from tests.records import first_difference, same_bits, stored
from tests.saved_run import TWO_MS, described, forge, make_run, walked, with_column
from tests.solved import body_of, simulated
from tests.walk import perfect_walk
from validation.judge import signals
from validation.store.record import CONSTANTS, RECORD_FILES, load_record, save_record
from validation.store.signals import load_signals
from validation.trial.record import state_steps

FINE = "simulation.time_step=0.0005"
"""Several steps of the physics per tick."""


@pytest.fixture(scope="module")
def record():
    return simulated(FINE, steps=1)


def test_what_is_stored_has_the_same_bits(record, tmp_path):
    """A state and the contacts every 10 ms, the torques of every tick, and all constants."""
    assert record.substeps == 4
    again = stored(record, body_of(FINE).xml, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {*RECORD_FILES, "model.xml"}
    assert first_difference(record, again) is None
    assert same_bits(again.torque, record.torque)
    for name in CONSTANTS:
        one, two = (getattr(each, name) for each in (record, again))
        assert same_bits(one, two) if isinstance(one, np.ndarray) else one == two, name
    rows = {name: pq.read_metadata(tmp_path / f"{name}.parquet").num_rows for name in ("joints", "contacts")}
    assert rows == {"joints": -(-record.steps // 20) + 1, "contacts": -(-record.steps // 20)}


def test_awkward_floats_are_kept(record, tmp_path):
    awkward = np.array([0.0, -0.0, np.nan, -np.nan, np.inf, -np.inf, 5e-324, 1 + 2**-52, np.pi, 0.1])
    q, rate, every = record.q.copy(), record.torque_rate.copy(), state_steps(record.time_step)
    q[: 10 * every : every, 0] = awkward
    q[10 * every, 0] = np.array([0x7FF8000000000123], dtype=np.int64).view(np.float64)[0]
    rate[5], rate[6], rate[7, :4] = 1.5, np.nan, -0.0
    limits = np.tile([-np.inf, np.inf], (len(record.joint_names), 1))
    changed = replace(record, q=q, torque_rate=rate, friction=float("inf"), joint_range=limits)
    kept = stored(changed, "", tmp_path)
    assert first_difference(changed, kept) is None
    assert kept.friction == float("inf")
    assert same_bits(kept.joint_range, limits)


def test_arrays_are_read_only_copies_but_of_what_nobody_can_write_to(record):
    source = record.q.copy()
    view = source[: len(source)]
    view.setflags(write=False)
    copied = replace(record, q=view)  # through its owner the view can still change
    source[0, 0] = 7.0
    assert copied.q[0, 0] != 7.0
    with pytest.raises(ValueError, match="read-only"):
        copied.q[0, 0] = 1.0
    source.setflags(write=False)
    assert replace(record, q=view).q is view
    assert replace(copied, friction=0.5).tick_torque is copied.tick_torque


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return make_run(tmp_path_factory.mktemp("record") / "run", steps=2)


def undigested(path):
    path.write_text(json.dumps(json.loads(path.read_text()) | {"files": {}}))


def rewritten(path, change):
    pq.write_table(change(pq.read_table(path)), path)


CHANGES = {
    "files without digests": ("summary.json", undigested, "has no digest"),
    "no summary": ("summary.json", lambda path: path.unlink(), "missing|has no"),
    "a missing row": ("ticks.parquet", lambda path: rewritten(path, lambda t: t.slice(1)), "has changed"),
    "a file that was none of the run's": ("external.parquet", lambda path: path.touch(), "has no digest"),
    "a missing file": ("contacts.parquet", lambda path: path.unlink(), "is missing"),
    "a table that is cut": ("signals.parquet", lambda path: os.truncate(path, 99), "has changed"),
    "another gait": ("run.toml", lambda path: path.write_text(path.read_text() + "\n"), "has changed"),
}


@pytest.mark.parametrize(("name", "change", "words"), CHANGES.values(), ids=CHANGES)
def test_a_changed_folder_is_neither_read_nor_replayed_nor_viewed(
    folder, tmp_path, ampm, name, change, words
):
    copy = tmp_path / "copy"
    shutil.copytree(folder, copy)
    change(copy / name)
    for use in (val.replay, val.load):
        with pytest.raises(InputError, match=words) as caught:
            use(copy)
        assert name in str(caught.value)
    assert ampm("view", copy, "--save", tmp_path / "a.rrd").status == 2


def opened(folder, name, change):
    """All of a record, one of whose files a function of its path has changed."""
    record = walked(2, TWO_MS, None)[1]
    save_record(record, folder)
    change(folder / f"{name}.parquet")
    return first_difference(record, load_record(folder))


PUSH = ("disturbance.push_y=20", "disturbance.push_at=0.3", "disturbance.push_segment=thorax")
ROW = 30


@pytest.fixture(scope="module")
def pushed(tmp_path_factory):
    return make_run(tmp_path_factory.mktemp("pushed") / "run", steps=2, settings=(*TWO_MS, *PUSH))


def at(rows, change):
    """A function that changes a column's numbers in some rows."""

    def changed(values):
        values[rows] = change(values[rows])
        return values

    return changed


last_bit = at(ROW, lambda number: np.nextafter(number, np.inf))
lose = at(ROW, lambda _: np.nan)


def turned(zero):
    assert zero == 0.0
    return -zero


FORGED = {
    "a contact force": ("contacts", "force_{point}_z", at(ROW, lambda force: force + 1.0)),
    "the sign of a zero": ("contacts", "force_{swing}_x", at(ROW, turned)),
    "where it acts": ("contacts", "position_{point}_x", last_bit),
    "a state": ("joints", "qd_left_knee_pitch", last_bit),
    "where a push acts": ("external", "position_thorax_y", at(160, lambda y: y + 1e-3)),
    "all ZMPs": ("signals", "measured_zmp_x", at(..., lambda zmp: zmp + 1e-3)),
    "a ZMP that is lost": ("signals", "measured_zmp_x", lose),
    "the COM": ("signals", "measured_com_x", last_bit),
    "a foot's force": ("signals", "right_force_x", last_bit),
    "a contact": ("signals", "left_contact", at(ROW, np.logical_not)),
    "slip": ("signals", "right_slip", last_bit),
    "a part of the ZMP error": ("signals", "zmp_error_momentum_rate_y", at(ROW, lambda part: part + 1e-9)),
    "the planned ZMP": ("signals", "plan_zmp_x", at(..., lambda zmp: zmp + 1e-3)),
}


@pytest.mark.parametrize(("file", "column", "change"), FORGED.values(), ids=FORGED)
def test_a_changed_number_with_a_forged_digest_is_found(pushed, tmp_path, file, column, change):
    points = val.load(pushed).record.point_sites
    column = column.format(point=points[0], swing=points[-1])
    file = f"{file}.parquet"
    copy = forge(pushed, tmp_path / "copy", file, lambda table: with_column(table, column, change))
    found = val.replay(copy)
    assert found.file == file
    of_sum = column.startswith(("zmp_error", "plan_zmp"))
    assert found.signal == (f"sum of zmp_error_{column[-1]}" if of_sum else column)
    rows = {"contacts": ROW * 0.01, "joints": ROW * 0.01, "external": 0.32}
    first = 0.0 if column in ("measured_zmp_x", "plan_zmp_x") and change is not lose else ROW * 0.002
    assert found.time == pytest.approx(rows.get(file.removesuffix(".parquet"), first))
    assert str(found.recorded) != str(found.replayed)


def test_all_columns_but_labels_plan_and_command_are_held(pushed):
    apart = ("phase", "stance", "plan_", "command_", "motion_", "zmp_error_")
    stored = load_signals(pushed / "signals.parquet").columns
    held = set(signals.columns_of({"measured": perfect_walk()[2]}, signals.ALL))
    assert {name for name in stored if not name.startswith(apart)} == held


def test_the_header_and_missing_rows_are_noticed(pushed, tmp_path):
    heavier = described(mass=val.load(pushed).record.mass + 1e-9)
    found = val.replay(forge(pushed, tmp_path / "heavier", "joints.parquet", heavier))
    assert (found.file, found.signal) == ("joints.parquet", "mass")
    short = forge(pushed, tmp_path / "short", "signals.parquet", lambda table: table.slice(1))
    with pytest.raises(InputError, match="should have 679 rows"):
        val.replay(short)


def test_a_long_walk_keeps_fewer_signals(tmp_path):
    with patch.object(signals, "MOST_ROWS", 200):
        folder = make_run(tmp_path / "run", steps=2, settings=(*TWO_MS, "gait.planner=dcm"))
        np.testing.assert_allclose(np.diff(load_signals(folder / "signals.parquet").time), 0.01)
        assert val.replay(folder).identical
        change = partial(with_column, name="left_force_y", change=last_bit)
        copy = forge(folder, tmp_path / "copy", "signals.parquet", change)
        assert val.replay(copy).signal == "left_force_y"
    assert signals.kept_rows(0, 0.01) == slice(None, None, 1)  # all of a walk that ends in its first step
