"""The sentence and the table of an explanation, made from its ``explain.json``."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ampm.exceptions import InputError
from validation.table import Table


def explanation_table(found: Mapping[str, Any]) -> Table:
    """Every change, with the verdict and the failed metrics before and after."""
    before = found["trial"]
    rows = [("", "the trial", _verdict(before), _metrics(before, before))]
    for row in found["changes"]:
        rows.append((" and ".join(row["layers"]), row["text"], _verdict(row), _metrics(before, row)))
    columns = (
        "layer",
        "change",
        "verdict",
        "metrics that failed before or fail then, with their share of the limit",
    )
    return Table(f"{found['title']}: layers changed one at a time", columns, rows)


def read_explanation(path: Path) -> tuple[str, Table] | None:
    """Sentence and table of a file; None if there is none.

    Raises:
        InputError: the file is damaged.
    """
    if not path.is_file():
        return None
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        return str(found["said"]), explanation_table(found)
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError):
        raise InputError(f"{path} is damaged; remove it, or run ampm explain again.") from None


def _verdict(row: Mapping[str, Any]) -> str:
    completed = row["outcome"] == "completed"
    return "pass" if row.get("passed") else "FAIL" if completed else str(row["outcome"]).replace("_", " ")


def _metrics(before: Mapping[str, Any], row: Mapping[str, Any]) -> str:
    """What failed before or fails then; of a walk that did not complete the cause."""
    if row["outcome"] != "completed":
        return str(row["cause"]).partition(";")[0]
    failed = [
        f"{item['label']} {item['text']} ({item['used']:.0%})"
        for name, item in row["metrics"].items()
        if max(item["used"] or 0.0, before["metrics"].get(name, item)["used"] or 0.0) > 1.0
    ]
    return "; ".join(failed)
