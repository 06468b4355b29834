"""The table of a run's metrics, made from its ``summary.json``."""

from collections.abc import Mapping
from typing import Any

from validation.table import BW, USED, Table, format_number, format_share, short_unit, with_uncertainty
from validation.trial.outcome import Outcome
from validation.trial.plan import gait_title


def summary_title(summary: Mapping[str, Any]) -> str:
    """Name of the gait, what was changed in it, and its planner if it is not the default one."""
    return gait_title(summary["gait"], summary.get("changed", {}), summary.get("planner", ""))


def walk_title(summary: Mapping[str, Any]) -> str:
    """Title of a walk: that of its summary, then pushes and other disturbances that its keys do not name."""
    named = ("sensors.", *summary.get("changed", {}))
    disturbances = [text for text in summary.get("disturbances", ()) if not text.startswith(named)]
    return ", ".join([summary_title(summary), *disturbances])


def walk_sentence(summary: Mapping[str, Any], outcome: Outcome) -> str:
    """Gait, steps, outcome, and verdict with its reason."""
    verdict = str(summary["verdict"]).replace("_", " ").upper()
    return f"{walk_title(summary)}, {outcome.summary}: {verdict}. {summary['reason']}"


def metric_table(summary: Mapping[str, Any]) -> Table:
    """Every judged metric of a ``summary.json`` with its limit; those that check the measurement come last.

    Labels are read from it, as other processes may not have a user's metric.
    """
    free = "velocity" in summary
    judged = [item for item in summary["metrics"].values() if item["tolerance"] is not None]
    rows = [_row(item) for item in judged if item["kind"] != "instrument"]
    checks = [_row(item) for item in judged if item["kind"] == "instrument"]
    if checks:
        what = "the measurement" if free else "plan and measurement"
        rows += [(f"Checks of {what}", *[""] * 5), *checks]
    return Table(
        f"{summary_title(summary)}: measured{'' if free else ' against plan'} (profile {summary['profile']})",
        ("metric", ">value", ">limit", "unit", USED, ""),
        rows,
        _notes(summary, rows),
    )


def _row(metric: Mapping[str, Any]) -> tuple[str, ...]:
    shown = metric["display"]
    value, limit = shown["value"], shown["tolerance"]
    verdict = {True: "pass", False: "FAIL", None: "not judged" if value is not None else "not measured"}
    return (
        metric["label"],
        with_uncertainty(value, shown.get("uncertainty")),
        format_number(limit, 3),
        short_unit(shown["unit"]),
        format_share(value, limit),
        "undecided" if metric.get("undecided") else verdict[metric["pass"]],
    )


def _notes(summary: Mapping[str, Any], rows: list[tuple[str, ...]]) -> list[str]:
    notes = ["BW: body weight."] if any(BW in row for row in rows) else []
    if known := summary.get("uncertainty"):
        notes.append(
            f"±: numerical uncertainty by a convergence study of {known['gait']}, {known['steps']} steps a "
            "level. A value closer to its limit than that is undecided."
        )
    if lead := summary.get("ahead", {}).get("judged"):
        notes.append(f"The plan moved: each instant is compared with the plan as it stood {lead:g} s before.")
    if summary["profile"] == "pushed":
        notes.append("Pushed: errors of ZMP, force and angular momentum have to be within limits again.")
    return [*notes, *summary.get("notes", ()), *summary.get("log", {}).get("notes", ())]
