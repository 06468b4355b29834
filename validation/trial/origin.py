"""A walk far from the world's origin: a table moved there, and its record moved back to be compared."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ampm.walk import ReferenceTable

if TYPE_CHECKING:
    from validation.trial.record import SimulationRecord

_PLACES = (
    "q",
    "com",
    "foot_position",
    "point_position",
    "point_place",
    "command_com",
    "command_zmp",
    "external_position",
)
"""Arrays of a record whose last axis begins with x."""


def moved_table(table: ReferenceTable, along: float) -> ReferenceTable:
    """References of which all places are moved along x [m]."""
    row = table.row.copy()
    row["com"][:, 0] += along
    row["foot_position"][:, :, 0] += along
    row["q"][:, 0] += along
    return ReferenceTable(row)


def moved_record(record: SimulationRecord, along: float) -> SimulationRecord:
    """The record with all places moved along x [m]; the same if it is not moved."""
    if not along:
        return record
    places: dict[str, Any] = {}
    for name in _PLACES:
        array = np.array(getattr(record, name))
        array[..., 0] += along
        places[name] = array
    return replace(record, **places)
