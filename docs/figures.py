"""The style of the pictures that the scripts of this folder draw by matplotlib."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

from validation.show.style import FAINT, GRID, INK
from validation.store.folders import output_file

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
