"""Pictures of a sweep's report that need no script: distributions with their tolerance, and the first map."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator
from numpy.typing import NDArray

from validation.show.run_figures import BAD, FAINT, INK, PLAN, new_figure, to_svg
from validation.study.sweep.map_data import Axis
from validation.study.sweep.table import STATES, State

Array = NDArray[np.float64]

COLOURS: Mapping[State, str] = {state: f"#0102{number:02d}" for number, state in enumerate(STATES)}
"""Stand-ins, which :func:`svg` replaces by the page's ``--state-...``."""

MARKERS: Mapping[State, str] = {
    State.PASS: "o",
    State.OUT_OF_TOLERANCE: "s",
    State.NOT_MEASURED: "d",
    State.FELL: "v",
    State.DIVERGED: "^",
    State.INFEASIBLE: "X",
    State.REFUSED: ".",
    State.CRASHED: "P",
    State.TIMED_OUT: "*",
    State.INTERRUPTED: "p",
}
"""Shape beside colour, for eyes and printers that miss the second. The page's script draws the same."""

_ORDER = (
    State.REFUSED,
    State.PASS,
    State.INTERRUPTED,
    State.NOT_MEASURED,
    State.OUT_OF_TOLERANCE,
    State.INFEASIBLE,
    State.DIVERGED,
    State.FELL,
    State.TIMED_OUT,
    State.CRASHED,
)
"""From back to front: what is rare and bad on top."""
_BINS = 32


def svg(figure: Figure, name: str, label: str) -> str:
    """Inline SVG whose colours follow the page; see :func:`validation.show.run_figures.to_svg`."""
    text = to_svg(figure, name, label)
    for state, colour in COLOURS.items():
        text = text.replace(colour, f"var(--state-{state.value.replace('_', '-')})")
    return text


def distribution(values: Array, limit: float | None, unit: str, title: str) -> Figure:
    """Histogram of a figure over the completed runs, with its tolerance.

    Args:
        values: shape (N,); NaN and infinities are left out.
        limit: tolerance in ``unit``, None if it has none.
        unit: of values and axis.
        title: what it is.
    """
    figure, (axis,) = new_figure(1.9, width=3.6, left=0.45, top=0.32)
    known = values[np.isfinite(values)]
    axis.set_title(title)
    if not known.size:
        axis.text(0.5, 0.5, "no completed run", transform=axis.transAxes, ha="center", color=FAINT)
        axis.set_axis_off()
        return figure
    # A few runs far out must not squeeze all others into one bin; how many are beyond is written there.
    high = float(np.quantile(known, 0.99)) * 1.15
    if limit is not None and (known > limit).mean() < 0.5:
        high = max(high, 1.12 * limit) if high > 0.4 * limit else high
    low = 0.0 if known.min() >= 0.0 else float(known.min())
    high = max(high, low + 1e-300)
    edges = np.linspace(low, high, _BINS + 1)
    counts, _ = np.histogram(known, edges)
    width = edges[1] - edges[0]
    over = edges[:-1] >= limit if limit is not None else np.zeros(_BINS, dtype=bool)
    axis.bar(edges[:-1][~over], counts[~over], width, align="edge", color=PLAN, linewidth=0)
    axis.bar(edges[:-1][over], counts[over], width, align="edge", color=BAD, linewidth=0)
    top = max(int(counts.max()), 1)
    if limit is not None and limit <= high:
        axis.axvline(limit, color=INK, linewidth=1.2, linestyle="--")
        axis.annotate(
            f"limit {limit:.3g}", (limit, top * 1.12), xytext=(-3, 0), textcoords="offset points",
            ha="right", va="center", fontsize=8, color=INK,
        )  # fmt: skip
    elif limit is not None:
        axis.annotate(
            f"limit {limit:.3g} →", (1.0, 0.95), xycoords="axes fraction", ha="right", va="center",
            fontsize=8, color=FAINT,
        )  # fmt: skip
    beyond = int((known > high).sum())
    if beyond:
        axis.annotate(
            f"{beyond} beyond →", (1.0, 0.5), xycoords="axes fraction", ha="right", va="center", fontsize=8,
            color=FAINT,
        )  # fmt: skip
    axis.set_xlim(low, high)
    axis.set_ylim(0, top * 1.25)
    axis.grid(False, axis="x")
    axis.locator_params(axis="y", nbins=3, integer=True)
    axis.locator_params(axis="x", nbins=6)
    axis.set_xlabel(f"[{unit}]" if unit else "[1]")
    return figure


def static_map(x: Axis, y: Axis, states: NDArray[np.int64], rows: NDArray[np.int64]) -> Figure:
    """The first map without any script: one mark per run over two quantities.

    Args:
        x: quantity to the right; a level is spread a little, so that equal runs do not hide each other.
        y: quantity upwards.
        states: of all runs, shape (N,).
        rows: runs to draw.
    """
    figure, (axis,) = new_figure(4.6, width=7.2, left=0.75, top=0.12)
    rng = np.random.default_rng(0)
    position = []
    for quantity in (x, y):
        values = quantity.values[rows]
        high = quantity.range[1]
        values[np.isposinf(values)] = high
        if quantity.levels is not None:
            values += rng.uniform(-0.28, 0.28, len(values))
        position.append(values)
    for state in _ORDER:
        of_state = states[rows] == STATES.index(state)
        if of_state.any():
            axis.plot(
                position[0][of_state], position[1][of_state], MARKERS[state], color=COLOURS[state],
                linestyle="", markersize=4.5, markeredgewidth=0, alpha=0.85, label=state.label,
            )  # fmt: skip
    for quantity, which in ((x, axis.xaxis), (y, axis.yaxis)):
        which.set_label_text(f"{quantity.label} [{quantity.unit}]" if quantity.unit else quantity.label)
        if quantity.levels is not None:
            shown = range(0, len(quantity.levels), max(1, len(quantity.levels) // 12))
            which.set_major_locator(FixedLocator(list(shown)))
            which.set_ticklabels([quantity.levels[i] for i in shown])
            which.set_minor_locator(NullLocator())
    if y.limit is not None and y.levels is None:
        axis.axhline(y.limit, color=INK, linewidth=1.0, linestyle="--")
    return figure
