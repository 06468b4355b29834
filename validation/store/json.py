"""JSON that every reader accepts: no NaN, no infinity."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any


def json_ready(value: Any, *, infinity: str | None = "inf") -> Any:
    """Copy of a nested value in which every number is one that JSON has.

    NaN becomes None, numpy numbers become Python's, a dataclass becomes its fields by name.

    Args:
        value: mappings, sequences, dataclasses, arrays, numbers and texts.
        infinity: what stands for an infinite number, with ``-`` before it for a negative one. ``"inf"`` is
            what ``--set`` reads back; None gives None.
    """
    if isinstance(value, Mapping):
        return {str(key): json_ready(item, infinity=infinity) for key, item in value.items()}
    if isinstance(value, str):
        return str(value)  # also of an enumeration
    if value is None or isinstance(value, bool | int):
        return value
    if isinstance(value, float):
        if math.isfinite(value):
            return float(value)
        return None if math.isnan(value) or infinity is None else infinity if value > 0 else f"-{infinity}"
    if is_dataclass(value) and not isinstance(value, type):
        entries = {item.name: getattr(value, item.name) for item in fields(value)}
        return json_ready(entries, infinity=infinity)
    if hasattr(value, "tolist"):  # numpy scalar or array
        return json_ready(value.tolist(), infinity=infinity)
    if isinstance(value, Sequence):
        return [json_ready(item, infinity=infinity) for item in value]
    return str(value)


def dump_json(value: Any) -> str:
    """Indented JSON of a nested value; infinite numbers become ``"inf"``, undefined ones null."""
    return json.dumps(json_ready(value), indent=2, allow_nan=False)


def write_json(path: Path, value: Any) -> None:
    """Write a nested value as JSON, as :func:`dump_json` does, and a line break."""
    path.write_text(dump_json(value) + "\n", encoding="utf-8")
