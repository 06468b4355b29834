"""Pictures of a sweep's report in Vega-Lite: the map of its runs, distributions with their tolerance.

The page carries data, specification and the library itself (vl-convert has the script), so that it works
offline. Colours are the page's CSS variables: light and dark need no second picture.
"""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup, escape
from numpy.typing import NDArray

from ampm.geometry import Array
from validation.judge.metrics import metric_label
from validation.study.sweep.table import BROKEN, STATES, State, SweepTable

Rows = NDArray[np.int64]
Mask = NDArray[np.bool_]
Spec = dict[str, Any]

MOST_POINTS, MOST_OF_RARE = 3000, 150
"""Largest number of single runs in the page, and the least of each state among them."""
MOST_STILL = 400
"""Points of the map without scripts."""
MOST_LEVELS = 24
"""Distinct values up to which an axis shows them as levels."""
BINS = 32
_CROSS = "M-.9,-.5L-.5,-.9L0,-.4L.5,-.9L.9,-.5L.4,0L.9,.5L.5,.9L0,.4L-.5,.9L-.9,.5L-.4,0Z"
_STAR = "M0,-1L.25,-.3L1,-.3L.4,.15L.6,.9L0,.45L-.6,.9L-.4,.15L-1,-.3L-.25,-.3Z"
SHAPES: Mapping[State, str] = {
    State.REFUSED: "circle",
    State.PASS: "circle",
    State.INTERRUPTED: "triangle-left",
    State.NOT_MEASURED: "diamond",
    State.OUT_OF_TOLERANCE: "square",
    State.INFEASIBLE: _CROSS,
    State.DIVERGED: "triangle-up",
    State.FELL: "triangle-down",
    State.TIMED_OUT: _STAR,
    State.CRASHED: "cross",
}
"""Shapes beside colours, to be told apart without colour; from back to front."""
_TEXT = {
    "labelColor": "var(--ink)",
    "titleColor": "var(--ink)",
    "titleFontWeight": "normal",
    "titleFontSize": 12,
}
_AXIS = {"gridColor": "var(--grid)", "domainColor": "var(--line)", "tickColor": "var(--line)"}
_CONFIG: Spec = {
    "background": None,
    "font": "system-ui, -apple-system, Roboto, DejaVu Sans, sans-serif",
    "view": {"stroke": None},
    "axis": {**_TEXT, **_AXIS, "labelFontSize": 12, "labelLimit": 130, "labelSeparation": 12},
    "legend": {
        **_TEXT,
        "orient": "bottom",
        "title": None,
        "titleLimit": 600,
        "labelFontSize": 13,
        "symbolSize": 90,
        "columns": 7,
    },
    "title": {"color": "var(--ink)", "fontWeight": "normal", "anchor": "start", "fontSize": 12},
    "rule": {"color": "var(--ink)", "strokeDash": [6, 4]},
    "text": {"color": "var(--ink)", "fontSize": 11},
}


