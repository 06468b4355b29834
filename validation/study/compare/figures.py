"""Curves of compared walks over one another, from their saved runs."""

from collections.abc import Sequence
from itertools import cycle
from typing import NamedTuple

import numpy as np

from ampm.geometry import Array
from validation.show.run_figures import middle, shade_double_support
from validation.show.style import (
    FAINT,
    INK,
    PARTS,
    Picture,
    decimate,
    new_figure,
    picture,
    style,
)
from validation.store.saved import SavedRun, load_saved_run
from validation.study.compare.comparison import Side

_COLORS = (*PARTS, INK)
_DASHED = (0, (4, 3))


class _Signal(NamedTuple):
    """A measured signal and its plan.

    Attributes:
        column: without its prefix.
        title: what it is.
        unit: in which it is drawn.
        scale: drawn value per SI value.
        travels: whether the mean travel of the plan is subtracted, because it would flatten the curve.
    """

    column: str
    title: str
    unit: str
    scale: float = 1.0
    travels: bool = False


_ERRORS = [_Signal(f"zmp_{axis}", f"ZMP {axis}", "mm", 1e3) for axis in "xy"]
_CURVES = [
    *(
        _Signal(f"angular_momentum_{axis}", f"Angular momentum {axis} about the COM", "N m s")
        for axis in "xy"
    ),
    _Signal("com_x", "COM x, less the mean travel of its plan", "mm", 1e3, travels=True),
    _Signal("com_y", "COM y", "mm", 1e3),
]


def draw_walks(sides: Sequence[Side]) -> tuple[list[tuple[str, str]], list[Picture]]:
    """Errors of the ZMP, angular momentum and COM of all walks.

    Returns:
        Name of every walk with its planner, and the colour of its curves; the pictures, without those of
        signals that no walk has.
    """
    runs = [load_saved_run(side.folder, check=False) for side in sides]
    names = [
        side.label if ", planner " in side.label else f"{side.label}, planner {side.planner}"
        for side in sides
    ]
    keys = [(name, color) for name, color in zip(names, cycle(_COLORS), strict=False)]
    with style():
        pictures = [_errors(runs, signal) for signal in _ERRORS if _is_measured(runs, signal)]
        pictures += [_curves(runs, signal) for signal in _CURVES if _is_measured(runs, signal)]
    return keys, pictures


def _is_measured(runs: Sequence[SavedRun], signal: _Signal) -> bool:
    return any(np.isfinite(run.signals[f"measured_{signal.column}"]).any() for run in runs)


def _errors(runs: Sequence[SavedRun], signal: _Signal) -> Picture:
    """Measured minus planned, over two steps and over the whole walk."""
    figure, (two_steps, whole) = new_figure(4.4, 2, ratios=[3, 2])
    for axis in (two_steps, whole):
        axis.axhline(0.0, color=FAINT, linewidth=0.7)
    shade_double_support(two_steps, runs[0].signals, middle(runs[0].signals), from_zero=True)
    for run, color in zip(runs, cycle(_COLORS), strict=False):
        signals, rows = run.signals, middle(run.signals)
        error = signal.scale * (signals[f"measured_{signal.column}"] - signals[f"plan_{signal.column}"])
        two_steps.plot(_from_zero(signals.time[rows]), error[rows], color=color, linewidth=1.0)
        whole.plot(*decimate(signals.time, error), color=color, linewidth=0.8)
    for axis, title in ((two_steps, "two steps"), (whole, "whole walk")):
        axis.set(title=f"Error of {signal.title}, {title}", xlabel="time [s]", ylabel=f"[{signal.unit}]")
        axis.margins(x=0)
    label = f"Error of {signal.title} of all walks"
    return picture(figure, label, "Measured minus planned. Two steps from the middle.")


def _curves(runs: Sequence[SavedRun], signal: _Signal) -> Picture:
    """Measurement and plan over two steps."""
    figure, (axis,) = new_figure(2.6)
    shade_double_support(axis, runs[0].signals, middle(runs[0].signals), from_zero=True)
    for run, color in zip(runs, cycle(_COLORS), strict=False):
        signals, rows = run.signals, middle(run.signals)
        time = _from_zero(signals.time[rows])
        plan, measured = (signals[f"{kind}_{signal.column}"][rows] for kind in ("plan", "measured"))
        base = np.linspace(plan[0], plan[-1], len(plan)) if signal.travels else 0.0
        axis.plot(time, signal.scale * (measured - base), color=color, linewidth=1.0)
        axis.plot(time, signal.scale * (plan - base), color=color, linewidth=1.0, linestyle=_DASHED)
    axis.set(title=f"{signal.title}, two steps", xlabel="time [s]", ylabel=f"[{signal.unit}]")
    axis.margins(x=0)
    return picture(figure, f"{signal.title} of all walks, planned and measured")


def _from_zero(time: Array) -> Array:
    return time - time[0]
