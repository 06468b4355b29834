"""Picture of a sweep's report in Vega-Lite: a scatter over any two quantities.

The page carries data, specification and the library itself (vl-convert has the script), so that it works
offline.
"""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from markupsafe import Markup

from ampm.geometry import Array
from validation.show.chart import Picture, new_charts
from validation.show.text import format_value
from validation.study.sweep.table import REPORT, RunState, SweepTable

Spec = dict[str, Any]

MOST_POINTS = 2000
"""Runs in the picture at most: all, or a random sample."""
LABEL = "Runs over two quantities"
"""What the picture shows."""
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
_CONFIG: Spec = {
    "font": "system-ui, -apple-system, Roboto, DejaVu Sans, sans-serif",
    "axis": {"labelFontSize": 12},
    "legend": {"labelFontSize": 12, "orient": "bottom", "title": None, "columns": 7, "symbolOpacity": 1},
}


def quantities(sweep: SweepTable) -> dict[str, Array]:
    """Varied parameters and judged metrics as numbers, by label, shape (N,) each; NaN where absent.

    A parameter with texts is the number of its value among :func:`texts`.
    """
    found: dict[str, Array] = {}
    for key in sweep.varied:
        values, unit = sweep.values(key), sweep.unit(key).replace("1", "")
        if values.dtype.kind == "U":
            values = np.unique(values, return_inverse=True)[1]
        found[f"{key} [{unit}]" if unit else key] = values.astype(float)
    found["largest share of a tolerance [%]"] = np.minimum(100.0 * sweep.worst_used, 1000.0)
    for metric in sweep.judged:
        values, _, unit = sweep.shown(metric)
        found[f"{sweep.label(metric)} [{unit}]"] = values
    return {label: values for label, values in found.items() if np.isfinite(values).any()}


def texts(sweep: SweepTable) -> dict[str, list[str]]:
    """Distinct values of the varied parameters with texts, in the order of their numbers."""
    values = {key: sweep.values(key) for key in sweep.varied}
    return {key: np.unique(found).tolist() for key, found in values.items() if found.dtype.kind == "U"}


def links_of(sweep: SweepTable) -> dict[int, str]:
    """Row to the address of its report, relative to the page, of every kept run."""
    if sweep.directory is None:
        return {}
    addresses = {row: f"{name}/{REPORT}" for row, name in enumerate(sweep.words("recording")) if name}
    return {row: address for row, address in addresses.items() if (sweep.directory / address).is_file()}


def run_data(sweep: SweepTable) -> list[dict[str, Any]]:
    """Name, outcome, parameters, link and all quantities of the runs that are drawn."""
    rows = np.sort(np.random.default_rng(1).permutation(len(sweep))[:MOST_POINTS])
    names, drawn, links = sweep.words("name"), quantities(sweep), links_of(sweep)
    parameters = sweep.table.select(sweep.varied).take(rows).to_pylist()
    found = []
    for row, varied in zip(rows.tolist(), parameters, strict=True):
        item = {
            "run": names[row],
            "outcome": sweep.states[row].label,
            "parameters": ", ".join(f"{key} {format_value(value)}" for key, value in varied.items()),
            "link": links.get(row),
        }
        for label, values in drawn.items():
            item[label] = float(f"{values[row]:.5g}") if np.isfinite(values[row]) else None
        found.append(item)
    return found


def scatter(sweep: SweepTable) -> Spec:
    """Runs over two quantities, which the page lets choose; a point of a kept run links to its report."""
    labels = list(quantities(sweep))
    params, encoding = [], {}
    for name, words, label in (("x", "right:", labels[0]), ("y", "up:", labels[min(1, len(labels) - 1)])):
        choice = {"input": "select", "options": labels, "name": f"{words} "}
        params.append({"name": name, "value": label, "bind": choice})
        scale = {"zero": False, "padding": 12}
        named = f"isArray(texts[{name}]) ? texts[{name}][datum.value] || '' : datum.label"
        encoding[name] = {
            "field": f"at_{name}",
            "type": "quantitative",
            "title": None,
            "scale": scale,
            "axis": {"labelExpr": named, "labelLimit": 200},
        }
    return {
        "params": [*params, {"name": "texts", "value": texts(sweep)}],
        "transform": [
            {"calculate": "datum[x]", "as": "at_x"},
            {"calculate": "datum[y]", "as": "at_y"},
            {"filter": "isValid(datum.at_x) && isValid(datum.at_y)"},
        ],
        "mark": {"type": "point", "filled": True, "size": 55, "opacity": 0.8},
        "encoding": {
            **encoding,
            "color": _color(sweep),
            "href": {"condition": {"test": "isValid(datum.link)", "field": "link"}},
            "tooltip": [{"field": field} for field in ("run", "outcome", "parameters")],
        },
        "width": "container",
        "height": 400,
        "config": _CONFIG,
    }


def _color(sweep: SweepTable) -> Spec:
    """Encoding of the outcome."""
    present = [state for state in RunState if sweep.counts[state]]
    scale = {"domain": [state.label for state in present], "range": [_COLORS[state] for state in present]}
    return {"field": "outcome", "type": "nominal", "scale": scale}


def as_json(spec: Any) -> Markup:
    """A specification, or data, for a script element, which no text in it can end."""
    text = json.dumps(spec, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return Markup(text.replace("<", "\\u003c"))


def scatter_picture(sweep: SweepTable) -> Picture:
    """The page's picture with its first choices, for a paper."""
    labels = list(quantities(sweep))
    first, second = labels[0], labels[min(1, len(labels) - 1)]
    runs = [run for run in run_data(sweep) if run[first] is not None and run[second] is not None]
    (chart,) = charts = new_charts(3.2, left=1.0)
    for state in RunState:
        points = [(run[first], run[second]) for run in runs if run["outcome"] == state.label]
        if points:
            x, y = np.transpose(points)
            chart.line([np.nan], [np.nan], _COLORS[state], 3.0, label=state.label)  # for the legend
            chart.dots(x, y, _COLORS[state], 4.0)
    low, high = chart.limits()
    margin = 0.05 * (high - low)[0]
    chart.xlim = float(low[0] - margin), float(high[0] + margin)
    words = {key: dict(zip(found, range(len(found)), strict=True)) for key, found in texts(sweep).items()}
    chart.xticks, chart.yticks = words.get(first, {}), words.get(second, {})
    chart.name("", second, first)
    return Picture(charts, LABEL, number=1)


def vega_script() -> Markup:
    """Script of Vega, Vega-Lite and Vega-Embed, to be put into a page."""
    import vl_convert  # loads a JavaScript engine

    bundle = vl_convert.javascript_bundle("window.vegaEmbed = vegaEmbed;")
    return Markup(bundle.replace("</script", "<\\/script"))
