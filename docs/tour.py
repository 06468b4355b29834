"""Walk the tours of docs/footsteps.md again: rewrite its table and data/tour.csv, and print the punches.

    python docs/tour.py [--seeds N] [--punched N]

N tours without punches, and N of every force. They are kept in build/tour, so that tours that were stopped go
on; a hundred of one kind take half an hour on one core.
"""

import argparse
import re
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
from trials import read_rows, write_rows

import ampm
from benchmarks.page import replace_between
from validation.table import Table, print_tables

ROOT = Path(__file__).parents[1]
PAGE = Path(__file__).with_name("footsteps.md")
KEPT = ROOT / "build" / "tour"
EXAMPLES = ROOT / "examples"
BODIES = {
    "G1": str(EXAMPLES / "tour-g1.toml"),
    "human": str(EXAMPLES / "tour-human.toml"),
    "human (normal)": "normal",
}
TARGETS = 18
FORCES = (0.0, 1.0 / 3.0, 1.0)
COLUMNS = ("body and gait", ">step [s]", ">tour [s]", ">no punches", ">a third of the force", ">full force")
"""Of the table: durations of a step and, on average, of a planned tour; completed tours by force."""
TITLES = {
    "human": "human, [quick steps](../examples/tour-human.toml)",
    "human (normal)": "human, `normal`",
    "G1": "[G1](../examples/tour-g1.toml)",
}
"""Of the bodies in the table."""
KINDS = {"foot": "foot|toe|ankle", "leg": "shank|knee|thigh|hip", "arm": "shoulder|elbow|wrist|arm|hand"}
"""Segments by a part of their name; all others are the trunk."""
Row = Mapping[str, Any]


def stabilizer(share: float) -> str:
    """The stabiliser that steps, if there are punches."""
    return "stepping" if share else "fixed"


def walk(body: str, share: float, seeds: int) -> list[Row]:
    """Tours of a body by seed, as ``examples/tour.py`` walks them."""
    from tour import walk_tours

    name = stabilizer(share)
    settings = ["simulation.time_step=0.002", f"controller.stabilizer={name}"]
    out = KEPT / f"{body}-{name}-{share:.3g}"
    return list(walk_tours(BODIES[body], settings, seeds, TARGETS, share, out=out, resume=True))


def write(found: Sequence[tuple[str, float, Sequence[Row]]]) -> None:
    """Rewrite the data file and the table, and print the punches."""
    names = ("seed", "outcome", "time", "planned", "reached", "error", "cause")
    cells = [
        (body, f"{share:.3g}", stabilizer(share), *(_cell(walk.get(name)) for name in names))
        for body, share, walks in found
        for walk in walks
    ]
    write_rows("tour", [("body", "force", "stabilizer", *names), *cells])
    write_table()
    print_endings()


def write_table() -> None:
    """Rewrite the table of the page from the data file."""
    walks, rows = read_rows("tour"), []
    for body, title in TITLES.items():
        tours = [walk for walk in walks if walk["body"] == body]
        step = ampm.plan(ampm.load_run(BODIES[body])).constants.step_duration
        planned = fmean(float(tour["planned"]) for tour in tours)
        completed = Counter(tour["force"] for tour in tours if not tour["cause"])
        counts = (str(completed[f"{share:.3g}"]) for share in FORCES)
        rows.append((title, f"{step:.2f}", f"{planned:.0f}", *counts))
    page = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(replace_between(page, "tours", Table("", COLUMNS, rows).markdown()), encoding="utf-8")


def print_endings() -> None:
    """Print how many punches of a kind were followed by another or the end of the tour, and not by a fall."""
    from tour import hinged, punches

    from models.load import build_body
    from validation.trial.plan import complete, load_request

    segments = {}
    for body, gait in BODIES.items():
        run = complete(load_request(gait)).run
        segments[body] = hinged(build_body(run).compile())
    hits, falls = Counter[tuple[str, str, str]](), Counter[tuple[str, str, str]]()
    for walk in read_rows("tour"):
        body, force, end = walk["body"], walk["force"], float(walk["time"] or 0.0)
        share = min(FORCES, key=lambda share: abs(share - float(force)))
        before = punches(int(walk["seed"]), share, segments[body], end)
        for push in before:
            kind = next((kind for kind, part in KINDS.items() if re.search(part, push.segment)), "trunk")
            size = f"{100 * int(np.linalg.norm(push.force) // 100)} N or more"
            for key in (kind, size):
                hits[body, force, key] += 1
                falls[body, force, key] += walk["outcome"] != "completed" and push is before[-1]
    rows = [
        (*key, str(hits[key]), str(falls[key]), f"{100.0 * (1.0 - falls[key] / hits[key]):.0f}")
        for key in sorted(hits)
    ]
    print_tables([Table("punches", ("body", ">force", "punch", ">number", ">ends", ">survived [%]"), rows)])


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
    sys.path.insert(0, str(ROOT / "examples"))
    write(
        [
            (body, share, walk(body, share, given.punched if share else given.seeds))
            for share in FORCES
            for body in BODIES
        ]
    )


if __name__ == "__main__":
    sys.exit(main())
