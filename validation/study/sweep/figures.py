"""Pictures of a sweep's report in Vega-Lite: scatter, parallel coordinates, distributions.

The page carries data, specification and the library itself (vl-convert has the script), so that it works
offline. Colours are the CSS variables of the page.
"""

import json
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup, escape
from numpy.typing import NDArray

from ampm.geometry import Array
from validation.study.sweep.table import STATES, SweepTable

Spec = dict[str, Any]

MOST_POINTS = 2000
"""Runs in a picture at most: all, or a random sample and the rows that are named."""
MOST_AXES = 9
"""Axes of the parallel coordinates at most."""
BINS = 32
HUES = tuple(f"var(--{name})" for name in ("part-1", "part-2", "part-3", "part-4", "left", "right"))
"""Colours of the values of a parameter with texts."""
WITHIN, OVER = "within the limit", "over the limit"
_AXIS = {"gridColor": "var(--grid)", "domainColor": "var(--line)", "tickColor": "var(--line)"}
_TEXT = {"labelColor": "var(--ink)", "titleColor": "var(--ink)", "titleFontWeight": "normal"}
_CONFIG: Spec = {
    "background": None,
    "font": "system-ui, -apple-system, Roboto, DejaVu Sans, sans-serif",
    "view": {"stroke": None},
    "axis": {**_TEXT, **_AXIS, "labelFontSize": 12, "titleFontSize": 12},
    "legend": {**_TEXT, "orient": "bottom", "title": None, "labelFontSize": 13, "columns": 7},
    "title": {
        "color": "var(--ink)",
        "fontWeight": "normal",
        "anchor": "start",
        "fontSize": 12,
        "subtitleColor": "var(--ink)",
    },
    "rule": {"color": "var(--ink)", "strokeDash": [6, 4]},
}


def quantities(sweep: SweepTable) -> dict[str, Array]:
    """Varied parameters and judged metrics as numbers, by label, shape (N,) each; NaN where absent.

    A parameter with texts is the place of its value among those of :func:`texts`.
    """
    found: dict[str, Array] = {}
    for key in sweep.varied:
        values, unit = sweep.values(key), sweep.unit(key).replace("1", "")
        if values.dtype.kind == "U":
            values = np.unique(values, return_inverse=True)[1].astype(float)
        found[f"{key} [{unit}]" if unit else key] = values
    found["largest share of a tolerance [%]"] = np.minimum(100.0 * sweep.worst_used, 1000.0)
    for metric in sweep.judged:
        values, unit = sweep.shown(metric)
        found[f"{sweep.label(metric)} [{unit.replace('of body weight', 'BW')}]"] = values
    return {label: values for label, values in found.items() if np.isfinite(values).any()}


def texts(sweep: SweepTable) -> dict[str, list[str]]:
    """Sorted values of every varied parameter with texts, such as ``gait.planner``."""
    columns = {key: sweep.values(key) for key in sweep.varied}
    return {key: np.unique(column).tolist() for key, column in columns.items() if column.dtype.kind == "U"}


def category(sweep: SweepTable) -> tuple[str, list[str]]:
    """The parameter with texts that gives bars their colours, and its values; empty if there is none.

    It is ``gait.planner``, or else the first one with as many values as there are colours.
    """
    found = {key: values for key, values in texts(sweep).items() if 2 <= len(values) <= len(HUES)}
    key = "gait.planner" if "gait.planner" in found else next(iter(found), "")
    return key, found.get(key, [])


def drawn_rows(sweep: SweepTable, keep: Sequence[int]) -> list[int]:
    """Rows that are drawn: all, or a random sample and the rows of ``keep``."""
    order = np.random.default_rng(1).permutation(len(sweep))[:MOST_POINTS]
    return sorted({*order.tolist(), *keep})


def run_data(sweep: SweepTable, rows: Sequence[int], links: Mapping[int, str]) -> list[dict[str, Any]]:
    """Name, outcome, link and all quantities of the runs that are drawn.

    Args:
        sweep: the sweep.
        rows: that are drawn.
        links: row to the address of its report.
    """
    names, named = sweep.words("name"), texts(sweep)
    found: list[dict[str, Any]] = [
        {"run": names[row], "outcome": sweep.state(row).label, "link": links.get(row)} for row in rows
    ]
    for label, values in quantities(sweep).items():
        words = sweep.words(label) if label in named else None
        for row, item, value in zip(rows, found, _rounded(values[list(rows)]), strict=True):
            item[label] = value if words is None else words[row]
    return found


