"""The report: one self-contained HTML page about a run, made from its folder alone.

Agreement and cost stand side by side, because either alone misleads. All text is escaped; pictures are inline
SVG whose colours follow the page.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ampm.body.motion import MOTION_UNITS
from ampm.parameters import RunParameters
from ampm.planner.support import StepPlan
from ampm.run_file import describe_keys
from validation.judge.compare import PARTS as CAUSES
from validation.judge.metrics import METRICS, display_unit, metric_label
from validation.show.instrument import instrument_section
from validation.show.page import render_page
from validation.show.report_pictures import pictures_of
from validation.show.style import style
from validation.show.text import BODY_WEIGHT, number, with_unit
from validation.store.saved import REPORT_FILE, SavedRun, load_saved_run, run_events
from validation.trial.outcome import OutcomeName

_SHARES = ("margin_torque", "margin_saturated")
"""Metrics that are shown as percentages."""

_LOST = (OutcomeName.FELL, OutcomeName.DIVERGED, OutcomeName.INFEASIBLE)
"""Outcomes that always fail."""


@dataclass(frozen=True)
class Row:
    """One row of a table of figures.

    Attributes:
        label: what it is.
        value: with its unit.
        limit: tolerance or limit, empty if there is none.
        share: value over limit, for the bar; None without a limit.
        passed: None where nothing is judged.
        note: reason of the tolerance, or where and when.
        own: whether the figure judges the testbed rather than the walk.
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
    """Write ``report.html`` into a run folder from what the folder holds.

    Args:
        run: folder of a finished run, or what was read from it; an existing report in it is replaced.

    Returns:
        Path of the report.

    Raises:
        InputError: the folder is no run folder.
    """
    saved = run if isinstance(run, SavedRun) else load_saved_run(run)
    path = saved.directory / REPORT_FILE
    path.write_text(render(saved), encoding="utf-8")
    return path


def render(saved: SavedRun) -> str:
    """Render the report of a run.

    Returns:
        A complete HTML document without references to anything outside it.
    """
    return render_page("report.html.j2", styles=["report.css"], **_context(saved))


def _context(saved: SavedRun) -> dict[str, Any]:
    summary = saved.summary
    plan = saved.plan()
    outcome = saved.record.outcome
    verdict = str(summary.get("verdict", "not_measured"))
    gait = str(summary.get("gait", "gait"))
    lost = outcome.name in _LOST
    headline = {"pass": "pass", "fail": "out of tolerance"}.get(verdict, verdict.replace("_", " "))
    agreement = _agreement(summary, judged=True)
    if not outcome.completed:
        headline = f"{outcome.name}, {headline}"
    with style():
        pictures = pictures_of(saved, plan) if len(saved.signals) > 1 else {}
    return {
        "gait": gait,
        "verdict": verdict,
        "verdict_class": "fail" if lost else verdict if verdict in ("pass", "fail") else "open",
        "headline": headline,
        "reason": _readable(str(summary.get("reason", "")), summary),
        "outcome_sentence": outcome.name.sentence,
        "profile": str(summary.get("profile", "")),
        "uncertainty": _convergence_study(summary),
        "facts": _facts(saved, plan),
        "agreement": agreement,
        "reasons": [(row.label, row.limit, row.note) for row in agreement],
        "reported": [(row.label, row.value) for row in _agreement(summary, judged=False)],
        "cost": _cost(saved),
        "first_step": _first_step_rows(summary),
        "windows": _window_rows(summary),
        "split": _split_rows(summary),
        "solver": _solver_rows(summary),
        "instrument": instrument_section(saved) if saved.summary.get("instrument") else None,
        "motion": _plain_rows(summary.get("motion")),
        "parameters": _parameters(saved.parameters),
        "environment": _plain_rows(summary.get("environment")),
        "timing": _plain_rows(summary.get("timing")),
        "pictures_by_section": pictures,
        "events": _events(saved),
    }


# --------------------------------------------------------------------------------------------- figures


def _label(name: str, metric: Mapping[str, Any]) -> str:
    """Label of a metric as the run has it: a registered one is unknown to other processes."""
    return str(metric.get("label") or metric_label(name))


def _readable(sentence: str, summary: Mapping[str, Any]) -> str:
    """A sentence with the names of metrics written out."""
    for name in sorted(summary.get("metrics", {}), key=len, reverse=True):
        sentence = sentence.replace(name, _label(name, summary["metrics"][name]))
    return sentence.replace("% of body weight", BODY_WEIGHT)


def _limit(limit: float | None, unit: str) -> str:
    """A tolerance as it was set, without trailing zeros."""
    if limit is None:
        return ""
    text = number(limit)
    mantissa, times, power = text.partition("·")
    if "." in mantissa:
        mantissa = mantissa.rstrip("0").rstrip(".")
    return with_unit(mantissa + times + power, unit)


