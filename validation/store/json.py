"""JSON that every reader accepts: no NaN, no infinity."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any


def json_ready(value: Any) -> Any:
    """Copy of a nested value in which every number is one that JSON has.

    ``inf`` becomes ``"inf"`` (which ``--set`` reads back), NaN becomes None, numpy numbers become Python's.
    """
    if isinstance(value, Mapping):
        return {str(key): json_ready(item) for key, item in value.items()}
    if isinstance(value, str) or value is None or isinstance(value, bool | int):
        return value
    if isinstance(value, float):
        if math.isnan(value):
            return None
        return float(value) if math.isfinite(value) else ("inf" if value > 0 else "-inf")
    if hasattr(value, "tolist"):  # numpy scalar or array
        return json_ready(value.tolist())
    if isinstance(value, Sequence):
        return [json_ready(item) for item in value]
    return str(value)
