"""A comparison of two sweeps as JSON, as tables on the terminal, and as a page."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from rich.markup import escape

from ampm.exceptions import InputError
from validation.judge.metrics import metric_label
from validation.show.text import format_number, print_line, print_table
from validation.store.folders import output_file
from validation.study.sweep.diff import SIGNIFICANCE, Change, MetricChange, SweepDiff
from validation.study.sweep.matching import revision
from validation.study.sweep.report import value_text
from validation.study.sweep.table import STATES, SweepTable

KINDS: Mapping[str, str] = {
    "newly_failing": "newly failing",
    "worse_outcome": "worse outcome",
    "worse_figures": "figures worse beyond tolerance",
    "newly_passing": "newly passing",
    "better_outcome": "better outcome",
    "other_outcome": "another outcome, neither better nor worse",
    "verdict_only": "another verdict, though no figure changed beyond noise",
}
_SHOWN = 12


def describe_diff(diff: SweepDiff) -> dict[str, Any]:
    """JSON object of a comparison; all values in SI units."""
    matching = diff.matching
    names_a, names_b = diff.a.words("name"), diff.b.words("name")
    return {
        "regression": bool(diff.regressions),
        "sentence": diff.sentence,
        "regressions": diff.regressions,
        "lacking": diff.lacking,
        "a": _side(diff.a),
        "b": _side(diff.b),
        "matched": {
            "runs": len(matching.a),
            "by": matching.by,
            "changed_parameters": [{"key": k, "a": one, "b": two} for k, one, two in matching.changed],
            "only_a": list(matching.only_a),
            "only_b": list(matching.only_b),
        },
        "notes": list(diff.notes),
        "transitions": [
            {"before": before.value, "after": after.value, "runs": count}
            for (before, after), count in _ordered(diff)
        ],
        "counts": {kind: len(diff.of_kind(kind)) for kind in KINDS},
        **{kind: [_change(change) for change in diff.of_kind(kind)] for kind in KINDS},
        "missing": [names_a[row] for row in matching.missing],
        "new": [names_b[row] for row in matching.new],
        "ambiguous": [names_a[row] for row in matching.ambiguous],
        "metrics": {item.metric: _metric(item) for item in diff.metrics},
    }


def _side(sweep: SweepTable) -> dict[str, Any]:
    return {
        "source": sweep.source,
        "name": sweep.name,
        "runs": len(sweep),
        "profile": sweep.profile,
        "revision": revision(sweep),
        "counts": {state.value: count for state, count in sweep.counts.items() if count},
    }


def _change(change: Change) -> dict[str, Any]:
    return {
        "a": change.a,
        "b": change.b,
        "before": change.before.value,
        "after": change.after.value,
        "metrics": list(change.metrics),
        "parameters": dict(change.parameters),
    }


def _metric(item: MetricChange) -> dict[str, Any]:
    return {
        "unit": item.unit,
        "pairs": item.pairs,
        "better": item.better,
        "worse": item.worse,
        "regressed": item.regressed,
        "noise": {"value": item.noise, "from": item.noise_from},
        "allowed": item.allowed,
        "median": {"a": item.before, "b": item.after, "shift": item.shift},
        "p": item.p,
        "verdict": item.verdict,
        "worst": {"run": item.worst, "a": item.worst_before, "b": item.worst_after} if item.worst else None,
    }


def _ordered(diff: SweepDiff) -> list[tuple[tuple[Any, Any], int]]:
    return sorted(
        diff.transitions.items(), key=lambda item: (STATES.index(item[0][0]), STATES.index(item[0][1]))
    )


# ------------------------------------------------------------------------------------------ terminal


def print_diff(diff: SweepDiff) -> None:
    """Print a comparison for people."""
    for letter, sweep in (("A", diff.a), ("B", diff.b)):
        at = revision(sweep)
        print_line(
            escape(f"{letter}: {sweep.source}, {len(sweep):,} runs" + (f", revision {at}" if at else ""))
        )
    matching = diff.matching
    unmatched = [
        f"{len(rows):,} {words}"
        for rows, words in ((matching.missing, "missing in B"), (matching.new, "new in B"))
        if len(rows)
    ]
    print_line(
        escape(f"{len(matching.a):,} runs matched by {matching.by}" + "".join(f"; {t}" for t in unmatched))
    )
    for note in diff.notes:
        print_line(escape(f"note: {note}"))
    rows = [
        (before.label, after.label, f"{count:,}", _verdict_of(before, after))
        for (before, after), count in _ordered(diff)
    ]
    print_table("outcomes", (("in A", "left"), ("in B", "left"), ("runs", "right"), ("", "left")), rows)
    moved = [item for item in diff.metrics if item.better or item.worse]
    if moved:
        print_table("figures of the runs that completed in both", _COLUMNS, [_row(item) for item in moved])
        print_line(
            "[dim]better, worse: pairs that differ by more than the noise. Beyond: grown by more than the "
            f"tolerance, too. p: Wilcoxon's signed-rank test, corrected for the number of figures; at p < "
            f"{SIGNIFICANCE:g} and a shift beyond the noise all runs together are called better or worse.[/]"
        )
    if len(moved) < len(diff.metrics):
        still = len(diff.metrics) - len(moved)
        print_line(f"{still} figure{' is' if still == 1 else 's are'} the same in every pair, but for noise.")
    for kind, title in KINDS.items():
        changes = diff.of_kind(kind)
        if changes:
            _print_changes(f"{title}: {len(changes):,}", changes)
    style = "bold red" if diff.regressions else "bold yellow" if diff.lacking else "bold green"
    print_line(f"[{style}]{escape(diff.sentence)}[/]")


_COLUMNS = (
    ("figure", "left"),
    ("all runs", "left"),
    ("better", "right"),
    ("worse", "right"),
    ("beyond", "right"),
    ("median A", "right"),
    ("median B", "right"),
    ("unit", "left"),
    ("shift", "right"),
    ("p", "right"),
    ("noise", "right"),
    ("worst", "left"),
)


def _cells(item: MetricChange) -> tuple[str, ...]:
    scale, unit = (1e3, "mm") if item.unit == "m" else (1.0, "" if item.unit == "1" else item.unit)
    before, after = scale * item.worst_before, scale * item.worst_after
    worst = f"{item.worst}: {format_number(before, 3)} → {format_number(after, 3)}"
    noise = "no bound" if math.isinf(item.noise) else format_number(scale * item.noise, 2)
    return (
        metric_label(item.metric),
        item.verdict,
        f"{item.better:,}",
        f"{item.worse:,}",
        f"{item.regressed:,}",
        format_number(scale * item.before),
        format_number(scale * item.after),
        unit,
        f"{scale * item.shift:+.2g}" if item.shift else "0",
        format_number(item.p, 2),
        noise,
        worst if item.worst else "",
    )


def _row(item: MetricChange) -> tuple[str, ...]:
    cells = [escape(cell) for cell in _cells(item)]
    colour = {"worse": "red", "better": "green"}.get(item.verdict)
    if colour:
        cells[1] = f"[{colour}]{cells[1]}[/]"
    if item.regressed:
        cells[4] = f"[red]{cells[4]}[/]"
    return tuple(cells)


def _verdict_of(before: Any, after: Any) -> str:
    return "" if before is after else "changed"


def _print_changes(title: str, changes: Sequence[Change]) -> None:
    rows = [
        (change.a, change.before.label, change.after.label, _metric_words(change), escape(_values(change)))
        for change in changes[:_SHOWN]
    ]
    if len(changes) > _SHOWN:
        rows.append((f"and {len(changes) - _SHOWN:,} more", "", "", "", ""))
    columns = (
        ("run", "left"),
        ("in A", "left"),
        ("in B", "left"),
        ("figures", "left"),
        ("parameters", "left"),
    )
    print_table(title, columns, rows)


def _metric_words(change: Change) -> str:
    words = [metric_label(name) for name in change.metrics[:3]]
    return "; ".join(words) + (f"; and {len(change.metrics) - 3} more" if len(change.metrics) > 3 else "")


def _values(change: Change) -> str:
    return ", ".join(f"{key} {value_text(value)}" for key, value in change.parameters.items())


# ---------------------------------------------------------------------------------------------- page


def check_page(path: Path) -> None:
    """Refuse a name that is no page's.

    Raises:
        InputError: it does not end in ``.html``.
    """
    if path.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"--out {path} is no page; give a name that ends in .html.")


def write_page(diff: SweepDiff, path: Path, *, force: bool) -> None:
    """Write a comparison as a self-contained page.

    Raises:
        InputError: the file exists and ``force`` is off, or it cannot be written.
    """
    environment = Environment(
        loader=PackageLoader("validation.show"), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
    css = "".join(
        environment.loader.get_source(environment, name)[0]  # type: ignore[union-attr]
        for name in ("report.css", "sweep.css")
    )
    text = environment.get_template("diff.html.j2").render(
        css=Markup(css),
        diff=diff,
        sides=[_side(diff.a), _side(diff.b)],
        transitions=_ordered(diff),
        columns=_COLUMNS,
        metrics=[(_cells(item), item) for item in diff.metrics],
        changes=[
            (
                f"{title.capitalize()}: {len(diff.of_kind(kind)):,}",
                [(change, _metric_words(change), _values(change)) for change in diff.of_kind(kind)[:100]],
            )
            for kind, title in KINDS.items()
            if diff.of_kind(kind)
        ],
    )
    with output_file(path, force=force) as work:
        work.write_text(text, encoding="utf-8")
