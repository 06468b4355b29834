"""The look that the figures of reports and of the paper share, whatever their colours."""

from __future__ import annotations

from typing import Any


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
