"""The report: one self-contained HTML page about a run, made from its folder alone.

Agreement and cost are shown together, because either alone is misleading. All text is escaped; pictures are
inline SVG whose colours follow the page.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from ampm.body.motion import MOTION_UNITS
from ampm.parameters import HUMAN, RunParameters, is_option
from ampm.planner.support import StepPlan
from ampm.run_file import describe_keys, key_info
from validation.judge.compare import PARTS, SIGNALS
from validation.judge.metrics import display_unit
from validation.show.cost_table import cost_table, reported_table
from validation.show.page import render_page
from validation.show.run_figures import RunFigures, middle
from validation.show.style import style
from validation.show.text import format_value
from validation.show.walker import FLOOR_MARKS, arrow_scale, draw_walker
from validation.store.folders import output_file
from validation.store.identity import parameter_values
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
_UNITS = {
    **MOTION_UNITS,
    **dict.fromkeys(("planning", "simulation", "measurement", "simulated", "time_median", "time_p99"), "s"),
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
    pictures, walker = {}, []
    if len(saved.signals) > 1:
        with style():
            pictures = RunFigures(saved, plan).sections()
        walker = [] if saved.is_log else draw_walker(saved, plan, middle(saved.signals))
    return render_page(
        "report.html.j2",
        f"{saved.title}: {headline}",
        styles=["report.css"],
        name=saved.title,
        verdict_class="fail" if lost else verdict if verdict in ("pass", "fail") else "open",
        headline=headline,
        reason=short_unit(summary["reason"]),
        outcome_sentence="" if saved.is_log else outcome.name.sentence,
        is_log=saved.is_log,
        disturbed=_disturbed(saved),
        from_rest=saved.from_rest,
        climbs=len({step.z for step in saved.parameters.footsteps}) > 1,
        facts=_gait(saved, plan) | _facts(saved, plan),
        walker=walker,
        floor_marks=FLOOR_MARKS,
        newtons=format_number(1.0 / arrow_scale(saved), 3) if walker else "",
        agreement=saved.table(),
        cost=cost_table(summary),
        reasons=_reasons(summary),
        reported=reported_table(summary),
        first_step=_first_step(summary),
        windows=Table("", _WINDOW_COLUMNS, list(_window_rows(summary))),
        split=_split(summary["zmp_error_split"]),
        solver=_plain("The controller's QP", _known(summary["solver"])),
        motion=_plain("Periodic whole-body motion", summary["motion"], _multipliers(summary["motion"])),
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
    sensors = saved.parameters.sensors.model_dump(exclude_defaults=True)
    parts += [f"sensors.{key} = {value}" for key, value in sensors.items()]
    return "; ".join([*parts, *filter(None, [saved.record.metadata.get("disturbances")])])


def _facts(saved: SavedRun, plan: StepPlan | None) -> dict[str, str]:
    """How far and how fast the body walked, and which."""
    record, summary, body = saved.record, saved.summary, saved.parameters.body
    if saved.is_log:
        log = summary["log"]
        return {
            "steps covered": str(record.outcome.steps_completed),
            "of the plan": f"{log['from']:.4g} to {log['until']:.4g} s",
            "rows": f"{log['rows']} at {log['rate']:.4g} Hz",
        }
    drake = saved.parameters.simulation.engine == "drake"
    unsolved = f"{int((record.qp_status == 2).sum())} of {len(record.qp_status)}"
    planned = "" if plan is None else f" of {plan.contacts.steps}"
    facts = {
        "steps walked": f"{record.outcome.steps_completed}{planned}",
        "simulated": f"{record.outcome.time:.4g} s",
        "distance": "" if saved.from_rest else f"{_distance(saved, 'measured'):.3g} m",  # the way may turn
        "mass": f"{record.mass:.3g} kg",
        "body": f"{HUMAN}, {body.height:.3g} m" if body.source == HUMAN else Path(body.source).stem,
        "engine": f"Drake {summary['environment']['versions']['drake']}" if drake else "",
        # A controller of one's own may have no QP.
        "unsolved QPs": "no QP" if summary["solver"]["unsolved"] is None else unsolved,
    }
    return {label: value for label, value in facts.items() if value}


def _gait(saved: SavedRun, plan: StepPlan | None) -> dict[str, str]:
    """What defines the gait: of the law's slopes those that its planner has."""
    gait, begin = saved.parameters.gait, float(saved.signals.time[:1].sum())  # a log may begin later
    time = float(saved.record.outcome.time) - begin
    planner = saved.summary.get("planner", "ampm")
    facts = {"planner": planner, "COM height": f"{gait.com_height:.4g} m"}
    if not saved.from_rest:  # lengths, times and speed vary otherwise
        facts |= {"step length": f"{gait.step_length:.4g} m", "step width": f"{gait.step_width:.4g} m"}
        if plan is not None:
            single, both = plan.constants.single_support_duration, plan.constants.double_support_duration
            facts |= {"single support": f"{single:.3f} s", "double support": f"{both:.3f} s"}
        facts["planned speed"] = f"{_distance(saved, 'plan') / time:.3g} m/s" if time else ""
    if planner in ("ampm", "footsteps"):
        facts |= {"slopes c_s, c_y": f"{gait.c_s:.4g}, {gait.c_y:.4g}", "ZMP a_s": f"{gait.a_s:.4g}"}
    facts["feet"] = saved.parameters.foot.schedule
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


def _events(saved: SavedRun) -> Table:
    """What happened, but for touch-downs and lift-offs."""
    events = [(f"{time:.3f} s", text) for time, level, text in sorted(run_events(saved)) if level != "DEBUG"]
    return Table("", ("time", "event"), events)


def _plain(title: str, entries: Summary, notes: Sequence[str] = ()) -> Table:
    """Any table of the summary by name and value."""
    return Table(title, ("", ">"), list(_plain_rows(entries)), notes)


def _known(solver: Summary) -> Summary:
    """How the QPs were solved; nothing without a QP."""
    if solver["unsolved"] is None:
        return {}
    return {name: value for name, value in solver.items() if value is not None}


def _multipliers(motion: Summary) -> list[str]:
    """What a multiplier above one means, if there is one."""
    if not any(math.hypot(*pair) > 1.0 for pair in motion.get("multipliers", ())):
        return []
    return [
        "A multiplier beyond 1 in magnitude amplifies a deviation in every step. The motion is therefore "
        "solved as a fixed point, and the controller holds it."
    ]


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
    rows = []
    options = (key_info(key) for key in parameter_values(run) if is_option(key))
    for info in (*describe_keys(), *options):
        value = run.value(info.key)
        text = f"{value:.10g}" if isinstance(value, float) else str(value)
        rows.append((info.key, text if info.unit == "1" else f"{text} {info.unit}".strip(), info.meaning))
    return Table("", ("parameter", ">value", "meaning"), rows)
