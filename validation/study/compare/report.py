"""Files of a comparison, of walks or of two sweeps."""

from pathlib import Path

from validation.show.chart import Picture
from validation.show.page import render_page
from validation.store.folders import output_file
from validation.store.json import write_json
from validation.study.compare.comparison import WalkComparison
from validation.study.compare.figures import draw_walks
from validation.study.compare.sweeps import SweepComparison

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
