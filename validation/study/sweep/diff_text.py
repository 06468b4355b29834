"""A comparison of two sweeps as JSON, as tables on the terminal, and as a page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from rich.markup import escape

from ampm.exceptions import InputError
from validation.judge.metrics import display_unit, metric_label
from validation.show.page import render_page
from validation.show.text import format_number, print_line, print_table
from validation.store.folders import output_file
from validation.study.sweep.diff import KINDS, Change, SweepDiff, revision
from validation.study.sweep.metric_change import SIGNIFICANCE, MetricChange
from validation.study.sweep.report import value_text
from validation.study.sweep.table import SweepTable

_SHOWN, _SHOWN_IN_PAGE = 12, 100
COLUMNS = (
    *("metric", "all runs", "better", "worse", "beyond", "median A", "median B"),
    *("unit", "shift", "p", "noise", "worst"),
)
NOTE = (
    "Better, worse: runs that differ by more than the noise, which is rounding or the numerical uncertainty "
    "of a convergence study. Beyond: grown by more than the tolerance, too. p: Wilcoxon's signed-rank test, "
    f"corrected for the number of metrics; at p < {SIGNIFICANCE:g} and a shift beyond the noise all "
    "runs together are called better or worse."
)


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
        "metrics": {
            item.name: _describe(diff, item, p) for item, p in zip(diff.metrics, diff.p_values, strict=True)
        },
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


def _describe(diff: SweepDiff, item: MetricChange, p: float) -> dict[str, Any]:
    medians = {"a": item.median(item.before), "b": item.median(item.after), "shift": item.median(item.growth)}
    worst = None
    if item.worse.any():
        row = int(np.argmax(np.where(item.worse, item.growth, -np.inf)))
        name = diff.a.words("name")[diff.rows_a[row]]
        worst = {"run": name, "a": float(item.before[row]), "b": float(item.after[row])}
    return {
        "unit": item.unit,
        "pairs": int(item.both.sum()),
        "better": int(item.better.sum()),
        "worse": int(item.worse.sum()),
        "regressed": int(item.regressed.sum()),
        "lost": int((item.completed & ~item.both).sum()),
        "noise": {"value": item.median(item.noise), "from": item.noise_from},
        "allowed": item.median(item.allowed),
        "median": medians,
        "p": p,
        "verdict": item.verdict(p),
        "worst": worst,
    }


def print_diff(diff: SweepDiff) -> None:
    """Print a comparison for people."""
    for letter, side in (("A", _side(diff.a)), ("B", _side(diff.b))):
        at = f", revision {side['revision']}" if side["revision"] else ""
        print_line(escape(f"{letter}: {side['source']}, {side['runs']:,} runs{at}"))
    for note in diff.notes:
        print_line(escape(f"note: {note}"))
    rows = [(a.label, b.label, f"{n:,}", "" if a is b else "changed") for a, b, n in diff.transitions]
    print_table("outcomes", _columns("in A", "in B", "runs", ""), rows)
    cells = [[escape(cell) for cell in row] for row in metric_cells(diff)]
    moved = [row for row in cells if row[2] != "0" or row[3] != "0"]
    for row in moved:
        row[1] = {"worse": "[red]worse[/]", "better": "[green]better[/]"}.get(row[1], row[1])
        row[4] = row[4] if row[4] == "0" else f"[red]{row[4]}[/]"
    if moved:
        print_table("metrics of the runs that completed in both", _columns(*COLUMNS), moved)
        print_line(f"[dim]{NOTE}[/]")
    if len(moved) < len(cells):
        print_line(f"metrics that are the same in every pair, but for noise: {len(cells) - len(moved)}")
    for title, changes in _groups(diff):
        shown = [[escape(cell) for cell in change_cells(change)] for change in changes[:_SHOWN]]
        rest = [[f"and {len(changes) - _SHOWN:,} more", "", "", "", ""]] if len(changes) > _SHOWN else []
        print_table(title, _columns("run", "in A", "in B", "metrics", "parameters"), [*shown, *rest])
    style = "bold red" if diff.regressions else "bold yellow" if diff.lacking else "bold green"
    print_line(f"[{style}]{escape(diff.sentence)}[/]")


def _columns(*names: str) -> list[tuple[str, str]]:
    left = ("metric", "all runs", "unit", "worst", "run", "in A", "in B", "metrics", "parameters", "")
    return [(name, "left" if name in left else "right") for name in names]


def metric_cells(diff: SweepDiff) -> list[list[str]]:
    """Rows of the table of metrics, with :data:`COLUMNS`."""
    found = []
    for name, item in describe_diff(diff)["metrics"].items():
        scale, unit = display_unit(item["unit"], math.nan) if item["unit"] != "N" else (1.0, "N")
        median, worst, noise = item["median"], item["worst"], item["noise"]["value"]
        a, b = (format_number(scale * worst[side], 3) if worst else "" for side in "ab")
        found.append(
            [
                metric_label(name),
                item["verdict"],
                *(f"{item[key]:,}" for key in ("better", "worse", "regressed")),
                *(format_number(scale * median[side]) for side in "ab"),
                unit.replace(" ", "\u00a0"),
                f"{scale * median['shift']:+.2g}" if median["shift"] else "0",
                format_number(item["p"], 2),
                "no bound" if math.isinf(noise) else format_number(scale * noise, 2),
                f"{worst['run']}: {a} → {b}" if worst else "",
            ]
        )
    return found


def change_cells(change: Change) -> list[str]:
    """Row of a table of runs: name, state before and after, metrics, parameters."""
    words = "; ".join(metric_label(name) for name in change.metrics[:3])
    more = f"; and {len(change.metrics) - 3} more" if len(change.metrics) > 3 else ""
    values = ", ".join(f"{key} {value_text(value)}" for key, value in change.parameters.items())
    name = change.a if change.a == change.b else f"{change.a} / {change.b}"
    return [name, change.before.label, change.after.label, words + more, values]


def _groups(diff: SweepDiff) -> list[tuple[str, Sequence[Change]]]:
    found = {title: diff.of_kind(kind) for kind, title in KINDS.items()}
    return [(f"{len(changes):,} {title}", changes) for title, changes in found.items() if changes]


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
    text = render_page(
        "diff.html.j2",
        styles=["report.css", "sweep.css"],
        diff=diff,
        sides=[_side(diff.a), _side(diff.b)],
        columns=_columns(*COLUMNS),
        metrics=metric_cells(diff),
        note=NOTE,
        changes=[
            (title, [(change, change_cells(change)) for change in changes[:_SHOWN_IN_PAGE]])
            for title, changes in _groups(diff)
        ],
    )
    with output_file(path, force=force) as work:
        work.write_text(text, encoding="utf-8")
