"""Colours of all pictures, and the style of those that matplotlib draws."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from validation.store.folders import output_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INK, FAINT, GRID, SHADE = "#1d2126", "#6c737d", "#e6e8ea", "#eceef1"
PLAN, COMMAND, MEASURED = "#0072b2", "#009e73", "#d55e00"
LEFT, RIGHT = "#8f2a62", "#a67c00"
GOOD, BAD = "#1a7f45", "#c62f3b"
PARTS = ("#332288", "#aa3377", "#33a088", "#ccbb44")
"""Colours of components and causes, from dark to light, so that they differ in grey, too."""

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
    "legend.borderaxespad": 0.1,
    "legend.borderpad": 0.1,
    "legend.handlelength": 1.2,
    "legend.columnspacing": 1.0,
    "legend.handletextpad": 0.4,
    "lines.linewidth": 1.3,
    "lines.solid_joinstyle": "round",
    "path.simplify_threshold": 0.3,
}
"""Settings of matplotlib; sizes in points."""


@contextmanager
def style() -> Iterator[None]:
    """Context in which figures are drawn and written; also a decorator."""
    import matplotlib as mpl  # slow to load, and pages do without

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