def _agreement(summary: Mapping[str, Any], *, judged: bool) -> list[Row]:
    rows = []
    for name, metric in summary.get("metrics", {}).items():
        tolerance = metric.get("tolerance")
        if (tolerance is not None) != judged:
            continue
        shown = metric.get("display") or metric
        unit = str(shown.get("unit") or "")
        value, limit = shown.get("value"), shown.get("tolerance")
        share = value / limit if value is not None and limit else None
        if unit == "" and limit == 0.0:
            value, limit = int(value) if value is not None else None, 0
        rows.append(
            Row(
                own=metric.get("kind") == "instrument",
                label=_label(name, metric),
                value=with_unit(value, unit) if judged or unit else number(value),
                limit=_limit(limit, unit),
                share=share,
                passed=metric.get("pass"),
                note=str(metric.get("reason") or ""),
                spread=_spread(shown, unit, lacking=bool(metric.get("not_studied"))),
                undecided=bool(metric.get("undecided")),
            )
        )
    return rows


def _spread(shown: Mapping[str, Any], unit: str, *, lacking: bool) -> str:
    """A numerical uncertainty with its sign and unit, empty without a study.

    Args:
        shown: value and uncertainty in ``unit``.
        unit: for people.
        lacking: whether a study that belongs to it was not made.
    """
    uncertainty = shown.get("uncertainty_at_least" if lacking else "uncertainty")
    if uncertainty is None:
        return "±\u00a0not studied" if lacking else ""
    least = "≥\u00a0" if lacking else ""
    return f"±\u00a0{least}{with_unit('∞' if uncertainty == 'inf' else uncertainty, unit, 2)}"


def _convergence_study(summary: Mapping[str, Any]) -> str:
    """Which study the uncertainties are from, empty if there is none."""
    known = summary.get("uncertainty")
    if not known:
        return ""
    text = f"a convergence study of {known['gait']}, {known['steps']} steps a level"
    if known.get("studies"):
        text += f" ({' + '.join(known['studies'])})"
    if known.get("not_studied"):
        text += f", which lacks {', '.join(known['not_studied'])}"
    return text


def _facts(saved: SavedRun, plan: StepPlan | None) -> list[tuple[str, str]]:
    record, summary = saved.record, saved.summary
    facts = [
        ("steps walked", f"{record.outcome.steps_completed} of {saved.parameters.gait.steps}"),
        ("simulated", with_unit(float(record.outcome.time), "s")),
        ("distance", with_unit(float(record.com[-1, 0] - record.com[0, 0]), "m")),
    ]
    if plan is not None:
        facts.append(("planned speed", with_unit(float(plan.constants.mean_velocity), "m/s")))
    facts.append(
        ("body", f"{number(float(record.mass))}\u00a0kg, {number(saved.parameters.body.height)}\u00a0m")
    )
    unsolved = f"{int((record.qp_status == 2).sum())} of {len(record.qp_status)}"
    solver = summary.get("solver", {})  # a controller of one's own may have no QP
    facts.append(("unsolved QPs", "no QP" if solver.get("time_median") is None else unsolved))
    factor = summary.get("timing", {}).get("real_time_factor")
    facts.append(("times real time", number(factor)))
    return facts


def _cost(saved: SavedRun) -> list[Row]:
    """Cost of the agreement: feedback, torque, friction, and the remaining margins."""
    weight = saved.record.mass * saved.record.gravity
    available = saved.summary.get("margins", {}).get("friction_available")
    limits = {"margin_torque": 1.0, "margin_friction": available}
    rows = []
    for metric in METRICS.values():
        name = metric.name.partition("_")[2]
        entry = saved.summary.get(metric.section, {}).get(name)
        if metric.section == "effort":  # components lie in one list
            vector, _, axis = name.rpartition("_")
            entry = saved.summary.get("effort", {}).get(vector, ())["xyz".index(axis)]
        if metric.section not in ("effort", "margins", "energy") or entry is None:
            continue
        scale, unit = display_unit(metric.unit, weight)
        if metric.name in _SHARES:
            scale, unit = 100.0, "%"
        elif metric.section == "energy":  # a way of metres
            scale, unit = 1.0, metric.unit
        value, note = entry, ""
        if isinstance(entry, Mapping):
            value, time = entry.get("value"), entry.get("time")
            note = str(entry.get("where") or "").replace("_", " ")
            note = note if time is None else f"{note} at {time:.2f} s".strip()
        limit = limits.get(metric.name)
        share = value / limit if value is not None and limit else None
        rows.append(
            Row(
                label=metric.label,
                value=with_unit(None if value is None else scale * value, unit),
                limit=_limit(scale * limit, unit) if limit else "",
                share=share,
                passed=None if share is None else share <= 1.0,
                note=note,
            )
        )
    return rows


