"""Shared by the paper's figures: style, colours, panels of plan, motion and simulation, files."""

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

from ampm.geometry import Array
from validation.show.style import figure_style, legend
from validation.store.folders import output_file

Line = Any
"""A line style of matplotlib."""

INK, FAINT, GRID, SHADE = "#1f2933", "#7b8794", "#e4e7eb", "#eef1f5"
PLAN, MOTION, MEASURED, BAND = "#9db9dd", "#1d4e89", "#d1495b", "#f0c987"
LEFT, RIGHT, TRUNK, FORCE = "#2f6fb0", "#c8622c", "#3e4c59", "#2a9d6f"
DASHED = (0, (3, 2))
SPREAD = "spread of the strides (no tolerance is set)"

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


def inches(figure: Figure, left: float, top: float, width: float, height: float) -> Axes:
    """Axes by their place on the paper, from its upper left corner [in]."""
    paper_width, paper_height = figure.get_size_inches()
    place = (left / paper_width, 1.0 - (top + height) / paper_height)
    return figure.add_axes((*place, width / paper_width, height / paper_height))


def shade(axis: Axes, spans: Iterable[tuple[float, float]]) -> None:
    """Shade the double supports."""
    for begin, end in spans:
        axis.axvspan(begin, end, color=SHADE, linewidth=0, zorder=0)


def zero_line(axis: Axes) -> None:
    """Thin line at zero."""
    axis.axhline(0.0, color=FAINT, linewidth=0.6)


def legend_above(axis: Axes, columns: int = 6) -> None:
    """Legend over the axes, under the title, clear of every curve."""
    legend(axis, columns, handlelength=2.0, columnspacing=1.1, handletextpad=0.45)


def arrow(
    axis: Axes, start: Array, end: Array, *, width: float = 1.4, alpha: float = 1.0, zorder: float = 4.0
) -> None:
    """A force between two points of the axes' own coordinates."""
    head = {"arrowstyle": "-|>,head_width=0.18,head_length=0.42", "shrinkA": 0, "shrinkB": 0}
    axis.annotate(
        "", xy=(end[0], end[1]), xytext=(start[0], start[1]), zorder=zorder,
        arrowprops={**head, "color": FORCE, "linewidth": width, "alpha": alpha},
    )  # fmt: skip


def curves(
    axis: Axes, time: Array, planned: Array | None, motion: Array, simulated: Array, *,
    tolerance: float | None = None, source: str = "simulation", label: str = "", line: Line = "-",
) -> None:  # fmt: skip
    """Plan (or, where there is none, nothing), motion and simulation on the same axes.

    Args:
        axis: to draw on.
        time: shape (n,).
        planned: shape (n,), or None for a quantity that no plan has.
        motion: shape (n,).
        simulated: shape (strides, n).
        tolerance: of the RMSE against the plan, drawn around it; without one the band is the strides' spread.
        source: what the simulated curve is.
        label: after each name in the legend.
        line: style, to distinguish walks; plans are broad and whole.
    """
    after = f", {label}" if label else ""
    band: dict[str, Any] = {"color": BAND, "linewidth": 0}
    if planned is not None and tolerance is not None:
        axis.fill_between(time, planned - tolerance, planned + tolerance, alpha=0.6, zorder=1, **band)
    else:
        axis.fill_between(time, simulated.min(axis=0), simulated.max(axis=0), alpha=0.9, zorder=2.5, **band)
    if planned is not None:
        axis.plot(time, planned, color=PLAN, linewidth=4.4, label=f"plan{after}")
    for values, color, width, name in (
        (motion, MOTION, 1.9, "inverse kinematics"),
        (simulated.mean(axis=0), MEASURED, 0.9, source),
    ):
        axis.plot(time, values, color=color, linewidth=width, linestyle=line, label=f"{name}{after}")


def difference(
    axis: Axes, time: Array, motion: Array | None, simulated: Array, *, tolerance: float | None = None,
    unit: str = "", line: Line = "-", note: str = "",
) -> None:  # fmt: skip
    """Every stride of the simulation, and the motion, less the plan (or less the motion), over a band.

    Args:
        axis: to draw on.
        time: shape (n,).
        motion: shape (n,); None where the motion is what is subtracted.
        simulated: shape (strides, n).
        tolerance: half the band: what a run's RMSE is allowed; None for the spread of the strides.
        unit: of the band, for the legend.
        line: style, to distinguish walks.
        note: to add to the band's name.
    """
    band: dict[str, Any] = {"color": BAND, "linewidth": 0}
    if tolerance is None:
        low, high = simulated.min(axis=0), simulated.max(axis=0)
        axis.fill_between(time, low, high, alpha=0.9, label=f"{SPREAD}{note}", **band)
    else:
        label = f"tolerance of the RMSE: ± {tolerance:.3g} {unit}{note}"
        axis.axhspan(-tolerance, tolerance, alpha=0.35, label=label, **band)
    zero_line(axis)
    axis.plot(time, simulated.T, color=MEASURED, linewidth=0.5, alpha=0.55, linestyle=line)
    if motion is not None:
        axis.plot(time, motion, color=MOTION, linewidth=1.1, linestyle=line)
    # Several walks may share the panel.
    reach = max(float(np.abs(axis.dataLim.intervaly).max()), tolerance or 0.0)
    axis.set_ylim(-1.2 * reach, 1.2 * reach)


def band_legend(axis: Axes) -> None:
    """The bands' names over a panel of differences, each once."""
    handles, labels = axis.get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))
    axis.legend(
        unique.values(), unique, loc="lower left", bbox_to_anchor=(-0.01, 0.97), fontsize=7.5, borderpad=0.1,
        handlelength=1.4, handletextpad=0.45, columnspacing=1.0, labelspacing=0.2,
    )  # fmt: skip
