"""The report of a sweep: one self-contained HTML page, made from the saved table alone.

It can be mailed: however many runs there are, what is in the page is bounded. All text is escaped; nothing is
fetched; without scripts the page lacks nothing but the choice of the map's axes.
"""

from __future__ import annotations

import json
import shlex
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from markupsafe import Markup

from ampm.run_file import PRESETS, load_run
from validation.judge.metrics import METRICS, metric_label
from validation.show.page import render_page
from validation.show.report import number, with_unit
from validation.show.text import format_duration
from validation.store.identity import parameter_values
from validation.study.sweep import figures, store
from validation.study.sweep.influence import LEAST_RUNS, Target, analyse, entangled
from validation.study.sweep.table import (
    BROKEN,
    LOST,
    STATES,
    State,
    SweepTable,
    counted_states,
    judge_sweep,
    read_sweep,
    share,
)

REPORT_FILE = store.REPORT
WORST = 10
"""Rows of a table of worst runs."""
MOST_SHOWN = 8
"""Parameters of a run in a table; the command that repeats it has them all."""
IDLE = 0.01
"""Median share of its tolerance below which a metric is rounding, and what drives it of no interest [1]."""
_REFUSED, _FAILS = "is refused", "fails, if it walks"
_PER_RUN = ("environment_worker", "environment_attempts", "environment_memory_peak", "environment_time")
"""Columns of the environment that differ between runs by their nature."""

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
    targets = influences(sweep)
    keys = by_strength(sweep.varied, targets)
    lost, furthest = worst_rows(sweep)
    repeat = Repeat.of(sweep)
    still, data = _map(sweep, keys, repeat, [*lost, *furthest])
    refused = np.flatnonzero(sweep.is_state(State.REFUSED))
    judged = [name for name in sweep.metrics if name in sweep.limits]
    definition = sweep.metadata.get("definition")
    return render_page(
        "sweep.html.j2",
        styles=["report.css", "sweep.css"],
        scripts=["sweep.js"],
        library=figures.library() if data else "",
        sweep=sweep,
        verdict=judge_sweep(sweep),
        counts=counted_states(sweep),
        facts=facts(sweep),
        warnings=warnings(sweep),
        still=still,
        data=data,
        distributions=[
            figures.distribution(*_bars(sweep, name), metric_label(name))
            for name in judged
            if not _is_instrument(name) and np.isfinite(sweep.shown(name)[0]).any()
        ],
        metrics=[
            (
                title,
                [row for name in judged if _is_instrument(name) is own for row in _metric_row(sweep, name)],
            )
            for title, own in (("", False), ("The instrument itself", True))
        ],
        lost=run_rows(sweep, lost, repeat, keys),
        lost_count=int(sweep.is_state(*LOST).sum()),
        furthest=run_rows(sweep, furthest, repeat, keys),
        over=bool((sweep.worst_used[furthest] > 1.0).any()),
        kept=sum(bool(name) for name in sweep.words("recording")),
        targets=[target for target in targets if target.influences],
        unsaid=_grouped((t.silent, t.name) for t in targets if t.silent),
        least_runs=LEAST_RUNS,
        entangled=[(a, b, number(rho, 2)) for a, b, rho in entangled(_parameters(sweep))[:6]],
        refusals=_counted(sweep, refused, lambda row: share(row, len(refused))),
        refused_share=share(len(refused), len(sweep)),
        broken=[
            (state, *row)
            for state in BROKEN
            for row in _counted(sweep, np.flatnonzero(sweep.is_state(state)))
        ],
        varied=varied_rows(sweep),
        timing=timing_rows(sweep),
        environment=environment_rows(sweep),
        definition=definition if isinstance(definition, str) else "",
        fixed=[
            (key, with_unit(value_text(sweep.table.column(key)[0].as_py()), sweep.unit(key)))
            for key in sweep.parameters
            if len(sweep) and key not in sweep.varied
        ],
        why=[
            (metric_label(name), _limit_text(sweep, name), limit.reason)
            for name, limit in sweep.limits.items()
            if limit.reason
        ],
    )


def _grouped(pairs: Iterable[tuple[str, str]]) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for key, value in pairs:
        found.setdefault(key, []).append(value)
    return found


