"""A walk far from the world's origin: references moved there, and its record moved back to be compared."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from ampm.walk import Reference
    from validation.trial.record import SimulationRecord

_PLACES = (
    "q", "com", "foot_position", "point_position", "command_com", "command_zmp", "external_position",
)  # fmt: skip
"""Arrays of a record whose last axis begins with x."""


def moved_references(references: Iterator[Reference], along: float) -> Iterator[Reference]:
    """References of which all places are moved along x [m]."""
    for reference in references:
        centre, values, q = reference.centre.copy(), reference.feet.values.copy(), reference.posture.q.copy()
        centre[0, 0] += along
        values[:, 0] += along
        q[0] += along
        feet, posture = reference.feet._replace(values=values), reference.posture._replace(q=q)
        yield reference._replace(centre=centre, feet=feet, posture=posture)


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
