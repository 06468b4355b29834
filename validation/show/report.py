"""The report: one self-contained HTML page about a run, made from its folder alone.

Agreement and cost are shown together, because either alone is misleading. All text is escaped; pictures are
inline SVG whose colours follow the page.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from ampm.body.motion import MOTION_UNITS
from ampm.parameters import HUMAN, RunParameters
from ampm.planner.support import StepPlan
from ampm.run_file import describe_keys
from validation.judge.compare import PARTS, SIGNALS
from validation.judge.metrics import display_unit
from validation.show.cost_table import cost_table, reported_table
from validation.show.page import render_page
from validation.show.run_figures import RunFigures
from validation.show.style import style
from validation.show.text import format_value
from validation.store.folders import output_file
from validation.store.saved import REPORT_FILE, SavedRun, load_saved_run, run_events
from validation.table import Table, format_number, short_unit
from validation.trial.outcome import OutcomeName

Summary = Mapping[str, Any]

_WINDOWS = {
    "run": "whole run",
    "single_support": "planned single support",
    "double_support": "planned double support",
    "measured_single_support": "measured single support",
    "measured_double_support": "measured double support",
    "first_step": "first step",
}
_SOLVER = {
    "ticks": ("control ticks", 1, ""),
    "solved_with_limits": ("ticks solved in the form with limits", 1, ""),
    "unsolved": ("unsolved ticks", 1, ""),
    "time_median": ("time of a solve, median", 1e6, "µs"),
    "time_p99": ("time of a solve, 99 %", 1e6, "µs"),
    "iterations_median": ("iterations, median", 1, ""),
    "residual_maximum": ("largest residual", 1, ""),
}
"""Entries of the summary's ``solver``: label, scale and unit."""

_UNITS = {
    **MOTION_UNITS,
    **dict.fromkeys(("planning", "simulation", "measurement", "simulated"), "s"),
    "memory": "GB",
}
"""Units of entries of the summary that carry none, by their documented SI."""


def write_report(run: str | Path | SavedRun) -> Path:
    """Write ``report.html`` into a run folder from its files.

    Args:
        run: folder of a finished run, or the run read from it; an existing report in it is replaced.

    Returns:
        Path of the report.

    Raises:
        InputError: the folder is no run folder.
    """
    saved = run if isinstance(run, SavedRun) else load_saved_run(run)
    path = saved.directory / REPORT_FILE
    with output_file(path) as work:
        work.write_text(render(saved), encoding="utf-8")
    return path


def render(saved: SavedRun) -> str:
    """Render the report of a run: a complete HTML document without references to anything outside it."""
    summary, plan, outcome = saved.summary, saved.plan(), saved.record.outcome
    verdict = summary["verdict"]
    lost = outcome.name not in (OutcomeName.COMPLETED, OutcomeName.INTERRUPTED)
    headline = "out of tolerance" if verdict == "fail" else verdict.replace("_", " ")
    headline = headline if outcome.completed else f"{outcome.name}, {headline}"
    with style():
        pictures = RunFigures(saved, plan).sections() if len(saved.signals) > 1 else {}
    return render_page(
        "report.html.j2",
        f"{saved.title}: {headline}",
        styles=["report.css"],
        gait=saved.title,
        verdict_class="fail" if lost else verdict if verdict in ("pass", "fail") else "open",
        headline=headline,
        reason=short_unit(summary["reason"]),
        outcome_sentence=outcome.name.sentence,
        disturbed=_disturbed(saved),
        from_rest=bool(saved.parameters.footsteps),
        climbs=len({step.z for step in saved.parameters.footsteps}) > 1,
        facts=_facts(saved, plan),
        agreement=saved.table(),
        cost=cost_table(summary),
        reasons=_reasons(summary),
        reported=reported_table(summary),
        first_step=_first_step(summary),
        windows=Table("", _WINDOW_COLUMNS, list(_window_rows(summary))),
        split=_split(summary["zmp_error_split"]),
        solver=_solver(summary["solver"]),
        motion=_plain("Periodic whole-body motion", summary["motion"]),
        parameters=_parameters(saved.parameters),
        environment=_plain("Versions and platform", summary["environment"]),
        timing=_plain("Timing", summary["timing"]),
        pictures_by_section=pictures,
        events=_events(saved),
    )


def _distance(saved: SavedRun, source: str) -> float:
    """Distance of the COM at the end from its start, by a source of signals [m]."""
    x, y = saved.signals[f"{source}_com_x"], saved.signals[f"{source}_com_y"]
    return math.hypot(x[-1] - x[0], y[-1] - y[0]) if len(x) else 0.0


def _disturbed(saved: SavedRun) -> str:
    """What disturbed the walk, empty if nothing did; pushes are in the record."""
    own = saved.parameters.disturbance.model_dump(exclude_defaults=True)
    parts = [f"{key} = {value}" for key, value in own.items() if not key.startswith(("push_", "seed"))]
    return "; ".join([*parts, *filter(None, [saved.record.metadata.get("disturbances")])])


