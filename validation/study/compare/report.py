"""Files of a comparison, of walks or of two sweeps, with the curves of the walks over one another."""

import os
from collections.abc import Sequence
from itertools import cycle
from pathlib import Path

import numpy as np

from validation.judge.compare import SIGNALS
from validation.judge.metrics import display_unit
from validation.show.chart import DASHED, Picture, decimate, new_charts, picture
from validation.show.page import render_page
from validation.show.report import write_report
from validation.show.run_figures import middle, shade_double_support
from validation.show.style import INK, PARTS
from validation.store.folders import output_file
from validation.store.json import write_json
from validation.store.saved import REPORT_FILE
from validation.study.compare.comparison import Side, WalkComparison
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


_COLORS = (*PARTS, INK)
_ERRORS = ("zmp_x", "zmp_y", "com_x", "com_y")
"""Signals of which measured minus planned is drawn; of the others both, the plan dashed."""
_CURVES = ("angular_momentum_x", "angular_momentum_y")


def draw_walks(sides: Sequence[Side]) -> tuple[list[tuple[str, str]], list[Picture]]:
    """Errors of the ZMP, COM and angular momentum of all walks.

    Returns:
        Name of every walk with its planner, and the colour of its curves; the pictures, without those of
        signals that no walk has.
    """
    names = [
        side.label if ", planner " in side.label else f"{side.label}, planner {side.planner}"
        for side in sides
    ]
    keys = list(zip(names, cycle(_COLORS), strict=False))
    pictures = [
        _draw(sides, name)
        for name in (*_ERRORS, *_CURVES)
        if any(np.isfinite(side.run.signals[f"measured_{name}"]).any() for side in sides)
    ]
    return keys, pictures


def _draw(sides: Sequence[Side], name: str) -> Picture:
    """One signal of all walks, over two steps from the middle of each."""
    (chart,) = charts = new_charts(2.6)
    is_error = name in _ERRORS
    scale, unit = display_unit(SIGNALS[name].unit, 1.0)
    first = sides[0].run.signals
    for side, color in zip(sides, cycle(_COLORS), strict=False):
        signals = side.run.signals
        rows = middle(signals)
        time = signals.time[rows] - signals.time[rows.start]
        measured, plan = scale * signals[f"measured_{name}"][rows], scale * signals[f"plan_{name}"][rows]
        chart.line(*decimate(time, measured - plan if is_error else measured), color)
        if not is_error:
            chart.line(*decimate(time, plan), color, dash=DASHED)
    shade_double_support(chart, first, middle(first), from_zero=True)
    title = f"{'Error of ' if is_error else ''}{SIGNALS[name].label}"
    chart.title, chart.xlabel, chart.ylabel = f"{title}, two steps", "time [s]", f"[{unit}]"
    return picture(charts, f"{title} of all walks", "Measured minus planned." if is_error else "")
