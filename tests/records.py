"""Comparison of records bit by bit."""

from dataclasses import fields

import numpy as np

from validation.store.record import load_record, record_tables, save_record
from validation.trial.files import RunFile
from validation.trial.record import INTEGERS, SHAPES, SimulationRecord, shape_of


def first_difference(first, second) -> str | None:
    """Name of the first array in which two records differ, but for times; on disk, if one is there."""
    of = columns_on_disk if first.com is None or second.com is None else arrays
    one, two = of(first), of(second)
    for name in dict.fromkeys([*one, *two]):
        if not name.endswith("qp_time") and not same_bits(one.get(name), two.get(name)):
            return name
    return None if first.outcome == second.outcome else "outcome"


def stored(record, model, folder):
    """The record, written beside the text of its model and opened again."""
    folder.mkdir(exist_ok=True)
    (folder / RunFile.MODEL).write_text(model, encoding="utf-8")
    save_record(record, folder)
    return load_record(folder)


def blank(steps, **known):
    """A record of some steps of the physics, a tick each; zero is what is not known."""
    rates = {"K+1": steps + 1, "R": steps + 1, "K": steps, "R-1": steps, "T": steps}
    joints, points = len(known["joint_names"]), len(known["point_foot"])
    sizes = {"nq": 7 + joints, "nv": 6 + joints, "nu": joints, "P": points, "F": 2, "S": 0, "L": 1}
    zeros = {name: np.zeros(shape_of(name, rates | sizes), INTEGERS.get(name)) for name in SHAPES}
    time = known["time_step"] * np.arange(steps + 1)
    zeros |= {"time": time, "tick_time": time[:-1], "state_rows": np.arange(steps + 1)}
    zeros["foot_forward"][..., 0] = 1.0
    return SimulationRecord(**zeros | known)


def arrays(record):
    """All arrays of a record by name."""
    found = {item.name: getattr(record, item.name) for item in fields(record)}
    return {name: value for name, value in found.items() if isinstance(value, np.ndarray)}


def columns_on_disk(record):
    """All columns of a record that are on disk, by the names of file and column."""
    tables = record_tables(record).items()
    return {f"{file} {name}": column for file, table in tables for name, column in table.items()}


def same_bits(one, two) -> bool:
    """Whether two arrays are the same: -0 is not 0, and a NaN is itself."""
    one, two = np.ascontiguousarray(one), np.ascontiguousarray(two)
    return one.dtype == two.dtype and one.shape == two.shape and one.tobytes() == two.tobytes()
