"""Walk the comparisons of docs/continuity.md again and write their figures into it.

    python docs/continuity.py
Four times ``ampm compare`` with eight walks in all: about two minutes.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from pages import between

from ampm.run_file import dump_run, load_run
from validation.cli.console import Narrator
from validation.study.compare.report import draw_file
from validation.study.compare.run import Pair, compare_pair, facts, shown

PAGE = Path(__file__).with_suffix(".md")
PICTURE = PAGE.parent / "images" / "continuity.png"
FASTER = "gait.switching_velocity=1.0808"
"""The plain pendulum slows down more over the foot: this v0 gives it the normal gait's mean speed."""
RESTING = "gait.a_s=inf"
"""On flat feet the ZMP rests in single support, so that both models differ in double support alone."""


def main() -> None:
    """Walk all pairs, and rewrite the table and the picture of the page."""
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
    page = PAGE.read_text(encoding="utf-8")
    page = between(page, "figures", _table(pairs))
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
        if rows[0].of.group != group:
            group = rows[0].of.group
            lines.append(f"| **{group}** |{' |' * (len(labels) + 1)}")
        values = " | ".join(shown(value) for row in rows for value in (row.a, row.b))
        lines.append(f"| {rows[0].of.label} | {rows[0].of.unit} | {values} |")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
