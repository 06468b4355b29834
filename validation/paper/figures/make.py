"""Makes the requested figures, and computes how far plan, motion and physics agree."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from ampm.description import SoleGeometry
from ampm.exceptions import InputError
from models.human import sole_geometry
from validation.paper.figures import accelerations, bodies, centroidal, foot_roll, geometry, human
from validation.paper.figures.canvas import file_names, save, style
from validation.paper.figures.walks import STEPS, Walk, Walks
from validation.progress import Progress
from validation.store.folders import check_output_file, output_file

NUMBERS = "figures.json"
"""File of the figures' numbers."""

_MOMENTUM, _NORMAL = "momentum", "normal"
_SWINGS = (0.1, 0.4, 0.7, 0.8, 0.9, 1.0)
"""Values of c_y whose momentum and swing are given beside Fig. 11."""

Drawn = tuple[Figure, Mapping[str, Any]]
"""A figure, and the numbers of its curves."""


def _plane(draw: Callable[[Walk, SoleGeometry], Figure], axis: int) -> Callable[[Walks], Drawn]:
    """Figure 4 or 5: the plane of one horizontal axis."""

    def figure(walks: Walks) -> Drawn:
        walk = walks.walk(_MOMENTUM)
        sole = sole_geometry(walk.trial.planned.request.run.body.height)
        return draw(walk, sole), geometry.numbers(walk, axis)

    return figure


def _figure_8(walks: Walks) -> Drawn:
    walk = walks.walk(_NORMAL)
    com = {f"COM {axis}": walk.deviation["com"].component(k) for k, axis in enumerate("xyz")}
    return bodies.figure_8(walk), centroidal.peak(com, "m")


def _figure_11(walks: Walks) -> Drawn:
    pair = [walks.walk("roll-0.1"), walks.walk("roll-0.7")]
    swing = {f"{value:g}": bodies.swing(walks.plan(_NORMAL, (f"gait.c_y={value}",))) for value in _SWINGS}
    gaits = {walk.label: bodies.numbers(walk) for walk in pair}
    return bodies.figure_11(pair), {"gaits": gaits, "c_y": swing}


def _figure_12(walks: Walks) -> Drawn:
    pair = walks.walk("pitch"), walks.walk(_NORMAL)
    return bodies.figure_12(*pair), {walk.label: bodies.numbers(walk) for walk in pair}


FIGURES: Mapping[str, tuple[str, Callable[[Walks], Drawn]]] = {
    "4": ("figure-04", _plane(geometry.figure_4, 0)),
    "5": ("figure-05", _plane(geometry.figure_5, 1)),
    "7": ("figure-07", foot_roll.figure_7),
    "8": ("figure-08", _figure_8),
    "9": ("figure-09", lambda walks: accelerations.figure_9(walks.walk(_NORMAL))),
    "10": ("figure-10", lambda walks: accelerations.figure_10(walks.walk(_NORMAL))),
    "11": ("figure-11", _figure_11),
    "12": ("figure-12", _figure_12),
    "human": ("human", human.figure_human),
}
"""Available figures: name of the files, and the function that draws it."""


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
        out: folder to write into; what else is in it stays.
        only: figures to draw, as a list or separated by commas; all if not given.
        steps: steps walked for a figure.
        force: whether earlier figures there may be replaced.
        stages: where to report progress.

    Returns:
        The files, SVG and PNG of every figure, and the numbers.

    Raises:
        InputError: no such figure, too few steps, or a file that exists.
    """
    stages = stages or Progress()
    wanted = _wanted(only)
    if steps < 4:
        raise InputError(f"--steps {steps} leaves no whole stride after the first one; take 4 or more.")
    if out.exists() and not out.is_dir():
        raise InputError(f"--out {out} is a file, not a folder; give another folder.")
    for name in wanted:
        for file in file_names(FIGURES[name][0]):
            check_output_file(out / file, force=force)
    paths: list[Path] = []
    numbers: dict[str, Any] = {}
    walks = Walks(steps, stages)
    with style():
        for name in wanted:
            stem, draw = FIGURES[name]
            figure, values = draw(walks)
            paths += save(figure, out, stem)
            numbers[stem] = values
    if any(numbers.values()):
        numbers = {**_earlier(out / NUMBERS), **{name: values for name, values in numbers.items() if values}}
        with output_file(out / NUMBERS) as work:
            work.write_text(json.dumps(numbers, indent=2) + "\n", encoding="utf-8")
        paths.append(out / NUMBERS)
    return paths


def _wanted(only: str | Sequence[str] | None) -> list[str]:
    """Names of the figures to draw, in the paper's order."""
    if only is None:
        return list(FIGURES)
    requested = [item.strip() for item in (only.split(",") if isinstance(only, str) else only)]
    unknown = [item for item in requested if item not in FIGURES]
    if unknown or not requested:
        raise InputError(f"there is no figure {', '.join(unknown)!r}; the figures are {', '.join(FIGURES)}.")
    return [name for name in FIGURES if name in requested]


def _earlier(path: Path) -> dict[str, Any]:
    """Numbers of figures that were drawn before into the same folder."""
    try:
        earlier = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return earlier if isinstance(earlier, dict) else {}
