"""Draw the figures of docs/paper.md again: ``python docs/images/paper.py``.

Takes two or three minutes; ``python docs/images/paper.py 12,human`` draws only these. Every number of the
pages that a preset could change stands in a table between marks. It is written here from
``docs/images/paper/figures.json``, which the figures write; ``--tables`` writes only the tables again.
"""

from __future__ import annotations

import json
import shutil
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from validation.cli.console import Narrator
from validation.paper.figures import make_figures
from validation.paper.figures.foot_roll import GRIDS
from validation.paper.figures.human import AXIS, HUMAN_MOMENTUM, SPEEDS, inward
from validation.paper.figures.make import NUMBERS
from validation.show.text import replace_between

HERE = Path(__file__).resolve().parent
PAGE = HERE.parent / "paper.md"
FOLDER = HERE / "paper"


def swings(said: Mapping[str, Mapping[str, float]]) -> str:
    """Momentum and swing of the trunk against c_y."""
    lines = ["| `gait.c_y` | L_x peak, plan [N m s] | trunk roll, peak to peak, IK [°] |", "|---|---|---|"]
    for value, item in said.items():
        lines.append(f"| {value} | {item['planned_L_x_peak_Nms']:.2f} | {item['trunk_roll_swing_deg']:.1f} |")
    return "\n".join(lines)


def foot_roll_table(numbers: Mapping[str, Any]) -> str:
    """The figure's numbers as a Markdown table.

    Args:
        numbers: as :func:`validation.paper.figures.foot_roll.figure_7` gives them.
    """
    lines = ["| | " + " | ".join(f"`{form}`" for form in numbers) + " |", "|---|" + "---|" * len(numbers)]

    def row(label: str, values: Sequence[str]) -> None:
        lines.append(f"| {label} | " + " | ".join(values) + " |")

    for key, label, unit in (
        ("velocity", "joint velocity", "rad/s"),
        ("acceleration", "joint acceleration", "rad/s²"),
        ("difference", "joint velocity per time", "rad/s²"),
    ):
        row(
            f"IK, largest change of {label} at a switch, grid "
            + ", ".join(f"{1e3 * grid:g}" for grid in GRIDS)
            + f" ms [{unit}]",
            [", ".join(_digits(item[key]) for item in said["jumps"].values()) for said in numbers.values()],
        )

    def walked(label: str, *names: str, digits: int = 2) -> None:
        row(label, [", ".join(f"{said['walk'][n]:.{digits}f}" for n in names) for said in numbers.values()])

    walked("simulation, ZMP RMSE x, y [mm]", "zmp_x_rmse", "zmp_y_rmse")
    walked("simulation, ZMP maximum x, y [mm]", "zmp_x_maximum", "zmp_y_maximum", digits=1)
    walked("simulation, force RMSE x, y, z [% of weight]", "force_x_rmse", "force_y_rmse", "force_z_rmse")
    walked("simulation, largest torque [% of the motor's limit]", "torque_share_percent", digits=0)
    walked("simulation, largest torque rate [kN m/s]", "torque_rate_peak_kNm_per_s")
    return "\n".join(lines)


def _digits(value: float) -> str:
    """Three digits, and no powers of ten."""
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}"


def human_table(numbers: Mapping[str, Any]) -> str:
    """The demos' momentum as a Markdown table.

    Args:
        numbers: as :func:`validation.paper.figures.human.figure_human` gives them.
    """
    lines = ["| gait | L_x / (m V H) | L_y / (m V H) | L_z / (m V H) |", "|---|---|---|---|"]
    bounds = " | ".join(f"≤ {HUMAN_MOMENTUM[axis]:g}" for axis in "xyz")
    lines.append(f"| people | {bounds} |")
    for gait, found in numbers["peaks"].items():
        cells = [f"{found[a]:.3f}" + (" (within)" if found[a] <= HUMAN_MOMENTUM[a] else "") for a in "xyz"]
        lines.append(f"| `{gait}` | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def ranges_table(numbers: Mapping[str, Any]) -> str:
    """The ranges of c_y and c_s within the human bounds, by plan and by simulation, as a Markdown table."""
    lines = [
        "| parameter | bound on people | within, by the plan alone | within, walked |",
        "|---|---|---|---|",
    ]
    for key, axis in AXIS.items():
        found = numbers["ranges"][key]
        bound = f"L_{axis} / (m V H) ≤ {HUMAN_MOMENTUM[axis]:g}"
        planned, walked = inward(found), inward(found["measured"])
        lines.append(f"| `gait.{key}` | {bound} | {planned} | {walked} |")
    offset = numbers["angular_momentum_y_offset"]
    lines += [
        "",
        f"(The constant of L_y of `normal` is {offset['Nms']:.2f} N m s, {offset['of_m_V_H']:.3f} of m V H.)",
    ]
    return "\n".join(lines)


def forces_table(numbers: Mapping[str, Any]) -> str:
    """One foot's ground force as a Markdown table."""
    who = {**{f"people_{end}": f"people, {speed:g} m/s" for end, speed in SPEEDS.items()},
           "simulated": "simulation, `normal`"}  # fmt: skip
    lines = [
        f"| force on one foot [body weight] | {' | '.join(who.values())} |",
        "|---|" + "---|" * len(who),
    ]
    forces = numbers["forces"]
    vertical = forces["vertical"]
    for name, label in (("first", "first peak"), ("valley", "least in mid-stance"), ("second", "last peak")):
        cells = [f"{vertical[f'{key}_{name}']:.2f}" for key in who]
        lines.append(f"| vertical, {label} | {' | '.join(cells)} |")
    for name in ("forward", "medial"):
        cells = [
            f"{forces[name][f'{key}_smallest']:.2f} to {forces[name][f'{key}_largest']:.2f}" for key in who
        ]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines)


TABLES: Mapping[str, tuple[tuple[str, Callable[[Any], str]], ...]] = {
    "figure-11": (("figure-11-swing", lambda said: swings(said["c_y"])),),
    "figure-07": (("foot roll", foot_roll_table),),
    "human": (("momentum", human_table), ("ranges", ranges_table), ("forces", forces_table)),
}
"""By figure: mark on the page, and what writes the table from the figure's numbers."""


def page(numbers: Mapping[str, Any]) -> str:
    """The page with every table that the numbers can give."""
    text = PAGE.read_text(encoding="utf-8")
    for figure, tables in TABLES.items():
        for name, written in tables if figure in numbers else ():
            text = replace_between(text, name, f"\n{written(numbers[figure])}\n")
    return text


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
    PAGE.write_text(page(_rounded(numbers)), encoding="utf-8")


def _rounded(value: Any) -> Any:
    """Six digits: what the tables need, and no noise of the last bits from one machine to the next."""
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    return float(f"{value:.6g}") if isinstance(value, float) else value


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else None)
