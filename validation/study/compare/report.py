"""Files of a comparison, of walks or of two sweeps, with the curves of the walks over one another."""

import os
import shlex
from collections.abc import Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import create_model

from ampm.exceptions import InputError
from validation.judge.compare import SIGNALS
from validation.judge.metrics import display_unit
from validation.judge.uncertainty import Uncertainty
from validation.run.trial import draw_run
from validation.show.chart import DASHED, Picture, decimate, new_charts, numbered
from validation.show.page import render_page
from validation.show.paper import cite_run
from validation.show.run_figures import middle, middle_name, shade_double_support, strides
from validation.show.style import INK, PARTS
from validation.store.folders import write_whole
from validation.store.json import read_json, write_json
from validation.store.saved import load_saved_run
from validation.study.compare.comparison import Side, WalkComparison
from validation.study.compare.sweeps import SweepComparison
from validation.study.robustness.study import Robustness
from validation.trial.files import RunFile

REPORT, COMPARISON_FILE = RunFile.REPORT, "comparison.json"


def is_comparison(folder: Path) -> bool:
    """Whether a folder is one of a comparison."""
    return (folder / COMPARISON_FILE).is_file()


def load_comparison(folder: Path) -> WalkComparison:
    """Read a comparison of walks from its folder, and the runs that it names.

    Raises :class:`InputError` if it is damaged, of sweeps, or one of its runs is gone.
    """
    studies: Any = {"study": Uncertainty | None, "robustness": Robustness | None}
    walk: Any = create_model("Walk", label=str, run=str, **studies)
    kind = create_model("Numbers", walks=list[walk])
    path, way_out = folder / COMPARISON_FILE, "run 'ampm compare' again"
    if "matched" in read_json(path, dict[str, Any], way_out)[0]:
        raise InputError(f"{folder} compares two sweeps: it has a page, no figures; {way_out} to write it.")
    walks = read_json(path, kind, way_out)[1].walks
    sides = [Side(one.label, load_saved_run(folder / one.run), one.study, one.robustness) for one in walks]
    return WalkComparison(sides)


def write_comparison(result: WalkComparison | SweepComparison, folder: Path) -> Path:
    """Write numbers and page, whose path is returned, and report and recording of walks that lack them."""
    folder.mkdir(parents=True, exist_ok=True)
    numbers = result.as_dict()
    for side, entry in zip(result.sides, numbers.get("walks", ()), strict=True):
        entry["run"] = os.path.relpath(side.run.directory, folder)
        if not all((side.run.directory / name).is_file() for name in (RunFile.REPORT, RunFile.RECORDING)):
            draw_run(side.run.directory, side.label)
    write_json(folder / COMPARISON_FILE, numbers)
    return write_whole(folder / REPORT, render(result, folder))


def render(result: WalkComparison | SweepComparison, folder: Path) -> str:
    """The page for a folder; of walks with their curves, and links to their reports and recordings."""
    keys, pictures = draw_walks(result.sides)
    folders = [os.path.relpath(side.run.directory, folder) for side in result.sides]
    return render_page(
        "curves.html.j2",
        result.title,
        sentence=result.sentence,
        tables=result.tables(),
        keys=keys,
        key_note="dashed: the plan of each; grey: planned double support of the first",
        runs=list(zip([side.label for side in result.sides], folders, strict=True)),
        view=shlex.join(["ampm", "view", *folders]),
        pictures=pictures,
        citations=[cite_run(side.run) for side in result.sides],
    )


_COLORS = (*PARTS, INK)
_ERRORS = ("zmp_x", "zmp_y", "com_x", "com_y")
"""Signals of which measured minus planned is drawn; of the others both, the plan dashed."""
_CURVES = ("angular_momentum_x", "angular_momentum_y")


def draw_walks(sides: Sequence[Side]) -> tuple[list[tuple[str, str]], list[Picture]]:
    """Label of every walk and the colour of its curves; pictures of the signals that a walk has."""
    keys = list(zip([side.label for side in sides], cycle(_COLORS), strict=False))
    pictures = [
        _draw(sides, name)
        for name in (*_ERRORS, *_CURVES)
        if any(np.isfinite(side.run.signals[f"measured_{name}"]).any() for side in sides)
        and not (name in _ERRORS and all(side.run.is_free for side in sides))
    ]
    return keys, numbered(pictures)


def _draw(sides: Sequence[Side], name: str) -> Picture:
    """One signal of all walks, over two steps of each, or over all of each if one has no two steps."""
    (chart,) = charts = new_charts(2.6)
    is_error = name in _ERRORS
    scale, unit = display_unit(SIGNALS[name].unit, 1.0)
    shortest = min((side.run.signals for side in sides), key=lambda signals: len(strides(signals)))
    windows = [middle(side.run) if strides(shortest) else slice(0, len(side.run.signals)) for side in sides]
    for side, rows, color in zip(sides, windows, cycle(_COLORS), strict=False):
        signals = side.run.signals
        time = signals.time[rows] - signals.time[rows.start]
        measured, plan = scale * signals[f"measured_{name}"][rows], scale * signals[f"plan_{name}"][rows]
        chart.line(*decimate(time, measured - plan if is_error else measured), color, label=side.label)
        if not is_error:
            chart.line(*decimate(time, plan), color, dash=DASHED)
    shade_double_support(chart, sides[0].run.signals, windows[0], from_zero=True)
    title = f"{'Error of ' if is_error else ''}{SIGNALS[name].label}"
    title = title[0].upper() + title[1:]
    chart.name(f"{title}, {middle_name(shortest)}", f"[{unit}]", "time since they began [s]")
    chart.top = max(chart.top, chart.heading_height() + 4.0)
    caption = "Measured minus planned." if is_error else "Measured; dashed: the plan of each."
    return Picture(charts, f"{title} of all walks", f"{caption} Grey: double support of {sides[0].label}.")
