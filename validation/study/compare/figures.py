"""Curves of compared walks over one another, from their saved runs."""

from collections.abc import Sequence
from itertools import cycle

import numpy as np

from validation.judge.compare import SIGNALS
from validation.judge.metrics import display_unit
from validation.show.chart import DASHED, Picture, decimate, new_charts, numbered
from validation.show.run_figures import middle, shade_double_support
from validation.show.style import INK, PARTS
from validation.study.compare.comparison import Side

_COLORS = (*PARTS, INK)
_ERRORS = ("zmp_x", "zmp_y", "com_x", "com_y")
"""Signals of which measured minus planned is drawn; of the others both, the plan dashed."""
_CURVES = ("angular_momentum_x", "angular_momentum_y")


def draw_walks(sides: Sequence[Side]) -> tuple[list[tuple[str, str]], list[Picture]]:
    """Errors of the ZMP, COM and angular momentum of all walks.

    Returns:
        Label of every walk, and the colour of its curves; the pictures, without those of
        signals that no walk has.
    """
    keys = list(zip([side.label for side in sides], cycle(_COLORS), strict=False))
    pictures = [
        _draw(sides, name)
        for name in (*_ERRORS, *_CURVES)
        if any(np.isfinite(side.run.signals[f"measured_{name}"]).any() for side in sides)
    ]
    return keys, numbered(pictures)


def _draw(sides: Sequence[Side], name: str) -> Picture:
    """One signal of all walks, over two steps from the middle of each."""
    (chart,) = charts = new_charts(2.6)
    is_error = name in _ERRORS
    scale, unit = display_unit(SIGNALS[name].unit, 1.0)
    first = sides[0].run.signals
    for side, color in zip(sides, cycle(_COLORS), strict=False):
        signals = side.run.signals
        rows = middle(signals)
        time = signals.time[rows] - signals.time[rows.start]
        measured, plan = scale * signals[f"measured_{name}"][rows], scale * signals[f"plan_{name}"][rows]
        chart.line(*decimate(time, measured - plan if is_error else measured), color, label=side.label)
        if not is_error:
            chart.line(*decimate(time, plan), color, dash=DASHED)
    shade_double_support(chart, first, middle(first), from_zero=True)
    title = f"{'Error of ' if is_error else ''}{SIGNALS[name].label}"
    chart.title, chart.xlabel, chart.ylabel = f"{title}, two steps", "time [s]", f"[{unit}]"
    chart.top = max(chart.top, chart.heading_height() + 4.0)
    caption = "Measured minus planned." if is_error else "Measured; dashed: the plan of each."
    return Picture(charts, f"{title} of all walks", caption)
