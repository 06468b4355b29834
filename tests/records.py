"""Comparison of records bit by bit."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from validation.store.record import MODEL_FILE, load_record, save_record


def first_difference(first, second) -> str | None:
    """Name of the first array in which two records differ, None if there is none.

    Wall-clock times are not compared.
    """
    one, two = arrays(first), arrays(second)
    for name in dict.fromkeys([*one, *two]):
        if name != "qp_time" and (name not in one or name not in two or not same_bits(one[name], two[name])):
            return name
    return None if first.outcome == second.outcome else "outcome"


def stored(record, model, folder):
    """The record, written beside the text of its model and read back."""
    folder.mkdir(exist_ok=True)
    (folder / MODEL_FILE).write_text(model, encoding="utf-8")
    save_record(record, folder)
    return load_record(folder)


def arrays(record):
    """All arrays of a record by name."""
    found = {item.name: getattr(record, item.name) for item in fields(record)}
    found |= {f"sensor_{name}": value for name, value in record.sensors.items()}
    return {name: value for name, value in found.items() if isinstance(value, np.ndarray)}


def same_bits(one, two) -> bool:
    """Whether two arrays are the same: -0 is not 0, and a NaN is itself."""
    one, two = np.ascontiguousarray(one), np.ascontiguousarray(two)
    return one.dtype == two.dtype and one.shape == two.shape and one.tobytes() == two.tobytes()
