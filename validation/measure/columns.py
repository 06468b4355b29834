"""Columns of a log under the names of :mod:`validation.measure.log`, in SI units."""

import re
from collections.abc import Mapping
from itertools import chain
from typing import Any

import numpy as np

from ampm.exceptions import InputError
from ampm.section import unknown
from validation.measure.log import COLUMNS

UNITS: Mapping[str, Mapping[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "speed": {"m/s": 1.0},
    "momentum": {"N m s": 1.0},
    "torque": {"N m": 1.0, "N mm": 1e-3},
    "force": {"N": 1.0, "kN": 1e3, "kgf": 9.80665},
    "quaternion": {},
    "": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
}
"""Factor to SI by unit, of columns with a word in their name."""
NAMES = ("time", *chain(*COLUMNS.values()))
"""All columns that a log may have."""
_SOURCE = re.compile(r"(?P<sign>-?)(?P<column>.*?)\s*(?:\[(?P<unit>[^\[\]]*)\])?")


def map_columns(table: Mapping[str, Any], mapping: Mapping[str, str]) -> dict[str, Any]:
    """Add columns to a table under other names, in SI units.

    The mapping has ``COLUMN``, ``COLUMN[UNIT]`` or ``-COLUMN[UNIT]``, with a unit of :data:`UNITS`, by the
    name in the log. The table may hold the column with its unit in brackets, too. Raises :class:`InputError`
    for an unknown name or unit, or a column that the table lacks.
    """
    found = dict(table)
    for name, text in mapping.items():
        if name not in NAMES:
            raise unknown(name, NAMES, "column of a log", value=name)
        match = _SOURCE.fullmatch(text)
        parts = match.groupdict() if match else {}
        column, unit = parts.get("column"), parts.get("unit")
        column = next((key for key in (text, text.removeprefix("-"), column) if key in table), None)
        if column is None:
            raise InputError(f"no column {text!r} for {name}; there are {', '.join(map(str, table))}.")
        units = next(units for word, units in UNITS.items() if word in name)
        if unit is not None and unit not in units:
            raise unknown(unit, units, f"unit of {name}", value=unit)
        sign = -1.0 if parts.get("sign") and column != text else 1.0
        try:
            found[name] = sign * units.get(str(unit), 1.0) * np.asarray(table[column], dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise InputError(f"the column {column!r} must be numbers ({error}).") from None
    return found
