"""Style of all figures: of pages, and of picture files."""

import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from html import escape
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

import matplotlib as mpl
import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ampm.geometry import Array
from validation.store.folders import output_file

INK, FAINT, GRID, SHADE = "#1d2126", "#6c737d", "#e6e8ea", "#eceef1"
PLAN, COMMAND, MEASURED = "#0072b2", "#009e73", "#d55e00"
LEFT, RIGHT = "#b0417a", "#a67c00"
GOOD, BAD = "#1a7f45", "#c62f3b"
PARTS = ("#4477aa", "#cc6644", "#228844", "#aa4499")
"""Colours of components and causes."""

STYLE: Any = {
    "svg.hashsalt": "ampm",
    "svg.fonttype": "none",
    "font.family": "sans-serif",
    "font.size": 9,
    "axes.titlelocation": "left",
    "axes.titlesize": 9,
    "axes.labelsize": 9,
    "axes.edgecolor": FAINT,
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "xtick.color": FAINT,
    "ytick.color": FAINT,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "text.color": INK,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "lines.linewidth": 1.3,
    "lines.solid_joinstyle": "round",
    "path.simplify_threshold": 0.3,
}
"""Settings of matplotlib; sizes in points."""

WIDTH = 5.2
"""Width of an ordinary figure [in]: 500 px, so that its 9 pt text stays readable on a telephone."""

_TOP, _BOTTOM, _GAP = 0.42, 0.42, 0.8
"""Room for title and legend, for labels below, and for all these between two axes [in]."""

_BUCKETS = 420
"""Buckets over a curve: each keeps its smallest and largest sample, so that spikes remain."""


class Picture(NamedTuple):
    """One figure of a page.

    Attributes:
        image: markup, without references to anything outside the page.
        caption: explanation.
        wide: whether it spans the page.
    """

    image: Markup
    caption: str
    wide: bool


@contextmanager
def style() -> Iterator[None]:
    """Context in which figures are drawn and written; also a decorator."""
    with mpl.rc_context(STYLE):
        yield


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure; the suffix chooses the format. An existing file is replaced.

    Raises:
        InputError: the file cannot be written.
    """
    # Without date and version equal figures give equal SVG files.
    metadata = {"Date": None, "Creator": None} if path.suffix == ".svg" else None
    with output_file(path) as work:
        figure.savefig(work, metadata=metadata)


def new_figure(
    height: float,
    rows: int = 1,
    *,
    width: float = WIDTH,
    left: float = 0.62,
    ratios: Sequence[float] | None = None,
) -> tuple[Figure, list[Axes]]:
    """Make a figure of ``rows`` axes, one above the other.

    Margins are fixed: matplotlib's constrained layout makes a report take seven times as long.

    Args:
        height: of the figure [in].
        rows: number of axes.
        width: of the figure [in].
        left: room for the labels of the vertical axis [in].
        ratios: relative heights of the axes.
    """
    # Made without pyplot: no global state, no display, safe in any thread.
    figure = Figure(figsize=(width, height))
    axes = figure.subplots(rows, 1, squeeze=False, height_ratios=ratios)[:, 0]
    inner = (height - _TOP - _BOTTOM - _GAP * (rows - 1)) / rows
    figure.subplots_adjust(
        left=left / width,
        right=1.0 - 0.12 / width,
        bottom=_BOTTOM / height,
        top=1.0 - _TOP / height,
        hspace=_GAP / inner,
    )
    return figure, list(axes)


def picture(figure: Figure, label: str, caption: str = "", *, wide: bool = False) -> Picture:
    """Render a figure for inlining in HTML.

    Args:
        figure: the figure.
        label: description of the picture for screen readers.
        caption: explanation.
        wide: whether it spans the page.
    """
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    data = quote(" ".join(buffer.getvalue().split()), safe=" =:;/,()'")
    image = Markup(f'<img alt="{escape(label)}" src="data:image/svg+xml,{data}">')
    return Picture(image, caption, wide)


def decimate(time: Array, value: Array, buckets: int = _BUCKETS) -> tuple[Array, Array]:
    """Thin a curve for drawing without losing its extremes.

    Args:
        time: shape (N,).
        value: shape (N,); NaN where undefined.
        buckets: each yields its smallest and its largest sample.

    Returns:
        Times and values, at most ``2 * buckets`` of each.
    """
    count = len(time)
    if count <= 2 * buckets:
        return time, value
    low, high = (np.where(np.isnan(value), empty, value) for empty in (np.inf, -np.inf))
    parts = np.array_split(np.arange(count), buckets)
    rows = np.unique([(part[low[part].argmin()], part[high[part].argmax()]) for part in parts])
    return time[rows], value[rows]


def legend(axis: Axes, columns: int = 5) -> None:
    """Legend above the axes, because curves fill the axes."""
    handles, labels = axis.get_legend_handles_labels()
    if not labels:
        return
    axis.legend(
        handles,
        labels,
        loc="lower left",
        bbox_to_anchor=(-0.01, 1.0),
        ncols=columns,
        borderaxespad=0.1,
        borderpad=0.1,
        handlelength=1.2,
        columnspacing=1.0,
        handletextpad=0.4,
    )
    lines = -(-len(labels) // columns)
    axis.set_title(axis.get_title(loc="left"), pad=6 + 13 * lines)
