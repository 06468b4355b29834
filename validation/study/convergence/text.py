"""The studies in words: rows of a table, and all of it as Markdown."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from validation.show.text import format_number
from validation.study.convergence.order import NO_RANGE, Estimate, Kind
from validation.study.convergence.result import Convergence, MetricStudy
from validation.study.convergence.studies import Study

_ALSO = ("energy_positive_work", "energy_negative_work", "energy_cost_of_transport")
"""Integrals that the short table has beside what is judged."""


def shortlist(result: Convergence) -> list[MetricStudy]:
    """What is judged, and the integrals."""
    return [item for item in result.metrics.values() if item.tolerance is not None or item.name in _ALSO]


def header(result: Convergence) -> tuple[str, ...]:
    """Of the columns of :func:`cells`."""
    numerical = [study for study in result.studies if study.numerical]
    finest = numerical[0].shown(numerical[0].values[-1]) if numerical else "last"
    return (
        "metric", "value ± u_num", "limit", "unit", "verdict", f"at {finest}", "observed order",
        "extrapolated", "± u_input",
    )  # fmt: skip


def cells(item: MetricStudy) -> tuple[str, ...]:
    """A metric's value, uncertainty, limit, order and extrapolated value."""
    word = "undecided" if item.undecided else {True: "pass", False: "FAIL", None: ""}[item.passed]
    order, extrapolated = _order(item)
    last = _shown(item, item.levels[next(iter(item.estimates))][-1]) if item.estimates else ""
    given = "" if item.input_uncertainty is None else _shown(item, item.input_uncertainty, 2)
    limit = "" if item.tolerance is None else _shown(item, item.tolerance)
    return item.name, _quoted(item), limit, _unit(item), word, last, order, extrapolated, given


def legend(result: Convergence) -> str:
    """What the uncertainties are of."""
    inputs = [study.name for study in result.studies if not study.numerical]
    parts = [f"u_num of {' + '.join(result.inside)}"] if result.inside else []
    if result.not_studied:
        parts.append(f"not studied: {', '.join(result.not_studied)}, so u_num is not known")
        if result.inside:
            parts.append("≥ is what the others leave")
    parts += [f"u_input of {', '.join(inputs)}, not in the verdict"] if inputs else []
    return "; ".join(parts) + "; a value closer to its limit than u_num is undecided"


def markdown(result: Convergence) -> str:
    """All metrics as Markdown: verdict, every metric, and the levels of every study."""
    run = result.request.run
    lines = [
        f"# Convergence of {result.request.name}",
        "",
        f"{run.gait.steps} steps a level, control at {run.controller.frequency:g} Hz, profile "
        f"{result.profile.name}: **{str(result.verdict).replace('_', ' ')}**. {result.verdict_reason}",
        "",
        *(f"- {note}" for note in result.notes),
        *([""] if result.notes else []),
        *summary_lines(result),
        "",
        f"{legend(result)}.",
    ]
    for study in result.studies:
        walks = [result.walks[level] for level in study.levels]
        text = ", ".join(
            f"{study.shown(value)} {walk.outcome} ({walk.seconds:.1f} s, {format_number(walk.memory)} MB)"
            for value, walk in zip(study.values, walks, strict=True)
        )
        table = levels_table(study, list(result.metrics.values()))
        lines += ["", f"## {study.name}: {study.topic.title}", "", *table, "", f"Walks: {text}."]
    lines += ["", "## Why", "", "| metric | |", "|---|---|"]
    lines += [f"| `{item.name}` | {item.reason} |" for item in result.metrics.values()]
    return "\n".join(lines) + "\n"


def summary_lines(result: Convergence, items: Sequence[MetricStudy] | None = None) -> Iterator[str]:
    """The main table: value, uncertainty, limit, order, extrapolated value."""
    yield _line(header(result))
    yield "|---" * len(header(result)) + "|"
    for item in items or result.metrics.values():
        name, *rest = cells(item)
        yield _line((f"`{name}`", *rest))


def levels_table(study: Study, items: Sequence[MetricStudy]) -> Iterator[str]:
    """Every level's value of some metrics, with what follows from them."""
    last = ("observed orders", "u") if study.numerical else ("largest deviation",)
    head = ("metric", "unit", *(study.shown(value) for value in study.values), *last)
    yield _line(head)
    yield "|---" * len(head) + "|"
    for item in items:
        values = (_shown(item, value) for value in item.levels[study.name])
        if study.numerical:
            found = item.estimates[study.name]
            ends: tuple[str, ...] = (_orders(found), _shown(item, found.uncertainty, 2))
        else:
            ends = (_shown(item, item.inputs[study.name], 2),)
        yield _line((f"`{item.name}`", _unit(item), *values, *ends))


def _line(texts: Sequence[str]) -> str:
    return f"| {' | '.join(texts)} |"


def _quoted(item: MetricStudy) -> str:
    """A value and its numerical uncertainty, in the unit for people."""
    if not item.not_studied:
        return f"{_shown(item, item.value)} ± {_shown(item, item.uncertainty, 2)}"
    known = "not studied" if math.isnan(item.at_least) else f"≥ {_shown(item, item.at_least, 2)}"
    return f"{_shown(item, item.value)} ± {known}"


def _order(item: MetricStudy) -> tuple[str, str]:
    """Observed order and extrapolated value, or plainly that there is none."""
    head = item.headline
    if item.exact:
        return "exact", ""
    if head is None:
        return "", ""
    if head.order is None or head.extrapolated is None:
        return (NO_RANGE if head.kind is Kind.NO_RANGE else str(head.kind)), ""
    # What is smaller than its own uncertainty has no digits to show.
    small = abs(head.extrapolated) < head.finest
    return f"{head.order:.2f}", "0" if small else _shown(item, head.extrapolated)


def _orders(found: Estimate) -> str:
    """Observed orders of all triplets; bold where they confirm one another."""
    text = ", ".join("–" if math.isnan(order) else f"{order:.2f}" for order in found.orders)
    return f"**{text}**" if found.asymptotic else text


def _shown(item: MetricStudy, value: float, digits: int = 3) -> str:
    return "∞" if math.isinf(value) else format_number(value * item.factor, digits)


def _unit(item: MetricStudy) -> str:
    return item.display_unit.replace("% of body weight", "% BW")
