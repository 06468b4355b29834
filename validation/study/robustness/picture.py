"""Polar plots of the pushes survived."""

import math
from typing import Any

from matplotlib.figure import Figure

from validation.show.style import into_file
from validation.study.robustness.push import PUSH_PHASES
from validation.study.robustness.result import PHASE_NAMES, CellResult, Robustness

_ANGLES = {"forward": 90.0, "wider": 180.0, "backward": 270.0, "narrower": 0.0}
"""Of the plot [degrees]: forward is up."""
_INCH = 2.9  # of one plot


@into_file
def draw(found: Robustness) -> Figure:
    """Draw all pushes, a plot for each height and phase."""
    heights = list(dict.fromkeys(item.cell.height for item in found.pushes))
    phases = [phase for phase in PUSH_PHASES if any(item.cell.phase == phase for item in found.pushes)]
    outer = max([item.survived or 0.0 for item in found.pushes] + [0.1])
    size = _INCH * len(phases), (_INCH + 0.4) * len(heights) + 0.4
    figure = Figure(figsize=size, dpi=110, layout="constrained")
    figure.suptitle(f"{found.title}; velocity change of a push of 0.1 s [m/s]", fontsize=9)
    plots = figure.subplots(len(heights), len(phases), squeeze=False, subplot_kw={"projection": "polar"})
    for row, height in zip(plots, heights, strict=True):
        for axes, phase in zip(row, phases, strict=True):
            items = [item for item in found.pushes if (item.cell.height, item.cell.phase) == (height, phase)]
            _plot(axes, items, outer)
            axes.set_title(f"{height}: {PHASE_NAMES[phase]}", fontsize=8, loc="center", y=1.12)
    return figure


def _plot(axes: Any, items: list[CellResult], outer: float) -> None:
    """One plot; a corner for every direction."""
    order = [item for name in _ANGLES for item in items if item.cell.direction == name]
    angles = [math.radians(_ANGLES[item.cell.direction]) for item in order]
    values = [item.survived or 0.0 for item in order]
    axes.plot([*angles, *angles[:1]], [*values, *values[:1]], "o-", color="#1f6fb4", lw=1.2, ms=3)
    axes.fill(angles, values, color="#1f6fb4", alpha=0.2)
    axes.set_ylim(0.0, 1.05 * outer)
    axes.set_xticks([math.radians(angle) for angle in _ANGLES.values()], list(_ANGLES), fontsize=7)
    axes.tick_params(axis="y", labelsize=6)