def _facts(saved: SavedRun, plan: StepPlan | None) -> dict[str, str]:
    record, summary = saved.record, saved.summary
    unsolved = f"{int((record.qp_status == 2).sum())} of {len(record.qp_status)}"
    body = saved.parameters.body
    time = float(record.outcome.time)
    planned = "" if plan is None else f" of {plan.contacts.steps}"
    straight = not saved.parameters.footsteps  # over footsteps the way may turn, and the speed vary
    walked, planned_way = (_distance(saved, source) for source in ("measured", "plan"))
    of = f"{body.height:.3g} m" if body.source == HUMAN else Path(body.source).stem
    facts = {
        "steps walked": f"{record.outcome.steps_completed}{planned}",
        "simulated": f"{time:.4g} s",
        "distance": f"{walked:.3g} m" if straight else "",
        "planned speed": f"{planned_way / time:.3g} m/s" if straight and time else "",
        "body": f"{record.mass:.3g} kg, {of}",
        # A controller of one's own may have no QP.
        "unsolved QPs": "no QP" if summary["solver"]["unsolved"] is None else unsolved,
        "times real time": format_number(summary["timing"].get("real_time_factor"), 3),
    }
    return {label: value for label, value in facts.items() if value}


def _reasons(summary: Summary) -> Table:
    """Why every tolerance is what it is."""
    rows = [
        (item["label"], _displayed(summary, item, "tolerance"), item["reason"] or "")
        for item in _judged(summary)
    ]
    return Table("", ("metric", ">tolerance", "reason"), rows)


def _first_step(summary: Summary) -> Table:
    """The first step, and the rest of the run, of every judged metric that has a first step."""
    rows = [
        (item["label"], _displayed(summary, item, "first_step"), _displayed(summary, item, "value"))
        for item in _judged(summary)
        if item["first_step"] is not None
    ]
    return Table("", ("metric", ">first step", ">rest of the run"), rows)


def _judged(summary: Summary) -> list[Summary]:
    return [item for item in summary["metrics"].values() if item["tolerance"] is not None]


def _displayed(summary: Summary, metric: Summary, key: str) -> str:
    """An SI value of a metric in the unit of reports."""
    scale, unit = display_unit(metric["unit"], summary["scales"]["body_weight"])
    return f"{_scaled(metric[key], scale, 4)} {short_unit(unit)}".rstrip()


_WINDOW_COLUMNS = ("signal", "window", ">RMSE", ">largest", ">bias", "unit", ">R²")


def _window_rows(summary: Summary) -> Iterator[tuple[str, ...]]:
    """Statistics of every signal by planned phase and by measured contact."""
    for name, windows in summary["statistics"].items():
        label = SIGNALS[name].label
        if SIGNALS[name].reference != "plan":
            label += f" against the {SIGNALS[name].reference}"
        for window, words in _WINDOWS.items():
            entry = windows[window]
            if entry["count"]:
                scale, unit = display_unit(entry["unit"], summary["scales"]["body_weight"])
                values = [_scaled(entry[key], scale) for key in ("rmse", "maximum", "bias")]
                r2 = entry["r2_reason"] if entry["r2"] is None else format_number(entry["r2"], 5)
                yield label, words, *values, short_unit(unit), r2
                label = ""


def _scaled(value: float | None, scale: float, digits: int = 3) -> str:
    return format_number(None if value is None else scale * value, digits)


def _split(split: Summary) -> Table:
    """Causes of the ZMP error; shares are of the squared error."""
    rows = [
        (
            label,
            *(_scaled(value, 1e3) for value in split["rmse"][part]),
            *(_scaled(value, 100.0, 2) for value in split["share"][part]),
        )
        for part, label in PARTS.items()
    ]
    return Table("", ("cause", ">RMS x [mm]", ">RMS y [mm]", ">share x [%]", ">share y [%]"), rows)


def _solver(solver: Summary) -> Table:
    """How the QPs were solved; empty without a QP."""
    rows = [
        (label, f"{_scaled(solver[key], scale)} {unit}".rstrip())
        for key, (label, scale, unit) in _SOLVER.items()
        if solver[key] is not None
    ]
    return Table("The controller's QP", ("", ">"), rows if solver["unsolved"] is not None else [])


def _events(saved: SavedRun) -> Table:
    """What happened, but for touch-downs and lift-offs."""
    events = [(f"{time:.3f} s", text) for time, level, text in sorted(run_events(saved)) if level != "DEBUG"]
    return Table("", ("time", "event"), events)


def _plain(title: str, entries: Summary) -> Table:
    """Any table of the summary by name and value."""
    return Table(title, ("", ">"), list(_plain_rows(entries)))


def _plain_rows(entries: Summary, prefix: str = "", unit: str = "") -> Iterator[tuple[str, str]]:
    """Rows of a table of the summary, nested names joined by a dot."""
    for key, value in entries.items():
        name = f"{prefix}{key.replace('_', ' ')}"
        if isinstance(value, Mapping):
            yield from _plain_rows(value, f"{name} · ", _UNITS.get(key, ""))
        elif isinstance(value, Sequence) and not isinstance(value, str):
            yield name, ", ".join(map(_item, value))
        else:
            own = "s" if unit and key == "time" else _UNITS.get(key, unit)
            yield name, f"{format_value(value)} {own}".rstrip() if value is not None else format_value(value)


def _item(value: Any) -> str:
    """An entry of a list; a pair of numbers is a complex one."""
    if isinstance(value, Sequence) and not isinstance(value, str) and len(value) == 2:
        real, imaginary = (float(part) for part in value)
        return f"{complex(real, imaginary):.4g}" if imaginary else format_value(real)
    return format_value(value)


def _parameters(run: RunParameters) -> Table:
    """Value with unit, and meaning of every parameter."""
    values, rows = run.model_dump(), []
    for info in describe_keys():
        section, key = info.key.split(".")
        value = values[section][key]
        text = f"{value:.10g}" if isinstance(value, float) else str(value)
        rows.append((info.key, text if info.unit == "1" else f"{text} {info.unit}".strip(), info.meaning))
    return Table("", ("parameter", ">value", "meaning"), rows)
