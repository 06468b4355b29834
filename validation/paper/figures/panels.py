"""Panels that several figures share: plan, motion and simulation on the same axes, and their difference."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from validation.paper.figures.canvas import BAND, FAINT, MEASURED, MOTION, PLAN

Array = NDArray[np.float64]

Line = Any
"""A line style of matplotlib."""

SPREAD = "spread of the strides (no tolerance is set)"


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
    if planned is not None and tolerance is not None:
        axis.fill_between(
            time, planned - tolerance, planned + tolerance, color=BAND, alpha=0.6, linewidth=0, zorder=1
        )
    else:
        axis.fill_between(
            time, simulated.min(axis=0), simulated.max(axis=0), color=BAND, alpha=0.9, linewidth=0, zorder=2.5
        )
    if planned is not None:
        axis.plot(time, planned, color=PLAN, linewidth=4.4, label=f"plan{after}")
    axis.plot(time, motion, color=MOTION, linewidth=1.9, linestyle=line, label=f"inverse kinematics{after}")
    axis.plot(
        time, simulated.mean(axis=0), color=MEASURED, linewidth=0.9, linestyle=line, label=f"{source}{after}"
    )


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
    if tolerance is None:
        axis.fill_between(
            time, simulated.min(axis=0), simulated.max(axis=0), color=BAND, alpha=0.9, linewidth=0,
            label=f"{SPREAD}{note}",
        )  # fmt: skip
    else:
        axis.axhspan(
            -tolerance, tolerance, color=BAND, alpha=0.35, linewidth=0,
            label=f"tolerance of the RMSE: ± {tolerance:.3g} {unit}{note}",
        )  # fmt: skip
    axis.axhline(0.0, color=FAINT, linewidth=0.6)
    axis.plot(time, simulated.T, color=MEASURED, linewidth=0.5, alpha=0.55, linestyle=line)
    if motion is not None:
        axis.plot(time, motion, color=MOTION, linewidth=1.1, linestyle=line)
    # Several walks may share the panel.
    reach = max(float(np.abs(axis.dataLim.intervaly).max()), tolerance or 0.0)
    axis.set_ylim(-1.2 * reach, 1.2 * reach)


def band_legend(axis: Axes, columns: int = 1) -> None:
    """The bands' names over a panel of differences, each once."""
    handles, labels = axis.get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))
    axis.legend(
        unique.values(), unique, loc="lower left", bbox_to_anchor=(-0.01, 0.97), fontsize=7.5, borderpad=0.1,
        ncols=columns, handlelength=1.4, handletextpad=0.45, columnspacing=1.0, labelspacing=0.2,
    )  # fmt: skip
