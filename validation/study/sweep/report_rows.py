"""Tables of a sweep's report: runs, refusals, crashes, parameters, time, environment."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ampm.parameters import PRESETS, load_run
from validation.judge.metrics import metric_label
from validation.show.report import number, with_unit
from validation.study.sweep.columns import parameter_values
from validation.study.sweep.store import CRASHES
from validation.study.sweep.table import STATES, State, SweepTable

STEPS = "gait.steps"
MOST_SHOWN = 8
"""Parameters of a run in a table; the command that repeats it has them all."""
_PER_RUN = frozenset({"worker", "attempts", "memory_peak", "time"})
"""Entries of the environment that differ between runs by their nature."""
_DECISIVE = ("revision", "modified", "code", "python", "version_", "processor", "platform")


@dataclass(frozen=True)
class Repeat:
    """How a run of a sweep is walked again by itself.

    Attributes:
        start: of the command line, with what all runs share.
        end: of the command line.
        preset: that it starts from.
    """

    start: str
    end: str
    preset: str

    @classmethod
    def of(cls, sweep: SweepTable) -> Repeat:
        """Shortest command for the runs of a sweep: a preset, and what differs from it."""
        first = {key: sweep.table.column(key)[0].as_py() for key in sweep.parameters} if len(sweep) else {}
        shared = {key: value for key, value in first.items() if key not in sweep.varied}
        candidates = {name: parameter_values(load_run(name)) for name in PRESETS}
        preset = min(candidates, key=lambda name: _differences(candidates[name], shared))
        base = candidates[preset]
        words = [f"ampm validate {preset}"]
        for key, value in shared.items():
            if value is None or base.get(key) == value:
                continue
            words.append(f"--steps {value}" if key == STEPS else setting(key, value))
        return cls(" ".join(words), f"--profile {sweep.profile}" if sweep.profile else "", preset)

    def command(self, sweep: SweepTable, row: int) -> str:
        """The command for one run."""
        varied = [(key, sweep.table.column(key)[row].as_py()) for key in sweep.varied]
        words = [setting(key, value) for key, value in varied if value is not None]
        return " ".join(part for part in (self.start, *words, self.end) if part)


def _differences(base: dict[str, Any], values: dict[str, Any]) -> int:
    return sum(base.get(key) != value for key, value in values.items())


def setting(key: str, value: Any) -> str:
    """A parameter as the command line takes it, with every digit."""
    text = str(value) if isinstance(value, str | int) else repr(float(value))
    return shlex.join(["--set", f"{key}={text}"])


def value_text(value: Any) -> str:
    """A parameter's value for people."""
    if value is None:
        return "–"
    if isinstance(value, float):
        return "inf" if value == float("inf") else f"{value:.5g}"
    return str(value)


def amount(value: float, unit: str) -> str:
    """A figure and its unit; a whole number without one is a count and has no decimals."""
    if not unit and float(value).is_integer() and abs(value) < 1e5:
        return f"{value:.0f}"
    return with_unit(float(value), unit)


# ------------------------------------------------------------------------------------------------ runs


def links_of(sweep: SweepTable) -> dict[int, list[tuple[str, str]]]:
    """Text and address, relative to the page, of what is kept of every run that is kept."""
    found = {}
    for row, name in enumerate(sweep.words("recording")):
        if not name or ":" in name or "\\" in name or name.startswith("/") or ".." in name.split("/"):
            continue  # only what lies beside the page
        links = []
        folder = None if sweep.directory is None else sweep.directory / name
        for file, text in (("report.html", "report"), ("recording.rrd", "recording")):
            if folder is None or (folder / file).is_file():
                links.append((text, f"{name}/{file}"))
        if links:
            found[row] = links
    return found


def run_rows(
    sweep: SweepTable, rows: Sequence[int], repeat: Repeat, keys: Sequence[str]
) -> list[dict[str, Any]]:
    """Rows of a table of runs, each with its first :data:`MOST_SHOWN` parameters of ``keys``."""
    links, names = links_of(sweep), sweep.words("name")
    causes, reasons = sweep.words("cause"), sweep.words("reason")
    found = []
    for row in rows:
        state = STATES[sweep.states[row]]
        why = causes[row] or reasons[row].replace("_", " ")
        if state in (State.PASS, State.OUT_OF_TOLERANCE):
            why = _used_sentence(sweep, row)
        elif not np.isnan(sweep.numbers("outcome_time")[row]):
            time = sweep.numbers("outcome_time")[row]
            steps = sweep.numbers("steps_completed")[row]
            why = f"at {time:.2f} s, after {steps:.0f} step{'' if steps == 1 else 's'}: {why}"
        values = [(key, sweep.table.column(key)[row].as_py()) for key in keys[:MOST_SHOWN]]
        found.append(
            {
                "name": names[row] or str(row),
                "state": state.value,
                "label": state.label,
                "why": why,
                "links": links.get(row, []),
                "parameters": [(key, value_text(value)) for key, value in values],
                "more": max(len(keys) - MOST_SHOWN, 0),
                "repeat": repeat.command(sweep, row),
            }
        )
    return found


