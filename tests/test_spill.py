"""Large arrays in temporary files hold the same numbers: a walk and its measurement keep every bit."""

from dataclasses import fields

import numpy as np

from tests.records import first_difference, same_bits
from tests.solved import body_of, simulated
from validation.measure.measure import measure
from validation.trial import spill
from validation.trial.bridge import pinocchio_model, to_pinocchio


def test_walk_and_measurement_have_the_same_bits_in_files(monkeypatch):
    model = pinocchio_model(body_of().compile())

    def results():
        record = simulated(steps=1)
        return record, measure(record, model, to_pinocchio)

    record, measured = results()
    monkeypatch.setattr(spill, "LEAST", 1)
    monkeypatch.setattr(spill, "ROWS", 100)
    monkeypatch.setattr(spill.blocks, "__defaults__", (100,))
    again, measured_again = results()
    assert isinstance(again.q.base.base, spill.mmap.mmap), "not copied either"
    assert first_difference(record, again) is None
    for item in fields(measured):
        one, two = getattr(measured, item.name), getattr(measured_again, item.name)
        assert same_bits(one, two) if isinstance(one, np.ndarray) else one == two, item.name


def test_few_rows_and_a_full_disk_stay_in_memory(monkeypatch):
    assert spill.zeros((spill.LEAST - 1, 2)).base is None

    def full(*_):
        raise OSError("no space left on device")

    monkeypatch.setattr(spill.os, "posix_fallocate", full)
    assert spill.zeros((spill.LEAST, 2)).base is None
