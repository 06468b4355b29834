"""Walk the floors of docs/footsteps.md; rewrite its table and data/floors.csv.

    python docs/floors.py

Rows that the file has are kept, so that a study that was stopped goes on: remove the file to walk all again.
Ten minutes on an idle core.
"""

import sys
from pathlib import Path
from typing import Any

from trials import agreement, ending, read_rows, write_rows

import ampm
import validation as val
from benchmarks.page import replace_between
from validation.table import Table

PAGE = Path(__file__).with_name("footsteps.md")
STEPS = 30
STEEP, UNKNOWN = 0.0524, 0.0349  # 3 and 2 degrees
KNOWN = {
    "3 degrees up": {"slope": STEEP},
    "3 degrees down": {"slope": -STEEP},
    "3 degrees, left up": {"cross_slope": STEEP},
    "3 degrees, left down": {"cross_slope": -STEEP},
    "2 degrees up, 2 left up": {"slope": UNKNOWN, "cross_slope": UNKNOWN},
}
UNEVEN: dict[str, tuple[dict[str, float], dict[str, float]]] = {
    "2 degrees up": ({}, {"slope_along": UNKNOWN}),
    "2 degrees down": ({}, {"slope_along": -UNKNOWN}),
    "2 degrees, left up": ({}, {"slope_across": UNKNOWN}),
    "2 degrees, left down": ({}, {"slope_across": -UNKNOWN}),
    "1 degree up on 2 known": ({"slope": UNKNOWN}, {"slope_along": 0.5 * UNKNOWN}),
    "1 degree, left up on 2 known": ({"cross_slope": UNKNOWN}, {"slope_across": 0.5 * UNKNOWN}),
    "stone of 1 cm": ({}, {"step_height": 0.01}),
    "hole of 1 cm": ({}, {"step_height": -0.01}),
    "3 times as soft": ({}, {"softness_factor": 3.0}),
}
SHOWN = {
    "2 degrees up": "2 degrees up",
    "2 degrees down": "2 degrees down",
    "2 degrees, left down": "2 degrees down to the left",
    "1 degree up on 2 known": "3 degrees up, of which 2 are known",
    "stone of 1 cm": "stone of 1 cm",
    "3 times as soft": "3 times as soft",
}
"""Unknown floors of the page, with their names there; the file has all."""
COLUMNS = ("gait", "floor", "stabilizer", "ZMP RMSE x, y [mm]", "F RMSE x, y, z [% weight]", "verdict")

Row = tuple[str, ...]


def main() -> None:
    """Walk what the file lacks, and rewrite the page's table."""
    cases: dict[Row, dict[str, Any]] = {
        (gait, floor, "fixed"): {"gait": slopes}
        for gait in ("normal", "momentum")
        for floor, slopes in KNOWN.items()
    }
    for floor, (slopes, unknown) in UNEVEN.items():
        for stabilizer in ("fixed", "stepping"):
            cases["normal", f"unknown: {floor}", stabilizer] = {
                "gait": slopes,
                "disturbance": unknown,
                "controller": {"stabilizer": stabilizer},
            }
    rows: dict[Row, Row] = {row[:3]: row for row in (tuple(row.values()) for row in read_rows("floors"))}
    for case, sections in cases.items():
        if case not in rows:
            run = ampm.load_run(case[0], **sections | {"gait": {"steps": STEPS, **sections["gait"]}})
            trial = val.walk(run).judged("default")
            completed = trial.record.outcome.completed
            zmp, _, force, *_ = agreement(trial.summary["metrics"]) if completed else ("", "", "")
            rows[case] = (*case, zmp, force, ending(trial.summary))
            print(*rows[case], sep=" | ", file=sys.stderr, flush=True)  # noqa: T201
            write_rows("floors", [COLUMNS, *rows.values()])
    body = [
        (title, *(rows["normal", f"unknown: {floor}", way][3] for way in ("fixed", "stepping")))
        for floor, title in SHOWN.items()
    ]
    table = Table("", ("unknown floor", "`fixed`: x, y [mm]", "`stepping`: x, y [mm]"), body)
    page = replace_between(PAGE.read_text(encoding="utf-8"), "unknown floors", table.markdown())
    PAGE.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
