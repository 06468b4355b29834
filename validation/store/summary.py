"""Entries of ``summary.json`` that reports, comparisons and verdicts read, and JSON files in general."""

import json
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError, create_model

from ampm.exceptions import InputError
from ampm.files import read_text

_ENTRIES = (
    "outcome steps_completed end verdict reason profile gait metrics timing statistics zmp_error_split "
    "effort margins energy solver scales environment files"
)
SUMMARY: Any = create_model("Summary", **dict.fromkeys(_ENTRIES.split(), Any))  # type: ignore[call-overload]
"""What every summary has; others are free. Its own digest answers for the values."""


def read_json(path: Path, kind: Any, way_out: str) -> tuple[Any, Any]:
    """Contents of a JSON file as they are, and as a type, which has all that is read of them.

    An :class:`InputError` names the first entry of another type and the way out.
    """
    try:
        found = json.loads(read_text(path))
        return found, TypeAdapter(kind).validate_python(found)
    except ValidationError as error:
        first = error.errors()[0]
        named = (str(part) for part in first["loc"] if part not in ("float", "str"))  # not pydantic's types
        where = ".".join(named) or "the file"
        what = first["msg"].lower().removeprefix("input ")
        raise InputError(f"{path} is damaged: {where}: {what}; {way_out}.") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} is not JSON ({error}); {way_out}.") from None
    except OSError:
        raise InputError(f"{path} is missing; {way_out}.") from None
