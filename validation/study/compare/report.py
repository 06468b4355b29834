"""Files of a comparison, of walks or of two sweeps."""

import os
from pathlib import Path

from validation.show.chart import Picture
from validation.show.page import render_page
from validation.show.report import write_report
from validation.store.folders import output_file
from validation.store.json import write_json
from validation.store.saved import REPORT_FILE
from validation.study.compare.comparison import WalkComparison
from validation.study.compare.figures import draw_walks
from validation.study.compare.sweeps import SweepComparison

REPORT, NUMBERS = REPORT_FILE, "comparison.json"


def write_comparison(result: WalkComparison | SweepComparison, folder: Path) -> None:
    """Write numbers and page into a folder, and the reports of walks that are kept in it."""
    folder.mkdir(parents=True, exist_ok=True)
    for side in result.sides if isinstance(result, WalkComparison) else ():
        if folder.resolve() in side.run.directory.resolve().parents:
            write_report(side.run)
    write_json(folder / NUMBERS, result.as_dict())
    with output_file(folder / REPORT) as work:
        work.write_text(render(result, folder), encoding="utf-8")


def render(result: WalkComparison | SweepComparison, folder: Path) -> str:
    """The page for a folder; of walks with their curves, and links to their reports."""
    keys: list[tuple[str, str]] = []
    pictures: list[Picture] = []
    links: list[str] = []
    if isinstance(result, WalkComparison):
        keys, pictures = draw_walks(result.sides)
        reports = [side.run.directory / REPORT_FILE for side in result.sides]
        links = [os.path.relpath(path, folder) if path.is_file() else "" for path in reports]
    return render_page(
        "comparison.html.j2",
        result.title,
        styles=["report.css"],
        sentence=result.sentence,
        tables=result.tables(),
        keys=keys,
        links=links,
        pictures=pictures,
    )
