"""Pictures of a sweep: where it passes, how much of the tolerances its runs use, and all judged metrics."""

import math
from collections.abc import Mapping
from itertools import cycle
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ampm.geometry import Array
from validation.judge.metrics import METRICS
from validation.show.chart import DASHED, Picture, new_charts, numbered
from validation.show.style import BAD, INK, PARTS
from validation.study.sweep.table import RunState, SweepTable, short_names
from validation.table import short_unit

Groups = Mapping[str, tuple[NDArray[np.bool_], str]]
"""Rows and colour of each kind of points, by what the legend says."""
MOST_POINTS = 2000
"""Runs in a picture at most: all, or a random sample."""
_MOST_KEYS, _MOST_USED = 6, 1000.0  # parameters that are drawn; largest share of a tolerance [%]
_SIZES = (6.5, 3.5)  # diameters of the dots of the first and last kind, so that none hides another [pt]
_COLORS: Mapping[RunState, str] = {
    RunState.PASS: "#0072b2",
    RunState.OUT_OF_TOLERANCE: "#e69f00",
    RunState.NOT_MEASURED: "#7d8590",
    RunState.FELL: "#d0480f",
    RunState.DIVERGED: "#a8327d",
    RunState.INFEASIBLE: "#6b4226",
    RunState.REFUSED: "#c3c9d1",
    RunState.CRASHED: "#111418",
    RunState.TIMED_OUT: "#6a51a3",
}


class Axis(NamedTuple):
    """A quantity of all runs."""

    label: str  # with its unit
    values: Array  # shape (N,), NaN where absent
    ticks: Mapping[str, float] = {}  # texts at their places; empty for numbers
    limit: float = math.nan  # the least of all runs; NaN without one


def texts(sweep: SweepTable) -> dict[str, list[str]]:
    """Distinct values of the varied parameters with texts."""
    values = {key: sweep.values(key) for key in sweep.varied}
    return {key: np.unique(found).tolist() for key, found in values.items() if found.dtype.kind == "U"}


def draw_sweep(sweep: SweepTable) -> list[Picture]:
    """Two varied parameters; then shares of the tolerances over each, and each metric over the first number.

    Colours are those of the states, or in the latter of the values of a text, if one varies.
    """
    drawn = np.zeros(len(sweep), dtype=bool)
    drawn[np.random.default_rng(1).permutation(len(sweep))[:MOST_POINTS]] = True
    axes = [_axis(sweep, key) for key in sweep.varied[:_MOST_KEYS]]
    states: Groups = {state.label: (drawn & sweep.is_state(state), _COLORS[state]) for state in RunState}
    pictures = [_scatter(axes[0], axes[1], states)] if len(axes) > 1 else []
    groups = states
    if len(named := texts(sweep)) == 1:
        ((key, names),) = named.items()
        shown_as = zip(names, short_names(names), cycle((*PARTS, INK)), strict=False)
        groups = {short: (drawn & (sweep.values(key) == name), color) for name, short, color in shown_as}
    used = np.minimum(100.0 * sweep.worst_used, _MOST_USED)
    more = f" (more at {_MOST_USED:g})" if (100.0 * sweep.worst_used > _MOST_USED).any() else ""
    share = Axis(f"largest share of a tolerance{more} [%]", used, limit=100.0)
    first = [axis for axis in axes if not axis.ticks][:1] or axes[:1]
    checks = {item.name for item in METRICS.values() if item.kind == "instrument"}
    shown = [(sweep.label(name), *sweep.shown(name)) for name in sweep.judged if name not in checks]
    metrics = [
        Axis(f"{label} [{short_unit(unit)}]", values, limit=float(np.fmin.reduce(limits)))
        for label, values, limits, unit in shown
    ]
    pairs = [*((axis, share) for axis in axes), *((axis, y) for axis in first for y in metrics)]
    pictures += [_scatter(x, y, groups) for x, y in pairs if np.isfinite(x.values + y.values).any()]
    return numbered(pictures)


def _axis(sweep: SweepTable, key: str) -> Axis:
    """A varied parameter; texts are numbered."""
    values, unit = sweep.values(key), sweep.unit(key)
    if values.dtype.kind != "U":
        return Axis(key if unit == "1" else f"{key} [{unit}]", values.astype(float))
    found, places = np.unique(values, return_inverse=True)
    names = short_names(found.tolist())
    return Axis(key, places.astype(float), {name: float(place) for place, name in enumerate(names)})


def _scatter(x: Axis, y: Axis, groups: Groups) -> Picture:
    """Runs over two quantities."""
    (chart,) = charts = new_charts(3.2, left=1.0)
    known = np.isfinite(x.values + y.values)
    if math.isfinite(y.limit):
        chart.level(y.limit, BAD, dash=DASHED)
    shown = {name: (mine, color) for name, (rows, color) in groups.items() if (mine := rows & known).any()}
    sizes = np.linspace(*_SIZES, len(shown))
    for size, (name, (mine, color)) in zip(sizes, shown.items(), strict=True):
        chart.line([np.nan], [np.nan], color, 3.0, label=name)  # for the legend
        chart.dots(x.values[mine], y.values[mine], color, float(size))
    low, high = chart.limits()
    margin = 0.5 if x.ticks else 0.05 * (high - low)[0]
    chart.xlim = float(low[0] - margin), float(high[0] + margin)
    chart.xticks, chart.yticks = dict(x.ticks), dict(y.ticks)
    (name, _, unit), (over, *_) = y.label.partition("["), x.label.partition(" [")
    chart.name(name if unit else "", f"[{unit}" if unit else name, x.label)
    chart.top = max(chart.top, chart.heading_height() + 4.0)
    return Picture(charts, f"runs: {name.strip()} over {over}")
