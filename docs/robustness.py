"""Walk the disturbances of docs/footsteps.md again; rewrite tables, picture and two files in data.

    python docs/robustness.py [--replicas N]

Pushes are walked N times a value, all others once: half an hour on two cores with five. Walks are kept in
build/robustness, so a study that was stopped goes on.
"""

import argparse
import csv
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from ampm.run_file import describe_keys
from validation.cli.console import Narrator
from validation.show.text import replace_between
from validation.study.robustness.cells import PUSHES, REPLICAS, other_cells
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
OTHER = ("disturbance", "unit", "fixed", "fixed, in tolerance", "stepping", "stepping, in tolerance")

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


def with_tables(page: str, studies: Studies) -> str:
    """The page with the tables of both stabilisers."""
    fixed, stepping = (studies[name][0].pushes_table() for name in STABILIZERS)
    pushes = [
        (*one[:2], *(f"{a.partition(' of ')[0]}, {b}" for a, b in zip(one[2:], other[2:], strict=True)))
        for one, other in zip(fixed.rows, stepping.rows, strict=True)
    ]
    page = replace_between(page, "pushes", replace(fixed, rows=pushes, notes=()).markdown())
    others = [
        (*one.cells()[:4], *other.cells()[2:4])
        for one, other in zip(*(studies[name][1].others for name in STABILIZERS), strict=True)
    ]
    return replace_between(page, "others", Table("", OTHER, others).markdown())


def write(studies: Studies) -> None:
    """Rewrite page, picture and data."""
    write_keys()
    PAGE.write_text(with_tables(PAGE.read_text(encoding="utf-8"), studies), encoding="utf-8")
    draw(studies["stepping"][0], PICTURE)
    with DATA.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        names = ("cell", "unit", "survived", "within", "bound", "zmp_x", "zmp_y", "cause")
        table.writerow(("stabilizer", *names))
        for name, (pushes, others) in studies.items():
            for item in (*pushes.pushes, *others.others):
                values = item.cell.name, item.cell.unit, item.survived, item.within, item.bound, *item.zmp
                table.writerow((name, *values, item.cause))


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
