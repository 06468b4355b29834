"""JSON that every reader accepts, without NaN and infinity; and JSON read as a type."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from ampm.exceptions import InputError
from ampm.files import read_text
from validation.store.folders import write_whole


def json_ready(value: Any) -> Any:
    """Copy of a nested value in which every number is one that JSON has.

    NaN becomes None, an infinite number ``"inf"`` or ``"-inf"``, which ``--set`` reads back; numpy numbers
    become Python's, a dataclass its fields by name.
    """
    if isinstance(value, Mapping):
        return {str(key): json_ready(item) for key, item in value.items()}
    if isinstance(value, str):
        return str(value)  # also of an enumeration
    if value is None or isinstance(value, bool | int):
        return value
    if isinstance(value, float):
        if math.isfinite(value):
            return float(value)
        return None if math.isnan(value) else "inf" if value > 0 else "-inf"
    if is_dataclass(value) and not isinstance(value, type):
        return {item.name: json_ready(getattr(value, item.name)) for item in fields(value)}
    if hasattr(value, "tolist"):  # numpy scalar or array
        return json_ready(value.tolist())
    if isinstance(value, Sequence):
        return [json_ready(item) for item in value]
    return str(value)


def dump_json(value: Any) -> str:
    """Indented JSON of a nested value, see :func:`json_ready`."""
    return json.dumps(json_ready(value), indent=2, allow_nan=False)


def write_json(path: Path, value: Any) -> None:
    """Write a nested value as JSON, see :func:`json_ready`; whole or not at all."""
    write_whole(path, dump_json(value) + "\n")


def read_json(path: Path, kind: Any, way_out: str) -> tuple[Any, Any]:
    """Contents of a JSON file as they are, and as a type, which has all that is read of them.

    An :class:`InputError` names the first entry of another type and the way out.
    """
    from pydantic import TypeAdapter, ValidationError  # slow to load

    if not path.exists():
        raise InputError(f"{path} is missing; {way_out}.")
    try:
        found = json.loads(read_text(path))
        return found, TypeAdapter(kind).validate_python(found)
    except ValidationError as error:
        first = error.errors()[0]
        named = (str(part) for part in first["loc"] if part not in ("float", "str"))  # not pydantic's types
        where = ".".join(named) or "the file"
        what = first["msg"].lower().removeprefix("input ")
        raise InputError(f"{path} is damaged, or of another version: {where}: {what}; {way_out}.") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} is not JSON ({error}); {way_out}.") from None
