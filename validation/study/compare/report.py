"""Files of a comparison, of walks or of two sweeps."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from validation.show.page import render_page
from validation.store.folders import output_file
from validation.store.json import write_json
from validation.study.compare.comparison import WalkComparison
from validation.study.compare.sweeps import SweepComparison

if TYPE_CHECKING:
    from validation.show.style import Picture

REPORT, NUMBERS = "report.html", "comparison.json"


def write_comparison(result: WalkComparison | SweepComparison, folder: Path) -> None:
    """Write numbers and page into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / NUMBERS, result.as_dict())
    with output_file(folder / REPORT) as work:
        work.write_text(render(result), encoding="utf-8")


def render(result: WalkComparison | SweepComparison) -> str:
    """A self-contained page; of walks with their curves."""
    keys: list[tuple[str, str]] = []
    pictures: list[Picture] = []
    if isinstance(result, WalkComparison):
        from validation.study.compare.figures import draw_walks  # matplotlib takes long to load

        keys, pictures = draw_walks(result.sides)
    return render_page(
        "comparison.html.j2",
        result.title,
        styles=["report.css"],
        sentence=result.sentence,
        tables=result.tables(),
        keys=keys,
        pictures=pictures,
    )
