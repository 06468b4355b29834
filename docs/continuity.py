"""Walk the comparisons of docs/paper.md on continuity again; rewrite its picture and data/continuity.csv.

    python docs/continuity.py
Four times ``ampm compare`` with eight walks in all: about two minutes.
"""

from __future__ import annotations

import csv
import sys
import tempfile
from pathlib import Path

from ampm.run_file import dump_run, load_run
from validation.cli.console import Narrator
from validation.study.compare.pair import Pair, compare_pair
from validation.study.compare.report import draw_file, facts, shown

HERE = Path(__file__).parent
PICTURE = HERE / "images" / "continuity.png"
DATA = HERE / "data" / "continuity.csv"
FASTER = "gait.switching_velocity=1.0808"
"""The plain pendulum slows down more over the foot: this v0 gives it the normal gait's mean speed."""
RESTING = "gait.a_s=inf"
"""On flat feet the ZMP rests in single support, so that both models differ in double support alone."""


def main() -> None:
    """Walk all pairs, and rewrite the values and the picture of the page."""
    with tempfile.TemporaryDirectory() as folder:

        def gait(name: str, preset: str, *settings: str, like: str) -> str:
            """A preset with the controller of another one."""
            path, run = Path(folder) / f"{name}.toml", load_run(preset, settings)
            run = run.model_copy(update={"controller": load_run(like).controller})
            path.write_text(dump_run(run), encoding="utf-8")
            return str(path)

        pairs = [
            _pair("normal", gait("ipm-gentle", "ipm", like="normal")),
            _pair(gait("normal-quick", "normal", like="ipm"), "ipm"),
            _pair("normal", gait("ipm-faster", "ipm", FASTER, like="ipm")),
            _pair(
                gait("flat-quick", "flat", RESTING, like="ipm"),
                gait("flat-ipm", "flat", RESTING, "gait.model=ipm", like="ipm"),
            ),
        ]
    draw_file(pairs[1], PICTURE)
    header, rows = _rows(pairs)
    with DATA.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows([header, *rows])


def _pair(a: str, b: str) -> Pair:
    return compare_pair(a, b, stages=Narrator())


def _rows(pairs: list[Pair]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Header, and all facts and quantities of all pairs: group, name, unit, values."""
    sides = [side for pair in pairs for side in (pair.a, pair.b)]
    rows = [
        ("gait", same[0][0], "", *(text for _, *both in same for text in both))
        for same in zip(*(facts(pair) for pair in pairs), strict=True)
    ]
    for same in zip(*(pair.rows for pair in pairs), strict=True):
        quantity = same[0].of
        values = (shown(value) for row in same for value in (row.a, row.b))
        rows.append((quantity.group, quantity.label, quantity.unit, *values))
    return ("group", "quantity", "unit", *(side.label for side in sides)), rows


if __name__ == "__main__":
    sys.exit(main())