def _map(sweep: SweepTable, keys: Sequence[str], repeat: Repeat, keep: list[int]) -> tuple[Markup, Markup]:
    """Still picture and data of the map; empty without a parameter that varies."""
    if not keys:
        return Markup(), Markup()
    labels = {name: metric_label(name) for name in sweep.metrics if name in sweep.limits}
    axes = [figures.parameter_axis(sweep, key) for key in keys] + figures.metric_axes(sweep, labels)
    data = figures.map_data(sweep, axes, links_of(sweep), (repeat.start, repeat.end), keep)
    text = json.dumps(data, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    # "<" only as an escape: no text in the data can end the script element.
    return figures.still_map(data, "Outcome of runs over two parameters"), Markup(
        text.replace("<", "\\u003c")
    )


# ------------------------------------------------------------------------------------------------ runs


class Repeat(NamedTuple):
    """How a run of a sweep is walked again by itself: beginning and end of the command line."""

    start: str
    end: str

    @classmethod
    def of(cls, sweep: SweepTable) -> Repeat:
        """Shortest command for the runs of a sweep: a preset, and what differs from it."""
        values = {key: sweep.table.column(key)[0].as_py() for key in sweep.parameters} if len(sweep) else {}
        shared = {key: v for key, v in values.items() if key not in sweep.varied and v is not None}
        differing = {}
        for preset in PRESETS:
            base = parameter_values(load_run(preset))
            differing[preset] = {key: value for key, value in shared.items() if base.get(key) != value}
        preset, settings = min(differing.items(), key=lambda item: len(item[1]))
        start = [f"ampm validate {preset}", *(setting(key, value) for key, value in settings.items())]
        return cls(" ".join(start), f"--profile {sweep.profile}" if sweep.profile else "")

    def command(self, sweep: SweepTable, row: int) -> str:
        """The command for one run, with every digit."""
        varied = [(key, sweep.table.column(key)[row].as_py()) for key in sweep.varied]
        words = [setting(key, value) for key, value in varied if value is not None]
        return " ".join(filter(None, (self.start, *words, self.end)))


def setting(key: str, value: Any) -> str:
    """A parameter as the command line takes it, with every digit."""
    return shlex.join(["--set", f"{key}={value}"])


def value_text(value: Any) -> str:
    """A parameter's value for people."""
    return "–" if value is None else f"{value:.5g}" if isinstance(value, float) else str(value)


def worst_rows(sweep: SweepTable) -> tuple[list[int], list[int]]:
    """The runs that a reader should look at first.

    Returns:
        Rows that did not complete, the earliest end first, and of those that did the ones that used most of
        a tolerance, the worst first.
    """
    lost = [row for row in sweep.worst if not sweep.measured[row]]
    furthest = [row for row in sweep.worst if sweep.measured[row]]
    return lost[:WORST], furthest[:WORST]


def links_of(sweep: SweepTable) -> dict[int, list[tuple[str, str]]]:
    """Text and address, relative to the page, of what is kept of every run that is kept."""
    found = {}
    for row, name in enumerate(sweep.words("recording")):
        if not name or ":" in name or "\\" in name or name.startswith("/") or ".." in name.split("/"):
            continue  # only what lies beside the page
        folder = None if sweep.directory is None else sweep.directory / name
        files = (("report", f"{name}/report.html"), ("recording", f"{name}/recording.rrd"))
        links = [item for item in files if folder is None or (folder / Path(item[1]).name).is_file()]
        if links:
            found[row] = links
    return found


def run_rows(
    sweep: SweepTable, rows: Sequence[int], repeat: Repeat, keys: Sequence[str]
) -> list[dict[str, Any]]:
    """Rows of a table of runs, each with its first :data:`MOST_SHOWN` parameters of ``keys``."""
    links, names = links_of(sweep), sweep.words("name")
    return [
        {
            "name": names[row],
            "state": STATES[sweep.states[row]],
            "why": _why(sweep, row),
            "links": links.get(row, []),
            "parameters": [
                (key, value_text(sweep.table.column(key)[row].as_py())) for key in keys[:MOST_SHOWN]
            ],
            "more": max(len(keys) - MOST_SHOWN, 0),
            "repeat": repeat.command(sweep, row),
        }
        for row in rows
    ]


def _why(sweep: SweepTable, row: int) -> str:
    """The metric that used most of its tolerance, or why and when the walk ended."""
    shares = {name: sweep.used(name)[row] for name in sweep.metrics if name in sweep.limits}
    shares = {name: value for name, value in shares.items() if not np.isnan(value)}
    if not shares:
        time, steps = sweep.numbers("outcome_time")[row], sweep.numbers("steps_completed")[row]
        why = sweep.words("cause")[row] or sweep.words("reason")[row].replace("_", " ")
        return why if np.isnan(time) else f"at {time:.2f} s, steps walked: {steps:.0f}: {why}"
    worst = max(shares, key=lambda name: shares[name])
    values, _, unit = sweep.shown(worst)
    over = sum(value > 1.0 for value in shares.values())
    more = f"; {over} of {len(shares)} over their limit" if over > 1 else ""
    return f"{metric_label(worst)}: {amount(values[row], unit)}, limit {_limit_text(sweep, worst)}{more}"


# --------------------------------------------------------------------------------------------- metrics


def _is_instrument(metric: str) -> bool:
    return metric in METRICS and METRICS[metric].kind == "instrument"


def _bars(sweep: SweepTable, metric: str) -> tuple[figures.Array, float | None, str]:
    values, limit, unit = sweep.shown(metric)
    return values, limit, unit.replace("% of body weight", "% BW")


def _metric_row(sweep: SweepTable, metric: str) -> list[dict[str, Any]]:
    values, _, unit = sweep.shown(metric)
    known = values[np.isfinite(values)]
    if not known.size:
        return []
    over = int((sweep.used(metric) > 1.0).sum())
    quantiles = {"median": 0.5, "95 % below": 0.95, "largest": 1.0}
    numbers = [(name, amount(np.quantile(known, part), unit)) for name, part in quantiles.items()]
    return [
        {
            "label": metric_label(metric),
            "note": sweep.limits[metric].reason,
            "over": f"{over:,} ({share(over, known.size)})" if over else "",
            "numbers": [*numbers, ("tolerance", _limit_text(sweep, metric))],
        }
    ]


def amount(value: float, unit: str) -> str:
    """A number and its unit; a whole number without one is a count and has no decimals."""
    count = not unit and float(value).is_integer() and abs(value) < 1e5
    return f"{value:.0f}" if count else with_unit(float(value), unit)


def _limit_text(sweep: SweepTable, metric: str) -> str:
    _, limit, unit = sweep.shown(metric)
    if limit is None:
        return ""
    return with_unit(f"{limit:.6g}" if limit == 0.0 or 1e-3 <= limit < 1e5 else number(limit, 2), unit)


# ---------------------------------------------------------------------------------- what drives what


def _parameters(sweep: SweepTable) -> dict[str, Any]:
    return {k: sweep.numbers(k) if sweep.is_number(k) else np.array(sweep.words(k)) for k in sweep.varied}


def influences(sweep: SweepTable) -> list[Target]:
    """What drives refusal, failing once walking, and every metric that is more than rounding."""
    known = ~sweep.is_state(*BROKEN)
    refused = sweep.is_state(State.REFUSED)
    failed = ~sweep.is_state(State.PASS)
    events = {_REFUSED: (known, refused), _FAILS: (known & ~refused, failed)}
    targets = {
        name: np.where(among, which, np.nan)
        for name, (among, which) in events.items()
        if 0 < which[among].sum() < among.sum()
    }
    for metric in sweep.metrics:
        used = sweep.used(metric)
        if metric in sweep.limits and np.isfinite(used).any() and np.nanmedian(used) >= IDLE:
            targets[metric_label(metric)] = np.where(np.isfinite(used), used, np.nan)
    return analyse(_parameters(sweep), targets) if sweep.varied else []


def by_strength(keys: Sequence[str], targets: Sequence[Target]) -> list[str]:
    """Parameters by their strongest influence beyond chance, on outcomes before metrics."""
    score = {key: [0.0, 0.0] for key in keys}
    for target in targets:
        for item in target.drivers:
            place = target.name not in (_REFUSED, _FAILS)
            score[item.parameter][place] = max(score[item.parameter][place], item.strength)
    return sorted(keys, key=lambda key: score[key], reverse=True)


# ----------------------------------------------------------------------------------------- this sweep


def _counted(sweep: SweepTable, rows: Any, share_of: Any = None) -> list[tuple[Any, ...]]:
    """Reasons of some runs, most frequent first: reason, runs, an example's name and cause, share."""
    reasons, causes, names = (sweep.words(name) for name in ("reason", "cause", "name"))
    first = {reasons[row]: row for row in reversed(rows.tolist())}
    found = []
    for reason, count in Counter(reasons[row] for row in rows).most_common():
        row = first[reason]
        trace = f"{store.CRASHES}/{names[row]}.txt"
        kept = sweep.directory is not None and "/" not in names[row] and (sweep.directory / trace).is_file()
        found.append((reason.replace("_", " ") or "–", count, names[row], causes[row], trace if kept else "",
                      share_of(count) if share_of else ""))  # fmt: skip
    return found


def varied_rows(sweep: SweepTable) -> list[Row]:
    """Parameters that vary: key, lowest and highest value, number of values, meaning."""
    found = []
    for key in sweep.varied:
        known = (
            sweep.numbers(key)[~np.isnan(sweep.numbers(key))] if sweep.is_number(key) else sweep.words(key)
        )
        values = np.unique(known)
        ends = [with_unit(value_text(value.item()), sweep.unit(key)) for value in (values[0], values[-1])]
        if not sweep.is_number(key):
            ends = [", ".join(values[:6]), ""]
        found.append((key, *ends, f"{len(values):,}", sweep.describe(key)))
    return found


def facts(sweep: SweepTable) -> list[tuple[str, str]]:
    """The few numbers beside the verdict."""
    of = f" of {sweep.planned:,}" if sweep.planned > len(sweep) else ""
    rows = [("runs", f"{len(sweep):,}{of}")]
    steps = np.unique(sweep.numbers("gait.steps"))
    if len(steps) and np.isfinite(steps).all():
        rows.append(("steps of a run", f"{steps[0]:.0f}" + (f" … {steps[-1]:.0f}" if len(steps) > 1 else "")))
    rows.append(("parameters that vary", f"{len(sweep.varied)}"))
    # A broken limit of 0 has no share; such runs are counted instead.
    used = np.array([sweep.used(name) for name in sweep.metrics if name in sweep.limits]).reshape(
        -1, len(sweep)
    )
    tightest = np.max(np.where(np.isfinite(used), used, -np.inf), axis=0, initial=-np.inf)
    tightest, broken = tightest[np.isfinite(tightest)], np.isinf(used).any(axis=0)
    if tightest.size:
        above = " above 0" if broken.any() else ""
        rows.append(
            (f"of its tightest tolerance{above}, the median run uses", f"{100 * np.median(tightest):.0f} %")
        )
    if broken.any():
        rows.append(("over a limit of 0", f"{broken.sum():,} of {sweep.measured.sum():,}"))
    total = float(np.nansum(sweep.numbers("timing_total")))
    if total > 0.0:
        rows.append(("computing time", format_duration(total)))
    return rows


def timing_rows(sweep: SweepTable) -> list[Row]:
    """Median and largest of every time, and the workers' memory."""
    rows: list[Row] = []
    times = [name for name in sweep.table.column_names if name.startswith("timing_")]
    for name in (*times, "environment_memory_peak"):
        values = sweep.numbers(name)[np.isfinite(sweep.numbers(name))]
        if values.size:
            middle, high = (with_unit(float(f(values)), sweep.unit(name)) for f in (np.median, np.max))
            rows.append((name.partition("_")[2].replace("_", " "), f"{middle}, up to {high}"))
    rows.append(("workers", f"{len({name for name in sweep.words('environment_worker') if name})}"))
    again = int((sweep.numbers("environment_attempts") > 1).sum())
    return [*rows, ("runs begun more than once", f"{again:,}")] if again else rows


def environment_rows(sweep: SweepTable) -> list[Row]:
    """Versions and platform: name, value, ``mixed`` where runs differ in it."""
    rows: list[Row] = []
    for column in sweep.table.column_names:
        counted = Counter(word for word in sweep.words(column) if word).most_common()
        if not column.startswith("environment_") or column in _PER_RUN or not counted:
            continue
        mixed = len(counted) > 1
        text = ", ".join(f"{word} ({n:,} runs)" if mixed else word for word, n in counted[:6])
        rows.append((column.removeprefix("environment_").removeprefix("version_").replace("_", " "),
                     text + (", …" if len(counted) > 6 else ""), "mixed" if mixed else ""))  # fmt: skip
    times = sorted(word for word in sweep.words("environment_time") if word)
    return [*rows, ("walked from, to (UTC)", f"{times[0]}, {times[-1]}", "")] if times else rows


def warnings(sweep: SweepTable) -> list[str]:
    """What makes a sweep less than one measurement."""
    found = []
    mixed = [name for name, _, mark in environment_rows(sweep) if mark]
    if mixed:
        found.append(
            "These runs were not all made by the same program on the same kind of machine and are not one "
            f"measurement. They differ in: {', '.join(mixed)}."
        )
    if "True" in sweep.words("environment_modified"):
        found.append("The code differed from its revision: the revision alone does not reproduce these runs.")
    return found
