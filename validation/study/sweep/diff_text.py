"""A comparison of two sweeps as JSON, and as tables: on the terminal, and in a page."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.text import Text

from ampm.geometry import Array
from validation.judge.metrics import display_unit, metric_label
from validation.show.page import render_page
from validation.show.text import BODY_WEIGHT, format_number, format_value, print_line, print_table
from validation.store.folders import output_file
from validation.study.sweep.diff import KINDS, MetricChange, SweepDiff
from validation.study.sweep.table import State, SweepTable

_SHOWN, _SHOWN_IN_PAGE = 12, 100
_COLOURS = {"worse": "red", "better": "green"}
_METRICS = (
    "metric", "all runs", ">better", ">worse", ">beyond", ">median A", ">median B", "unit", ">shift", ">p",
    ">noise", "worst",
)  # fmt: skip
_NOTE = (
    "Better, worse: runs that differ by more than the noise. Beyond: grown by more than the tolerance, too. "
    "p: Wilcoxon's signed-rank test, corrected for the number of metrics."
)


@dataclass(frozen=True)
class Table:
    """One table of a comparison.

    Attributes:
        title: line above.
        columns: names; a ``>`` before it aligns a column to the right.
        rows: cells; a :class:`State` is one with a colour of its own.
    """

    title: str
    columns: tuple[str, ...]
    rows: list[list[str]]


def describe_diff(diff: SweepDiff) -> dict[str, Any]:
    """JSON object of a comparison; all values in SI units."""
    return {
        "regression": bool(diff.regressions),
        "sentence": diff.sentence,
        "regressions": diff.regressions,
        "lacking": diff.lacking,
        "a": _side(diff.a),
        "b": _side(diff.b),
        "matched": len(diff.rows_a),
        "notes": list(diff.notes),
        "transitions": [{"before": a.value, "after": b.value, "runs": n} for a, b, n in diff.transitions],
        "counts": {kind: len(diff.of_kind(kind)) for kind in KINDS},
        **{kind: [asdict(change) for change in diff.of_kind(kind)] for kind in KINDS},
        "missing": diff.missing,
        "new": diff.new,
        "metrics": {item.name: _describe(diff, item) for item in diff.metrics},
    }


def _side(sweep: SweepTable) -> dict[str, Any]:
    revisions = ", ".join(word[:10] for word in sweep.distinct("environment_revision"))
    modified = revisions and "True" in sweep.words("environment_modified")
    return {
        "source": sweep.source,
        "name": sweep.name,
        "runs": len(sweep),
        "profile": sweep.profile,
        "revision": revisions + (" (changed since)" if modified else ""),
        "counts": {state.value: count for state, count in sweep.counts.items() if count},
    }


def _describe(diff: SweepDiff, item: MetricChange, scale: Array | float = 1.0) -> dict[str, Any]:
    worst, before, after = None, scale * item.before, scale * item.after
    if item.worse.any():
        row = int(np.argmax(np.where(item.worse, item.growth, -np.inf)))
        name = diff.a.words("name")[diff.rows_a[row]]
        worst = {"run": name, "a": float(before[row]), "b": float(after[row])}
    medians = {"a": before, "b": after, "shift": scale * item.growth}
    return {
        "unit": item.unit,
        "pairs": int(item.both.sum()),
        "better": int(item.better.sum()),
        "worse": int(item.worse.sum()),
        "regressed": int(item.regressed.sum()),
        "lost": int((item.worse & ~item.both).sum()),
        "noise": {"value": item.median(scale * item.noise), "from": item.noise_from},
        "allowed": item.median(scale * item.allowed),
        "median": {key: item.median(values) for key, values in medians.items()},
        "p": item.p,
        "verdict": item.verdict,
        "worst": worst,
    }


def tables(diff: SweepDiff, most: int) -> list[Table]:
    """Outcomes, metrics, and runs that changed.

    Args:
        diff: the comparison.
        most: rows of a table of runs.
    """
    metrics = [_metric_cells(diff, item) for item in diff.metrics]
    found = [
        Table("outcomes", ("in A", "in B", ">runs"), [[a, b, f"{n:,}"] for a, b, n in diff.transitions]),
        Table("metrics of the runs that completed in both", _METRICS, metrics),
    ]
    for kind, title in KINDS.items():
        changes = diff.of_kind(kind)
        rows: list[list[str]] = []
        for change in changes[:most]:
            name = change.a if change.a == change.b else f"{change.a} / {change.b}"
            values = ", ".join(f"{key} {format_value(value)}" for key, value in change.parameters.items())
            grown = "; ".join(map(metric_label, change.metrics))
            rows.append([name, change.before, change.after, grown, values])
        if len(changes) > most:
            rows.append([f"and {len(changes) - most:,} more", "", "", "", ""])
        columns = ("run", "in A", "in B", "metrics", "parameters")
        found.append(Table(f"{len(changes):,} {title}", columns, rows))
    return [table for table in found if table.rows]


def _metric_cells(diff: SweepDiff, change: MetricChange) -> list[str]:
    """Cells of a metric, in millimetres and per cent of the body weight of the runs of A."""
    scale, unit = display_unit(change.unit, diff.a.weight[diff.rows_a])
    item = _describe(diff, change, scale)
    median, worst, noise = item["median"], item["worst"], item["noise"]["value"]
    a, b = (format_number(worst[side], 3) if worst else "" for side in "ab")
    return [
        metric_label(change.name),
        item["verdict"],
        *(f"{item[key]:,}" for key in ("better", "worse", "regressed")),
        *(format_number(median[side]) for side in "ab"),
        unit.replace("% of body weight", BODY_WEIGHT).replace(" ", "\u00a0"),
        f"{median['shift']:+.2g}" if median["shift"] else "0",
        format_number(item["p"], 2),
        "no bound" if math.isinf(noise) else format_number(noise, 2),
        f"{worst['run']}: {a} → {b}" if worst else "",
    ]


def print_diff(diff: SweepDiff) -> None:
    """Print a comparison on the terminal."""
    for letter, side in (("A", _side(diff.a)), ("B", _side(diff.b))):
        at = f", revision {side['revision']}" if side["revision"] else ""
        print_line(f"{letter}: {side['source']}, {side['runs']:,} runs{at}")
    for note in diff.notes:
        print_line(f"note: {note}")
    for table in tables(diff, _SHOWN):
        print_table(table.title, table.columns, [[_marked(cell) for cell in row] for row in table.rows])
    style = "bold red" if diff.regressions else "bold yellow" if diff.lacking else "bold green"
    print_line(diff.sentence, style)


def _marked(cell: str) -> Text:
    text = cell.label if isinstance(cell, State) else cell
    return Text(text, _COLOURS.get(text, ""))


def write_page(diff: SweepDiff, path: Path, *, force: bool) -> None:
    """Write a comparison as a self-contained page.

    Raises:
        InputError: the file exists and ``force`` is off, or it cannot be written.
    """
    end = " in the runs that both have" if diff.lacking else ""
    headline = "regression" if diff.regressions else f"no regression{end}"
    text = render_page(
        "diff.html.j2",
        f"{diff.b.name} against {diff.a.name}: {headline}",
        styles=["report.css", "sweep.css"],
        diff=diff,
        sides=[_side(diff.a), _side(diff.b)],
        tables=tables(diff, _SHOWN_IN_PAGE),
        note=_NOTE,
    )
    with output_file(path, force=force) as work:
        work.write_text(text, encoding="utf-8")
