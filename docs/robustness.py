"""Walk the disturbances of docs/footsteps.md again; rewrite its tables and data/robustness.csv.

    python docs/robustness.py [--replicas N]

Pushes are walked N times a value, all others once: half an hour on two cores with five. Walks are kept in
build/robustness, so a study that was stopped goes on.
"""

import argparse
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from trials import read_rows, write_rows

from benchmarks.page import replace_between
from validation.cli.console import Narrator
from validation.study.robustness.cells import DIRECTIONS, PUSH_PHASES, PUSHES, other_cells
from validation.study.robustness.study import REPLICAS, Robustness, robustness
from validation.table import Table

PAGE = Path(__file__).with_name("footsteps.md")
KEPT = PAGE.parents[1] / "build" / "robustness"
STABILIZERS = ("fixed", "stepping")
PUSH = ("direction", ">fixed", ">stepping")
OTHERS = ("disturbance", ">fixed", ">stepping", ">largest tried")
SHOWN = {
    "one step higher": ("higher floor under one step [cm]", 100.0),
    "one step lower": ("lower floor under one step [cm]", -100.0),
    "slope downhill": ("slope down [degrees]", -math.degrees(1.0)),
    "soft floor": ("softer floor [times]", 1.0),
    "delay of sensors": ("late sensors [ms]", 1e3),
    "delay of torques": ("late torques [ms]", 1e3),
    "bias of torques": ("bias of torques [N m]", 1.0),
}
"""Other disturbances of the page, not all of which are survived as far as tried: name, factor of the unit."""
HEIGHT = "com"
"""Where the pushes of the page act; the data file has those at the chest, too."""

Rows = Mapping[tuple[str, str], Mapping[str, str]]
"""Rows of the data file, by stabiliser and cell."""
Studies = Mapping[str, tuple[Robustness, Robustness]]
"""Pushes, and all others, by stabiliser."""


def write_tables() -> None:
    """Rewrite the tables of the page from the data file."""
    found = {(row["stabilizer"], row["cell"]): row for row in read_rows("robustness")}
    page = replace_between(PAGE.read_text(encoding="utf-8"), "pushes", _pushes(found).markdown())
    page = replace_between(page, "other disturbances", _others(found).markdown())
    PAGE.write_text(page, encoding="utf-8")


def _others(found: Rows) -> Table:
    """Largest value survived of every other disturbance that is shown, and the largest that was tried."""
    tried = {cell.name: cell.values[-1] for cell in other_cells()}
    rows = []
    for name, (title, factor) in SHOWN.items():
        survived = [float(found[stabilizer, name]["survived"] or 0.0) for stabilizer in STABILIZERS]
        rows.append((title, *(f"{factor * value:.3g}" for value in (*survived, tried[name]))))
    return Table("", OTHERS, rows)


def _pushes(found: Rows) -> Table:
    """Velocity changes survived by direction of the push: the range over its phases [m/s]."""
    rows = []
    for direction in DIRECTIONS:
        cells = [f"{HEIGHT} {phase} {direction}" for phase in PUSH_PHASES]
        fixed, stepping = (
            [float(found[name, cell]["survived"] or 0.0) for cell in cells] for name in STABILIZERS
        )
        rows.append((direction, *(_range(values) for values in (fixed, stepping))))
    return Table("", PUSH, rows)


def _range(values: Sequence[float]) -> str:
    least, most = f"{min(values):.2f}", f"{max(values):.2f}"
    return least if least == most else f"{least}–{most}"


def write(studies: Studies) -> None:
    """Rewrite page and data."""
    rows = [
        (name, item.cell.name, item.cell.unit, item.survived, item.cause)
        for name, (pushes, others) in studies.items()
        for item in (*pushes.cells, *others.cells)
    ]
    write_rows("robustness", [("stabilizer", "cell", "unit", "survived", "cause"), *rows])
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
