"""Paper, pens and colours shared by the paper's figures; files are written as SVG and PNG."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from numpy.typing import NDArray

from validation.show.style import figure_style, legend
from validation.store.folders import output_file

Array = NDArray[np.float64]

INK, FAINT, GRID, SHADE = "#1f2933", "#7b8794", "#e4e7eb", "#eef1f5"
PLAN, MOTION, MEASURED = "#9db9dd", "#1d4e89", "#d1495b"
LEFT, RIGHT, TRUNK = "#2f6fb0", "#c8622c", "#3e4c59"
FORCE, ZMP, COM = "#2a9d6f", "#2a9d6f", "#1f2933"
BAND = "#f0c987"

SOURCES = {"plan": PLAN, "motion": MOTION, "measured": MEASURED}

_STYLE: Any = figure_style(INK, FAINT, GRID) | {
    "svg.fonttype": "path",  # the same letters wherever the file is shown
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "lines.linewidth": 1.4,
    "lines.solid_capstyle": "round",
    "figure.facecolor": "white",
}


def style() -> Any:
    """Context in which the figures are drawn and written."""
    return mpl.rc_context(_STYLE)


def file_names(name: str) -> tuple[str, str]:
    """Files of one figure."""
    return f"{name}.svg", f"{name}.png"


def save(figure: Figure, folder: Path, name: str) -> list[Path]:
    """Write a figure as SVG and PNG.

    Returns:
        Both files.
    """
    paths = [folder / file for file in file_names(name)]
    with output_file(paths[0]) as work:
        FigureCanvasSVG(figure).print_svg(str(work), metadata={"Date": None, "Creator": None})
    with output_file(paths[1]) as work:
        figure.set_dpi(160)
        FigureCanvasAgg(figure).print_png(str(work), metadata={"Software": None})
    return paths


def shade(axis: Axes, spans: Iterable[tuple[float, float]]) -> None:
    """Shade the double supports."""
    for begin, end in spans:
        axis.axvspan(begin, end, color=SHADE, linewidth=0, zorder=0)


def legend_above(axis: Axes, columns: int = 6) -> None:
    """Legend over the axes, under the title, clear of every curve."""
    legend(axis, columns, handlelength=2.0, columnspacing=1.1, handletextpad=0.45)


def bare(axis: Axes) -> None:
    """No frame, no grid, no ticks: for drawings of bodies."""
    axis.grid(False)
    axis.set_xticks([])
    axis.set_yticks([])
    for spine in axis.spines.values():
        spine.set_visible(False)


def inches(figure: Figure, left: float, top: float, width: float, height: float) -> Axes:
    """Axes by their place on the paper, from its upper left corner [in]."""
    paper_width, paper_height = figure.get_size_inches()
    place = (left / paper_width, 1.0 - (top + height) / paper_height)
    return figure.add_axes((*place, width / paper_width, height / paper_height))


def arrow(
    axis: Axes, start: Array, end: Array, *, color: str = FORCE, width: float = 1.4, alpha: float = 1.0,
    zorder: float = 4.0,
) -> None:  # fmt: skip
    """An arrow between two points of the axes' own coordinates."""
    axis.annotate(
        "", xy=(float(end[0]), float(end[1])), xytext=(float(start[0]), float(start[1])), zorder=zorder,
        arrowprops={
            "arrowstyle": "-|>,head_width=0.18,head_length=0.42", "color": color, "linewidth": width,
            "shrinkA": 0, "shrinkB": 0, "alpha": alpha,
        },
    )  # fmt: skip
