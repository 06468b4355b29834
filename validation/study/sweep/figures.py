"""Pictures of a sweep: where it passes, and how much of the tolerances its runs use."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ampm.geometry import Array
from validation.show.chart import Picture, new_charts, numbered
from validation.study.sweep.table import REPORT, RunState, SweepTable

MOST_POINTS = 2000
"""Runs in a picture at most: all, or a random sample."""
_MOST_KEYS, _MOST_USED = 6, 1000.0  # parameters that are drawn; largest share of a tolerance [%]
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
    ticks: Mapping[str, float]  # texts at their places; empty for numbers


def texts(sweep: SweepTable) -> dict[str, list[str]]:
    """Distinct values of the varied parameters with texts."""
    values = {key: sweep.values(key) for key in sweep.varied}
    return {key: np.unique(found).tolist() for key, found in values.items() if found.dtype.kind == "U"}


def links_of(sweep: SweepTable) -> dict[int, str]:
    """Row to the address of its report, relative to the page, of every kept run."""
    if sweep.directory is None:
        return {}
    addresses = {row: f"{name}/{REPORT}" for row, name in enumerate(sweep.words("recording")) if name}
    return {row: address for row, address in addresses.items() if (sweep.directory / address).is_file()}


def draw_sweep(sweep: SweepTable) -> list[Picture]:
    """The first two varied parameters over one another, then shares of the tolerances over each of them."""
    rows = np.sort(np.random.default_rng(1).permutation(len(sweep))[:MOST_POINTS])
    axes = [_axis(sweep, key) for key in sweep.varied[:_MOST_KEYS]]
    used = Axis("largest share of a tolerance [%]", np.minimum(100.0 * sweep.worst_used, _MOST_USED), {})
    pairs = [*([tuple(axes[:2])] if len(axes) > 1 else []), *((axis, used) for axis in axes)]
    return numbered(_scatter(sweep, rows, x, y) for x, y in pairs if np.isfinite(x.values + y.values).any())


def _axis(sweep: SweepTable, key: str) -> Axis:
    """A varied parameter; texts are numbered."""
    values, unit = sweep.values(key), sweep.unit(key).replace("1", "")
    if values.dtype.kind != "U":
        return Axis(f"{key} [{unit}]" if unit else key, values.astype(float), {})
    names, places = np.unique(values, return_inverse=True)
    return Axis(key, places.astype(float), {name: float(place) for place, name in enumerate(names.tolist())})


def _scatter(sweep: SweepTable, rows: NDArray[np.intp], x: Axis, y: Axis) -> Picture:
    """Runs over two quantities."""
    (chart,) = charts = new_charts(3.2, left=1.0)
    known = np.isfinite(x.values + y.values)
    for state, color in _COLORS.items():
        mine = rows[(known & sweep.is_state(state))[rows]]
        if mine.size:
            chart.line([np.nan], [np.nan], color, 3.0, label=state.label)  # for the legend
            chart.dots(x.values[mine], y.values[mine], color, 4.0)
    low, high = chart.limits()
    margin = 0.05 * (high - low)[0]
    chart.xlim = float(low[0] - margin), float(high[0] + margin)
    chart.xticks, chart.yticks = dict(x.ticks), dict(y.ticks)
    chart.name("", y.label, x.label)
    named = [axis.label.partition(" [")[0] for axis in (y, x)]
    return Picture(charts, f"runs: {' over '.join(named)}")
