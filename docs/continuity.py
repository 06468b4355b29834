"""Walk the comparisons of docs/continuity.md again and write their figures into it.

    python docs/continuity.py
Three times ``ampm compare`` with six walks in all: about two minutes.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from ampm.parameters import dump_run, load_run
from validation.console import Narrator
from validation.pair_report import draw_file
from validation.pairs import Pair, compare_pair, facts, shown

PAGE = Path(__file__).with_suffix(".md")
PICTURE = PAGE.parent / "images" / "continuity.png"
FASTER = "gait.switching_velocity=1.0808"
"""The plain pendulum slows down more over the foot: this v0 gives it the normal gait's mean speed."""
RESTING = "gait.a_s=inf"
"""On flat feet the ZMP rests in single support, so that both models differ in double support alone."""


def main() -> None:
    """Walk all pairs, and rewrite the table and the picture of the page."""
    with tempfile.TemporaryDirectory() as folder:

        def gait(name: str, preset: str, *settings: str) -> str:
            path = Path(folder) / f"{name}.toml"
            path.write_text(dump_run(load_run(preset, settings)), encoding="utf-8")
            return str(path)

        pairs = [
            _pair("normal", "ipm"),
            _pair("normal", gait("ipm-faster", "ipm", FASTER)),
            _pair(gait("flat-ampm", "flat", RESTING), gait("flat-ipm", "flat", RESTING, "gait.model=ipm")),
        ]
    draw_file(pairs[0], PICTURE)
    page = PAGE.read_text(encoding="utf-8")
    page = _between(page, "figures", _table(pairs))
    PAGE.write_text(page, encoding="utf-8")


def _pair(a: str, b: str) -> Pair:
    return compare_pair(a, b, stages=Narrator())


def _table(pairs: list[Pair]) -> str:
    """All figures of all pairs, group by group."""
    labels = [label for pair in pairs for label in (pair.a.label, pair.b.label)]
    lines = [f"| | unit | {' | '.join(labels)} |", f"|---|---|{'---:|' * len(labels)}"]
    for told in zip(*(facts(pair) for pair in pairs), strict=True):
        lines.append(f"| {told[0][0]} | | {' | '.join(text for _, *both in told for text in both)} |")
    group = ""
    for rows in zip(*(pair.rows for pair in pairs), strict=True):
        if rows[0].group != group:
            group = rows[0].group
            lines.append(f"| **{group}** |{' |' * (len(labels) + 1)}")
        values = " | ".join(shown(value) for row in rows for value in (row.a, row.b))
        lines.append(f"| {rows[0].label} | {rows[0].unit if rows[0].unit != '1' else ''} | {values} |")
    return "\n".join(lines)


def _between(page: str, name: str, table: str) -> str:
    """The page with another table between its marks."""
    start, end = f"<!-- {name} -->\n", f"\n<!-- end of {name} -->"
    before, _, rest = page.partition(start)
    _, _, after = rest.partition(end)
    return f"{before}{start}{table}{end}{after}"


if __name__ == "__main__":
    sys.exit(main())
