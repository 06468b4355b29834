"""A record is lossless on disk, immutable in memory, and two records that differ say where."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from ampm.exceptions import InputError
from tests.records import first_difference, same_bits, stored
from tests.solved import body_of, simulated
from validation.store.record import RECORD_FILES, StoredRecord, load_record, save_record
from validation.trial.outcome import Outcome, OutcomeName
from validation.trial.record import restart_steps

FINE = "simulation.time_step=0.0005"
"""Several steps of the physics per tick."""


@pytest.fixture(scope="module")
def record():
    return simulated(FINE, steps=1)


@pytest.fixture(scope="module")
def model():
    return body_of(FINE).xml


def assert_equal(one, two):
    """All fields have the same bits; those of ``tests.records`` and what they leave out."""
    assert first_difference(one, two) is None
    for name in ("qp_time", "torque_limit", "joint_range", "point_foot", "point_group"):
        assert same_bits(getattr(one, name), getattr(two, name)), name
    assert list(one.sensors) == list(two.sensors)
    for name in ("metadata", "joint_names", "external_segments", "mass", "gravity", "time_step", "friction"):
        assert repr(getattr(one, name)) == repr(getattr(two, name)), name


def test_round_trip_is_bit_exact_though_few_states_are_kept(record, model, tmp_path):
    assert record.substeps == 4
    again = stored(record, model, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {*RECORD_FILES, "model.xml"}
    assert_equal(record, again)
    assert pq.read_metadata(tmp_path / "joints.parquet").num_rows == -(-record.steps // 20) + 1
    assert pq.read_metadata(tmp_path / "ticks.parquet").num_rows == record.tick_time.size


def test_any_step_is_found_again_from_the_state_before(record, model, tmp_path):
    stored(record, model, tmp_path)
    kept = StoredRecord(tmp_path)
    np.testing.assert_array_equal(kept.q, record.q[kept.state_rows])
    rows = np.array([0, 3, 20, 41, 42, 299, record.steps - 1])
    force, position = kept.contacts_at(rows)
    np.testing.assert_array_equal(force, record.point_force[rows])
    np.testing.assert_array_equal(position, record.point_position[rows])
    np.testing.assert_array_equal(kept.torque, record.torque)
    q = kept.q.copy()
    q[2:, 0] += 1.0  # another processor would come to another state: the recorded one counts
    vars(kept)["q"] = q
    moved = kept.contacts_at(np.array([39, 40, 45]))[1] - record.point_position[[39, 40, 45]]
    np.testing.assert_allclose(moved[:, :, 0], [[0.0] * 12, [1.0] * 12, [1.0] * 12], rtol=0.0, atol=1e-9)


def test_torques_of_any_hold_are_kept(record, model, tmp_path):
    """Rates that are not the torques' differences, and torques that are held."""
    rate = record.torque_rate.copy()
    rate[5], rate[6], rate[7, :4] = 1.5, np.nan, -0.0
    stored(replace(record, torque_rate=rate), model, tmp_path)
    assert same_bits(StoredRecord(tmp_path).torque_rate, rate)
    table = pq.read_table(tmp_path / "ticks.parquet")
    assert table.column(f"torque_rate_{record.joint_names[0]}").null_count > 0.9 * len(rate)


def test_awkward_floats_are_kept(record, model, tmp_path):
    awkward = np.array([0.0, -0.0, np.nan, -np.nan, np.inf, -np.inf, 5e-324, 1 + 2**-52, np.pi, 0.1])
    q, every = record.q.copy(), restart_steps(record.time_step)
    q[: 10 * every : every, 0] = awkward
    q[10 * every, 0] = np.array([0x7FF8000000000123], dtype=np.int64).view(np.float64)[0]
    limits = np.tile([-np.inf, np.inf], (len(record.joint_names), 1))
    save_record(replace(record, q=q, friction=float("inf"), joint_range=limits), tmp_path)
    kept = StoredRecord(tmp_path)
    assert same_bits(kept.q, q[kept.state_rows])
    assert kept.friction == float("inf")
    assert same_bits(kept.joint_range, limits)


def test_interrupted_before_the_first_step_is_still_a_record(record, model, tmp_path):
    whole = {item.name: getattr(record, item.name) for item in fields(record)}
    empty: dict[str, Any] = {}
    for name, value in whole.items():
        if isinstance(value, np.ndarray) and name.startswith(("tick", "qp", "torque_rate", "warmstart")):
            empty[name] = value[:0]
        elif isinstance(value, np.ndarray) and value.shape[:1] == (record.steps + 1,):
            empty[name] = value[:1]
        elif isinstance(value, np.ndarray) and value.shape[:1] == (record.steps,):
            empty[name] = value[:0]
    empty["sensors"] = {name: value[:1] for name, value in record.sensors.items()}
    stub = replace(record, **empty, outcome=Outcome(OutcomeName.INTERRUPTED, 0.0, "stopped by the user", 0))
    again = stored(stub, model, tmp_path)
    assert again.steps == 0
    assert again.outcome == stub.outcome
    np.testing.assert_array_equal(again.q, stub.q)


def test_columns_are_named_and_the_last_warm_start_is_null(record, tmp_path):
    save_record(record, tmp_path)
    table = pq.read_table(tmp_path / "joints.parquet")
    joint = record.joint_names[0]
    assert {"time", "q_root_qw", f"q_{joint}", "qd_root_wz", f"warmstart_{joint}"} <= set(table.column_names)
    assert table.column(f"warmstart_{joint}").null_count == 1
    assert table.column(f"warmstart_{joint}")[-1].as_py() is None
    ticks = pq.read_table(tmp_path / "ticks.parquet")
    assert {"time", f"torque_{joint}", "command_force_z", "qp_iterations"} <= set(ticks.column_names)
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


def test_wrong_shapes_are_refused_by_name(record):
    with pytest.raises(InputError, match="torque has shape"):
        replace(record, torque=record.torque[:-1])
    with pytest.raises(InputError, match="sensor 'gyro'"):
        replace(record, sensors={"gyro": np.zeros((3, 3))})
    with pytest.raises(InputError, match="outcome 'tired'"):
        Outcome("tired", 0.0, "", 0)  # type: ignore[arg-type]


def test_missing_and_foreign_files_are_input_errors(record, model, tmp_path):
    with pytest.raises(InputError, match=r"joints\.parquet is missing"):
        load_record(tmp_path)
    save_record(record, tmp_path)
    (tmp_path / "ticks.parquet").write_bytes(b"no parquet")
    (tmp_path / "model.xml").write_text(model, encoding="utf-8")
    with pytest.raises(InputError, match="cannot be read"):
        load_record(tmp_path)
