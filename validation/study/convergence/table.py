"""The studies in words: tables for the terminal and as Markdown."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from validation.show.text import format_number, print_line, print_table
from validation.study.convergence.execute import level
from validation.study.convergence.order import NO_RANGE, Estimate, Kind
from validation.study.convergence.result import Convergence, MetricStudy
from validation.study.convergence.studies import COUNTS, Study

_SHORT = {"% of body weight": "% BW", "1": ""}
_ALSO = ("energy_positive_work", "energy_negative_work", "energy_cost_of_transport")
"""Integrals that the short table has beside what is judged."""
_COLOURS = {"pass": "green", "fail": "red", "undecided": "yellow", "not_measured": "yellow"}


def print_convergence(result: Convergence) -> None:
    """Print what the studies found: metrics with their uncertainty, and the verdict on them."""
    print_table(
        f"{result.request.name}: value ± numerical uncertainty, {result.request.run.gait.steps} steps "
        f"(profile {result.profile.name})",
        (
            ("metric", "left"),
            ("value ± u_num", "right"),
            ("limit", "right"),
            ("unit", "left"),
            ("", "left"),
            (f"at {_finest(result)}", "right"),
            ("order", "left"),
            ("extrapolated", "right"),
            ("± u_input", "right"),
        ),
        [_row(item) for item in shortlist(result)],
    )
    print_line(f"  {_legend(result)}")
    for note in result.notes:
        print_line(f"  note: {_escaped(note)}")
    word = str(result.verdict).replace("_", " ").upper()
    print_line(
        f"[bold {_COLOURS[str(result.verdict)]}]{result.request.name}: {word}[/]  "
        f"{_escaped(result.verdict_reason)}"
    )


def shortlist(result: Convergence) -> list[MetricStudy]:
    """What is judged, and the integrals."""
    return [item for item in result.metrics.values() if item.tolerance is not None or item.name in _ALSO]


def _row(item: MetricStudy) -> tuple[str, ...]:
    if item.undecided:
        mark = "[yellow]undecided[/]"
    elif item.passed is None:
        mark = ""
    else:
        mark = "[green]pass[/]" if item.passed else "[red]FAIL[/]"
    order, extrapolated = _order(item)
    limit = "" if item.tolerance is None else _shown(item, item.tolerance)
    given = "" if item.input_uncertainty is None else _shown(item, item.input_uncertainty, 2)
    return (item.name, quoted(item), limit, _unit(item), mark, _last(item), order, extrapolated, given)


def _finest(result: Convergence) -> str:
    """The last level of the study that the order is of."""
    numerical = [study for study in result.studies if study.topic.kind == "numerical"]
    return numerical[0].shown(numerical[0].values[-1]) if numerical else "last"


def _last(item: MetricStudy) -> str:
    """The value there."""
    return _shown(item, item.levels[next(iter(item.estimates))][-1]) if item.estimates else ""


def quoted(item: MetricStudy) -> str:
    """A value and its numerical uncertainty, in the unit for people."""
    if not item.not_studied:
        return f"{_shown(item, item.value)} ± {_shown(item, item.uncertainty, 2)}"
    known = "not studied" if math.isnan(item.at_least) else f"≥ {_shown(item, item.at_least, 2)}"
    return f"{_shown(item, item.value)} ± {known}"


def _order(item: MetricStudy) -> tuple[str, str]:
    """Observed order and extrapolated value, or plainly that there is none."""
    head = item.headline
    if item.name in COUNTS:
        return "exact", ""
    if head is None:
        return "", ""
    if head.order is None or head.extrapolated is None:
        return (NO_RANGE if head.kind is Kind.NO_RANGE else str(head.kind)), ""
    # What is smaller than its own uncertainty has no digits to show.
    return f"{head.order:.2f}", "0" if abs(head.extrapolated) < head.finest else _shown(
        item, head.extrapolated
    )


def _shown(item: MetricStudy, value: float, digits: int = 3) -> str:
    if math.isinf(value):
        return "∞"
    return format_number(value * item.factor, digits)


def _unit(item: MetricStudy) -> str:
    return _SHORT.get(item.display_unit, item.display_unit)


def _legend(result: Convergence) -> str:
    inputs = [study.topic.name for study in result.studies if study.topic.kind == "input"]
    parts = [f"u_num of {' + '.join(result.inside)}"] if result.inside else []
    if result.not_studied:
        lacking = ", ".join(result.not_studied)
        parts.append(f"not studied: {lacking}, so u_num is not known")
        if result.inside:
            parts.append("≥ is what the others leave")
    parts += [f"u_input of {', '.join(inputs)}, not in the verdict"] if inputs else []
    return "; ".join(parts) + "; a value closer to its limit than u_num is undecided"


# --------------------------------------------------------------------------------------------- Markdown


def markdown(result: Convergence) -> str:
    """All figures as Markdown: verdict, every metric, and the levels of every study."""
    return "\n".join(_lines(result)) + "\n"


def _lines(result: Convergence) -> Iterator[str]:
    run = result.request.run
    yield f"# Convergence of {result.request.name}"
    yield ""
    yield (
        f"{run.gait.steps} steps a level, control at {run.controller.frequency:g} Hz, profile "
        f"{result.profile.name}: **{str(result.verdict).replace('_', ' ')}**. {result.verdict_reason}"
    )
    yield ""
    yield from (f"- {note}" for note in result.notes)
    if result.notes:
        yield ""
    yield from summary_lines(result)
    yield ""
    yield f"{_legend(result)}."
    for study in result.studies:
        yield from _study_lines(result, study)
    yield from ("", "## Why", "", "| metric | |", "|---|---|")
    yield from (f"| `{item.name}` | {item.reason} |" for item in result.metrics.values())


def summary_lines(result: Convergence, items: Sequence[MetricStudy] | None = None) -> Iterator[str]:
    """The main table: value, uncertainty, limit, order, extrapolated value."""
    yield (
        f"| metric | value ± u_num | limit | unit | | at {_finest(result)} | observed order | extrapolated "
        "| u_input |"
    )
    yield "|---|---|---|---|---|---|---|---|---|"
    for item in items or result.metrics.values():
        word = "undecided" if item.undecided else {True: "pass", False: "fail", None: ""}[item.passed]
        order, extrapolated = _order(item)
        limit = "" if item.tolerance is None else _shown(item, item.tolerance)
        given = "" if item.input_uncertainty is None else _shown(item, item.input_uncertainty, 2)
        cells = (
            f"`{item.name}`", quoted(item), limit, _unit(item), word, _last(item), order, extrapolated, given,
        )  # fmt: skip
        yield f"| {' | '.join(cells)} |"


def _study_lines(result: Convergence, study: Study) -> Iterator[str]:
    topic = study.topic
    yield from ("", f"## {topic.name}: {topic.title}", "")
    walks = [result.walks[level(study, index)] for index in range(len(study.values))]
    yield from levels_table(result, study, list(result.metrics.values()))
    yield ""
    yield (
        "Walks: "
        + ", ".join(
            f"{study.shown(value)} {walk.outcome} ({walk.seconds:.1f} s, {walk.memory:.0f} MB)"
            for value, walk in zip(study.values, walks, strict=True)
        )
        + "."
    )


def levels_table(result: Convergence, study: Study, items: Sequence[MetricStudy]) -> Iterator[str]:
    """Every level's value of some metrics, with what follows from them."""
    name, numerical = study.topic.name, study.topic.kind == "numerical"
    last = "observed orders | u |" if numerical else "largest deviation |"
    yield f"| metric | unit | {' | '.join(study.shown(value) for value in study.values)} | {last}"
    yield "|---" * (3 + len(study.values) + numerical) + "|"
    for item in items:
        cells = [f"`{item.name}`", _unit(item), *(_shown(item, value) for value in item.levels[name])]
        if numerical:
            found = item.estimates[name]
            cells += [_orders(found), _shown(item, found.uncertainty, 2)]
        else:
            cells.append(_shown(item, item.inputs[name], 2))
        yield f"| {' | '.join(cells)} |"


def _orders(found: Estimate) -> str:
    """Observed orders of all triplets; bold where they confirm one another."""
    told = ", ".join("–" if math.isnan(order) else f"{order:.2f}" for order in found.orders)
    return f"**{told}**" if found.asymptotic else told


def _escaped(text: str) -> str:
    return text.replace("[", "\\[")