def _first_step_rows(summary: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Label, first step, rest of the run, of every judged metric that has a first step."""
    rows = []
    for name, metric in summary.get("metrics", {}).items():
        first, value = metric.get("first_step"), metric.get("value")
        shown = metric.get("display") or metric
        if metric.get("tolerance") is None or first is None or value is None:
            continue
        scale = shown["value"] / value if value and shown.get("value") is not None else 1.0
        unit = str(shown.get("unit") or "")
        rows.append((_label(name, metric), with_unit(first * scale, unit), with_unit(value * scale, unit)))
    return rows


_WINDOWS: Mapping[str, str] = {
    "run": "whole run",
    "single_support": "planned single support",
    "double_support": "planned double support",
    "measured_single_support": "measured single support",
    "measured_double_support": "measured double support",
    "first_step": "first step",
}


def _window_rows(summary: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Statistics of every signal by planned phase and by measured contact."""
    rows = []
    for name, windows in summary.get("statistics", {}).items():
        label = metric_label(f"{name}_rmse").removesuffix(", RMSE")
        reference = windows.get("run", {}).get("reference", "plan")
        label += "" if reference == "plan" else f" against the {reference}"
        for window, words in _WINDOWS.items():
            entry = windows.get(window)
            if not entry or not entry.get("count"):
                continue
            scale, unit = (1e3, "mm") if entry["unit"] == "m" else (1.0, entry["unit"])
            values = [number(_times(entry.get(key), scale)) for key in ("rmse", "maximum", "bias")]
            r2 = entry.get("r2")
            shown = number(r2, 5) if r2 is not None else str(entry.get("r2_reason") or "–")
            rows.append((label, words, *values, unit, shown))
            label = ""
    return rows


def _times(value: float | None, scale: float) -> float | None:
    return None if value is None else scale * value


def _split_rows(summary: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Cause, RMS x, y [mm], share of the squared error x, y [%]."""
    split = summary.get("zmp_error_split", {})
    rows = []
    for part, label in CAUSES.items():
        if part in split.get("rmse", {}):
            rms = [number(_times(v, 1e3)) for v in split["rmse"][part]]
            share = [number(_times(v, 100.0), 2) for v in split["share"][part]]
            rows.append((label, *rms, *share))
    return rows


_SOLVER: Mapping[str, tuple[str, float, str]] = {
    "ticks": ("control ticks", 1.0, ""),
    "solved_with_limits": ("ticks solved in the form with limits", 1.0, ""),
    "unsolved": ("unsolved ticks", 1.0, ""),
    "time_median": ("time of a solve, median", 1e6, "µs"),
    "time_p99": ("time of a solve, 99 %", 1e6, "µs"),
    "iterations_median": ("iterations, median", 1.0, ""),
    "residual_maximum": ("largest residual", 1.0, ""),
}
"""Entries of the summary's ``solver``: label, scale and unit."""


def _solver_rows(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    solver = summary.get("solver", {})
    rows = []
    for key, (label, scale, unit) in _SOLVER.items():
        value = solver.get(key)
        if value is not None:
            whole = not unit and float(value).is_integer()
            rows.append((label, with_unit(int(value) if whole else scale * value if unit else value, unit)))
    return rows


_UNITS: Mapping[str, str] = {
    **MOTION_UNITS,
    **dict.fromkeys(("planning", "simulation", "measurement", "simulated"), "s"),
    "memory": "GB",
}
"""Units of entries of the summary that carry none, by their documented SI."""


def _plain_rows(entry: Any, prefix: str = "", unit: str = "") -> list[tuple[str, str]]:
    """Any table of the summary as (name, value) rows, nested names joined by a dot."""
    rows: list[tuple[str, str]] = []
    if isinstance(entry, Mapping):
        for key, value in entry.items():
            name = f"{prefix}{str(key).replace('_', ' ')}"
            if isinstance(value, Mapping):
                rows += _plain_rows(value, f"{name} · ", _UNITS.get(str(key), ""))
            elif isinstance(value, Sequence) and not isinstance(value, str):
                rows.append((name, ", ".join(_item(item) for item in value)))
            else:
                rows.append(
                    (name, with_unit(value, "s" if unit and key == "time" else _UNITS.get(str(key), unit), 4))
                )
    return rows


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


def _events(saved: SavedRun) -> list[tuple[str, str]]:
    """Events other than footfalls."""
    return [(f"{time:.3f} s", text) for time, level, text in sorted(run_events(saved)) if level != "DEBUG"]
