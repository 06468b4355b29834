"""Draw the figures of docs/figures.md, foot-roll.md and human.md again: ``python docs/images/paper.py``.

Takes two or three minutes; ``python docs/images/paper.py 12,human`` draws only these. Every number of the
pages that a preset could change stands in a table between marks. It is written here from
``docs/images/paper/figures.json``, which the figures write; ``--tables`` writes only the tables again.
"""

from __future__ import annotations

import json
import shutil
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from validation.cli.console import Narrator
from validation.paper.figures import make_figures
from validation.paper.figures.foot_roll import table as foot_roll_table
from validation.paper.figures.human import forces_table, ranges_table
from validation.paper.figures.human import table as human_table
from validation.paper.figures.make import NUMBERS

HERE = Path(__file__).resolve().parent
DOCS = HERE.parent
FOLDER = HERE / "paper"


def agreement(said: Mapping[str, Mapping[str, Any]]) -> str:
    """RMSE and largest distance, by what is compared."""
    lines = ["| | RMSE | largest | |", "|---|---|---|---|"]
    for name, item in said.items():
        unit, factor = ("mm", 1e3) if item["unit"] == "m" else (item["unit"], 1.0)
        rmse, largest = (_shown(factor * item[key]) for key in ("rmse", "maximum"))
        lines.append(f"| {name} | {rmse} | {largest} | {unit} |")
    return "\n".join(lines)


def trunks(said: Mapping[str, Mapping[str, float]]) -> str:
    """What trunk and momentum of each gait do, and how far plan, IK and simulation are apart."""
    axis = "x" if any(name.startswith("roll") for name in said) else "y"
    what = "roll" if axis == "x" else "pitch"
    lines = [f"| | {' | '.join(f'`{gait}`' for gait in said)} |", "|---|" + "---|" * len(said)]

    def row(label: str, written: Callable[[Mapping[str, float]], str]) -> None:
        lines.append(f"| {label} | " + " | ".join(written(item) for item in said.values()) + " |")

    row("trunk roll, largest, simulation [°]", lambda item: f"{item['trunk_roll_largest_deg']:.0f}")
    row(
        "trunk pitch, simulation [°]",
        lambda item: f"{item['trunk_pitch_smallest_deg']:.0f} to {item['trunk_pitch_largest_deg']:.0f}",
    )
    row(
        f"trunk {what}, simulation less IK, largest [°]",
        lambda item: f"{item[f'trunk_{what}_simulation_less_ik_deg']:.2f}",
    )
    for k in "xy":
        row(
            f"L_{k} peak, plan, simulation [N m s]",
            lambda item, k=k: (
                f"{item[f'planned_L_{k}_peak_Nms']:.2f}, {item[f'measured_L_{k}_peak_Nms']:.2f}"
            ),
        )
    row(
        f"L_{axis} less plan, largest, IK, simulation [N m s]",
        lambda item: (
            f"{_shown(item[f'L_{axis}_ik_less_plan_Nms'])}, {item[f'L_{axis}_simulation_less_plan_Nms']:.2f}"
        ),
    )
    return "\n".join(lines)


def swings(said: Mapping[str, Mapping[str, float]]) -> str:
    """Momentum and swing of the trunk against c_y."""
    lines = ["| `gait.c_y` | L_x peak, plan [N m s] | trunk roll, peak to peak, IK [°] |", "|---|---|---|"]
    for value, item in said.items():
        lines.append(f"| {value} | {item['planned_L_x_peak_Nms']:.2f} | {item['trunk_roll_swing_deg']:.1f} |")
    return "\n".join(lines)


TABLES: Mapping[str, tuple[tuple[str, str, Callable[[Any], str]], ...]] = {
    **{f"figure-{k}": (("figures.md", f"figure-{k}", agreement),) for k in ("04", "05", "08", "09", "10")},
    "figure-11": (
        ("figures.md", "figure-11", lambda said: trunks(said["gaits"])),
        ("figures.md", "figure-11-swing", lambda said: swings(said["c_y"])),
    ),
    "figure-12": (("figures.md", "figure-12", trunks),),
    "figure-07": (("foot-roll.md", "foot roll", foot_roll_table),),
    "human": (
        ("human.md", "momentum", human_table),
        ("human.md", "ranges", ranges_table),
        ("human.md", "forces", forces_table),
    ),
}
"""By figure: page, mark on it, and what writes the table from the figure's numbers."""


def pages(numbers: Mapping[str, Any]) -> dict[str, str]:
    """The pages with every table that the numbers can give."""
    texts: dict[str, str] = {}
    for figure, tables in TABLES.items():
        for page, name, written in tables if figure in numbers else ():
            text = texts.get(page) or (DOCS / page).read_text(encoding="utf-8")
            texts[page] = _put(text, page, name, written(numbers[figure]))
    return texts


def main(only: str | None) -> None:
    """Draw, keep the vector graphics and the numbers, and rewrite the tables."""
    FOLDER.mkdir(exist_ok=True)
    kept = FOLDER / NUMBERS
    numbers = json.loads(kept.read_text(encoding="utf-8")) if kept.exists() else {}
    if only != "--tables":
        with tempfile.TemporaryDirectory() as folder:
            for path in make_figures(Path(folder), only, stages=Narrator()):
                if path.suffix == ".svg":
                    shutil.copy(path, FOLDER / path.name)
                elif path.name == NUMBERS:
                    numbers |= json.loads(path.read_text(encoding="utf-8"))
        kept.write_text(json.dumps(_rounded(numbers), indent=1) + "\n", encoding="utf-8")
    for page, text in pages(_rounded(numbers)).items():
        (DOCS / page).write_text(text, encoding="utf-8")


def _rounded(value: Any) -> Any:
    """Six digits: what the tables need, and no noise of the last bits from one machine to the next."""
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    return float(f"{value:.6g}") if isinstance(value, float) else value


def _shown(value: float) -> str:
    """Two digits, or that there is nothing to see."""
    return "< 0.0001" if value < 1e-4 else f"{value:.2g}"


def _put(text: str, page: str, name: str, table: str) -> str:
    """A page with a table between its marks."""
    start, end = f"<!-- {name} -->\n", f"<!-- end of {name} -->"
    before, _, rest = text.partition(start)
    _, found, after = rest.partition(end)
    if not found:
        raise SystemExit(f"docs/{page} has no place for {name!r}")
    return f"{before}{start}\n{table}\n\n{end}{after}"


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else None)
