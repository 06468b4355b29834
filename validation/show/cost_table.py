"""The tables of what a walk cost, and of all that is not judged, made from its ``summary.json``."""

from collections.abc import Mapping, Sequence
from typing import Any

from ampm.body.limits import ROLL_TOLERANCE
from validation.judge.margins import tilt_warnings
from validation.judge.metrics import METRICS, Metric, cost_entry, display_unit
from validation.table import ABSENT, USED, Table, format_number, format_share, package_rows, short_unit

COSTS = {row["metric"]: row for row in package_rows("show/costs.csv")}
"""Costs beside the agreement, by metric; the others are in :func:`reported_table`.

Each says whether it is shown in percent, whether the larger value is better, its numerical change at half the
time step on the presets, rounded up (``change``, a share of the value, and ``least`` [SI] of one near zero),
and verb and noun of a conclusion.
"""


def cost_table(summary: Mapping[str, Any]) -> Table:
    """Effort of a walk, and what was left to its limits, beside which agreement must be read."""
    notes = [_sentence(summary)]
    margin = summary["margins"]["plan_polygon"]["value"]
    if margin is not None and abs(margin) <= ROLL_TOLERANCE:
        notes.append(
            "The planned ZMP margin is that of the worst instant: when a rolling foot lifts its heel, the "
            "ZMP passes the ball, which is then the edge of the support; a plan may pass it by "
            f"{1e3 * ROLL_TOLERANCE:g} mm."
        )
    if summary["outcome"] == "completed" and (tilt := summary["margins"].get("tilt")):
        notes += tilt_warnings(tilt["value"], tilt["where"])
    rows = _measured(summary, [_row(summary, METRICS[name]) for name in COSTS])
    return Table("effort and margins", ("cost", ">value", ">limit", "unit", USED, "where"), rows, notes)


def reported_table(summary: Mapping[str, Any]) -> Table:
    """Metrics without a limit, and the costs that :func:`cost_table` leaves out."""
    rows = [
        (item["label"], format_number(item["display"]["value"]), short_unit(item["display"]["unit"]), "")
        for item in summary["metrics"].values()
        if item["tolerance"] is None
    ]
    rest = [item for item in METRICS.values() if item.section and item.name not in COSTS]
    rows += [(row[0], row[1], row[3], row[5]) for row in (_row(summary, metric) for metric in rest)]
    return Table("", ("", ">value", "unit", "where"), _measured(summary, rows))


def _measured(summary: Mapping[str, Any], rows: Sequence[Sequence[str]]) -> list[Sequence[str]]:
    """Rows that have a value; of a walk with plan and joints all."""
    return [row for row in rows if row[1] != ABSENT or not {"log", "velocity"} & summary.keys()]


def _row(summary: Mapping[str, Any], metric: Metric) -> tuple[str, ...]:
    value, where = cost_entry(summary, metric), ""
    if isinstance(value, Mapping):
        at = "" if value["time"] is None else f", {value['time']:.2f} s"
        where = f"{value['where'].replace('_', ' ')}{at}".removeprefix(", ")
        value = value["value"]
    scale, unit = cost_unit(metric, summary["scales"]["body_weight"])
    limit = cost_limit(summary, metric.name)
    if value is None:
        return metric.label, ABSENT, "", "", "", where
    shown = "" if limit is None else format_number(scale * limit)
    number = float(value)  # infinity is a word
    number = 0.0 if abs(number) < 1e-10 else scale * number  # a ZMP on the edge, but for rounding
    return metric.label, format_number(number, 3), shown, short_unit(unit), format_share(value, limit), where


def cost_limit(summary: Mapping[str, Any], name: str) -> float | None:
    """Limit of a cost in SI units; None if it has none."""
    return {"margin_torque": 1.0, "margin_friction": summary["margins"]["friction_available"]}.get(name)


def cost_unit(metric: Metric, weight: float) -> tuple[float, str]:
    """Factor and unit in which a cost of a body with a weight [N] is shown."""
    if COSTS.get(metric.name, {}).get("percent"):
        return 100.0, "%"
    if metric.section == "energy":  # a way of metres
        return 1.0, metric.unit.removesuffix("1")
    return display_unit(metric.unit, weight)


def _sentence(summary: Mapping[str, Any]) -> str:
    """Length of the walk, and how its QPs were solved."""
    solver, timing = summary["solver"], summary["timing"]
    if "log" in summary:
        return "A log has no joints: torques, speeds, clearance and QPs are not measured."
    steps = f"{summary['steps_completed']} step" + "s" * (summary["steps_completed"] != 1)
    walked = f"{summary['outcome']}, {steps} in {timing['simulated']:.4g} s"
    factor = f"the closed loop at {format_number(timing['real_time_factor'], 3)} times real time"
    if solver["unsolved"] is None:
        return f"{walked}, {factor}; no QP was reported."
    seconds = (solver["time_median"], solver["time_p99"])
    median, most = (format_number(None if time is None else 1e6 * time, 3) for time in seconds)
    times = f"median {median} µs, 99th percentile {most} µs"
    return f"{walked}, {factor}; {solver['ticks']} QPs, {solver['unsolved']} unsolved, {times}."
