"""Draws the requested figures, and computes the agreement of plan, motion and physics."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from ampm.exceptions import InputError
from validation.paper.figures.accelerations import figure_9, figure_10
from validation.paper.figures.bodies import figure_8, figure_11, figure_12
from validation.paper.figures.canvas import file_names, save, style
from validation.paper.figures.foot_roll import figure_7
from validation.paper.figures.human import figure_human
from validation.paper.figures.planes import figure_4, figure_5
from validation.paper.figures.walks import STEPS, Walks
from validation.progress import Progress
from validation.store.folders import check_output_file, output_file

NUMBERS = "figures.json"
"""File of the figures' numbers."""

FIGURES: Mapping[str, tuple[str, Callable[[Walks], tuple[Figure, Mapping[str, Any]]]]] = {
    "4": ("figure-04", figure_4),
    "5": ("figure-05", figure_5),
    "7": ("figure-07", figure_7),
    "8": ("figure-08", figure_8),
    "9": ("figure-09", figure_9),
    "10": ("figure-10", figure_10),
    "11": ("figure-11", figure_11),
    "12": ("figure-12", figure_12),
    "human": ("human", figure_human),
}
"""Available figures: name of the files, and the function that draws it and gives its numbers."""


def make_figures(
    out: Path,
    only: str | Sequence[str] | None = None,
    steps: int = STEPS,
    *,
    force: bool = False,
    stages: Progress | None = None,
) -> list[Path]:
    """Draw the paper's figures from data.

    Args:
        out: folder to write into; other files in it stay.
        only: figures to draw, as a list or separated by commas; all if not given.
        steps: steps walked for a figure.
        force: whether earlier figures there may be replaced.
        stages: where to report progress.

    Returns:
        The files, SVG and PNG of every figure, and the numbers.

    Raises:
        InputError: no such figure, too few steps, or a file that exists.
    """
    requested = [item.strip() for item in only.split(",")] if isinstance(only, str) else only or list(FIGURES)
    unknown = [item for item in requested if item not in FIGURES]
    if unknown:
        raise InputError(f"there is no figure {', '.join(unknown)!r}; the figures are {', '.join(FIGURES)}.")
    if steps < 4:
        raise InputError(f"--steps {steps} leaves no whole stride after the first one; take 4 or more.")
    if out.exists() and not out.is_dir():
        raise InputError(f"--out {out} is a file, not a folder; give another folder.")
    wanted = [figure for name, figure in FIGURES.items() if name in requested]
    for stem, _ in wanted:
        for file in file_names(stem):
            check_output_file(out / file, force=force)
    paths: list[Path] = []
    numbers = _earlier(out / NUMBERS)
    walks = Walks(steps, stages)
    with style():
        for stem, draw in wanted:
            figure, numbers[stem] = draw(walks)
            paths += save(figure, out, stem)
    with output_file(out / NUMBERS) as work:
        work.write_text(json.dumps(numbers, indent=2) + "\n", encoding="utf-8")
    return [*paths, out / NUMBERS]


def _earlier(path: Path) -> dict[str, Any]:
    """Numbers of figures that were drawn before into the same folder."""
    try:
        earlier = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return earlier if isinstance(earlier, dict) else {}
