"""The report: one self-contained HTML page about a run, made from its folder alone.

Agreement and cost are shown together, because either alone is misleading. All text is escaped; pictures are
inline SVG.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import create_model

from ampm.parameters import HUMAN
from ampm.planner.support import StepPlan
from ampm.run_file import dump_run
from validation.judge.compare import PARTS
from validation.show.cost_table import cost_table, reported_table
from validation.show.page import render_page
from validation.show.paper import cite_run
from validation.show.run_figures import RunFigures, strides
from validation.store.folders import write_whole
from validation.store.json import dump_json, read_json
from validation.store.saved import SavedRun, load_saved_run, run_events
from validation.table import Table, format_number, short_unit
from validation.trial.files import RunFile
from validation.trial.outcome import SENTENCES, OutcomeName


def write_report(run: str | Path | SavedRun) -> Path:
    """Write ``report.html`` into the folder of a finished run, or of a run read from it; returns its path.

    An earlier report is replaced. Raises :class:`InputError` if it is not a run folder.
    """
    saved = run if isinstance(run, SavedRun) else load_saved_run(run)
    return write_whole(saved.directory / RunFile.REPORT, render(saved))


def render(saved: SavedRun) -> str:
    """Render the report of a run: a complete HTML document without references to anything outside it."""
    summary, plan, outcome = saved.summary, saved.plan(), saved.record.outcome
    verdict, disturbances = summary["verdict"], summary.get("disturbances", ())
    lost = outcome.name not in (OutcomeName.COMPLETED, OutcomeName.INTERRUPTED)
    headline = "out of tolerance" if verdict == "fail" else verdict.replace("_", " ")
    headline = headline if outcome.completed else f"{outcome.name}, {headline}"
    pictures = RunFigures(saved, plan).sections() if len(saved.signals) > 1 else {}
    # Without touch-downs and lift-offs.
    events = [(f"{time:.3f} s", text) for time, level, text in sorted(run_events(saved)) if level != "DEBUG"]
    return render_page(
        "report.html.j2",
        f"{saved.title}: {headline}",
        saved=saved,
        verdict_class="fail" if lost else verdict if verdict in ("pass", "fail") else "open",
        headline=headline,
        reason=short_unit(summary["reason"]),
        outcome_sentence="" if saved.is_log else SENTENCES[outcome.name],
        disturbed="; ".join(text for text in disturbances if not text.startswith("sensors.")),
        sensed="; ".join(text for text in disturbances if text.startswith("sensors.")),
        has_strides=bool(strides(saved.signals)),
        facts=_facts(saved, plan),
        explanation=_explanation(saved.directory / RunFile.EXPLANATION),
        cost=cost_table(summary),
        reported=reported_table(summary),
        split=split_table(summary["zmp_error_split"]),
        parameters=dump_run(saved.parameters),
        others=dump_json({name: summary[name] for name in ("solver", "motion", "timing", "environment")}),
        pictures=pictures,
        citation=cite_run(saved),
        events=Table("", ("time", "event"), events),
    )


def _explanation(path: Path) -> tuple[str, Table] | None:
    """Sentence and table of ``explain.json``; None without the file, an InputError if it is damaged."""
    if not path.is_file():
        return None
    kind = create_model("File", said=str, table=Table)
    found = read_json(path, kind, "remove it, or run ampm explain again")[1]
    return found.said, found.table


def _facts(saved: SavedRun, plan: StepPlan | None) -> dict[str, str]:
    """What defines the gait, with the slopes of the law if its planner has them, and how far it walked."""
    gait, body, outcome = saved.parameters.gait, saved.parameters.body, saved.record.outcome
    summary = saved.summary
    planner = summary.get("planner", "ampm")
    facts = {"planner": planner, "COM height": f"{gait.com_height:.4g} m"}
    if saved.is_free:
        facts = {"planner": planner}
        for kind, values in summary["velocity"].items():
            vx, vy, wz = (format_number(value, 3) for value in np.round(np.array(values, float), 4) + 0.0)
            facts[f"{kind} velocity"] = f"({vx}, {vy}) m/s, {wz} rad/s"
    elif not saved.from_rest:  # lengths, times and speed vary otherwise
        if plan is not None:  # a user's planner may make other steps
            facts |= {"step length": f"{gait.step_length:.4g} m", "step width": f"{gait.step_width:.4g} m"}
        for label, value in saved.planned_timing.items():
            name, _, unit = label.rstrip("]").partition(" [")
            facts[name] = f"{format_number(value, 3)} {unit}"
    if planner in ("ampm", "footsteps"):
        facts |= {"slopes c_s, c_y": f"{gait.c_s:.4g}, {gait.c_y:.4g}", "ZMP a_s": f"{gait.a_s:.4g}"}
    if saved.is_log:
        log = saved.summary["log"]
        facts["steps covered"] = str(outcome.steps_completed)
        facts["of the plan"] = f"{log['from']:.3f} to {log['until']:.3f} s"
        return facts | {"rows": f"{log['rows']} at {log['rate']:.4g} Hz"}
    planned = "" if plan is None else f" of {plan.contacts.steps}"
    facts["steps walked"] = f"{outcome.steps_completed}{planned}"
    facts["simulated"] = f"{outcome.time:.4g} s"
    facts["body"] = f"{HUMAN}, {body.height:.3g} m" if body.source == HUMAN else Path(body.source).stem
    facts["mass"] = f"{saved.record.mass:.3g} kg"
    if saved.parameters.simulation.engine == "drake":
        facts["engine"] = f"Drake {saved.summary['environment']['versions']['drake']}"
    return facts


def split_table(split: Mapping[str, Any]) -> Table:
    """Causes of the ZMP error; shares are of the squared error."""
    rows = []
    for part, label in PARTS.items():
        values = np.array([*split["rmse"][part], *split["share"][part]], dtype=float)  # None is NaN
        rows.append((label, *map(format_number, values * (1e3, 1e3, 100.0, 100.0), (3, 3, 2, 2))))
    columns = ("cause", ">RMS x [mm]", ">RMS y [mm]", ">share x [%]", ">share y [%]")
    return Table("causes of the ZMP error", columns, rows)