@dataclass(frozen=True)
class Axis:
    """One quantity that the map can show.

    Attributes:
        key: of a parameter, or ``metric:<name>``, ``used``.
        label: displayed name.
        unit: of ``values``, empty if none.
        values: shape (N,), NaN where absent; index of the level where ``levels`` is not None.
        levels: names of the levels, None for a range.
        parameter: whether it is a parameter, else a metric.
        limit: tolerance in ``unit``, None if it has none.
    """

    key: str
    label: str
    unit: str
    values: Array
    levels: tuple[str, ...] | None = None
    parameter: bool = False
    limit: float | None = None

    def column(self, rows: Rows) -> list[Any]:
        """Values of some runs: parameters with every digit, metrics with four; None where absent."""
        values = self.values[rows].tolist()
        if self.levels is not None:
            return [None if np.isnan(v) else self.levels[int(v)] for v in values]
        return [(v if self.parameter else float(f"{v:.4g}")) if np.isfinite(v) else None for v in values]

    def channels(self, name: str, field: str) -> Spec:
        """Vega-Lite's encoding of this quantity along ``x`` or ``y``."""
        shown: Spec = {"field": field, "title": f"{self.label} [{self.unit}]" if self.unit else self.label}
        if self.levels is None:
            finite = self.values[np.isfinite(self.values)]
            low, high = float(finite.min()), float(finite.max())
            ends = [low, high if high > low else low + (abs(low) or 1.0)]
            scale: Spec = {"domain": ends, "nice": False, "padding": 9}
            return {name: {**shown, "type": "quantitative", "scale": scale}}
        order = list(self.levels if name == "x" else self.levels[::-1])
        shown |= {"type": "ordinal", "scale": {"domain": order}, "sort": order}
        # Runs on a level are spread over its band, so that all are visible.
        spread = {"field": f"{name}Offset", "type": "quantitative", "scale": {"domain": [-0.3, 1.3]}}
        return {name: {**shown, "axis": {"labelAngle": 0, "grid": False}}, f"{name}Offset": spread}


def parameter_axis(sweep: SweepTable, key: str) -> Axis:
    """A parameter as an axis: levels if it has texts or few values, else a range."""
    values, unit = sweep.values(key), sweep.unit(key).replace("1", "")
    distinct, index = np.unique(values, return_inverse=True)
    if values.dtype.kind == "U":
        return Axis(key, key, "", index.astype(float), tuple(distinct.tolist()), True)
    if len(distinct) <= MOST_LEVELS and (len(distinct) <= len(sweep) / 2 or not np.isfinite(distinct).all()):
        names = tuple(f"{value:.6g}" for value in distinct if not np.isnan(value))
        return Axis(key, key, unit, np.where(np.isnan(values), np.nan, index), names, True)
    return Axis(key, key, unit, values, None, True)


MOST_USED = 1000.0
"""Share at which the map draws a limit of zero that was passed [%]: its own share is infinite."""


def metric_axes(sweep: SweepTable) -> list[Axis]:
    """Judged metrics as axes or colours, in display units; first the worst of them all."""
    used = np.minimum(100.0 * sweep.worst_used, MOST_USED)  # NaN stays
    found = [Axis("used", "largest share of a tolerance", "%", used, limit=100.0)]
    for metric in sweep.judged:
        values, limit, unit = sweep.shown(metric)
        unit = unit.replace("of body weight", "BW")
        found.append(Axis(f"metric:{metric}", metric_label(metric), unit, values, limit=limit))
    return [axis for axis in found if np.isfinite(axis.values).any()]


def drawn_rows(sweep: SweepTable, keep: Sequence[int]) -> tuple[Rows, Mask]:
    """Runs that are single points in the page: all, or a random sample and some of every state.

    Args:
        sweep: the sweep.
        keep: rows to take in any case.

    Returns:
        Rows from the state in the back of the map to that in front, and which of them are of the draw: the
        others do not count in shares. Both of shape (n,).
    """
    place = np.array([list(SHAPES).index(state) for state in STATES])
    order = np.random.default_rng(1).permutation(len(sweep))
    draw, beside = order, order[:0]
    if len(order) > MOST_POINTS:
        rare = [order[sweep.states[order] == state][:MOST_OF_RARE] for state in range(len(STATES))]
        beside = np.unique(np.concatenate([np.asarray(keep, dtype=np.int64), *rare]))
        draw = order[: MOST_POINTS - len(np.setdiff1d(beside, order[:MOST_POINTS]))]
    rows = np.union1d(draw, beside)
    rows = rows[np.argsort(place[sweep.states[rows]], kind="stable")]
    return rows, np.isin(rows, draw)


