"""The studies as a picture: how much each figure changes from level to level, on logarithmic axes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, NullFormatter, NullLocator

from validation.study.convergence.result import Convergence, MetricStudy
from validation.study.convergence.studies import COUNTS, Study

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_LEAST = 1e-9  # relative change below which it is the arithmetic's
_LEFT_OUT = ("com_agreement_maximum", "angular_momentum_agreement_maximum", "standing_weight_error")
"""Rounding, on whatever level."""


def draw(result: Convergence, path: Path) -> None:
    """Draw all studies into a file; the suffix chooses the format.

    Solid, filled: in the asymptotic range, the distance to the extrapolated value. Dashed, hollow: no
    asymptotic range, the change to the next finer level.

    Raises:
        OSError: the file cannot be written.
    """
    items = [
        item
        for item in result.metrics.values()
        if item.tolerance is not None and item.name not in COUNTS and item.name not in _LEFT_OUT
    ]
    rows = -(-(len(result.studies) + 1) // 2)  # one cell is the legend's
    # Figures are made without pyplot: no global state, no display, safe in any thread.
    figure = Figure(figsize=(12.4, 4.1 * rows + 0.5), layout="constrained")
    FigureCanvasAgg(figure)
    steps = result.request.run.gait.steps
    figure.suptitle(f"{result.request.name}: what the numbers depend on, {steps} steps a level")
    grid = list(figure.subplots(rows, 2, squeeze=False).flat)
    for axes, study in zip(grid, result.studies, strict=False):
        if study.topic.kind == "numerical":
            _draw_numerical(axes, study, items)
        else:
            _draw_input(axes, study, items)
    _draw_legend(grid[len(result.studies)], items)
    for axes in grid[len(result.studies) :]:
        axes.set_axis_off()
    with mpl.rc_context({"svg.hashsalt": "ampm"}):  # the same names in the file each time
        figure.savefig(path, dpi=110, metadata={"Date": None} if path.suffix == ".svg" else None)


def _draw_legend(axes: Axes, items: Sequence[MetricStudy]) -> None:
    def line(label: str, colour: str, style: str = "-", fill: str | None = None, marker: str = "o") -> Line2D:
        return Line2D([], [], color=colour, ls=style, marker=marker, mfc=fill or colour, ms=4.5, label=label)

    handles = [line(item.name, _colour(number), marker="") for number, item in enumerate(items)]
    handles += [
        line("asymptotic range: distance to the\nextrapolated value", "0.3"),
        line("no asymptotic range: change to the\nnext finer level", "0.3", "--", "none"),
        line("model parameter: a sensitivity,\nno convergence", "0.3", marker="s"),
    ]
    axes.legend(handles=handles, loc="center", ncols=2, fontsize="small", frameon=False, labelspacing=0.8)


def _draw_numerical(axes: Axes, study: Study, items: Sequence[MetricStudy]) -> None:
    factor, unit = study.topic.shown
    steps = factor * np.array(study.values)
    top = _LEAST
    for number, item in enumerate(items):
        found = item.estimates[study.topic.name]
        values = np.array(item.levels[study.topic.name])
        if found.extrapolated is not None:
            error, at, line, fill = np.abs(values - found.extrapolated), steps, "-", _colour(number)
        else:
            error, at, line, fill = np.abs(np.diff(values)), steps[:-1], "--", "none"
        error = error / abs(item.value) if item.value else error
        error = np.where(error > _LEAST, error, np.nan)  # drawn as a gap
        axes.plot(
            at, error, ls=line, color=_colour(number), lw=1.2, marker="o", ms=4.5, mfc=fill, label=item.name
        )
        top = max(top, float(np.nanmax(error, initial=_LEAST)))
    axes.set_xscale("log")
    if top == _LEAST:  # nothing that a logarithmic axis could hold
        axes.set_ylim(0.0, 1.0)
        axes.text(0.5, 0.5, "no change but rounding", transform=axes.transAxes, ha="center", va="center")
    else:
        axes.set_yscale("log")
        for order in (1, 2):
            guide = 2.5 * top * (steps / steps[0]) ** order
            axes.plot(steps, guide, color="0.6", lw=0.8, ls=":")
            axes.annotate(
                f"order {order}",
                (steps[-1], guide[-1]),
                fontsize="x-small",
                color="0.4",
                va="bottom",
                ha="left",
            )
    axes.set_xlabel(f"{study.topic.title} [{unit or '1'}]")
    axes.set_ylabel("error, over the gait's own value [1]")
    _ticks(axes, study, steps)


def _draw_input(axes: Axes, study: Study, items: Sequence[MetricStudy]) -> None:
    factor, unit = study.topic.shown
    at = factor * np.array(study.values)
    for number, item in enumerate(items):
        values = np.array(item.levels[study.topic.name])
        change = values / item.value if item.value else np.full(values.shape, np.nan)
        axes.plot(at, change, color=_colour(number), lw=1.2, ms=4.5, marker="s", label=item.name)
    axes.set_xscale("log")
    axes.axvline(factor * study.values[study.own], color="0.6", lw=0.8, ls=":")
    axes.set_xlabel(f"{study.topic.key} [{unit or '1'}]: {study.topic.title}", fontsize="small")
    axes.set_ylabel("value, over the gait's own [1]")
    _ticks(axes, study, at)


def _ticks(axes: Axes, study: Study, at: np.ndarray) -> None:
    axes.xaxis.set_major_locator(FixedLocator(list(at)))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_xticklabels([f"{value:.3g}" for value in at])
    axes.set_title(study.topic.name, fontsize="medium")
    axes.grid(alpha=0.3)


def _colour(number: int) -> str:
    return to_hex(mpl.colormaps["tab20"](number % 20))
