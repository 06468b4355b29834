"""Walk the tours of docs/footsteps.md again: rewrite data/tour.csv, and print a table of it.

    python docs/tour.py [--seeds N] [--punched N]

N tours without punches, and N of every force. They are kept in build/tour, so that tours that were stopped go
on; a hundred of one kind take half an hour on one core.
"""

import argparse
import csv
import sys
from collections.abc import Sequence
from pathlib import Path
from statistics import fmean

from trials import DATA, write_rows

from validation.cli.console import Narrator
from validation.study.tour import Tours, tour
from validation.table import ABSENT, Table, print_tables

KEPT = Path(__file__).parents[1] / "build" / "tour"
BODIES = {"G1": (None, ["body.source='g1'", "gait.switching_velocity=0.5"]), "human": ("normal", [])}
FORCES = (0.0, 1.0 / 3.0, 1.0)
COLUMNS = ("body", ">force [%]", ">completed [%]", ">survived [%]", ">off target [mm]")
"""Of the table; means over all tours."""


def stabilizer(share: float) -> str:
    """The stabiliser that steps, if there are punches."""
    return "stepping" if share else "fixed"


def walk(body: str, share: float, seeds: int) -> Tours:
    """Tours of a body."""
    gait, settings = BODIES[body]
    name = stabilizer(share)
    settings = [*settings, "simulation.time_step=0.002", f"controller.stabilizer={name}"]
    out = KEPT / f"{body}-{name}-{share:.3g}"
    return tour(gait, settings, seeds=seeds, share=share, out=out, resume=True, progress=Narrator())


def write(found: Sequence[tuple[str, Tours]]) -> None:
    """Rewrite the data file, and print its table."""
    names = ("seed", "outcome", "time", "planned", "reached", "error", "cause")
    cells = [
        (body, f"{tours.share:.3g}", stabilizer(tours.share), *(_cell(walk.get(name)) for name in names))
        for body, tours in found
        for walk in tours.walks
    ]
    write_rows("tour", [("body", "force", "stabilizer", *names), *cells])
    print_table()


def print_table() -> None:
    """Print the means over the tours of every kind, from the data file."""
    with DATA.joinpath("tour.csv").open(encoding="utf-8", newline="") as file:
        walks = list(csv.DictReader(file))
    rows = []
    for body, force in dict.fromkeys((walk["body"], walk["force"]) for walk in walks):
        tours = [walk for walk in walks if (walk["body"], walk["force"]) == (body, force)]
        completed = [float(not tour["cause"]) for tour in tours]
        lasted = [float(tour["time"]) / float(tour["planned"]) if tour["time"] else 0.0 for tour in tours]
        off = [float(tour["error"]) for tour in tours if tour["error"]]
        shares = (f"{100.0 * share:.0f}" for share in (float(force), fmean(completed), fmean(lasted)))
        rows.append((body, *shares, f"{1e3 * fmean(off):.2g}" if off else ABSENT))
    print_tables([Table("tours", COLUMNS, rows)])


def _cell(value: object) -> str:
    if value is None:  # of a tour that was refused, or reached no target
        return ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def main(arguments: Sequence[str] | None = None) -> None:
    """Walk what is missing, and rewrite everything."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--punched", type=int, default=100)
    given = parser.parse_args(arguments)
    write(
        [
            (body, walk(body, share, given.punched if share else given.seeds))
            for share in FORCES
            for body in BODIES
        ]
    )


if __name__ == "__main__":
    sys.exit(main())
