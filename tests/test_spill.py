"""Large arrays in temporary files hold the same numbers: a walk and its measurement keep every bit."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from tests.records import first_difference, same_bits, stored
from tests.solved import body_of, simulated
from validation.judge.margins import energy
from validation.measure.measure import measure
from validation.trial import spill
from validation.trial.bridge import pinocchio_model, to_pinocchio


@pytest.fixture
def spills(monkeypatch):
    """Every array is in a file, and few rows are worked on at a time."""
    monkeypatch.setattr(spill, "LEAST", 1)
    monkeypatch.setattr(spill.blocks, "__defaults__", (100,))
    monkeypatch.setattr(spill, "ROWS", 100)


def test_numbers_outlive_their_memory(spills):
    array = spill.zeros((1000, 3))
    assert isinstance(array.base, spill.mmap.mmap)
    array[:] = np.arange(3000.0).reshape(1000, 3)
    spill.release()
    assert same_bits(array, np.arange(3000.0).reshape(1000, 3))


def test_few_rows_and_a_full_disk_stay_in_memory(monkeypatch):
    assert spill.zeros((spill.LEAST - 1, 2)).base is None

    def full(*_):
        raise OSError("no space left on device")

    monkeypatch.setattr(spill.os, "posix_fallocate", full)
    assert spill.zeros((spill.LEAST, 2)).base is None


def test_record_and_measurement_have_the_same_bits(request, tmp_path):
    body = body_of()
    model = pinocchio_model(body.compile())

    def results():
        record = simulated(steps=1)
        return record, measure(record, model, to_pinocchio), energy(record, np.arange(record.steps) > 40)

    record, measured, work = results()
    request.getfixturevalue("spills")
    again, measured_again, work_again = results()
    assert isinstance(again.q.base.base, spill.mmap.mmap), "not copied either"
    assert first_difference(record, again) is None
    assert first_difference(again, stored(again, body.xml, tmp_path)) is None
    for item in fields(measured):
        one, two = getattr(measured, item.name), getattr(measured_again, item.name)
        assert same_bits(one, two) if isinstance(one, np.ndarray) else one == two, item.name
    assert work == work_again
