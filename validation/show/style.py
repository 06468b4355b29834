"""Style of all figures: of pages, whose colours follow the page, and of picture files."""

import io
import re
from collections.abc import Callable, Sequence
from functools import wraps
from html import escape
from pathlib import Path
from typing import Any, Concatenate, NamedTuple, ParamSpec, TypeVar

import matplotlib as mpl
import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from ampm.geometry import Array
from validation.store.folders import output_file

Drawn = TypeVar("Drawn")
More = ParamSpec("More")


def figure_style(ink: str, faint: str, grid: str) -> dict[str, Any]:
    """Settings of matplotlib: sizes in points.

    Args:
        ink: colour of text.
        faint: of axes and ticks.
        grid: of grid lines.
    """
    return {
        "svg.hashsalt": "ampm",
        "font.family": "sans-serif",
        "font.size": 9,
        "axes.titlelocation": "left",
        "axes.titley": 1.0,  # given, so that it is not searched for
        "axes.labelsize": 9,
        "axes.edgecolor": faint,
        "axes.labelcolor": ink,
        "axes.titlecolor": ink,
        "axes.linewidth": 0.7,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "axes.axisbelow": True,
        "grid.color": grid,
        "grid.linewidth": 0.6,
        "xtick.color": faint,
        "ytick.color": faint,
        "xtick.labelcolor": ink,
        "ytick.labelcolor": ink,
        "xtick.labelsize": 8,
        "ytick.labelsize": 8,
        "text.color": ink,
        "legend.frameon": False,
        "legend.fontsize": 8,
        "lines.solid_joinstyle": "round",
        "path.simplify_threshold": 0.3,
    }


_VARIABLES = (
    *("ink", "faint", "grid", "shade", "plan", "command", "measured", "left", "right", "good", "bad"),
    *("part-1", "part-2", "part-3", "part-4"),
)
_COLORS = tuple(f"#0101{number:02x}" for number in range(1, 1 + len(_VARIABLES)))
"""Unique placeholder colours; :func:`picture` replaces each by the CSS variable of its name."""
INK, FAINT, GRID, SHADE, PLAN, COMMAND, MEASURED, LEFT, RIGHT, GOOD, BAD, *_PARTS = _COLORS
PARTS = tuple(_PARTS)

WIDTH = 5.2
"""Width of an ordinary figure [in]: 500 px, so that its 9 pt text stays readable on a telephone."""

_BUCKETS = 420
"""Buckets over a whole run: each keeps its smallest and largest sample, so that spikes remain."""


class Picture(NamedTuple):
    """One figure of a page.

    Attributes:
        svg: markup.
        caption: explanation.
        wide: whether it spans the page.
    """

    svg: Markup
    caption: str
    wide: bool


def style() -> Any:
    """Context in which figures for pages are drawn and written."""
    own: Any = {"svg.fonttype": "none", "axes.titlesize": 9, "lines.linewidth": 1.3}
    return mpl.rc_context(figure_style(INK, FAINT, GRID) | own)


def file_style() -> Any:
    """Context in which figures for picture files are drawn and written."""
    settings: Any = figure_style("#1b1e24", "#5b6270", "#dfe3ea")
    return mpl.rc_context(settings)


def into_file(
    make: Callable[Concatenate[Drawn, More], Figure],
) -> Callable[Concatenate[Drawn, Path, More], None]:
    """A function that draws something as a figure, turned into one that draws it into a file.

    It takes the path after what is drawn; the suffix chooses the format. An existing file is replaced.

    Raises:
        InputError: the file cannot be written.
    """

    @wraps(make, assigned=("__module__", "__name__", "__qualname__", "__doc__"))
    def draw(drawn: Drawn, path: Path, *more: More.args, **named: More.kwargs) -> None:
        with output_file(path) as work, file_style():
            # Without date and version equal figures give equal SVG files.
            metadata = {"Date": None, "Creator": None} if path.suffix == ".svg" else None
            make(drawn, *more, **named).savefig(work, metadata=metadata)

    del draw.__dict__["__wrapped__"]  # its signature has no path
    return draw


