"""Walk the table of model predictive control in docs/controller.md again: ``python docs/predictive.py``.

It writes data/mpc.csv. Takes a quarter of an hour on an idle machine.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path
from typing import Any

from trials import DATA, write_rows

import ampm
import validation as val
from validation.show.text import replace_between
from validation.table import Table

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "controller.md"
FORCES = {"forward": (1, 0), "backward": (-1, 0), "left": (0, 1), "right": (0, -1)}
COLUMNS = ("walk", "ZMP RMSE x, y [mm]", "tightest metric", *(f"{name} [N]" for name in FORCES))
AT, DURATION, LARGEST, GRID = 2.3, 0.1, 480.0, 15.0
"""Of a push: time, duration [s], largest force tried, and distance of the forces tried [N]."""


def largest_push(run: ampm.RunParameters, planner: Any, direction: tuple[int, int]) -> float:
    """Largest force on the chest that a walk of ten steps survives, by bisection [N]."""
    survived, not_survived = 0.0, LARGEST
    while not_survived - survived > GRID:
        force = 0.5 * (survived + not_survived)
        push = val.Push("chest", (force * direction[0], force * direction[1], 0.0), at=AT, duration=DURATION)
        if val.walk(run, planner=planner, disturbances=[push]).record.outcome.completed:
            survived = force
        else:
            not_survived = force
    return survived


def row(name: str, planner: Any, stabilizer: str) -> tuple[str, ...]:
    """Agreement of thirty steps, and the largest pushes of ten."""
    run = ampm.load_run("normal").replace({"controller.stabilizer": stabilizer})
    trial = val.walk(run, planner=planner)
    errors = ", ".join(f"{1e3 * trial.metrics[f'zmp_{axis}_rmse'].value:.2f}" for axis in "xy")
    margin, label = min((item.margin, item.label) for item in trial.verdict.judged if item.margin is not None)
    short = run.replace({"gait.steps": 10, "simulation.time_step": 0.002})
    pushes = [f"{largest_push(short, planner, direction):.0f}" for direction in FORCES.values()]
    return name, errors, f"{label}: {1.0 - margin:.0%} of its limit", *pushes


def write_table() -> None:
    """Rewrite the table of the page from the data file, without the tightest metric."""
    with (DATA / "mpc.csv").open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    columns = *header[:2], *(f">{name}" for name in header[3:])
    table = Table("", columns, [(*cells[:2], *cells[3:]) for cells in rows]).markdown()
    PAGE.write_text(replace_between(PAGE.read_text(encoding="utf-8"), "mpc", table), encoding="utf-8")


def main() -> None:
    """Walk everything and rewrite data and page."""
    sys.path.insert(0, str(ROOT))
    from examples.planners.capture import Capture
    from examples.planners.mpc import Mpc

    walks = [("AMPM", "ampm", "fixed"), ("AMPM, stepping", "ampm", "stepping")]
    walks += [("MPC", Mpc(), "fixed"), ("capture steps", Capture(), "fixed")]
    write_rows("mpc", [COLUMNS, *(row(*walk) for walk in walks)])
    write_table()


if __name__ == "__main__":
    main()