def _used_sentence(sweep: SweepTable, row: int) -> str:
    """The figure that used most of its tolerance, and how many are over theirs."""
    shares = {name: sweep.used(name)[row] for name in sweep.metrics if name in sweep.limits}
    shares = {name: value for name, value in shares.items() if not np.isnan(value)}
    if not shares:
        return ""
    worst = max(shares, key=lambda name: shares[name])
    values, limit, unit = sweep.shown(worst)
    unit = "% BW" if unit == "% of body weight" else unit
    text = f"{metric_label(worst)}: {amount(values[row], unit)}"
    if limit is not None:
        text += f", limit {with_unit(f'{limit:.6g}', unit)}"
    over = sum(value > 1.0 for value in shares.values())
    return f"{text}; {over} of {len(shares)} over their limit" if over > 1 else text


def refusal_rows(sweep: SweepTable) -> list[dict[str, Any]]:
    """Refusals by reason, most frequent first."""
    rows = np.flatnonzero(sweep.is_state(State.REFUSED))
    reasons, causes = sweep.words("reason"), sweep.words("cause")
    counted = Counter(reasons[row] for row in rows)
    most = max(counted.values(), default=1)
    examples: dict[str, str] = {}
    for row in rows.tolist():
        examples.setdefault(reasons[row], causes[row])
    return [
        {
            "reason": reason.replace("_", " ") or "not said",
            "count": f"{count:,}",
            "share": f"{100.0 * count / len(rows):.1f}\u00a0%",
            "width": f"{100.0 * count / most:.1f}",
            "example": examples[reason],
        }
        for reason, count in counted.most_common()
    ]


def broken_rows(sweep: SweepTable, states: Sequence[State]) -> list[dict[str, Any]]:
    """Crashes, hangs and interruptions by kind and reason."""
    reasons, causes, names = sweep.words("reason"), sweep.words("cause"), sweep.words("name")
    found = []
    for state in states:
        rows = np.flatnonzero(sweep.is_state(state)).tolist()
        for reason, count in Counter(reasons[row] for row in rows).most_common():
            first = next(row for row in rows if reasons[row] == reason)
            found.append(
                {
                    "state": state.value,
                    "label": state.label,
                    "reason": reason or "–",
                    "count": f"{count:,}",
                    "first": names[first] or str(first),
                    "example": causes[first] or "no cause was kept",
                    "traceback": _traceback(sweep, names[first]),
                }
            )
    return found


def _traceback(sweep: SweepTable, name: str) -> str:
    """Address of a crash's traceback, relative to the page; empty if there is none."""
    file = f"{CRASHES}/{name}.txt"
    kept = sweep.directory is not None and "/" not in name and (sweep.directory / file).is_file()
    return file if kept else ""


# ------------------------------------------------------------------------------------------ parameters


def varied_rows(sweep: SweepTable) -> list[dict[str, Any]]:
    """Ranges of the parameters that vary."""
    found = []
    for key in sweep.varied:
        unit = "" if sweep.unit(key) == "1" else sweep.unit(key)
        if sweep.is_number(key):
            values = sweep.numbers(key)
            known = values[~np.isnan(values)]
            low, high = (with_unit(value_text(float(bound(known))), unit) for bound in (np.min, np.max))
            distinct = len(np.unique(known))
        else:
            words = sorted(set(sweep.words(key)))
            low, high, distinct = ", ".join(words[:6]), "", len(words)
        found.append(
            {
                "key": key,
                "low": low,
                "high": high,
                "distinct": f"{distinct:,}",
                "words": sweep.describe(key),
            }
        )
    return found


def fixed_rows(sweep: SweepTable) -> list[tuple[str, str]]:
    """Parameters that all runs share."""
    if not len(sweep):
        return []
    rows = []
    for key in sweep.parameters:
        if key not in sweep.varied:
            unit = "" if sweep.unit(key) == "1" else sweep.unit(key)
            rows.append((key, with_unit(value_text(sweep.table.column(key)[0].as_py()), unit)))
    return rows


# ------------------------------------------------------------------------------- time and environment


def facts(sweep: SweepTable) -> list[tuple[str, str]]:
    """The few figures beside the verdict."""
    rows = [("runs", f"{len(sweep):,}" + (f" of {sweep.planned:,}" if sweep.planned > len(sweep) else ""))]
    steps = sweep.numbers(STEPS)
    known = np.unique(steps[~np.isnan(steps)])
    if known.size:
        text = f"{known[0]:.0f}" if known.size == 1 else f"{known[0]:.0f} … {known[-1]:.0f}"
        rows.append(("steps of a run", text))
    rows.append(("parameters that vary", f"{len(sweep.varied)}"))
    rows += _used_facts(sweep)
    total = np.nansum(sweep.numbers("timing_total"))
    if total > 0.0:
        rows.append(("computing time", duration(float(total))))
    return rows


