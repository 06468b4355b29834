"""The report of a sweep: one self-contained HTML page, made from the saved table alone.

Its size is bounded for any number of runs. All text is escaped; nothing is fetched; without scripts only the
choice of the map's axes is missing.
"""

from __future__ import annotations

import json
import re
import shlex
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from ampm.presets import PRESETS
from ampm.run_file import load_run
from validation.judge.metrics import METRICS, metric_label
from validation.show.page import render_page
from validation.show.text import format_duration, format_value, limit_with_unit, number, with_unit
from validation.store.identity import parameter_values
from validation.store.saved import RECORDING_FILE, REPORT_FILE
from validation.study.sweep import figures, store
from validation.study.sweep.influence import Target, analyse, correlated
from validation.study.sweep.table import BROKEN, STATES, State, SweepTable, read_sweep

WORST = 10
"""Rows of a table of worst runs."""
MOST_SHOWN = 8
"""Parameters of a run in a table; the command that repeats it has all."""
IDLE = 0.01
"""Median share of its tolerance below which a metric is rounding, and influences on it are not computed
[1]."""
_MIXED = "mixed: "
_REFUSED, _FAILS = "is refused", "fails, if it walks"
_PER_RUN = ("environment_worker", "environment_attempts", "environment_memory_peak", "environment_time")
"""Columns of the environment that always differ between runs."""

_KEPT = {"report": REPORT_FILE, "recording": RECORDING_FILE}
"""Files of a run that is kept."""

Row = tuple[str, ...]


def write_sweep_report(directory: Path) -> Path:
    """Write ``report.html`` into a sweep's folder from the table that it holds.

    Args:
        directory: folder of a sweep, finished or not; an existing report in it is replaced.

    Returns:
        Path of the report.

    Raises:
        InputError: the folder holds no sweep, or no result yet.
    """
    path = Path(directory) / REPORT_FILE
    text = render(read_sweep(directory))
    with store.durable(path) as file:
        file.write(text.encode())
    return path


def render(sweep: SweepTable) -> str:
    """Render the report of a sweep.

    Returns:
        A complete HTML document; its only references are relative links to kept runs.
    """
    varied = {key: sweep.values(key) for key in sweep.varied}
    targets = analyse(varied, targets_of(sweep)) if varied else []
    keys = by_strength(sweep.varied, targets)
    lost, furthest = (
        [row for row in sweep.worst if sweep.measured[row] == ended][:WORST] for ended in (False, True)
    )
    still, data = _map(sweep, keys, [*lost, *furthest])
    judged = [name for name in sweep.judged if np.isfinite(sweep.shown(name)[0]).any()]
    own = [name for name in judged if name in METRICS and METRICS[name].kind == "instrument"]
    walked = [name for name in judged if name not in own]
    environment = environment_rows(sweep)
    verdict = judge_sweep(sweep)
    return render_page(
        "sweep.html.j2",
        f"{sweep.name}: {verdict[1]}",
        styles=["report.css", "sweep.css"],
        scripts=["sweep.js"],
        vega=figures.vega_script() if data else "",
        sweep=sweep,
        verdict=verdict,
        share=share,
        still=still,
        data=data,
        pictures=[figures.distribution(*sweep.shown(name), metric_label(name)) for name in walked],
        metrics=[
            (title, [metric_row(sweep, name) for name in names])
            for title, names in (("", walked), ("The instrument itself", own))
        ],
        worst=[
            ("Did not complete, the earliest end first", run_rows(sweep, lost, keys)),
            ("Out of tolerance, or closest to it", run_rows(sweep, furthest, keys)),
        ],
        targets=targets,
        correlated=[(a, b, number(rho, 2)) for a, b, rho in correlated(varied)[:6]],
        unwalked=unwalked_rows(sweep),
        computing_time=format_duration(float(np.nansum(sweep.numbers("timing_total")))),
        varied_rows=varied_rows(sweep),
        fixed_rows=[
            (key, with_unit(format_value(sweep.table.column(key)[0].as_py()), sweep.unit(key)))
            for key in sweep.parameters
            if key not in sweep.varied
        ],
        timing_rows=timing_rows(sweep),
        environment_rows=environment,
        mixed=[name for name, text in environment if text.startswith(_MIXED)],
        modified="True" in sweep.words("environment_modified"),
        reason_rows=[(metric_label(n), _limit(sweep, n), limit.reason) for n, limit in sweep.limits.items()],
    )