def new_figure(
    height: float,
    rows: int = 1,
    *,
    width: float = WIDTH,
    left: float = 0.62,
    top: float = 0.42,
    gap: float = 0.3,
    ratios: Sequence[float] | None = None,
) -> tuple[Figure, list[Axes]]:
    """Make a figure of ``rows`` axes, one above the other.

    Margins and places of labels are fixed, and ticks are few: matplotlib's automatic layout takes longer than
    the drawing, and ticks take most of that.

    Args:
        height: of the figure [in].
        rows: number of axes.
        width: of the figure [in].
        left: room for the labels of the vertical axis [in].
        top: room for title and legend [in].
        gap: between two axes [in].
        ratios: relative heights of the axes.
    """
    figure = Figure(figsize=(width, height))
    inner = (height - top - 0.42 - gap * (rows - 1)) / rows
    axes = figure.subplots(rows, 1, squeeze=False, height_ratios=ratios)[:, 0]
    figure.subplots_adjust(
        left=left / width,
        right=1.0 - 0.12 / width,
        bottom=0.42 / height,
        top=1.0 - top / height,
        hspace=gap / inner,
    )
    figure.patch.set_alpha(0.0)
    for axis in axes:
        axis.patch.set_alpha(0.0)
        axis.xaxis.set_label_coords(0.5, -0.26 / (axis.get_position().height * height))
        axis.yaxis.set_label_coords(-(left - 0.14) / (width - left - 0.12), 0.5)
        axis.locator_params(nbins=6, steps=(1, 2, 2.5, 5, 10))
    return figure, list(axes)


def picture(figure: Figure, name: str, label: str, caption: str = "", *, wide: bool = False) -> Picture:
    """Render a figure for inlining in HTML.

    Args:
        figure: the figure.
        name: unique in the page; prefixes every id.
        label: description of the picture for screen readers.
        caption: explanation.
        wide: whether it spans the page.
    """
    buffer = io.StringIO()
    FigureCanvasSVG(figure).print_svg(buffer, metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    for reference in (' id="', "url(#", 'xlink:href="#'):
        text = text.replace(reference, f"{reference}{name}-")
    text = re.sub("#0101[0-9a-f]{2}", lambda color: css_color(color[0]), text)
    # The page's own type; matplotlib lists every font of the family it was configured with.
    text = re.sub(r"font: ([\d.]+px) [^;\"]*", r"font-size: \1", text)
    width, height = (72 * size for size in figure.get_size_inches())
    head = (
        f'<svg role="img" aria-label="{escape(label)}" viewBox="0 0 {width:g} {height:g}" '
        'xmlns:xlink="http://www.w3.org/1999/xlink" xmlns="http://www.w3.org/2000/svg">'
    )
    lines = map(str.strip, text[text.index(">") + 1 :].split("\n"))
    return Picture(Markup("\n".join([head, *filter(None, lines)])), caption, wide)


def css_color(placeholder: str) -> str:
    """CSS of a placeholder colour, such as :data:`PLAN`."""
    return f"var(--{_VARIABLES[_COLORS.index(placeholder)]})"


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


def legend(axis: Axes, columns: int = 5, **spacing: float) -> None:
    """Legend above the axes, because curves fill the axes."""
    handles, labels = axis.get_legend_handles_labels()
    if labels:
        lengths = {"handlelength": 1.2, "columnspacing": 1.0, "handletextpad": 0.4, **spacing}
        axis.legend(
            handles,
            labels,
            loc="lower left",
            bbox_to_anchor=(-0.01, 1.0),
            ncols=columns,
            borderaxespad=0.1,
            borderpad=0.1,
            **lengths,
        )
        lines = -(-len(labels) // columns)
        axis.set_title(axis.get_title(loc="left"), pad=6 + 13 * lines)
