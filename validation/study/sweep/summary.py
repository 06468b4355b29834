"""A sweep in a few numbers: ``sweep.json``, the table on the terminal, the exit status."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
import pyarrow as pa

from validation.cli.options import Status
from validation.show.text import print_line, print_table
from validation.study.sweep.columns import OUTCOMES
from validation.study.sweep.faults import MACHINE_FAULTS
from validation.study.sweep.progress import duration
from validation.study.sweep.table import SweepTable

AGAIN = ("timed_out", "interrupted")
"""Outcomes that are no answer: ``--resume`` walks these runs again, and those that the machine ended."""
_SHOWN = 10


def unfinished(table: pa.Table) -> np.ndarray:
    """Rows that ``--resume`` walks again, shape (N,), bool: what ended them may have been the machine."""
    outcome = np.array(table["outcome"].to_pylist(), dtype=object)
    reason = np.array(table["reason"].to_pylist(), dtype=object)
    return np.isin(outcome, AGAIN) | ((outcome == "crashed") & np.isin(reason, list(MACHINE_FAULTS)))


def worst_runs(table: pa.Table, metadata: dict[str, Any], count: int) -> list[int]:
    """Numbers of the runs that walked worst, worst first.

    Those that did not complete come first, the earliest end before the later; then those that used most of a
    tolerance. Ties go to the lower number.
    """
    outcome = table["outcome"].to_pylist()
    steps = table["steps_completed"].to_pylist()
    used = SweepTable(table, metadata, None, "sweep").worst_used
    ranked = []
    for row, name in enumerate(outcome):
        if name in OUTCOMES[1:4]:
            ranked.append((0, float(steps[row] or 0), row))
        elif name == "completed":
            ranked.append((1, -float(used[row]) if not np.isnan(used[row]) else 0.0, row))
    numbers = table["run"]
    return [numbers[row].as_py() for *_, row in sorted(ranked)[:count]]


def summarise(table: pa.Table, metadata: dict[str, Any], *, seconds: float | None = None) -> dict[str, Any]:
    """Contents of ``sweep.json``.

    Args:
        table: of the sweep.
        metadata: of the table.
        seconds: wall-clock time of this call [s].
    """
    outcomes = Counter(table["outcome"].to_pylist())
    verdicts = Counter(v for v in table["verdict"].to_pylist() if v is not None)
    rows = zip(
        table["outcome"].to_pylist(), table["reason"].to_pylist(), table["failed"].to_pylist(), strict=True
    )
    reasons: Counter[str] = Counter()
    failed: Counter[str] = Counter()
    for outcome, reason, names in rows:
        if outcome == "refused":
            reasons[str(reason)] += 1
        failed.update(name for name in (names or "").split(",") if name)
    revisions = sorted({str(value) for value in table["environment_revision"].to_pylist()})
    walking = [value for value in table["timing_total"].to_pylist() if value is not None]
    memory = [value for value in table["environment_memory_peak"].to_pylist() if value is not None]
    columns = table.select(["run", "name", "outcome", "verdict", "failed", "recording"])
    by_run = {entry["run"]: entry for entry in columns.to_pylist()}
    return {
        "name": metadata["name"],
        "profile": metadata["profile"],
        "runs": metadata["runs"],
        "rows": table.num_rows,
        "outcomes": {name: outcomes[name] for name in OUTCOMES if outcomes[name]},
        "verdicts": dict(sorted(verdicts.items())),
        "refusals": dict(reasons.most_common()),
        "failed": dict(failed.most_common()),
        "worst": [by_run[run] for run in worst_runs(table, metadata, _SHOWN)],
        "unfinished": int(unfinished(table).sum()) + metadata["runs"] - table.num_rows,
        "revisions": revisions,
        "environments": len(set(table["environment_code"].to_pylist())),
        "timing": {"wall": seconds, "workers": sum(walking), "unit": "s"},
        "memory_peak": {"value": max(memory, default=None), "unit": "MB"},
    }


def status_of(summary: dict[str, Any]) -> Status:
    """Exit status of a sweep: of what walked, the worst."""
    outcomes, verdicts = summary["outcomes"], summary["verdicts"]
    if outcomes.get("crashed"):
        return Status.CRASH
    if any(outcomes.get(name) for name in (*OUTCOMES[1:4], *AGAIN)):
        return Status.NOT_COMPLETED
    if not outcomes.get("completed"):
        return Status.REFUSED
    return Status.PASS if set(verdicts) <= {"pass"} else Status.OUT_OF_TOLERANCE


def print_summary(summary: dict[str, Any], directory: str) -> None:
    """For people."""
    verdicts = summary["verdicts"]
    rows = []
    for name, number in summary["outcomes"].items():
        detail = ""
        if name == "completed":
            detail = ", ".join(
                f"{verdicts[v]} {v.replace('_', ' ')}" for v in verdicts if v != "not_measured"
            )
        elif name == "refused":
            detail = ", ".join(f"{n} {reason}" for reason, n in summary["refusals"].items())
        rows.append((name.replace("_", " "), str(number), detail))
    noun = "run" if summary["runs"] == 1 else "runs"
    title = f"sweep {summary['name']}: {summary['rows']} of {summary['runs']} {noun}"
    print_table(title, (("outcome", "left"), ("runs", "right"), ("", "left")), rows)
    if summary["failed"]:
        shown = ", ".join(f"{name} {number}" for name, number in list(summary["failed"].items())[:_SHOWN])
        print_line(f"out of tolerance: {shown}")
    timing = summary["timing"]
    if timing["wall"] is not None:
        print_line(f"{duration(timing['wall'])} on the clock, {duration(timing['workers'])} of workers")
    if summary["unfinished"]:
        one = summary["unfinished"] == 1
        print_line(
            f"{summary['unfinished']} {'run has' if one else 'runs have'} no answer yet: "
            f"--resume walks {'it' if one else 'them'} again"
        )
    print_line(directory)
