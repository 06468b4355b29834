"""Numbers as text."""

import math
from typing import Any

from validation.table import ABSENT, format_number


def format_value(value: Any) -> str:
    """A parameter's value for a table: five digits of a float, anything else unchanged."""
    return format_number(value, 5) if value is None or isinstance(value, float) else str(value)


def format_duration(seconds: float) -> str:
    """A time as text: ``250 µs``, ``12 s``, ``45 min``, ``3 h 20 min``, ``11.6 days``; a dash for NaN."""
    if math.isnan(seconds):
        return ABSENT
    for unit, size, most in (("µs", 1e-6, 1000), ("ms", 1e-3, 1000), ("s", 1.0, 90)):
        if seconds < most * size:
            return f"{seconds / size:.3g} {unit}"
    hours, minutes = divmod(round(seconds / 60), 60)
    if seconds < 5400:
        return f"{60 * hours + minutes} min"
    if hours < 48:
        return f"{hours} h {minutes} min" if minutes else f"{hours} h"
    return f"{seconds / 86400:.1f} days"
