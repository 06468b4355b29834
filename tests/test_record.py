"""A record is lossless on disk, immutable in memory, and two records that differ say where."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from ampm.exceptions import InputError
from tests.records import first_difference, same_bits
from tests.tiny import swinging
from validation.store.record import EXTERNAL_FILE, RECORD_FILES, load_record, save_record
from validation.trial.outcome import Outcome, OutcomeName


@pytest.fixture(scope="module")
def record():
    return swinging(steps=60)


def assert_equal(one, two):
    """All fields have the same bits; those of ``tests.records`` and what they leave out."""
    assert first_difference(one, two) is None
    for name in ("qp_time", "torque_limit", "joint_range", "point_foot", "point_group"):
        assert same_bits(getattr(one, name), getattr(two, name)), name
    assert list(one.sensors) == list(two.sensors)
    for name in ("metadata", "joint_names", "external_segments", "mass", "gravity", "time_step", "friction"):
        assert repr(getattr(one, name)) == repr(getattr(two, name)), name


def test_round_trip_is_bit_exact(record, tmp_path):
    save_record(record, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == set(RECORD_FILES)
    assert_equal(record, load_record(tmp_path))


def test_round_trip_keeps_awkward_floats(record, tmp_path):
    awkward = np.array([0.0, -0.0, np.nan, -np.nan, np.inf, -np.inf, 5e-324, 1 + 2**-52, np.pi, 0.1])
    payload = np.array([0x7FF8000000000123], dtype=np.int64).view(np.float64)[0]
    q = record.q.copy()
    q[:10, 0] = awkward
    q[10, 0] = payload
    odd = replace(record, q=q, friction=float("inf"), joint_range=np.array([[-np.inf, np.inf]]))
    save_record(odd, tmp_path)
    assert_equal(odd, load_record(tmp_path))


def test_interrupted_before_the_first_step_is_still_a_record(record, tmp_path):
    whole = {item.name: getattr(record, item.name) for item in fields(record)}
    empty: dict[str, Any] = {}
    for name, value in whole.items():
        if isinstance(value, np.ndarray) and name.startswith(("tick", "qp")):
            empty[name] = value[:0]
        elif isinstance(value, np.ndarray) and value.shape[:1] == (record.steps + 1,):
            empty[name] = value[:1]
        elif isinstance(value, np.ndarray) and value.shape[:1] == (record.steps,):
            empty[name] = value[:0]
    empty["sensors"] = {name: value[:1] for name, value in record.sensors.items()}
    stub = replace(record, **empty, outcome=Outcome(OutcomeName.INTERRUPTED, 0.0, "stopped by the user", 0))
    save_record(stub, tmp_path)
    assert_equal(stub, load_record(tmp_path))


def test_columns_are_named_and_the_last_torque_is_null(record, tmp_path):
    save_record(record, tmp_path)
    table = pq.read_table(tmp_path / "joints.parquet")
    wanted = "time q_root_qw q_swing qd_root_wz qd_swing torque_swing warmstart_swing"
    assert set(wanted.split()) <= set(table.column_names)
    assert table.column("torque_swing").null_count == 1
    assert table.column("torque_swing")[-1].as_py() is None
    contacts = pq.read_table(tmp_path / "contacts.parquet")
    assert "left_heel_0_force_z" in contacts.column_names
    json.loads(table.schema.metadata[b"ampm_record"], parse_constant=lambda name: pytest.fail(name))


def test_arrays_are_read_only_copies_but_of_what_nobody_can_write_to(record):
    source = record.q.copy()
    view = source[: len(source)]
    view.setflags(write=False)
    copied = replace(record, q=view)  # through its owner the view can still change
    source[0, 0] = 7.0
    assert copied.q[0, 0] != 7.0
    with pytest.raises(ValueError, match="read-only"):
        copied.q[0, 0] = 1.0
    with pytest.raises(TypeError):
        copied.sensors["new"] = source
    source.setflags(write=False)
    assert replace(record, q=view).q is view
    assert replace(copied, friction=0.5).torque is copied.torque


def test_pushed_segments_are_kept_beside_the_rest(record, tmp_path):
    rng = np.random.default_rng(0)
    parts = {f"external_{part}": rng.normal(size=(60, 2, 3)) for part in ("force", "moment", "position")}
    pushed = replace(record, external_segments=("thorax", "pelvis"), **parts)
    save_record(pushed, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {*RECORD_FILES, EXTERNAL_FILE}
    assert_equal(pushed, load_record(tmp_path))
    assert "thorax_force_x" in pq.read_table(tmp_path / EXTERNAL_FILE).column_names


def test_wrong_shapes_are_refused_by_name(record):
    with pytest.raises(InputError, match="torque has shape"):
        replace(record, torque=record.torque[:-1])
    with pytest.raises(InputError, match="sensor 'gyro'"):
        replace(record, sensors={"gyro": np.zeros((3, 3))})
    with pytest.raises(InputError, match="outcome 'tired'"):
        Outcome("tired", 0.0, "", 0)  # type: ignore[arg-type]


def test_missing_and_foreign_files_are_input_errors(record, tmp_path):
    with pytest.raises(InputError, match=r"joints\.parquet is missing"):
        load_record(tmp_path)
    save_record(record, tmp_path)
    (tmp_path / "states.parquet").write_bytes(b"no parquet")
    with pytest.raises(InputError, match="cannot be read"):
        load_record(tmp_path)
