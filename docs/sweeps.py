"""Write the columns of a sweep's table into docs/data/sweep-columns.csv: ``python docs/sweeps.py``."""

from __future__ import annotations

import csv
from pathlib import Path

from validation.study.sweep.schema import columns

FILE = Path(__file__).parent / "data" / "sweep-columns.csv"


def rows() -> list[tuple[str, str, str, str]]:
    """Header, then name, kind, unit and meaning of every column."""
    return [
        ("column", "kind", "unit", "meaning"),
        *((item.name, item.kind, item.unit, item.words) for item in columns()),
    ]


if __name__ == "__main__":
    with FILE.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(rows())