def scatter(sweep: SweepTable) -> Spec:
    """Runs over two quantities, which the page lets choose; a point of a kept run links to its report."""
    labels = list(quantities(sweep))
    chosen = {"x": labels[0], "y": labels[min(1, len(labels) - 1)]}
    params = [
        {"name": name, "value": value, "bind": {"input": "select", "options": labels, "name": f"{words} "}}
        for (name, value), words in zip(chosen.items(), ("right:", "up:"), strict=True)
    ]
    transform = [{"calculate": _number_of(name), "as": f"at_{name}"} for name in chosen]
    scale = {"zero": False, "padding": 12}
    encoding = {
        name: {
            "field": f"at_{name}",
            "type": "quantitative",
            "title": None,
            "scale": scale,
            "axis": {  # of texts a tick for each, with its text
                "tickMinStep": {"expr": f"texts[{name}] ? 1 : 0"},
                "labelExpr": f"texts[{name}] ? texts[{name}][datum.value] || '' : datum.label",
            },
        }
        for name in chosen
    }
    colour = _colour(sweep)
    fields = ["run", "outcome", *labels[: len(sweep.varied)]]
    return {
        "title": {"text": {"expr": "'up: ' + y + ', right: ' + x"}},
        "data": {"name": "runs"},
        "params": [{"name": "texts", "value": texts(sweep)}, *params],
        "transform": [*transform, {"filter": "isValid(datum.at_x) && isValid(datum.at_y)"}],
        "mark": {"type": "point", "filled": True, "size": 55, "opacity": 0.8},
        "encoding": {
            **encoding,
            "color": colour,
            "shape": {**colour, "scale": {"domain": colour["scale"]["domain"]}},
            "href": {"condition": {"test": "isValid(datum.link)", "field": "link"}},
            "tooltip": [{"field": _escaped(field), "title": field} for field in fields],
        },
        "width": "container",
        "height": 400,
        "config": _CONFIG,
    }


def parallel(sweep: SweepTable) -> Spec:
    """Parallel coordinates: a line for each run across the varied parameters and its largest share."""
    labels = list(quantities(sweep))[: len(sweep.varied) + 1][-MOST_AXES:]
    ends = [{"op": op, "field": "value", "as": op} for op in ("min", "max")]
    ranges = "[datum.label, ranges[datum.label]]"
    return {
        "data": {"name": "runs"},
        "params": [
            {"name": "texts", "value": texts(sweep)},
            {"name": "ranges", "value": _ranges(sweep, labels)},
        ],
        "transform": [
            {"fold": [_escaped(label) for label in labels], "as": ["axis", "given"]},
            {"calculate": _number_of("datum.axis", "datum.given"), "as": "value"},
            {"filter": "isValid(datum.value)"},
            {"joinaggregate": ends, "groupby": ["axis"]},
            {"calculate": "(datum.value - datum.min) / (datum.max - datum.min || 1)", "as": "share"},
        ],
        "mark": {"type": "line", "opacity": 0.25, "strokeWidth": 1.2},
        "encoding": {
            "x": {
                "field": "axis",
                "type": "nominal",
                "sort": labels,
                "title": None,
                "axis": {"labelAngle": -20, "labelLimit": 300, "grid": True, "labelExpr": ranges},
            },
            "y": {
                "field": "share",
                "type": "quantitative",
                "title": "lowest to highest value",
                "axis": {"labels": False},
            },
            "detail": {"field": "run"},
            "color": _colour(sweep),
            "tooltip": [{"field": "run"}, {"field": "outcome"}],
        },
        "width": "container",
        "height": 320,
        "config": _CONFIG,
    }


def _number_of(label: str, value: str = "") -> str:
    """Expression for a quantity of a run as a number; a text is its place among the sorted ones."""
    value = value or f"datum[{label}]"
    return f"texts[{label}] ? indexof(texts[{label}], {value}) : {value}"


def _ranges(sweep: SweepTable, labels: Sequence[str]) -> dict[str, str]:
    """Lowest and highest value of quantities, or all texts from below, as text."""
    found, named = quantities(sweep), texts(sweep)
    ranges = {label: f"{np.nanmin(found[label]):.4g} to {np.nanmax(found[label]):.4g}" for label in labels}
    return ranges | {label: ", ".join(named[label]) for label in labels if label in named}


def _colour(sweep: SweepTable) -> Spec:
    """Encoding of the outcome."""
    present = [state for state in STATES if sweep.counts[state]]
    colours = [f"var(--state-{state.value.replace('_', '-')})" for state in present]
    scale = {"domain": [state.label for state in present], "range": colours}
    return {"field": "outcome", "type": "nominal", "scale": scale}


def _rounded(values: Array) -> list[float | None]:
    """Five digits; None where a value is absent."""
    return [float(f"{value:.5g}") if np.isfinite(value) else None for value in values.tolist()]


def _escaped(field: str) -> str:
    """A field's name in an encoding, where dots and brackets would be paths."""
    return re.sub(r"([.\[\]])", r"\\\1", field)