def _map(sweep: SweepTable, keys: Sequence[str], keep: Sequence[int]) -> tuple[Markup, Markup]:
    """Still picture and data of the map; empty without a parameter that varies."""
    if not keys:
        return Markup(), Markup()
    axes = [figures.parameter_axis(sweep, key) for key in keys] + figures.metric_axes(sweep)
    data = figures.map_data(sweep, axes, links_of(sweep), repeat_command(sweep), keep)
    text = json.dumps(data, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    # "<" is escaped: no text in the data can end the script element.
    still = figures.still_map(data, "Outcome of runs over two parameters")
    return still, Markup(text.replace("<", "\\u003c"))


# ------------------------------------------------------------------------------------------------ runs


def repeat_command(sweep: SweepTable) -> tuple[str, str]:
    """Shortest command for the runs of a sweep: a preset, and what differs from it.

    Returns:
        Its beginning and its end; the varied keys go between.
    """
    shared = {key: sweep.table.column(key)[0].as_py() for key in sweep.parameters if key not in sweep.varied}
    found: list[list[str]] = []
    for preset in PRESETS:
        base = parameter_values(load_run(preset))
        settings = [_setting(key, v) for key, v in shared.items() if v is not None and base.get(key) != v]
        found.append([f"ampm validate {preset}", *settings])
    shortest = min(found, key=len)
    return " ".join(shortest), shlex.join(["--profile", sweep.profile, *sweep.metadata["options"]])


def _setting(key: str, value: Any) -> str:
    return shlex.join(["--set", f"{key}={value}"])


def links_of(sweep: SweepTable) -> dict[int, list[tuple[str, str]]]:
    """Text and address, relative to the page, of the files of every kept run."""
    found = {}
    for row, name in enumerate(sweep.words("recording")):
        if re.fullmatch(rf"{store.RECORDINGS}/\w+", name):  # only files beside the page
            kept = [(text, f"{name}/{file}") for text, file in _KEPT.items()]
            if sweep.directory is not None:
                kept = [item for item in kept if (sweep.directory / item[1]).is_file()]
            found[row] = kept
    return {row: kept for row, kept in found.items() if kept}


def run_rows(sweep: SweepTable, rows: Sequence[int], keys: Sequence[str]) -> list[dict[str, Any]]:
    """Rows of a table of runs, each with its first :data:`MOST_SHOWN` parameters of ``keys``."""
    links, names, repeat, found = links_of(sweep), sweep.words("name"), repeat_command(sweep), []
    for row in rows:
        varied = [(key, sweep.table.column(key)[row].as_py()) for key in keys]
        settings = [_setting(key, value) for key, value in varied if value is not None]
        found.append(
            {
                "name": names[row],
                "state": sweep.state(row),
                "why": _why(sweep, row),
                "links": links.get(row, []),
                "parameters": [(key, format_value(value)) for key, value in varied[:MOST_SHOWN]],
                "repeat": " ".join([repeat[0], *settings, repeat[1]]),
            }
        )
    return found


def _why(sweep: SweepTable, row: int) -> str:
    """The metric that used most of its tolerance, or why and when the walk ended."""
    shares = {name: value for name in sweep.judged if not np.isnan(value := sweep.used(name)[row])}
    if not shares:
        time, steps = sweep.numbers("outcome_time")[row], sweep.numbers("steps_completed")[row]
        why = sweep.words("cause")[row] or sweep.words("reason")[row].replace("_", " ")
        return why if np.isnan(time) else f"at {time:.2f} s, steps walked: {steps:.0f}: {why}"
    worst = max(shares, key=lambda name: shares[name])
    values, _, unit = sweep.shown(worst)
    over = sum(value > 1.0 for value in shares.values())
    more = f"; {over} of {len(shares)} over their limit" if over > 1 else ""
    return f"{metric_label(worst)}: {_amount(values[row], unit)}, limit {_limit(sweep, worst, row)}{more}"


# --------------------------------------------------------------------------------------------- metrics


def metric_row(sweep: SweepTable, metric: str) -> tuple[str, str, list[Row]]:
    """Label of a metric, how many runs are over its tolerance, and names and values of the other cells."""
    values, _, unit = sweep.shown(metric)
    known = values[np.isfinite(values)]
    over = int((sweep.used(metric) > 1.0).sum())
    quantiles = {"median": 0.5, "95 % below": 0.95, "largest": 1.0}
    cells: list[Row] = [(name, _amount(np.quantile(known, part), unit)) for name, part in quantiles.items()]
    counted = f"{over:,} ({share(over, known.size)})" if over else ""
    return metric_label(metric), counted, [*cells, ("tolerance", _limit(sweep, metric))]


def _amount(value: float, unit: str) -> str:
    """A number and its unit; a whole number without one is a count and has no decimals."""
    count = not unit and float(value).is_integer() and abs(value) < 1e5
    return f"{value:.0f}" if count else with_unit(float(value), unit)


def _limit(sweep: SweepTable, metric: str, row: int | None = None) -> str:
    """Limit of a run, or of all, which differs where their bodies do; without a limit, nothing."""
    values, unit = sweep.shown_limits(metric)
    values = values if row is None else values[[row]]
    values = values[np.isfinite(values)]
    if not values.size:
        return ""
    low, high = float(values.min()), float(values.max())
    if low == high:
        return limit_with_unit(low, unit)
    return f"{number(low, 3)} ... {limit_with_unit(float(number(high, 3)), unit)}"


def targets_of(sweep: SweepTable) -> dict[str, figures.Array]:
    """Targets of the influence analysis: refusal, failure of a walk, every metric above rounding."""
    known, refused = ~sweep.is_state(*BROKEN), sweep.is_state(State.REFUSED)
    events = {_REFUSED: (known, refused), _FAILS: (known & ~refused, ~sweep.is_state(State.PASS))}
    found = {
        name: np.where(among, which, np.nan)
        for name, (among, which) in events.items()
        if 0 < which[among].sum() < among.sum()
    }
    for metric in sweep.judged:
        used = sweep.used(metric)
        if np.isfinite(used).any() and np.nanmedian(used) >= IDLE:
            found[metric_label(metric)] = np.where(np.isfinite(used), used, np.nan)
    return found


def by_strength(keys: Sequence[str], targets: Sequence[Target]) -> list[str]:
    """Parameters by their strongest significant influence, on outcomes before metrics."""
    score = {key: [0.0, 0.0] for key in keys}
    for target in targets:
        place = target.name not in (_REFUSED, _FAILS)
        for item in target.drivers:
            score[item.parameter][place] = max(score[item.parameter][place], item.strength)
    return sorted(keys, key=lambda key: score[key], reverse=True)


# ----------------------------------------------------------------------------------------- this sweep


def unwalked_rows(sweep: SweepTable) -> list[dict[str, Any]]:
    """Refusals, crashes, hangs and interruptions by reason, each with its first run as an example."""
    reasons, causes, names = (sweep.words(name) for name in ("reason", "cause", "name"))
    found = []
    for state in (State.REFUSED, *BROKEN):
        rows = np.flatnonzero(sweep.is_state(state)).tolist()
        for reason, count in Counter(reasons[row] for row in rows).most_common():
            row = next(row for row in rows if reasons[row] == reason)
            trace = f"{store.CRASHES}/{Path(names[row]).name}.txt"
            kept = sweep.directory is not None and (sweep.directory / trace).is_file()
            found.append(
                {
                    "state": state,
                    "reason": reason.replace("_", " "),
                    "runs": f"{count:,} ({share(count, len(sweep))})",
                    "example": f"run {names[row]}: {causes[row] or 'no cause was kept'}",
                    "traceback": trace if kept else "",
                }
            )
    return found


def varied_rows(sweep: SweepTable) -> list[Row]:
    """Parameters that vary: key, lowest and highest value, number of values, meaning."""
    found = []
    for key in sweep.varied:
        values = np.unique(sweep.values(key))
        ends = [with_unit(format_value(value.item()), sweep.unit(key)) for value in (values[0], values[-1])]
        found.append((key, *ends, f"{len(values):,}", sweep.describe(key)))
    return found


def timing_rows(sweep: SweepTable) -> list[Row]:
    """Median and largest of every time, and the workers' memory."""
    rows: list[Row] = []
    times = [name for name in sweep.table.column_names if name.startswith("timing_")]
    for name in (*times, "environment_memory_peak", "environment_attempts"):
        values = sweep.numbers(name)[np.isfinite(sweep.numbers(name))]
        if values.size:
            middle, high = (with_unit(float(f(values)), sweep.unit(name)) for f in (np.median, np.max))
            rows.append((name.partition("_")[2].replace("_", " "), f"{middle}, up to {high}"))
    return [*rows, ("workers", f"{len(sweep.distinct('environment_worker'))}")]


def environment_rows(sweep: SweepTable) -> list[Row]:
    """Versions and platform: name, and value or, where runs differ in it, values and their runs."""
    rows: list[Row] = []
    for column in sweep.table.column_names:
        if not column.startswith("environment_") or column in _PER_RUN:
            continue
        if counted := Counter(filter(None, sweep.words(column))).most_common():
            text = _MIXED + ", ".join(f"{word} ({n:,} runs)" for word, n in counted[:6])
            label = column.removeprefix("environment_").removeprefix("version_").replace("_", " ")
            rows.append((label, text if len(counted) > 1 else counted[0][0]))
    times = sweep.distinct("environment_time")
    return [*rows, ("walked from, to (UTC)", f"{times[0]}, {times[-1]}")] if times else rows


def judge_sweep(sweep: SweepTable) -> tuple[str, str, str]:
    """Whether a sweep passes: all walks met every tolerance, and every run has a result.

    Returns:
        ``pass``, ``fail`` or ``open``; a few words; a sentence.
    """
    counts, missing = sweep.counts, sweep.planned - len(sweep)
    walked, passed = sum(counts[state] for state in STATES if state.walked), counts[State.PASS]
    css, headline = "open", "nothing walked"
    if passed < walked:
        css, headline = "fail", f"{share(passed, walked)} of what walked passes"
    elif any(counts[state] for state in BROKEN):
        headline = "not every run has an answer"
    elif walked and not missing:
        css, headline = "pass", "pass"
    sentence = f"{passed:,} of {walked:,} runs that walked met every tolerance."
    if missing:
        headline = "unfinished"
        sentence += f" {missing:,} of {sweep.planned:,} runs are missing: 'ampm sweep --resume' walks them."
    return css, headline, sentence


def share(part: int, whole: int) -> str:
    """A percentage that is not rounded to 0 or 100."""
    percent = 100.0 * part / max(whole, 1)
    if part in (0, whole) or 0.1 <= percent <= 99.9:
        text = f"{percent:.0f}" if part in (0, whole) or 1.0 <= percent < 99.5 else f"{percent:.1f}"
    else:
        text = "< 0.1" if percent < 50.0 else "> 99.9"
    return f"{text} %"
