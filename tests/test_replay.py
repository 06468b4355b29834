"""A replay notices every recorded number that the repeated steps do not have, however small the change."""

from functools import partial
from unittest.mock import patch

import numpy as np
import pytest

import validation as val
from ampm.exceptions import InputError
from tests.saved_run import TWO_MS, described, forge, make_run, with_column
from tests.walk import perfect_walk
from validation.judge import signals
from validation.store.signals import load_signals

PUSH = ("disturbance.push_y=20", "disturbance.push_at=0.3", "disturbance.push_segment=thorax")
ROW = 30


@pytest.fixture(scope="module")
def pushed(tmp_path_factory):
    return make_run(tmp_path_factory.mktemp("pushed") / "run", steps=2, settings=(*TWO_MS, *PUSH))


def add(by, rows=slice(ROW, ROW + 1)):
    def change(values):
        values[rows] += by
        return values

    return change


def last_bit(values):
    values[ROW] = np.nextafter(values[ROW], np.inf)
    return values


def turn_sign(values):
    assert values[ROW] == 0.0
    values[ROW] = -0.0
    return values


def flip(values):
    values[ROW] ^= True
    return values


def lose(values):
    values[ROW] = np.nan
    return values


FORGED = {
    "a contact force": ("contacts", "force_{point}_z", add(1.0)),
    "the sign of a zero": ("contacts", "force_{swing}_x", turn_sign),
    "where it acts": ("contacts", "position_{point}_x", last_bit),
    "a state": ("joints", "qd_left_knee_pitch", last_bit),
    "where a push acts": ("external", "position_thorax_y", add(1e-3, slice(160, 161))),
    "all ZMPs": ("signals", "measured_zmp_x", add(1e-3, slice(None))),
    "a ZMP that is lost": ("signals", "measured_zmp_x", lose),
    "the COM": ("signals", "measured_com_x", last_bit),
    "a foot's force": ("signals", "right_force_x", last_bit),
    "a contact": ("signals", "left_contact", flip),
    "slip": ("signals", "right_slip", last_bit),
    "a part of the ZMP error": ("signals", "zmp_error_momentum_rate_y", add(1e-9)),
    "the planned ZMP": ("signals", "plan_zmp_x", add(1e-3, slice(None))),
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
