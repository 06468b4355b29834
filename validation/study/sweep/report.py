"""The report of a sweep: one self-contained HTML page, made from the saved table alone.

It can be mailed: however many runs there are, what is in the page is bounded
(:mod:`validation.study.sweep.map_data`). All text is escaped; nothing is fetched; without scripts the
page lacks
nothing but the choice of the map's axes.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from validation.judge.metrics import METRICS, metric_label
from validation.show import run_figures as run_figures
from validation.show.report import number, with_unit
from validation.study.sweep import figures, map_data, store
from validation.study.sweep.report_rows import (
    Repeat,
    amount,
    broken_rows,
    environment_rows,
    facts,
    fixed_rows,
    links_of,
    refusal_rows,
    run_rows,
    timing_rows,
    varied_rows,
    warnings,
)
from validation.study.sweep.report_sensitivity import SensitivityTable, sensitivity_table
from validation.study.sweep.table import BROKEN, LOST, State, SweepTable, read_sweep
from validation.study.sweep.tally import counted_states, judge_sweep, lost_count, share

REPORT_FILE = store.REPORT
WORST = 10
"""Rows of a table of worst runs."""


def write_sweep_report(directory: Path) -> Path:
    """Write ``report.html`` into a sweep's folder from the table that it holds.

    Args:
        directory: folder of a sweep, finished or not; an existing report in it is replaced.

    Returns:
        Path of the report.

    Raises:
        InputError: the folder holds no sweep, or no result yet.
    """
    directory = Path(directory)
    path = directory / REPORT_FILE
    text = render(read_sweep(directory))
    with store.durable(path) as file:
        file.write(text.encode())
    return path


def render(sweep: SweepTable) -> str:
    """Render the report of a sweep.

    Returns:
        A complete HTML document; its only references are relative links to kept runs.
    """
    environment = Environment(
        loader=PackageLoader("validation.show"), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
    source = {
        name: environment.loader.get_source(environment, name)[0]  # type: ignore[union-attr]
        for name in ("report.css", "sweep.css", "sweep_tools.js", "sweep.js")
    }
    return environment.get_template("sweep.html.j2").render(
        css=Markup(source["report.css"] + source["sweep.css"]),
        script=Markup(source["sweep_tools.js"] + source["sweep.js"]),
        **_context(sweep),
    )


def _context(sweep: SweepTable) -> dict[str, Any]:
    sensitivity = sensitivity_table(sweep)
    lost, furthest = worst_rows(sweep)
    repeat = Repeat.of(sweep)
    counts = sweep.counts
    with run_figures.style():
        pictures = _distributions(sweep)
        still, caption, data = _map(sweep, sensitivity, repeat, [*lost, *furthest])
    definition = sweep.metadata.get("definition")
    over = sweep.worst_used[furthest] if len(furthest) else np.array([])
    return {
        "name": sweep.name,
        "verdict": judge_sweep(sweep),
        "counts": counted_states(sweep),
        "profile": sweep.profile,
        "facts": facts(sweep),
        "warnings": warnings(sweep),
        "still_map": still,
        "still_caption": caption,
        "no_map": "No parameter varies in this sweep, so there is no map.",
        "data": data,
        "measured": f"{int(sweep.measured.sum()):,}",
        "distributions": pictures,
        "figures": _figure_table(sweep) if sweep.measured.any() else [],
        "weight_note": any(sweep.shown(name)[2].startswith("%") for name in sweep.metrics),
        "lost": run_rows(sweep, lost, repeat, sensitivity.by_strength),
        "lost_more": lost_count(sweep) if lost_count(sweep) > len(lost) else 0,
        "furthest": run_rows(sweep, furthest, repeat, sensitivity.by_strength),
        "furthest_title": "Out of tolerance, and closest to it"
        if (over > 1.0).any()
        else "Closest to a tolerance",
        "recordings_note": _recordings_note(sweep),
        "matrix": sensitivity.rows,
        "matrix_keys": sensitivity.keys,
        "hidden_keys": sensitivity.hidden,
        "drivers": sensitivity.drivers,
        "undriven": sensitivity.undriven,
        "unsaid": sensitivity.unsaid,
        "no_matrix": sensitivity.silent,
        "entangled": [(a, b, number(rho, 2)) for a, b, rho in sensitivity.entangled],
        "refusals": refusal_rows(sweep),
        "refused_sentence": _refused_sentence(counts[State.REFUSED], len(sweep)),
        "broken": broken_rows(sweep, BROKEN),
        "varied": varied_rows(sweep),
        "timing": timing_rows(sweep),
        "environment": environment_rows(sweep),
        "definition": definition if isinstance(definition, str) else "",
        "fixed": fixed_rows(sweep),
        "why": [
            (metric_label(name), _limit_text(sweep, name), limit.reason)
            for name, limit in sweep.limits.items()
            if limit.reason
        ],
    }


def worst_rows(sweep: SweepTable) -> tuple[list[int], list[int]]:
    """The runs that a reader should look at first.

    Returns:
        Rows that did not complete, the earliest end first, and of those that did the ones that used most of
        a tolerance, the worst first.
    """
    rows = np.flatnonzero(sweep.is_state(*LOST))
    steps, time = sweep.numbers("steps_completed")[rows], sweep.numbers("outcome_time")[rows]
    lost = rows[np.lexsort((rows, np.nan_to_num(time, nan=np.inf), np.nan_to_num(steps, nan=np.inf)))]
    used = sweep.worst_used
    known = np.flatnonzero(~np.isnan(used))
    furthest = known[np.argsort(-used[known], kind="stable")]
    return lost[:WORST].tolist(), furthest[:WORST].tolist()


# --------------------------------------------------------------------------------------------- the map


def _map(
    sweep: SweepTable, sensitivity: SensitivityTable, repeat: Repeat, keep: list[int]
) -> tuple[Markup | None, str, Markup | None]:
    """Still picture, its caption, and the data of the live one; None without a parameter that varies."""
    keys = sensitivity.by_strength
    metrics = {name: metric_label(name) for name in sweep.metrics if name in sweep.limits}
    data = map_data.map_data(
        sweep, keys, metrics, links_of(sweep), {"start": repeat.start, "end": repeat.end}, keep
    )
    if data is None:
        return None, "", None
    x = map_data.parameter_axis(sweep, keys[0])
    y = map_data.parameter_axis(sweep, keys[1]) if len(keys) > 1 else map_data.used_axis(sweep)
    rows = map_data.drawn_rows(sweep, keep)[: 2 * map_data.MOST_POINTS]
    if len(rows) > _STILL:
        rows = np.sort(np.random.default_rng(1).choice(rows, _STILL, replace=False))
    figure = figures.static_map(x, y, sweep.states, rows)
    still = Markup(figures.svg(figure, "map", f"Outcome of every run over {x.label} and {y.label}"))
    shown = "Every run" if len(rows) == len(sweep) else f"{len(rows):,} of {len(sweep):,} runs"
    caption = f"{shown} over {x.label} and {y.label}."
    # "<" only as an escape: no text in the data can end the script element.
    text = json.dumps(data, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return still, caption, Markup(text.replace("<", "\\u003c"))


_STILL = 2000
"""Marks of the still map."""


# --------------------------------------------------------------------------------------------- figures


def _is_instrument(metric: str) -> bool:
    return metric in METRICS and METRICS[metric].kind == "instrument"


def _distributions(sweep: SweepTable) -> list[Markup]:
    """Histograms of the judged figures of the walk itself; those of the instrument stand in the table."""
    if not sweep.measured.any():
        return []
    found = []
    for index, name in enumerate(sweep.metrics):
        if name not in sweep.limits or _is_instrument(name):
            continue
        values, limit, unit = sweep.shown(name)
        label = metric_label(name)
        figure = figures.distribution(values, limit, unit.replace("% of body weight", "% BW"), label)
        found.append(Markup(figures.svg(figure, f"d{index}", f"Distribution of {label}")))
    return found


def _figure_table(sweep: SweepTable) -> list[tuple[str, list[dict[str, Any]]]]:
    walk: list[dict[str, Any]] = []
    own: list[dict[str, Any]] = []
    for name in sweep.metrics:
        if name not in sweep.limits:
            continue
        values, _, unit = sweep.shown(name)
        known = values[np.isfinite(values)]
        if not known.size:
            continue
        over = int((sweep.used(name) > 1.0).sum())
        median, high, largest = (amount(np.quantile(known, q), unit) for q in (0.5, 0.95, 1.0))
        entry = {
            "label": metric_label(name),
            "median": median,
            "high": high,
            "largest": largest,
            "limit": _limit_text(sweep, name),
            "over": f"{over:,}" if over else "",
            "over_share": share(over, known.size),
            "note": sweep.limits[name].reason,
        }
        (own if _is_instrument(name) else walk).append(entry)
    return [(title, rows) for title, rows in (("", walk), ("The instrument itself", own)) if rows]


def _limit_text(sweep: SweepTable, metric: str) -> str:
    _, limit, unit = sweep.shown(metric)
    if limit is None:
        return ""
    return with_unit(f"{limit:.6g}" if limit == 0.0 or 1e-3 <= limit < 1e5 else number(limit, 2), unit)


# ----------------------------------------------------------------------------------------------- words


def _refused_sentence(refused: int, total: int) -> str:
    return (
        f"{refused:,} of {total:,} gaits ({share(refused, total)}) were refused before anything walked, each "
        "with the value, the limit and a way out."
    )


def _recordings_note(sweep: SweepTable) -> str:
    kept = sum(1 for name in sweep.words("recording") if name)
    if not kept:
        return "No run of this sweep kept a recording; 'sweep.recordings' in its definition says which do."
    return (
        f"{kept:,} run{'' if kept == 1 else 's'} kept a recording. The links work while this page lies in "
        "the sweep's folder; 'ampm view recordings/NAME', called there, opens one in Rerun."
    )
