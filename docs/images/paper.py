"""Draw the figures of docs/figures.md, foot-roll.md and human.md again: ``python docs/images/paper.py``.

Takes two or three minutes; also writes the tables of these pages from the figures' own numbers.
"""

from __future__ import annotations

import json
import shutil
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from validation.console import Narrator
from validation.paper_figures import make_figures
from validation.paper_figures.foot_roll import table as foot_roll_table
from validation.paper_figures.human import forces_table, ranges_table
from validation.paper_figures.human import table as human_table
from validation.paper_figures.make import NUMBERS

HERE = Path(__file__).resolve().parent
DOCS = HERE.parent
FOLDER = HERE / "paper"


def main(only: str | None) -> None:
    """Draw, keep the vector graphics, and rewrite the tables."""
    with tempfile.TemporaryDirectory() as folder:
        drawn = make_figures(Path(folder), only, stages=Narrator())
        FOLDER.mkdir(exist_ok=True)
        for path in drawn:
            if path.suffix == ".svg":
                shutil.copy(path, FOLDER / path.name)
        path = Path(folder) / NUMBERS
        numbers = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    if "figure-07" in numbers:
        _write("foot-roll.md", "foot roll", foot_roll_table(numbers["figure-07"]))
    if "human" in numbers:
        _write("human.md", "momentum", human_table(numbers["human"]))
        _write("human.md", "ranges", ranges_table(numbers["human"]))
        _write("human.md", "forces", forces_table(numbers["human"]))
    for name in ("figure-09", "figure-10"):
        if name in numbers:
            _write("figures.md", name, _agreement(numbers[name]))
    for name in ("figure-11", "figure-12"):
        if name in numbers:
            _write("figures.md", name, _trunk(numbers[name]))


def _agreement(said: Mapping[str, Mapping[str, Any]]) -> str:
    lines = ["| | RMSE | largest | |", "|---|---|---|---|"]
    for name, item in said.items():
        lines.append(f"| {name} | {item['rmse']:.2g} | {item['maximum']:.2g} | {item['unit']} |")
    return "\n".join(lines)


def _trunk(said: Mapping[str, Mapping[str, float]]) -> str:
    lines = [
        "| gait | trunk roll, largest [°] | trunk pitch [°] | L_x peak, planned and simulated [N m s] | "
        "L_y peak, planned and simulated [N m s] |",
        "|---|---|---|---|---|",
    ]
    for gait, item in said.items():
        peaks = [
            f"{item[f'planned_L_{axis}_peak_Nms']:.2f}, {item[f'measured_L_{axis}_peak_Nms']:.2f}"
            for axis in "xy"
        ]
        pitch = f"{item['trunk_pitch_smallest_deg']:.0f} to {item['trunk_pitch_largest_deg']:.0f}"
        lines.append(f"| `{gait}` | {item['trunk_roll_largest_deg']:.0f} | {pitch} | {' | '.join(peaks)} |")
    return "\n".join(lines)


def _write(page: str, name: str, text: str) -> None:
    """Put a text between its marks on a page."""
    path = DOCS / page
    start, end = f"<!-- {name} -->\n", f"<!-- end of {name} -->"
    before, _, rest = path.read_text(encoding="utf-8").partition(start)
    _, found, after = rest.partition(end)
    if not found:
        raise SystemExit(f"{path} has no place for {name!r}")
    path.write_text(f"{before}{start}\n{text}\n\n{end}{after}", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else None)
