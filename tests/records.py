"""Comparison of records bit by bit."""

from __future__ import annotations

import numpy as np

from validation.store.record import record_columns


def first_difference(first, second) -> str | None:
    """Name of the first column in which two records differ, None if there is none.

    Wall-clock times are not compared.
    """
    one, two = columns(first), columns(second)
    for name in dict.fromkeys([*one, *two]):
        if name != "qp_time" and (name not in one or name not in two or not same_bits(one[name], two[name])):
            return name
    return None if first.outcome == second.outcome else "outcome"


def columns(record):
    """All columns of a record by name."""
    return {name: column for file in record_columns(record).values() for name, column in file.items()}


def same_bits(one, two) -> bool:
    """Whether two arrays are the same: -0 is not 0, and a NaN is itself."""
    one, two = np.ascontiguousarray(one), np.ascontiguousarray(two)
    return one.dtype == two.dtype and one.shape == two.shape and one.tobytes() == two.tobytes()