def distribution(
    values: Array,
    limit: float | None,
    unit: str,
    title: str,
    groups: Mapping[str, NDArray[np.bool_]] | None = None,
) -> Markup:
    """Histogram of a metric over the completed runs, with its tolerance, as SVG.

    Args:
        values: shape (N,); NaN and infinities are left out.
        limit: tolerance in ``unit``, None if it has none; without groups more is red.
        unit: of values and axis.
        title: what it is.
        groups: name to rows, shape (N,) each; every one gets the colour of its place in :data:`HUES`.
    """
    finite = np.isfinite(values)
    known, unit = values[finite], unit.replace("of body weight", "BW")
    # Few outliers must not put all others into one bin: the number beyond is written above.
    low, high = min(0.0, float(known.min())), float(np.quantile(known, 0.99)) * 1.15
    if limit is not None and high > 0.4 * limit:
        high = max(high, 1.12 * limit)
    high = high if high > low else low + 1.0
    limited = limit is not None and low <= limit <= high
    if groups is None:
        over = known > (np.inf if limit is None else limit)
        parts, hues = {WITHIN: known[~over], OVER: known[over]}, ["var(--plan)", "var(--bad)"]
    else:
        parts, hues = {name: values[finite & rows] for name, rows in groups.items()}, [*HUES]
    bins = BINS
    if limit is not None and low < limit <= high:
        # A bin ends at the limit, so that no bar is on both sides of it and its line is beside the bars.
        bins = max(1, round(BINS * (limit - low) / (high - low)))
        step = (limit - low) / bins
        bins = math.ceil((high - low) / step - 1e-9)
        high = low + step * bins
    edges = np.linspace(low, high, bins + 1)
    counts = {name: np.histogram(part, edges)[0] for name, part in parts.items()}
    most = int(np.sum([*counts.values()], axis=0).max())
    beyond = int((known > high).sum())
    notes = [] if limit is None else [f"limit {limit:.3g}"]
    notes += [f"{beyond} {'run' if beyond == 1 else 'runs'} beyond"] if beyond else []
    colors = {"domain": list(parts), "range": hues[: len(parts)]}
    bars: Spec = {
        "mark": {"type": "bar", "binSpacing": 0},
        "encoding": {
            "x": {
                "field": "from",
                "bin": "binned",
                "type": "quantitative",
                "scale": {"domain": [low, high], "nice": False},
                "title": f"[{unit or 1}]",
                "axis": {"grid": False, "values": [low, (low + high) / 2, high], "format": ".3g"},
            },
            "x2": {"field": "to"},
            "y": {
                "field": "runs",
                "type": "quantitative",
                "title": "runs",
                "axis": {"values": list(range(0, most + 1, _round_step(most / 4))), "format": "d"},
            },
            "color": {"field": "group", "type": "nominal", "scale": colors, "legend": None},
        },
    }
    rule: Spec = {
        "transform": [{"sample": 1}],
        "mark": "rule",
        "encoding": {"x": {"datum": limit, "type": "quantitative"}},
    }
    picture = {
        "title": {"text": title, "subtitle": ", ".join(notes)},
        "width": 300,
        "height": 120,
        "data": {
            "values": [
                {"from": left, "to": right, "runs": count, "group": name}
                for name, part in counts.items()
                for left, right, count in zip(
                    edges[:-1].tolist(), edges[1:].tolist(), part.tolist(), strict=True
                )
                if count
            ]
        },
        "layer": [rule, bars] if limited else [bars],
    }
    return svg(picture, f"Distribution of {title}")


def _round_step(step: float) -> int:
    """The least of 1, 2, 5, 10, 20 ... that is not smaller."""
    power = 10 ** max(0, math.floor(math.log10(max(step, 1.0))))
    return next(factor * power for factor in (1, 2, 5, 10) if factor * power >= step)


def svg(spec: Spec, label: str) -> Markup:
    """Draw a specification as inline SVG, as wide as the page gives it, with a text for screen readers."""
    import vl_convert  # loads a JavaScript engine

    text = vl_convert.vegalite_to_svg(json.dumps({**spec, "config": {**_CONFIG, "aria": False}}))
    named = f' role="img" aria-label="{escape(label)}"'
    return Markup(re.sub(r' width="[\d.]+" height="[\d.]+"', named, text, count=1))


def as_json(spec: Any) -> Markup:
    """A specification, or data, for a script element, which no text in it can end."""
    text = json.dumps(spec, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return Markup(text.replace("<", "\\u003c"))


def vega_script() -> Markup:
    """Script of Vega, Vega-Lite and Vega-Embed, to be put into a page."""
    import vl_convert  # loads a JavaScript engine

    bundle = vl_convert.javascript_bundle("window.vegaEmbed = vegaEmbed;")
    return Markup(bundle.replace("</script", "<\\/script"))
