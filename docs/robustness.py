"""Walk the disturbances of docs/footsteps.md again; rewrite tables, picture and two files in data.

    python docs/robustness.py [--replicas N]

Pushes are walked N times a value, all others once: half an hour on two cores with five. Walks are kept in
build/robustness, so a study that was stopped goes on.
"""

import argparse
import csv
import math
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path

from ampm.planner.capture import DIRECTIONS, PUSH_PHASES
from ampm.run_file import describe_keys
from validation.cli.console import Narrator
from validation.show.text import replace_between
from validation.study.robustness.cells import HEIGHTS, PUSHES, REPLICAS, Cell, other_cells
from validation.study.robustness.picture import draw
from validation.study.robustness.result import Robustness
from validation.study.robustness.study import robustness
from validation.table import Table

PAGE = Path(__file__).with_name("footsteps.md")
DATA = PAGE.parent / "data" / "robustness.csv"
KEYS = DATA.with_name("disturbances.csv")
PICTURE = PAGE.parent / "images" / "robustness.png"
KEPT = PAGE.parents[1] / "build" / "robustness"
SECTION = "disturbance."
STABILIZERS = ("fixed", "stepping")
PUSH = ("push at", "direction", ">fixed", ">stepping", ">bound")
OTHER = ("key", *(f">{name}" for name in STABILIZERS))
SLOPES = ("slope_along", "slope_across")

Rows = Mapping[tuple[str, str], Mapping[str, str]]
"""Rows of the data file, by stabiliser and cell."""
Studies = Mapping[str, tuple[Robustness, Robustness]]
"""Pushes, and all others, by stabiliser."""


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


def write_tables() -> None:
    """Rewrite the tables of the page from the data file."""
    with DATA.open(encoding="utf-8", newline="") as file:
        found = {(row["stabilizer"], row["cell"]): row for row in csv.DictReader(file)}
    page = replace_between(PAGE.read_text(encoding="utf-8"), "pushes", _pushes(found).markdown())
    PAGE.write_text(replace_between(page, "others", _others(found).markdown()), encoding="utf-8")


def _pushes(found: Rows) -> Table:
    """Velocity changes survived by place and direction of the push: the range over its phases [m/s]."""
    rows = []
    for height, direction in product(HEIGHTS, DIRECTIONS):
        cells = [f"{height} {phase} {direction}" for phase in PUSH_PHASES]
        fixed, stepping = (
            [float(found[name, cell]["survived"] or 0.0) for cell in cells] for name in STABILIZERS
        )
        bound = [float(found["fixed", cell]["bound"]) for cell in cells]
        rows.append((height, direction, *(_range(values) for values in (fixed, stepping, bound))))
    return Table("", PUSH, rows)


def _range(values: Sequence[float]) -> str:
    least, most = f"{min(values):.2f}", f"{max(values):.2f}"
    return least if least == most else f"{least}–{most}"


def _others(found: Rows) -> Table:
    """Largest values survived of every other key, below and above its default; bold the largest tried."""
    rows = []
    for kind in dict.fromkeys(cell.kind for cell in other_cells()):
        cells = sorted((cell for cell in other_cells() if cell.kind == kind), key=lambda cell: cell.values[0])
        unit = "degrees" if kind in SLOPES else cells[0].unit
        shown = (
            " to ".join(_survived(cell, found[name, cell.name]) for cell in cells) for name in STABILIZERS
        )
        rows.append((f"`{kind}`" if unit == "1" else f"`{kind}` [{unit}]", *shown))
    return Table("", OTHER, rows)


def _survived(cell: Cell, row: Mapping[str, str]) -> str:
    value = float(row["survived"] or 0.0)
    text = f"{math.degrees(value) if cell.kind in SLOPES else value:.4g}"
    return f"**{text}**" if value == cell.values[-1] else text


def write(studies: Studies) -> None:
    """Rewrite page, picture and data."""
    write_keys()
    draw(studies["stepping"][0], PICTURE)
    with DATA.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        names = ("cell", "unit", "survived", "within", "bound", "zmp_x", "zmp_y", "cause")
        table.writerow(("stabilizer", *names))
        for name, (pushes, others) in studies.items():
            for item in (*pushes.pushes, *others.others):
                values = item.cell.name, item.cell.unit, item.survived, item.within, item.bound, *item.zmp
                table.writerow((name, *values, item.cause))
    write_tables()


def study(name: str, part: str, only: Sequence[str], replicas: int) -> Robustness:
    """One part of the study of a stabiliser; what was walked already is not walked again."""
    return robustness(
        "normal",
        [f"controller.stabilizer={name}"],
        only=only,
        replicas=replicas,
        out=KEPT / f"{name}-{part}",
        resume=True,
        progress=Narrator(),
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Walk what is missing, and rewrite everything."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--replicas", type=int, default=REPLICAS)
    given = parser.parse_args(arguments)
    kinds = sorted({cell.kind for cell in other_cells()})
    write(
        {
            name: (study(name, "pushes", [PUSHES], given.replicas), study(name, "others", kinds, 1))
            for name in STABILIZERS
        }
    )


if __name__ == "__main__":
    main()
