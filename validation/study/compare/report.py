"""Files of a comparison, of walks or of two sweeps."""

import os
from pathlib import Path

from pydantic import BaseModel

from validation.judge.uncertainty import Uncertainty
from validation.run.trial import draw_run
from validation.show.chart import Picture
from validation.show.page import render_page
from validation.show.paper import Citation, cite_run
from validation.store.folders import output_file
from validation.store.json import write_json
from validation.store.saved import RECORDING_FILE, REPORT_FILE, load_saved_run
from validation.store.summary import read_json
from validation.study.compare.comparison import Side, WalkComparison, comparison_of
from validation.study.compare.figures import draw_walks
from validation.study.compare.sweeps import SweepComparison
from validation.study.robustness.result import Robustness

REPORT, NUMBERS = REPORT_FILE, "comparison.json"


class _Walk(BaseModel):
    """What is read of a walk."""

    label: str
    run: str
    study: Uncertainty | None
    robustness: Robustness | None


class _File(BaseModel):
    """What is read of the numbers."""

    walks: list[_Walk]


def is_comparison(folder: Path) -> bool:
    """Whether a folder is one of a comparison."""
    return (folder / NUMBERS).is_file()


def load_comparison(folder: Path) -> WalkComparison:
    """Read a comparison of walks from its folder, and the runs that it names.

    Raises:
        InputError: it is damaged, of sweeps, or one of its runs is gone.
    """
    found = read_json(folder / NUMBERS, _File, "run 'ampm compare' again; that of sweeps has no pictures")
    walks = _File.model_validate(found).walks
    sides = (
        Side(item.label, load_saved_run(folder / item.run), item.study, item.robustness) for item in walks
    )
    return comparison_of(list(sides))


def write_comparison(result: WalkComparison | SweepComparison, folder: Path) -> None:
    """Write numbers and page into a folder, and report and recording of every walk that lacks them."""
    folder.mkdir(parents=True, exist_ok=True)
    numbers = result.as_dict()
    if isinstance(result, WalkComparison):
        for side, entry in zip(result.sides, numbers["walks"], strict=True):
            entry["run"] = os.path.relpath(side.run.directory, folder)
            if not all((side.run.directory / name).is_file() for name in (REPORT_FILE, RECORDING_FILE)):
                draw_run(side.run.directory, side.label)
    write_json(folder / NUMBERS, numbers)
    with output_file(folder / REPORT) as work:
        work.write_text(render(result, folder), encoding="utf-8")


def render(result: WalkComparison | SweepComparison, folder: Path) -> str:
    """The page for a folder; of walks with their curves, and links to their reports and recordings."""
    keys: list[tuple[str, str]] = []
    pictures: list[Picture] = []
    links: list[str] = []
    citations: list[Citation] = []
    if isinstance(result, WalkComparison):
        keys, pictures = draw_walks(result.sides)
        citations = [cite_run(side.run) for side in result.sides]
        links = [os.path.relpath(side.run.directory, folder) for side in result.sides]
    return render_page(
        "comparison.html.j2",
        result.title,
        styles=["report.css"],
        sentence=result.sentence,
        tables=result.tables(),
        keys=keys,
        links=links,
        pictures=pictures,
        citations=citations,
    )
