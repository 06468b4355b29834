"""Files of a comparison, of walks or of two sweeps."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from validation.show.page import render_page
from validation.store.folders import check_target, output_file
from validation.store.json import write_json
from validation.study.compare.comparison import WalkComparison
from validation.study.compare.sweeps import SweepComparison
from validation.study.row_file import ROWS

if TYPE_CHECKING:
    from validation.show.style import Picture

REPORT, NUMBERS = "report.html", "comparison.json"
Result = WalkComparison | SweepComparison


def check_folder(folder: Path, *, resume: bool) -> None:
    """Refuse a folder that must not be written.

    Raises:
        InputError: it is not empty, and not one of a comparison to go on with.
    """
    marks, way_out = (ROWS, NUMBERS), "--resume to go on with its comparison"
    check_target(folder, None, force=resume, what="comparison", marks=marks, way_out=way_out)


def write_comparison(result: Result, folder: Path) -> None:
    """Write numbers and page into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / NUMBERS, result.as_dict())
    with output_file(folder / REPORT) as work:
        work.write_text(render(result), encoding="utf-8")


def render(result: Result) -> str:
    """A self-contained page."""
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