def points(present: Sequence[State]) -> Spec:
    """The map as points, without data and axes: tooltips of runs, and a legend that switches states.

    Args:
        present: states to show, from back to front.
    """
    names = [state.label for state in present]
    colours = [f"var(--state-{state.value.replace('_', '-')})" for state in present]
    outcome = {"field": "outcome", "type": "nominal"}
    pick = {"type": "point", "fields": ["row"], "on": "click", "nearest": True, "toggle": False}
    shown = {"type": "point", "fields": ["outcome"], "toggle": "true"}
    edge = [{"param": name, "empty": False, "value": "var(--pick)"} for name in ("pick", "hover")]
    layer = {
        "mark": {"type": "point", "filled": True, "opacity": 0.85, "strokeWidth": 2.5},
        "params": [
            {"name": "pick", "select": pick},
            {"name": "hover", "select": {**pick, "on": "pointermove", "clear": "pointerout"}},
            {"name": "shown", "select": shown, "bind": "legend", "value": [{"outcome": n} for n in names]},
        ],
        "encoding": {
            "color": {**outcome, "scale": {"domain": names, "range": colours}},
            "shape": {**outcome, "scale": {"domain": names, "range": [SHAPES[s] for s in present]}},
            "size": {"condition": {"test": "datum.outcome == 'refused'", "value": 16}, "value": 52},
            "stroke": {"condition": edge, "value": None},
        },
    }
    spread = [
        {"calculate": f"datum.row * {step} % 1", "as": name}
        for name, step in (("xOffset", 0.7548776662), ("yOffset", 0.5698402910))
    ]
    transform = [*spread, {"filter": {"param": "shown"}}]
    return {"config": _CONFIG, "width": "container", "transform": transform, "layer": [layer]}


def map_data(
    sweep: SweepTable,
    axes: Sequence[Axis],
    links: Mapping[int, Sequence[tuple[str, str]]],
    repeat: tuple[str, str],
    keep: Sequence[int],
) -> Spec:
    """Input of the page's script, ready for JSON.

    Args:
        sweep: the sweep.
        axes: quantities, the two of the first map first.
        links: text and address, relative to the page, of the kept files of a row.
        repeat: beginning and end of the command that walks a run again; the varied keys go between.
        keep: rows that must be among the points.
    """
    rows, counted = drawn_rows(sweep, keep)
    states = [sweep.state(row) for row in rows]
    names, causes, reasons = (sweep.words(name) for name in ("name", "cause", "reason"))
    columns = {
        "row": rows.tolist(),
        "run": [names[row] for row in rows],
        "outcome": [state.label for state in states],
        "pass": [
            int(state is State.PASS) if fair and state not in BROKEN else None
            for state, fair in zip(states, counted.tolist(), strict=True)
        ],
        "why": [(causes[row] or reasons[row].replace("_", " "))[:240] for row in rows],
        **{f"a{number}": axis.column(rows) for number, axis in enumerate(axes)},
    }
    entries = []
    for number, axis in enumerate(axes):
        field = f"a{number}"
        channels = {name: axis.channels(name, field) for name in ("x", "y")}
        entries.append({**vars(axis), "field": field, **channels})
        del entries[-1]["values"]
    return {
        "total": len(sweep),
        "spec": points([state for state in SHAPES if sweep.counts[state]]),
        "columns": columns,
        "links": {str(row): links[row] for row in rows.tolist() if row in links},
        "repeat": repeat,
        "axes": entries,
    }


