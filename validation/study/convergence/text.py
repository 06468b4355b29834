"""The studies as text: rows of a table, and everything as Markdown."""

from __future__ import annotations

import math
from collections.abc import Sequence

from validation.show.text import ABSENT, BODY_WEIGHT, format_number, markdown_table
from validation.study.convergence.order import Estimate
from validation.study.convergence.result import Convergence, MetricStudy
from validation.study.convergence.studies import Study

_ALSO = ("energy_positive_work", "energy_negative_work", "energy_cost_of_transport")
"""Integrals that the short table has beside what is judged."""


def shortlist(result: Convergence) -> list[MetricStudy]:
    """Metrics that are judged, and the integrals."""
    return [item for item in result.metrics.values() if item.tolerance is not None or item.name in _ALSO]


def header(result: Convergence) -> tuple[str, ...]:
    """Of the columns of :func:`cells`."""
    finest = [study.shown(study.values[-1]) for study in result.studies if study.numerical]
    return (
        "metric", "value ± u_num", "limit", "unit", "verdict", f"at {finest[0] if finest else 'last'}",
        "observed order", "extrapolated", "± u_input",
    )  # fmt: skip


def cells(item: MetricStudy) -> tuple[str, ...]:
    """A metric's value, uncertainty, limit, order and extrapolated value; a text if it has none."""
    word = "undecided" if item.undecided else {True: "pass", False: "FAIL", None: ""}[item.passed]
    last = _shown(item, item.levels[next(iter(item.estimates))][-1]) if item.estimates else ""
    given = "" if item.input_uncertainty is None else _shown(item, item.input_uncertainty, 2)
    limit = "" if item.tolerance is None else _shown(item, item.tolerance)
    head, order, extrapolated = item.headline, "", ""
    if item.exact:
        order = "exact"
    elif head is not None:
        order = str(head.kind) if head.order is None else f"{head.order:.2f}"
        if head.extrapolated is not None:  # a value below its own uncertainty has no significant digits
            small = abs(head.extrapolated) < head.finest
            extrapolated = "0" if small else _shown(item, head.extrapolated)
    return item.name, item.quoted, limit, _unit(item), word, last, order, extrapolated, given


def legend(result: Convergence) -> str:
    """Explanation of what the uncertainties cover."""
    known = result.uncertainty
    inputs = [study.name for study in result.studies if not study.numerical]
    parts = [f"u_num of {' + '.join(known.studies)}"] if known.studies else []
    if known.not_studied:
        parts.append(f"not studied: {', '.join(known.not_studied)}, so u_num is not known")
        parts += ["≥ is what the others leave"] if known.studies else []
    parts += [f"u_input of {', '.join(inputs)}, not in the verdict"] if inputs else []
    return "; ".join(parts) + "; a value closer to its limit than u_num is undecided"


def markdown(result: Convergence) -> str:
    """All metrics as Markdown: verdict, every metric, and the levels of every study."""
    run, verdict, items = result.request.run, result.verdict, list(result.metrics.values())
    parts = [
        f"# Convergence of {result.request.name}",
        f"{run.gait.steps} steps a level, control at {run.controller.frequency:g} Hz, profile "
        f"{verdict.profile}: **{verdict.name.replace('_', ' ')}**. {verdict.reason}",
        *(["\n".join(f"- {note}" for note in result.notes)] if result.notes else []),
        summary_table(result, items),
        f"{legend(result)}.",
    ]
    for study in result.studies:
        walks = [result.walks[run] for run in study.runs]
        text = ", ".join(
            f"{study.shown(value)} {walk.outcome} ({walk.seconds:.1f} s, {format_number(walk.memory)} MB)"
            for value, walk in zip(study.values, walks, strict=True)
        )
        parts += [f"## {study.name}: {study.title}", _levels_table(study, items), f"Walks: {text}."]
    why = markdown_table(("metric", ""), [(f"`{item.name}`", item.found) for item in items])
    return "\n\n".join([*parts, "## Why", why]) + "\n"


def summary_table(result: Convergence, items: Sequence[MetricStudy]) -> str:
    """Value, uncertainty, limit, order and extrapolated value of some metrics, as Markdown."""
    rows = ((f"`{name}`", *rest) for name, *rest in map(cells, items))
    return markdown_table(header(result), list(rows))


def _levels_table(study: Study, items: Sequence[MetricStudy]) -> str:
    """Every level's value of some metrics, with order and uncertainty."""
    last = ("observed orders", "u") if study.numerical else ("largest deviation",)
    rows = []
    for item in items:
        values = [_shown(item, value) for value in item.levels[study.name]]
        if study.numerical:
            one = item.estimates[study.name]
            values += [_orders(one), _shown(item, one.uncertainty, 2)]
        else:
            values.append(_shown(item, item.inputs[study.name], 2))
        rows.append((f"`{item.name}`", _unit(item), *values))
    return markdown_table(("metric", "unit", *map(study.shown, study.values), *last), rows)


def _orders(found: Estimate) -> str:
    """Observed orders of all triplets; bold where they confirm one another."""
    text = ", ".join(ABSENT if math.isnan(order) else f"{order:.2f}" for order in found.orders)
    return f"**{text}**" if found.asymptotic else text


def _shown(item: MetricStudy, value: float, digits: int = 3) -> str:
    return "∞" if math.isinf(value) else format_number(value * item.factor, digits)


def _unit(item: MetricStudy) -> str:
    return item.display_unit.replace("% of body weight", BODY_WEIGHT)
