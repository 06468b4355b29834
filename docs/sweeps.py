"""Write the columns of a sweep's table into docs/data/sweep-columns.csv: ``python docs/sweeps.py``."""

from __future__ import annotations

import csv
from pathlib import Path

from validation.study.sweep.schema import schema

FILE = Path(__file__).parent / "data" / "sweep-columns.csv"
KINDS = {"double": "real", "int64": "whole", "string": "text"}


def rows() -> list[tuple[str, str, str, str]]:
    """Header, then name, kind, unit and meaning of every column."""
    found = [("column", "kind", "unit", "meaning")]
    for field in schema():
        unit, meaning = (field.metadata[key].decode() for key in (b"unit", b"meaning"))
        found.append((field.name, KINDS[str(field.type)], unit, meaning))
    return found


if __name__ == "__main__":
    with FILE.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(rows())
