"""Comparison of records bit by bit."""

from dataclasses import fields

import numpy as np

from validation.store.record import MODEL_FILE, StoredRecord, save_record
from validation.trial.record import stored_rows

_STATES = ("q", "qd")
_CONTACTS = ("point_force", "point_position")
_TICKS = ("tick_torque", "torque_rate", "qp_status", "qp_residual", "qp_iterations", "qp_time")
_EXTERNAL = ("external_force", "external_moment", "external_position")


def first_difference(first, second) -> str | None:
    """Name of the first array in which two records differ, None if there is none.

    Wall-clock times are not compared. If one of the records is on disk, what is on disk is compared.
    """
    of = stored_arrays if StoredRecord in (type(first), type(second)) else arrays
    one, two = of(first), of(second)
    for name in dict.fromkeys([*one, *two]):
        if name != "qp_time" and (name not in one or name not in two or not same_bits(one[name], two[name])):
            return name
    return None if first.outcome == second.outcome else "outcome"


def stored(record, model, folder):
    """The record, written beside the text of its model and opened again."""
    folder.mkdir(exist_ok=True)
    (folder / MODEL_FILE).write_text(model, encoding="utf-8")
    save_record(record, folder)
    return StoredRecord(folder)


def arrays(record):
    """All arrays of a record by name."""
    found = {item.name: getattr(record, item.name) for item in fields(record)}
    return {name: value for name, value in found.items() if isinstance(value, np.ndarray)}


def stored_arrays(record):
    """All arrays of a record that are on disk, with the rows that they have there."""
    names = [*_STATES, *_CONTACTS, *_TICKS, *(_EXTERNAL if record.external_segments else ())]
    if isinstance(record, StoredRecord):
        return {name: getattr(record, name) for name in names}
    found = {name: getattr(record, name) for name in names if name != "tick_torque"}
    rows = stored_rows(record.steps, record.time_step)
    found |= {name: found[name][rows] for name in _STATES}
    found |= {name: found[name][rows[:-1]] for name in _CONTACTS}
    return found | {"tick_torque": record.torque[:: record.substeps]}


def same_bits(one, two) -> bool:
    """Whether two arrays are the same: -0 is not 0, and a NaN is itself."""
    one, two = np.ascontiguousarray(one), np.ascontiguousarray(two)
    return one.dtype == two.dtype and one.shape == two.shape and one.tobytes() == two.tobytes()
