"""The report of a sweep: one self-contained HTML page, made from the folder's table alone.

All text is escaped. Pictures and scripts are in the page, see :mod:`validation.study.sweep.figures`.
"""

import hashlib
import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from validation.show.page import render_page
from validation.show.paper import Citation, cite
from validation.show.text import format_value
from validation.store.folders import output_file
from validation.study.sweep import figures
from validation.study.sweep.figures import texts
from validation.study.sweep.table import BROKEN, REPORT, RESULTS, STATES, State, SweepTable, read_sweep
from validation.table import Table, format_number, short_unit

WORST = 20
"""Runs in the table of the worst."""


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
    charts: dict[str, Markup] = {}
    if sweep.varied:
        charts = {
            "runs": figures.as_json(run_data_of(sweep)),
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
        charts=charts,
        most_points=figures.MOST_POINTS,
        metrics=metric_table(sweep),
        worst=worst_runs(sweep),
        citation=cite_sweep(sweep),
        labels=figures.LABELS,
    )


# ------------------------------------------------------------------------------------------------ runs


def links_of(sweep: SweepTable) -> dict[int, str]:
    """Row to the address of its report, relative to the page, of every kept run."""
    if sweep.directory is None:
        return {}
    addresses = {row: f"{name}/{REPORT}" for row, name in enumerate(sweep.words("recording")) if name}
    return {row: address for row, address in addresses.items() if (sweep.directory / address).is_file()}


def run_data_of(sweep: SweepTable) -> list[dict[str, Any]]:
    """What the pictures draw, see :func:`validation.study.sweep.figures.run_data`."""
    return figures.run_data(sweep, links_of(sweep))


def cite_sweep(sweep: SweepTable) -> Citation:
    """How to cite a sweep; the digest is of its table, of an unfinished one of its definition."""
    file = None if sweep.directory is None else sweep.directory / RESULTS
    data = sweep.metadata["definition"].encode() if file is None or not file.is_file() else file.read_bytes()
    what = f"Sweep {sweep.name} of {sweep.planned} runs"
    return cite(what, sweep.metadata["environment"], hashlib.sha256(data).hexdigest())


def worst_runs(sweep: SweepTable) -> list[dict[str, Any]]:
    """Rows of the table of the worst runs, each with the command that walks it again."""
    links, names, found = links_of(sweep), sweep.words("name"), []
    gaits = sweep.words("gait")
    for row in sweep.worst[:WORST]:
        varied = {key: sweep.table.column(key)[row].as_py() for key in sweep.metadata["varied"]}
        gait = {"gait": gaits[row]} if len(set(gaits)) > 1 else {}
        command = sweep.metadata["command"].replace(" GAIT ", f" {shlex.quote(gaits[row])} ")
        settings = [f"--set {shlex.quote(f'{key}={value}')}" for key, value in varied.items()]
        found.append(
            {
                "name": names[row],
                "state": sweep.state(row),
                "why": _why(sweep, row),
                "link": links.get(row, ""),
                "parameters": {key: format_value(value) for key, value in {**gait, **varied}.items()},
                "repeat": " ".join([command, *settings]),
            }
        )
    return found


def _why(sweep: SweepTable, row: int) -> str:
    """The metric that used most of its tolerance, or why and when the walk ended."""
    used = {name: sweep.used(name)[row] for name in sweep.judged}
    shares = {name: share for name, share in used.items() if not np.isnan(share)}
    if not shares:
        time, steps = sweep.numbers("outcome_time")[row], sweep.numbers("steps_completed")[row]
        return f"at {time:.2f} s, steps walked: {steps:.0f}: {sweep.words('cause')[row]}"
    worst = max(shares, key=lambda name: shares[name])
    values, unit = sweep.shown(worst)
    over = sum(value > 1.0 for value in shares.values())
    more = f"; {over} of {len(shares)} over their limit" if over > 1 else ""
    limit = _limits(sweep, worst, [row])
    return f"{sweep.label(worst)}: {_amount(values[row], unit)}, limit {limit}{more}"


# ---------------------------------------------------------------------------------------------- tables


def metric_table(sweep: SweepTable) -> Table:
    """How many runs are over a metric's tolerance, and the distribution of its values.

    Runs that differ in a parameter with texts, such as the planner, are told apart under headings.
    """
    columns = ("metric", ">over", ">median", ">95 % below", ">largest", ">tolerance")
    rows: list[tuple[str, ...]] = []
    named = list(texts(sweep))
    cells = list(zip(*map(sweep.words, named), strict=True)) or [()] * len(sweep)
    for group in sorted(set(cells)):
        inside = np.array([cell == group for cell in cells])
        found = list(_metric_rows(sweep, inside))
        if named and found:
            heading = ", ".join(f"{key} {value}" for key, value in zip(named, group, strict=True))
            rows.append((heading, *[""] * (len(columns) - 1)))
        rows += found
    return Table("Metrics of the completed runs", columns, rows)


def _metric_rows(sweep: SweepTable, inside: NDArray[np.bool_]) -> Iterator[tuple[str, ...]]:
    for metric in sweep.judged:
        values, unit = sweep.shown(metric)
        known = values[np.isfinite(values) & inside]
        if known.size:
            over = f"{int((sweep.used(metric) > 1.0)[inside].sum()):,} of {known.size:,}"
            quantiles = [_amount(np.quantile(known, part), unit) for part in (0.5, 0.95, 1.0)]
            yield sweep.label(metric), over, *quantiles, _limits(sweep, metric, np.flatnonzero(inside))


def _amount(value: float, unit: str) -> str:
    """A number and its unit."""
    return f"{format_number(float(value), 3)} {short_unit(unit)}".rstrip()


def _limits(sweep: SweepTable, metric: str, rows: Sequence[int] | NDArray[np.intp]) -> str:
    """Limit of some runs: one number, or a range where their bodies differ."""
    values, unit = sweep.shown_limits(metric)
    known = values[rows][np.isfinite(values[rows])]
    low, high = (_amount(value, unit) for value in (known.min(), known.max()))
    return low if low == high else f"{low} ... {high}"


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
        css, headline = "fail", f"{passed:,} of {walked:,} walks pass"
    elif any(counts[state] for state in BROKEN):
        headline = "not every run has an answer"
    elif walked and not missing:
        css, headline = "pass", "pass"
    sentence = f"{passed:,} of {walked:,} runs that walked met every tolerance."
    if missing:
        headline = "unfinished"
        sentence += f" {missing:,} of {sweep.planned:,} runs are missing: 'ampm sweep --resume' walks them."
    return css, headline, sentence
