"""Curves of compared walks over one another, from their saved runs."""

from collections.abc import Sequence
from itertools import cycle
from typing import NamedTuple

import numpy as np

from validation.show.run_figures import middle, shade_double_support
from validation.show.style import INK, PARTS, Picture, new_figure, picture, style
from validation.study.compare.comparison import Side

_COLORS = (*PARTS, INK)


class _Curve(NamedTuple):
    """A signal over two steps.

    Attributes:
        column: without its prefix.
        title: what it is.
        unit: in which it is drawn.
        scale: drawn value per SI value.
        is_error: whether the plan is subtracted; otherwise it is drawn, too, dashed.
    """

    column: str
    title: str
    unit: str
    scale: float = 1.0
    is_error: bool = False


_CURVES = [
    _Curve("zmp_x", "Error of ZMP x", "mm", 1e3, is_error=True),
    _Curve("zmp_y", "Error of ZMP y", "mm", 1e3, is_error=True),
    _Curve("com_x", "Error of COM x", "mm", 1e3, is_error=True),
    _Curve("com_y", "COM y", "mm", 1e3),
    _Curve("angular_momentum_x", "Angular momentum x about the COM", "N m s"),
    _Curve("angular_momentum_y", "Angular momentum y about the COM", "N m s"),
]


def draw_walks(sides: Sequence[Side]) -> tuple[list[tuple[str, str]], list[Picture]]:
    """Errors of the ZMP, COM and angular momentum of all walks.

    Returns:
        Name of every walk with its planner, and the colour of its curves; the pictures, without those of
        signals that no walk has.
    """
    names = [
        side.label if ", planner " in side.label else f"{side.label}, planner {side.planner}"
        for side in sides
    ]
    keys = list(zip(names, cycle(_COLORS), strict=False))
    with style():
        pictures = [
            _draw(sides, curve)
            for curve in _CURVES
            if any(np.isfinite(side.run.signals[f"measured_{curve.column}"]).any() for side in sides)
        ]
    return keys, pictures


def _draw(sides: Sequence[Side], curve: _Curve) -> Picture:
    """One signal of all walks, over two steps from the middle of each."""
    figure, (axis,) = new_figure(2.6)
    first = sides[0].run.signals
    shade_double_support(axis, first, middle(first), from_zero=True)
    for side, color in zip(sides, cycle(_COLORS), strict=False):
        signals = side.run.signals
        rows = middle(signals)
        time = signals.time[rows] - signals.time[rows.start]
        measured = curve.scale * signals[f"measured_{curve.column}"][rows]
        plan = curve.scale * signals[f"plan_{curve.column}"][rows]
        axis.plot(time, measured - plan if curve.is_error else measured, color=color, linewidth=1.0)
        if not curve.is_error:
            axis.plot(time, plan, color=color, linewidth=1.0, linestyle="--")
    axis.set(title=f"{curve.title}, two steps", xlabel="time [s]", ylabel=f"[{curve.unit}]")
    axis.margins(x=0)
    caption = "Measured minus planned." if curve.is_error else ""
    return picture(figure, f"{curve.title} of all walks", caption)
