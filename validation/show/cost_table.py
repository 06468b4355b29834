"""The tables of what a walk cost, and of all that is not judged, made from its ``summary.json``."""

import math
from collections.abc import Iterable, Mapping
from typing import Any

from validation.judge.margins import LOADED
from validation.judge.metrics import METRICS, Metric, cost_entry, display_unit
from validation.table import ABSENT, USED, Table, format_number, format_share, short_unit

_SHARES = ("margin_torque", "margin_saturated")
"""Costs that are shown as percentages."""
_SHOWN = (
    "effort_zmp_x",
    "effort_zmp_y",
    *_SHARES,
    "margin_friction",
    "margin_plan_polygon",
    "margin_measured_polygon",
    "margin_knee",
    "margin_joint",
    "margin_clearance",
    "energy_cost_of_transport",
)
"""Costs beside the agreement; the others are in :func:`reported_table`."""


def cost_table(summary: Mapping[str, Any]) -> Table:
    """Effort of a walk, and what was left to its limits, beside which agreement must be read.

    Args:
        summary: contents of ``summary.json``.
    """
    rows = [_row(summary, METRICS[name]) for name in _SHOWN]
    if "log" in summary:
        rows = [row for row in rows if row[1] != ABSENT]
    columns = ("cost", ">value", ">limit", "unit", USED, "where")
    return Table("effort and margins", columns, rows, [_sentence(summary)], _hints(summary))


def reported_table(summary: Mapping[str, Any]) -> Table:
    """Metrics without a limit, and the costs that :func:`cost_table` leaves out."""
    rows = [
        (item["label"], format_number(item["display"]["value"]), short_unit(item["display"]["unit"]), "")
        for item in summary["metrics"].values()
        if item["tolerance"] is None
    ]
    rest: Iterable[Metric] = (item for item in METRICS.values() if item.section and item.name not in _SHOWN)
    for metric in rest:
        label, value, _, unit, _, where = _row(summary, metric)
        rows.append((label, value, unit, where))
    if "log" in summary:
        rows = [row for row in rows if row[1] != ABSENT]
    return Table("", ("", ">value", "unit", "where"), rows, hints=_hints(summary))


def _hints(summary: Mapping[str, Any]) -> dict[str, str]:
    """Label to one sentence about a value that looks worse than it is, or whose cause is not obvious."""
    margins, motion = summary["margins"], summary.get("motion", {})
    found = {}
    for axis in "xy":
        feedback, metric = cost_entry(summary, METRICS[f"effort_zmp_{axis}"]), f"zmp_{axis}_rmse"
        error = summary["metrics"].get(metric, {}).get("value")
        if None not in (feedback, error) and feedback > error:
            found[f"effort_zmp_{axis}"] = (
                "More than the error is normal: the command shifts the ZMP to bring COM and momentum back."
            )
    planned, loaded = margins["plan_polygon"]["value"], margins["plan_in_measured_polygon"]["value"]
    if None not in (planned, loaded) and -1e-6 <= planned < 0.01:
        inside = f"stays {_millimetres(loaded)} or more inside" if loaded >= 0.0 else "leaves"
        found["margin_plan_polygon"] = (
            "The worst instant: a rolling foot lifts its heel as the ZMP passes the ball, which is then the "
            f"edge. The planned ZMP {inside} the sole points that carry force."
        )
    friction, net = margins["friction"]["value"], margins["friction_net"]["value"]
    if None not in (friction, net) and friction > 0.5 * (margins["friction_available"] or math.inf):
        found["margin_friction"] = (
            f"Of one foot, which may carry as little as {LOADED:.0%} of the weight; the net force uses "
            f"{format_number(net, 3)} at most."
        )
    joint, limit = motion.get("joint_limit_margin"), margins["joint"]["value"]
    if joint and limit is not None and limit < 0.1:
        found["margin_joint"] = f"The planned motion comes to {format_number(joint['value'], 3)} rad itself."
    if (sliding := margins["sliding_time"]["value"]) is not None:
        found["margin_sliding_weight"] = (
            f"More than {LOADED:.0%} of the weight slides for {format_number(1e3 * sliding, 3)} ms at most."
        )
    if 0.0 < (margins["penetration"]["value"] or 0.0) < 0.003:
        found["margin_penetration"] = "The contact is soft: the weight presses the soles in."
    return {METRICS[name].label: sentence for name, sentence in found.items()}


def _millimetres(length: float) -> str:
    return f"{format_number(1e3 * length, 3)} mm"


def _row(summary: Mapping[str, Any], metric: Metric) -> tuple[str, ...]:
    value, where = cost_entry(summary, metric), ""
    if isinstance(value, Mapping):
        at = "" if value["time"] is None else f", {value['time']:.2f} s"
        where = f"{value['where'].replace('_', ' ')}{at}".removeprefix(", ")
        value = value["value"]
    scale, unit = display_unit(metric.unit, summary["scales"]["body_weight"])
    if metric.name in _SHARES:
        scale, unit = 100.0, "%"
    elif metric.section == "energy":  # a way of metres
        scale, unit = 1.0, metric.unit.removesuffix("1")
    limits = {"margin_torque": 1.0, "margin_friction": summary["margins"]["friction_available"]}
    limit = limits.get(metric.name)
    if value is None:
        return metric.label, format_number(None), "", "", "", where
    return (
        metric.label,
        format_number(scale * value, 3),
        "" if limit is None else format_number(scale * limit),
        short_unit(unit),
        format_share(value, limit),
        where,
    )


def _sentence(summary: Mapping[str, Any]) -> str:
    """Length of the walk, and how its QPs were solved."""
    solver, timing = summary["solver"], summary["timing"]
    if "log" in summary:
        return "A log has no joints: torques, speeds, clearance and QPs are not measured."
    walked = f"{summary['outcome']}, {summary['steps_completed']} steps in {timing['simulated']:.4g} s"
    factor = f"the closed loop at {format_number(timing['real_time_factor'], 3)} times real time"
    if solver["unsolved"] is None:
        return f"{walked}, {factor}; no QP was reported."
    median, most = (_microseconds(solver[key]) for key in ("time_median", "time_p99"))
    times = f"median {median} us, 99th percentile {most} us"
    return f"{walked}, {factor}; {solver['ticks']} QPs, {solver['unsolved']} unsolved, {times}."


def _microseconds(seconds: float | None) -> str:
    return format_number(None if seconds is None else 1e6 * seconds, 3)
