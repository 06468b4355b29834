"""The report of a sweep: one self-contained HTML page, made from the folder's table alone.

All text is escaped. Pictures and scripts are in the page, see :mod:`validation.study.sweep.figures`.
"""

import hashlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from validation.show.page import render_page
from validation.show.paper import Citation, cite
from validation.store.folders import write_whole
from validation.study.sweep.figures import MOST_POINTS, draw_sweep, texts
from validation.study.sweep.table import BROKEN, RunState, SweepFile, SweepTable, read_sweep
from validation.table import Table, format_number, format_value, short_unit

_WORST = 20  # runs in the table of the worst


def write_sweep_report(directory: Path) -> Path:
    """Write ``report.html`` into the folder of a sweep, finished or not, from its table; returns its path.

    Raises :class:`InputError` if the folder holds no sweep, or no result yet.
    """
    return write_whole(Path(directory) / SweepFile.REPORT, render(read_sweep(directory)))


def render(sweep: SweepTable) -> str:
    """The report as a complete HTML document; its only references are relative links to kept runs."""
    verdict = judge_sweep(sweep)
    return render_page(
        "sweep.html.j2",
        f"{sweep.name}: {verdict[1]}",
        sweep=sweep,
        verdict=verdict,
        pictures=draw_sweep(sweep),
        most_points=MOST_POINTS,
        metrics=sweep_metric_table(sweep),
        worst=worst_runs(sweep),
        citation=cite_sweep(sweep),
    )


def cite_sweep(sweep: SweepTable) -> Citation:
    """How to cite a sweep; the digest is of its table, of an unfinished one of its definition."""
    file = None if sweep.directory is None else sweep.directory / SweepFile.RESULTS
    data = sweep.metadata["definition"].encode() if file is None or not file.is_file() else file.read_bytes()
    what = f"Sweep {sweep.name} of {sweep.planned} runs"
    return cite(what, sweep.metadata["environment"], hashlib.sha256(data).hexdigest())


def worst_runs(sweep: SweepTable) -> Table:
    """The worst runs, with links to the reports of those that are kept."""
    names, gaits, kept = map(sweep.words, ("name", "gait", "recording"))
    rows, link = [], Markup('<a href="{}">{}</a>')
    for row in sweep.worst[:_WORST]:
        name, address = names[row], f"{kept[row]}/{SweepFile.REPORT}"  # relative to the page
        if sweep.directory is not None and kept[row] and (sweep.directory / address).is_file():
            name = link.format(address, name)
        values = {"gait": gaits[row]} if len(set(gaits)) > 1 else {}
        values |= {key: sweep.table.column(key)[row].as_py() for key in sweep.metadata["varied"]}
        parameters = ", ".join(f"{key} {format_value(value)}" for key, value in values.items())
        rows.append((name, sweep.states[row].label, _why(sweep, row), parameters))
    return Table("", ("run", "outcome", "why", "parameters"), rows)


def _why(sweep: SweepTable, row: int) -> str:
    """The metric that used most of its tolerance, or why and when the walk ended."""
    used = {name: sweep.used(name)[row] for name in sweep.judged}
    shares = {name: share for name, share in used.items() if not np.isnan(share)}
    if not shares:
        time, steps = sweep.numbers("outcome_time")[row], sweep.numbers("steps_completed")[row]
        return f"at {time:.2f} s, steps walked: {steps:.0f}: {sweep.words('cause')[row]}"
    worst = max(shares, key=lambda name: shares[name])
    over = sum(value > 1.0 for value in shares.values())
    more = f"; {over} of {len(shares)} over their limit" if over > 1 else ""
    values, limits, unit = sweep.shown(worst)
    return f"{sweep.label(worst)}: {_amount(values[row], unit)}, limit {_amount(limits[row], unit)}{more}"


def sweep_metric_table(sweep: SweepTable) -> Table:
    """How many runs are over a metric's tolerance, and the distribution of its values.

    Runs that differ in a parameter with texts, such as the planner, are told apart under headings.
    """
    columns = ("metric", ">over", ">median", ">95 % below", ">largest", ">tolerance")
    rows: list[tuple[str, ...]] = []
    named = list(texts(sweep))
    cells = list(zip(*map(sweep.words, named), strict=True)) or [()] * len(sweep)
    for group in sorted(set(cells)):
        found = list(_metric_rows(sweep, np.array([cell == group for cell in cells])))
        if named and found:
            heading = ", ".join(f"{key} {value}" for key, value in zip(named, group, strict=True))
            rows.append((heading, *[""] * (len(columns) - 1)))
        rows += found
    return Table("Metrics of the completed runs", columns, rows)


def _metric_rows(sweep: SweepTable, inside: NDArray[np.bool_]) -> Iterator[tuple[str, ...]]:
    """Rows of the metrics of some runs; the limit is a range where their bodies differ."""
    for metric in sweep.judged:
        values, limits, unit = sweep.shown(metric)
        known = values[~np.isnan(values) & inside]
        if known.size:
            over = f"{int((sweep.used(metric) > 1.0)[inside].sum()):,} of {known.size:,}"
            with np.errstate(invalid="ignore"):  # between infinite values
                parts = np.nan_to_num(np.quantile(known, (0.5, 0.95, 1.0)), nan=np.inf, posinf=np.inf)
            ends = [_amount(end(limits[inside & np.isfinite(limits)]), unit) for end in (np.min, np.max)]
            shown = (_amount(value, unit) for value in parts)
            yield sweep.label(metric), over, *shown, " ... ".join(dict.fromkeys(ends))


def _amount(value: float, unit: str) -> str:
    """A number and its unit."""
    return f"{format_number(float(value), 3)} {short_unit(unit)}".rstrip()


def judge_sweep(sweep: SweepTable) -> tuple[str, str, str]:
    """Whether every run has a result, and all walks pass: ``pass``, ``fail`` or ``open``; words; sentence."""
    counts, missing = sweep.counts, sweep.planned - len(sweep)
    passed, not_walked = counts[RunState.PASS], (RunState.REFUSED, *BROKEN)
    walked = sum(counts[state] for state in RunState if state not in not_walked)
    sentence = f"{passed:,} of {walked:,} runs that walked met every tolerance."
    if missing:
        sentence += f" {missing:,} of {sweep.planned:,} runs are missing: 'ampm sweep --resume' walks them."
    css = "fail" if passed < walked else "open"
    if missing:
        return css, "unfinished", sentence
    if passed < walked:
        return css, f"{passed:,} of {walked:,} walks pass", sentence
    if any(counts[state] for state in BROKEN):
        return css, "not every run has an answer", sentence
    return ("pass", "pass", sentence) if walked else (css, "nothing walked", sentence)