def still_map(data: Spec, label: str) -> Markup:
    """The first map without scripts, as SVG: at most :data:`MOST_STILL` runs."""
    columns, x, y = data["columns"], data["axes"][0], data["axes"][min(1, len(data["axes"]) - 1)]
    names, step = ("row", "outcome", x["field"], y["field"]), -(-len(columns["row"]) // MOST_STILL)
    rows = zip(*(columns[name][::step] for name in names), strict=True)
    (layer,) = data["spec"]["layer"]
    layer = {**layer, "encoding": {**layer["encoding"], **x["x"], **y["y"]}}
    values = {"values": [dict(zip(names, row, strict=True)) for row in rows]}
    return svg({**data["spec"], "width": 640, "height": 400, "data": values, "layer": [layer]}, label)


def distribution(values: Array, limit: float | None, unit: str, title: str) -> Markup:
    """Histogram of a metric over the completed runs, with its tolerance, as SVG.

    Args:
        values: shape (N,); NaN and infinities are left out.
        limit: tolerance in ``unit``, None if it has none.
        unit: of values and axis.
        title: what it is.
    """
    known, unit = values[np.isfinite(values)], unit.replace("of body weight", "BW")
    # Few outliers must not put all others into one bin: the number beyond is written at the edge.
    low, high = min(0.0, float(known.min())), float(np.quantile(known, 0.99)) * 1.15
    if limit is not None and high > 0.4 * limit and (known > limit).mean() < 0.5:
        high = max(high, 1.12 * limit)
    high = high if high > low else low + 1.0
    counts, edges = np.histogram(known, np.linspace(low, high, BINS + 1))
    broken = limit is not None and bool((known > limit).any())
    bars = [
        {"low": a, "high": b, "runs": int(n), "over": broken and limit is not None and a >= limit}
        for (a, b), n in zip(itertools.pairwise(edges.tolist()), counts, strict=True)
    ]
    beyond, scale = int((known > edges[-1]).sum()), {"domain": [low, float(edges[-1])], "nice": False}
    x = {"field": "low", "bin": "binned", "type": "quantitative", "title": f"[{unit or 1}]", "scale": scale}
    ticks = {"tickCount": 3, "tickMinStep": 1, "format": "d"}
    y = {"field": "runs", "type": "quantitative", "title": None, "axis": ticks}
    colour = {"condition": {"test": "datum.over", "value": "var(--bad)"}, "value": "var(--plan)"}
    x["axis"] = {"grid": False, "tickCount": 6}
    encoding = {"x": x, "x2": {"field": "high"}, "y": y, "color": colour}
    layers: list[Spec] = [{"mark": {"type": "bar", "binSpacing": 0}, "encoding": encoding}]
    text: Spec = {"type": "text", "align": "right"}
    marks: list[tuple[Any, Spec]] = []
    if limit is not None:  # a line with its value; an arrow at the edge if it is beyond
        at = {"x": {"datum": min(limit, float(edges[-1]))}}
        arrow = " →" if limit > edges[-1] else ""
        side = {"dx": -4} if limit > low else {"dx": 4, "align": "left"}
        marks = [({**text, **side, "y": 6, "text": f"limit {limit:.3g}{arrow}"}, at)]
        marks += [] if arrow else [("rule", at)]
    if beyond:
        marks.append(({**text, "x": 300, "y": 22, "color": "var(--faint)", "text": f"{beyond} beyond →"}, {}))
    layers += [{"data": {"values": [{}]}, "mark": mark, "encoding": at} for mark, at in marks]
    size = {"config": _CONFIG, "width": 300, "height": 120}
    return svg(
        {**size, "title": title, "data": {"values": bars}, "layer": layers}, f"Distribution of {title}"
    )


def svg(spec: Spec, label: str) -> Markup:
    """Draw a specification as inline SVG, as wide as the page gives it, with a text for screen readers."""
    import vl_convert  # loads a JavaScript engine

    spec = {**spec, "config": {**_CONFIG, "aria": False}}
    text = vl_convert.vegalite_to_svg(json.dumps(spec))
    named = f' role="img" aria-label="{escape(label)}"'
    return Markup(re.sub(r' width="[\d.]+" height="[\d.]+"', named, text, count=1))


def vega_script() -> Markup:
    """Script of Vega, Vega-Lite and Vega-Embed, to be put into a page."""
    import vl_convert  # loads a JavaScript engine

    return Markup(
        vl_convert.javascript_bundle("window.vegaEmbed = vegaEmbed;").replace("</script", "<\\/script")
    )
