"""The report of a sweep: one self-contained HTML page, made from the folder's table alone.

All text is escaped. Pictures and scripts are in the page, see :mod:`validation.study.sweep.figures`.
"""

import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from ampm.presets import PRESETS
from ampm.run_file import load_run
from validation.show.page import render_page
from validation.show.text import format_duration, format_value
from validation.store.folders import output_file
from validation.store.identity import parameter_values
from validation.study.sweep import figures
from validation.study.sweep.table import BROKEN, REPORT, STATES, State, SweepTable, read_sweep
from validation.table import Table, format_number, short_unit

WORST = 12
"""Runs in each of both tables of the worst."""
MOST_SHOWN = 8
"""Parameters of a run in a table; the command that repeats it has all."""


def write_sweep_report(directory: Path) -> Path:
    """Write ``report.html`` into a sweep's folder from the table that it holds.

    Args:
        directory: folder of a sweep, finished or not; an existing report in it is replaced.

    Returns:
        Path of the report.

    Raises:
        InputError: the folder holds no sweep, or no result yet.
    """
    path = Path(directory) / REPORT
    text = render(read_sweep(directory))
    with output_file(path) as file:
        file.write_text(text, encoding="utf-8")
    return path


def render(sweep: SweepTable) -> str:
    """Render the report of a sweep.

    Returns:
        A complete HTML document; its only references are relative links to kept runs.
    """
    walked = [row for row in sweep.worst if not sweep.measured[row]][:WORST]
    furthest = [row for row in sweep.worst if sweep.measured[row]][:WORST]
    judged = [name for name in sweep.judged if np.isfinite(sweep.shown(name)[0]).any()]
    links = links_of(sweep)
    charts: dict[str, Markup] = {}
    if sweep.varied:
        runs = figures.run_data(sweep, figures.drawn_rows(sweep, [*walked, *furthest]), links)
        charts = {
            "fields": figures.as_json(list(runs[0])),
            "rows": figures.as_json([list(item.values()) for item in runs]),
            "scatter": figures.as_json(figures.scatter(sweep)),
            "parallel": figures.as_json(figures.parallel(sweep)),
            "vega": figures.vega_script(),
        }
    verdict = judge_sweep(sweep)
    return render_page(
        "sweep.html.j2",
        f"{sweep.name}: {verdict[1]}",
        styles=["report.css", "sweep.css"],
        sweep=sweep,
        verdict=verdict,
        share=share,
        charts=charts,
        most_points=figures.MOST_POINTS,
        category=figures.category(sweep),
        hues=figures.HUES,
        pictures=[_distribution(sweep, name) for name in judged],
        metrics=metric_table(sweep, judged),
        worst=[
            ("Did not complete, the earliest end first", run_rows(sweep, walked, links)),
            ("Out of tolerance, or closest to it", run_rows(sweep, furthest, links)),
        ],
        unwalked=unwalked_table(sweep),
        computing_time=format_duration(float(np.nansum(sweep.numbers("timing_total")))),
    )


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


def links_of(sweep: SweepTable) -> dict[int, str]:
    """Row to the address of its report, relative to the page, of every kept run."""
    if sweep.directory is None:
        return {}
    addresses = {row: f"{name}/{REPORT}" for row, name in enumerate(sweep.words("recording")) if name}
    return {row: address for row, address in addresses.items() if (sweep.directory / address).is_file()}


def run_rows(sweep: SweepTable, rows: Sequence[int], links: Mapping[int, str]) -> list[dict[str, Any]]:
    """Rows of a table of runs, each with its first :data:`MOST_SHOWN` varied parameters."""
    names, repeat, found = sweep.words("name"), repeat_command(sweep), []
    for row in rows:
        varied = [(key, sweep.table.column(key)[row].as_py()) for key in sweep.varied]
        settings = [_setting(key, value) for key, value in varied if value is not None]
        found.append(
            {
                "name": names[row],
                "state": sweep.state(row),
                "why": _why(sweep, row),
                "link": links.get(row, ""),
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
    values, unit = sweep.shown(worst)
    over = sum(value > 1.0 for value in shares.values())
    more = f"; {over} of {len(shares)} over their limit" if over > 1 else ""
    return f"{sweep.label(worst)}: {_amount(values[row], unit)}, limit {_limit(sweep, worst, row)}{more}"


# ---------------------------------------------------------------------------------------------- tables


def metric_table(sweep: SweepTable, metrics: Sequence[str]) -> Table:
    """How many runs are over a metric's tolerance, and the distribution of its values."""
    rows = []
    for metric in metrics:
        values, unit = sweep.shown(metric)
        known = values[np.isfinite(values)]
        over = int((sweep.used(metric) > 1.0).sum())
        counted = f"{over:,} ({share(over, known.size)})" if over else "0"
        quantiles = [_amount(np.quantile(known, part), unit) for part in (0.5, 0.95, 1.0)]
        rows.append((sweep.label(metric), counted, *quantiles, _limit(sweep, metric)))
    columns = ("metric", ">over", ">median", ">95 % below", ">largest", ">tolerance")
    return Table("Metrics of the completed runs", columns, rows)


def _distribution(sweep: SweepTable, metric: str) -> Markup:
    """Histogram of a metric, with its limit if all runs have the same."""
    values, unit = sweep.shown(metric)
    limits = sweep.shown_limits(metric)[0]
    limits = np.unique(limits[np.isfinite(limits)])
    limit = float(limits[0]) if len(limits) == 1 else None
    key, names = figures.category(sweep)
    groups = {name: sweep.values(key) == name for name in names} if names else None
    return figures.distribution(values, limit, unit, sweep.label(metric), groups)


def _amount(value: float, unit: str) -> str:
    """A number and its unit."""
    return f"{format_number(float(value), 3)} {short_unit(unit)}".rstrip()


def _limit(sweep: SweepTable, metric: str, row: int | None = None) -> str:
    """Limit of a run, or of all, which differs where their bodies do; without a limit, nothing."""
    values, unit = sweep.shown_limits(metric)
    values = values if row is None else values[[row]]
    values = values[np.isfinite(values)]
    if not values.size:
        return ""
    low, high = float(values.min()), float(values.max())
    if low == high:
        return f"{format_number(low)} {short_unit(unit)}".rstrip()
    return f"{format_number(low, 3)} ... {_amount(high, unit)}"


def unwalked_table(sweep: SweepTable) -> Table:
    """Refusals, crashes, hangs and interruptions by reason, each with its first run as an example."""
    reasons, causes, names = (np.array(sweep.words(name)) for name in ("reason", "cause", "name"))
    rows = []
    for state in (State.REFUSED, *BROKEN):
        among = np.flatnonzero(sweep.is_state(state))
        for reason, count in Counter(reasons[among].tolist()).most_common():
            row = int(among[reasons[among] == reason][0])
            example = f"run {names[row]}: {causes[row] or 'no cause was kept'}"
            counted = f"{count:,} ({share(count, len(sweep))})"
            rows.append((state.label, reason.replace("_", " "), counted, example))
    return Table("", ("outcome", "reason", ">runs", "for example"), rows)


# --------------------------------------------------------------------------------------------- verdict


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
    return f"{text} %"