def _used_facts(sweep: SweepTable) -> list[tuple[str, str]]:
    """How much of the tolerances is used; a broken limit of 0 has no share, and is counted instead."""
    shares = {name: sweep.used(name) for name in sweep.metrics if name in sweep.limits}
    if not shares:
        return []
    used = np.stack(list(shares.values()))
    worst = np.max(np.where(np.isfinite(used), used, -np.inf), axis=0)
    worst = worst[np.isfinite(worst)]
    broken = [name for name, values in shares.items() if np.isinf(values).any()]
    rows = []
    if worst.size:
        which = "tolerance above 0" if broken else "tolerance"
        rows.append((f"of its tightest {which}, the median run uses", f"{100 * np.median(worst):.0f}\u00a0%"))
    if broken:
        names = "; ".join(metric_label(name) for name in broken)
        count, measured = int(np.isinf(used).any(axis=0).sum()), int(sweep.measured.sum())
        rows.append((f"over a limit of 0 ({names})", f"{count:,} of {measured:,}"))
    return rows


def duration(seconds: float) -> str:
    """A time for people."""
    if seconds < 120.0:
        return f"{seconds:.3g}\u00a0s"
    if seconds < 7200.0:
        return f"{seconds / 60.0:.0f}\u00a0min"
    return f"{seconds / 3600.0:.1f}\u00a0h"


def timing_rows(sweep: SweepTable) -> list[tuple[str, str, bool]]:
    """Median and largest of every time, and the workers' memory."""
    rows = []
    for name in sweep.table.column_names:
        if not name.startswith("timing_") or not sweep.is_number(name):
            continue
        values = sweep.numbers(name)
        values = values[np.isfinite(values)]
        if values.size:
            unit = "" if name.endswith("factor") else "\u00a0s"
            label = name.removeprefix("timing_").replace("_", " ")
            text = f"{number(float(np.median(values)))}{unit}, up to {number(float(values.max()))}{unit}"
            rows.append((f"{label}, median", text, False))
    memory = sweep.numbers("environment_memory_peak")
    if np.isfinite(memory).any():
        rows.append(("memory of a worker, up to", with_unit(float(np.nanmax(memory)), "MB"), False))
    workers = {name for name in sweep.words("environment_worker") if name}
    if workers:
        rows.append(("workers", f"{len(workers)}", False))
    attempts = sweep.numbers("environment_attempts")
    if np.nansum(attempts > 1):
        rows.append(("runs begun more than once", f"{int(np.nansum(attempts > 1)):,}", False))
    return rows


def _environment(sweep: SweepTable) -> dict[str, list[tuple[str, int]]]:
    """Distinct values and their counts, by entry; runs that say nothing are left out."""
    found = {}
    for column in sweep.table.column_names:
        name = column.removeprefix("environment_")
        if name == column or name in _PER_RUN:
            continue
        counted = Counter(word for word in sweep.words(column) if word)
        if counted:
            found[name] = counted.most_common()
    return found


def environment_rows(sweep: SweepTable) -> list[tuple[str, str, bool]]:
    """Versions and platform: name, value, whether runs differ in it."""
    rows = []
    for name, values in _environment(sweep).items():
        label = name.removeprefix("version_").replace("_", " ")
        if name == "modified":
            label, values = "changed since that revision", [(_yes(word), n) for word, n in values]
        if len(values) == 1:
            text = values[0][0]
        else:
            text = ", ".join(f"{word} ({count:,} runs)" for word, count in values[:6])
            text += ", …" if len(values) > 6 else ""
        rows.append((label, text, len(values) > 1))
    times = sorted(word for word in sweep.words("environment_time") if word)
    if times:
        rows.append(("walked from, to (UTC)", f"{times[0]}, {times[-1]}", False))
    return rows


def warnings(sweep: SweepTable) -> list[str]:
    """What makes a sweep less than one measurement."""
    found = []
    values = _environment(sweep)
    mixed = [name for name, counted in values.items() if len(counted) > 1 and name.startswith(_DECISIVE)]
    if mixed:
        names = ", ".join(name.removeprefix("version_").replace("_", " ") for name in mixed)
        found.append(
            "These runs were not all made by the same program on the same kind of machine; not the same: "
            f"{names}. Rows of different versions or revisions are not one measurement; see “Versions and "
            "platform”."
        )
    if any(word == "True" for word, _ in values.get("modified", ())):
        found.append(
            "The code differed from its revision when these runs were made, so that the revision alone does "
            "not reproduce them."
        )
    return found


def _yes(word: str) -> str:
    return {"True": "yes", "False": "no"}.get(word, word)
