"""Draw the figures of docs/paper.md again: ``python docs/images/paper.py``.

Takes two or three minutes; ``python docs/images/paper.py 12,human`` draws only these. All numbers of the
pages that depend on presets are in tables between marks. It is written here from
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
from validation.paper.figures.foot_roll import GRIDS
from validation.paper.figures.human import AXIS, HUMAN_MOMENTUM, SPEEDS, inward
from validation.paper.figures.make import NUMBERS
from validation.show.text import markdown_table, replace_between

HERE = Path(__file__).resolve().parent
PAGE = HERE.parent / "paper.md"
FOLDER = HERE / "paper"


def swings(said: Mapping[str, Mapping[str, float]]) -> str:
    """Momentum and swing of the trunk against c_y."""
    return markdown_table(
        ("`gait.c_y`", "L_x peak, plan [N m s]", "trunk roll, peak to peak, IK [°]"),
        [
            (value, f"{item['planned_L_x_peak_Nms']:.2f}", f"{item['trunk_roll_swing_deg']:.1f}")
            for value, item in said.items()
        ],
    )


def foot_roll_table(numbers: Mapping[str, Any]) -> str:
    """The figure's numbers as a Markdown table.

    Args:
        numbers: as :func:`validation.paper.figures.foot_roll.figure_7` gives them.
    """
    grids = ", ".join(f"{1e3 * grid:g}" for grid in GRIDS)
    rows = [
        (
            f"IK, largest change of {label} at a switch, grid {grids} ms [{unit}]",
            *(", ".join(_digits(item[key]) for item in said["jumps"].values()) for said in numbers.values()),
        )
        for key, label, unit in (
            ("velocity", "joint velocity", "rad/s"),
            ("acceleration", "joint acceleration", "rad/s²"),
            ("difference", "joint velocity per time", "rad/s²"),
        )
    ]
    rows += [
        (
            f"simulation, {label}",
            *(", ".join(f"{said['walk'][n]:.{digits}f}" for n in names) for said in numbers.values()),
        )
        for label, digits, names in (
            ("ZMP RMSE x, y [mm]", 2, ("zmp_x_rmse", "zmp_y_rmse")),
            ("ZMP maximum x, y [mm]", 1, ("zmp_x_maximum", "zmp_y_maximum")),
            ("force RMSE x, y, z [% of weight]", 2, [f"force_{axis}_rmse" for axis in "xyz"]),
            ("largest torque [% of the motor's limit]", 0, ["torque_share_percent"]),
            ("largest torque rate [kN m/s]", 2, ["torque_rate_peak_kNm_per_s"]),
        )
    ]
    return markdown_table(("", *(f"`{form}`" for form in numbers)), rows)


def _digits(value: float) -> str:
    """Three digits, and no powers of ten."""
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}"


def human_table(numbers: Mapping[str, Any]) -> str:
    """The demos' momentum as a Markdown table.

    Args:
        numbers: as :func:`validation.paper.figures.human.figure_human` gives them.
    """
    rows = [("people", *(f"≤ {HUMAN_MOMENTUM[axis]:g}" for axis in "xyz"))]
    for gait, found in numbers["peaks"].items():
        within = {axis: " (within)" if found[axis] <= HUMAN_MOMENTUM[axis] else "" for axis in "xyz"}
        rows.append((f"`{gait}`", *(f"{found[axis]:.3f}{within[axis]}" for axis in "xyz")))
    return markdown_table(("gait", *(f"L_{axis} / (m V H)" for axis in "xyz")), rows)


def ranges_table(numbers: Mapping[str, Any]) -> str:
    """The ranges of c_y and c_s within the human bounds, by plan and by simulation, as a Markdown table."""
    rows = []
    for key, axis in AXIS.items():
        found = numbers["ranges"][key]
        bound = f"L_{axis} / (m V H) ≤ {HUMAN_MOMENTUM[axis]:g}"
        rows.append((f"`gait.{key}`", bound, inward(found), inward(found["measured"])))
    table = markdown_table(
        ("parameter", "bound on people", "within, by the plan alone", "within, walked"), rows
    )
    offset = numbers["angular_momentum_y_offset"]
    said = f"{offset['Nms']:.2f} N m s, {offset['of_m_V_H']:.3f} of m V H"
    return f"{table}\n\n(The constant of L_y of `normal` is {said}.)"


def forces_table(numbers: Mapping[str, Any]) -> str:
    """One foot's ground force as a Markdown table."""
    who = {**{f"people_{end}": f"people, {speed:g} m/s" for end, speed in SPEEDS.items()},
           "simulated": "simulation, `normal`"}  # fmt: skip
    forces = numbers["forces"]
    rows = [
        (f"vertical, {label}", *(f"{forces['vertical'][f'{key}_{name}']:.2f}" for key in who))
        for name, label in (
            ("first", "first peak"),
            ("valley", "least in mid-stance"),
            ("second", "last peak"),
        )
    ]
    rows += [
        (
            name,
            *(
                f"{forces[name][f'{key}_smallest']:.2f} to {forces[name][f'{key}_largest']:.2f}"
                for key in who
            ),
        )
        for name in ("forward", "medial")
    ]
    return markdown_table(("force on one foot [body weight]", *who.values()), rows)


TABLES: Mapping[str, tuple[tuple[str, Callable[[Any], str]], ...]] = {
    "figure-11": (("figure-11-swing", lambda said: swings(said["c_y"])),),
    "figure-07": (("foot roll", foot_roll_table),),
    "human": (("momentum", human_table), ("ranges", ranges_table), ("forces", forces_table)),
}
"""By figure: mark on the page, and function that writes the table from the figure's numbers."""


def page(numbers: Mapping[str, Any]) -> str:
    """The page with all tables of these numbers."""
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
    """Six digits: enough for the tables, and the same on all machines."""
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    return float(f"{value:.6g}") if isinstance(value, float) else value


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else None)
