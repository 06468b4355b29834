"""The report: one self-contained HTML page about a run, made from its folder alone.

Agreement and cost are shown together, because either alone is misleading. All text is escaped; pictures are
inline SVG whose colours follow the page.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from ampm.body.motion import MOTION_UNITS
from ampm.parameters import HUMAN, RunParameters
from ampm.planner.support import StepPlan
from ampm.run_file import describe_keys
from validation.judge.compare import PARTS, SIGNALS
from validation.judge.metrics import METRICS, cost_entry, display_unit
from validation.show.page import render_page
from validation.show.run_figures import RunFigures
from validation.show.style import style, without_collection
from validation.show.text import BODY_WEIGHT, limit_with_unit, number, with_unit
from validation.store.folders import output_file
from validation.store.saved import REPORT_FILE, SavedRun, load_saved_run, run_events
from validation.trial.outcome import OutcomeName

Summary = Mapping[str, Any]

_SHARES = ("margin_torque", "margin_saturated")
"""Metrics that are shown as percentages."""

_LOST = (OutcomeName.FELL, OutcomeName.DIVERGED, OutcomeName.INFEASIBLE, OutcomeName.CRASHED)
"""Outcomes that always fail."""

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


class Row(NamedTuple):
    """One row of a table of metrics.

    Attributes:
        label: what it is.
        value: with its unit.
        limit: tolerance or limit, empty if there is none.
        share: value over limit, for the bar; None without a limit.
        passed: None where nothing is judged.
        note: reason of the tolerance, or where and when.
        own: whether the metric judges the measurement rather than the walk.
        spread: numerical uncertainty with sign and unit, empty if it is not known.
        undecided: whether the value is closer to the limit than that.
    """

    label: str
    value: str
    limit: str = ""
    share: float | None = None
    passed: bool | None = None
    note: str = ""
    own: bool = False
    spread: str = ""
    undecided: bool = False


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
    headline = {"fail": "out of tolerance"}.get(verdict, verdict.replace("_", " "))
    judged = {name: item for name, item in summary["metrics"].items() if item["tolerance"] is not None}
    reported = {name: item for name, item in summary["metrics"].items() if item["tolerance"] is None}
    agreement = [_metric_row(metric) for metric in judged.values()]
    reason = summary["reason"]
    for name in sorted(summary["metrics"], key=len, reverse=True):
        reason = reason.replace(name, summary["metrics"][name]["label"])
    with style(), without_collection():
        pictures = RunFigures(saved, plan).sections() if len(saved.signals) > 1 else {}
    headline = headline if outcome.completed else f"{outcome.name}, {headline}"
    return render_page(
        "report.html.j2",
        f"{saved.title}: {headline}",
        styles=["report.css"],
        gait=saved.title,
        verdict_class="fail" if outcome.name in _LOST else verdict if verdict in ("pass", "fail") else "open",
        headline=headline,
        reason=reason.replace("% of body weight", BODY_WEIGHT),
        outcome_sentence=outcome.name.sentence,
        disturbed=_disturbed(saved),
        profile=summary["profile"],
        from_rest=bool(saved.parameters.footsteps),
        climbs=len({step.z for step in saved.parameters.footsteps}) > 1,
        uncertainty=_convergence_study(summary.get("uncertainty")),
        facts=_facts(saved, plan),
        agreement=agreement,
        reasons=[(row.label, row.limit, row.note) for row in agreement],
        reported=[(item["label"], _shown(item)) for item in reported.values()],
        cost=list(_cost_rows(summary)),
        first_step=list(_first_step_rows(judged)),
        windows=list(_window_rows(summary)),
        split=_split_rows(summary["zmp_error_split"]),
        solver=list(_solver_rows(summary["solver"])),
        motion=list(_plain_rows(summary["motion"])),
        parameters=_parameters(saved.parameters),
        environment=list(_plain_rows(summary["environment"])),
        timing=list(_plain_rows(summary["timing"])),
        pictures_by_section=pictures,
        events=[
            (f"{time:.3f} s", text) for time, level, text in sorted(run_events(saved)) if level != "DEBUG"
        ],
    )


def _shown(metric: Mapping[str, Any]) -> str:
    """Value of a metric; one without a unit whose limit is zero is a count."""
    shown = metric["display"]
    value = shown["value"]
    if value is not None and not shown["unit"] and shown["tolerance"] == 0.0:
        value = int(value)
    return with_unit(value, shown["unit"])


def _metric_row(metric: Mapping[str, Any]) -> Row:
    """A judged metric, with the label stored in the run: other processes may not have it registered."""
    shown, lacking = metric["display"], "not_studied" in metric
    value, limit, unit = shown["value"], shown["tolerance"], shown["unit"]
    uncertainty = shown.get("uncertainty_at_least" if lacking else "uncertainty")
    spread = "±\u00a0not studied" if lacking else ""
    if uncertainty is not None:
        least = "≥\u00a0" if lacking else ""
        spread = f"±\u00a0{least}{with_unit('∞' if uncertainty == 'inf' else uncertainty, unit, 2)}"
    return Row(
        label=metric["label"],
        value=_shown(metric),
        limit=limit_with_unit(limit, unit),
        share=value / limit if value is not None and limit else None,
        passed=metric["pass"],
        note=metric["reason"] or "",
        own=metric["kind"] == "instrument",
        spread=spread,
        undecided=metric.get("undecided", False),
    )


def _convergence_study(known: Summary | None) -> str:
    """Source of the uncertainties, empty if there is none."""
    if known is None:
        return ""
    text = f"a convergence study of {known['gait']}, {known['steps']} steps a level"
    if known["studies"]:
        text += f" ({' + '.join(known['studies'])})"
    if known["not_studied"]:
        text += f", which lacks {', '.join(known['not_studied'])}"
    return text


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
    of = f"{number(body.height)}\u00a0m" if body.source == HUMAN else Path(body.source).stem
    facts = {
        "steps walked": f"{record.outcome.steps_completed}{planned}",
        "simulated": with_unit(time, "s"),
        "distance": with_unit(_distance(saved, "measured"), "m") if straight else "",
        "planned speed": with_unit(_distance(saved, "plan") / time, "m/s") if straight and time else "",
        "body": f"{number(float(record.mass))}\u00a0kg, {of}",
        # A controller of one's own may have no QP.
        "unsolved QPs": "no QP" if summary["solver"]["unsolved"] is None else unsolved,
        "times real time": number(summary["timing"].get("real_time_factor")),
    }
    return {label: value for label, value in facts.items() if value}


def _cost_rows(summary: Summary) -> Iterator[Row]:
    """Cost of the agreement: feedback, torque, friction, and the remaining margins."""
    limits = {"margin_torque": 1.0, "margin_friction": summary["margins"]["friction_available"]}
    for metric in METRICS.values():
        if not metric.section:
            continue
        value, note = cost_entry(summary, metric), ""
        scale, unit = display_unit(metric.unit, summary["scales"]["body_weight"])
        if metric.name in _SHARES:
            scale, unit = 100.0, "%"
        elif metric.section == "energy":  # a way of metres
            scale, unit = 1.0, metric.unit
        if isinstance(value, Mapping):
            at = "" if value["time"] is None else f" at {value['time']:.2f} s"
            note = f"{value['where'].replace('_', ' ')}{at}".strip()
            value = value["value"]
        limit = limits.get(metric.name)
        share = value / limit if value is not None and limit else None
        yield Row(
            label=metric.label,
            value=with_unit(None if value is None else scale * value, unit),
            limit=limit_with_unit(scale * limit, unit) if limit else "",
            share=share,
            passed=None if share is None else share <= 1.0,
            note=note,
        )


def _first_step_rows(judged: Summary) -> Iterator[tuple[str, ...]]:
    """Label, first step, rest of the run, of every judged metric that has a first step."""
    for metric in judged.values():
        first, value, shown = metric["first_step"], metric["value"], metric["display"]
        if first is not None and value is not None:
            scale = shown["value"] / value if value else 1.0
            yield (
                metric["label"],
                with_unit(first * scale, shown["unit"]),
                with_unit(value * scale, shown["unit"]),
            )


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
                values = [number(_scaled(entry[key], scale)) for key in ("rmse", "maximum", "bias")]
                r2 = entry["r2_reason"] if entry["r2"] is None else number(entry["r2"], 5)
                yield label, words, *values, unit, r2
                label = ""


def _scaled(value: float | None, scale: float) -> float | None:
    return None if value is None else scale * value


def _split_rows(split: Summary) -> list[tuple[str, ...]]:
    """Cause, RMS x, y [mm], share of the squared error x, y [%]."""
    return [
        (
            label,
            *(number(_scaled(value, 1e3)) for value in split["rmse"][part]),
            *(number(_scaled(value, 100.0), 2) for value in split["share"][part]),
        )
        for part, label in PARTS.items()
    ]


def _solver_rows(solver: Summary) -> Iterator[tuple[str, str]]:
    for key, (label, scale, unit) in _SOLVER.items():
        if (value := solver[key]) is not None:
            whole = not unit and float(value).is_integer()
            yield label, with_unit(int(value) if whole else scale * value, unit)


def _plain_rows(entries: Summary, prefix: str = "", unit: str = "") -> Iterator[tuple[str, str]]:
    """Any table of the summary as (name, value) rows, nested names joined by a dot."""
    for key, value in entries.items():
        name = f"{prefix}{key.replace('_', ' ')}"
        if isinstance(value, Mapping):
            yield from _plain_rows(value, f"{name} · ", _UNITS.get(key, ""))
        elif isinstance(value, Sequence) and not isinstance(value, str):
            yield name, ", ".join(map(_item, value))
        else:
            yield name, with_unit(value, "s" if unit and key == "time" else _UNITS.get(key, unit), 4)


def _item(value: Any) -> str:
    """An entry of a list; a pair of numbers is a complex one."""
    if isinstance(value, Sequence) and not isinstance(value, str) and len(value) == 2:
        real, imaginary = (float(part) for part in value)
        sign = "−" if imaginary < 0 else "+"
        return number(real, 4) + (f" {sign} {number(abs(imaginary), 4)}i" if imaginary else "")
    return number(value, 4)


def _parameters(run: RunParameters) -> list[tuple[str, str, str]]:
    """Key, value with unit, and meaning of every parameter."""
    values, rows = run.model_dump(), []
    for info in describe_keys():
        section, key = info.key.split(".")
        value = values[section][key]
        text = f"{value:.10g}" if isinstance(value, float) else str(value)
        rows.append((info.key, text if info.unit == "1" else f"{text} {info.unit}".strip(), info.meaning))
    return rows
