"""Walk the study of docs/robustness.md again; rewrite its tables, its picture and two files in data.

    python docs/robustness.py [--replicas N]
Five minutes on two cores with one replica. Levels are kept in build/robustness, so a study that was stopped
goes on.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Sequence
from pathlib import Path

from ampm.run_file import describe_keys
from validation.cli.console import Narrator
from validation.show.text import markdown_table, replace_between
from validation.study.robustness.picture import draw
from validation.study.robustness.result import Robustness
from validation.study.robustness.run import robustness
from validation.study.robustness.text import OTHER_HEADER, PUSH_HEADER, other_rows, push_rows

PAGE = Path(__file__).with_suffix(".md")
DATA = PAGE.parent / "data" / "robustness.csv"
KEYS = DATA.with_name("disturbances.csv")
PICTURE = PAGE.parent / "images" / "robustness.png"
KEPT = PAGE.parents[1] / "build" / "robustness"
SECTION = "disturbance."


def keys_table() -> list[tuple[str, ...]]:
    """Header, and every key of the section: unit, default, bounds, meaning."""
    return [
        ("key", "unit", "default", "bounds", "meaning"),
        *(
            (info.key, info.unit, str(info.default), info.range, info.meaning)
            for info in describe_keys()
            if info.key.startswith(SECTION)
        ),
    ]


def write_keys() -> None:
    """Rewrite data/disturbances.csv."""
    with KEYS.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(keys_table())


def with_tables(page: str, pushes: Robustness, others: Robustness) -> str:
    """The page with the tables of studies; segments are in the file only."""
    page = replace_between(page, "pushes", markdown_table(PUSH_HEADER, push_rows(pushes)))
    listed = zip(other_rows(others), others.others, strict=True)
    rows = [row[:-1] for row, item in listed if not item.cell.fixed]
    return replace_between(page, "others", markdown_table(OTHER_HEADER[:-1], rows))


def write(pushes: Robustness, others: Robustness) -> None:
    """Rewrite page, picture and data."""
    write_keys()
    PAGE.write_text(with_tables(PAGE.read_text(encoding="utf-8"), pushes, others), encoding="utf-8")
    draw(pushes, PICTURE)
    with DATA.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(("cell", "unit", "survived", "within", "bound", "zmp_x", "zmp_y", "cause"))
        for item in (*pushes.pushes, *others.others):
            table.writerow(
                (
                    item.cell.name,
                    item.cell.unit,
                    item.survived,
                    item.within,
                    item.bound,
                    *item.zmp,
                    item.cause,
                )
            )


def main(arguments: Sequence[str] | None = None) -> None:
    """Walk what is missing, and rewrite everything."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--replicas", type=int, default=5)
    given = parser.parse_args(arguments)
    found = robustness("normal", replicas=given.replicas, out=KEPT, resume=True, progress=Narrator())
    write(found, found)


if __name__ == "__main__":
    sys.exit(main())
