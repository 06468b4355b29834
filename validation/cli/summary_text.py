"""A trial's summary for the terminal: the verdict, its metrics, and beside them what the agreement cost."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.text import Text

from validation.show.text import ABSENT, format_number, judged, print_line, print_table, print_verdict

_SHORT = {"% of body weight": "% of weight"}
"""Units as a terminal of 80 columns has room for them."""


def print_result(summary: Mapping[str, Any], folder: Path) -> None:
    """Print a trial's ``summary.json`` for a reader.

    Args:
        summary: contents of the file.
        folder: that holds it.
    """
    print_table(
        f"{summary['gait']}: measured against plan, without the first step (profile {summary['profile']})",
        ("metric", ">value", ">limit", "unit", ""),
        [_row(name, item) for name, item in summary["metrics"].items() if item["tolerance"] is not None],
    )
    for name, text in cost(summary).items():
        print_line(f"  {name:<18}{text}")
    print_verdict(summary["gait"], summary["verdict"], summary["reason"])
    if "uncertainty" in summary:
        print_line(f"  {_studied(summary['uncertainty'])}")
    for file, what in (("recording.rrd", f"ampm view {folder}"), ("report.html", "open in a browser")):
        if (folder / file).is_file():
            print_line(f"  {folder / file}  ({what})")
    print_line()


def _studied(known: Mapping[str, Any]) -> str:
    """Explanation of what the ± covers."""
    inside = " + ".join(known.get("studies") or ())
    text = f"± numerical uncertainty{f' ({inside})' if inside else ''} of a convergence study of "
    text += f"{known['steps']} steps; a value closer to its limit than that is undecided"
    lacking = known.get("not_studied") or ()
    return text + (f"; not studied, so nothing is decided: {', '.join(lacking)}" if lacking else "")


def _row(name: str, metric: Mapping[str, Any]) -> tuple[str | Text, ...]:
    shown = metric["display"]
    mark = "undecided" if metric.get("undecided") else {True: "pass", False: "FAIL"}.get(metric["pass"])
    value = format_number(shown["value"], 3)
    if metric.get("not_studied"):
        known = shown["uncertainty_at_least"]
        value += " ± not studied" if known is None else f" ± ≥ {format_number(float(known), 2)}"
    elif "uncertainty" in shown:
        value += f" ± {format_number(float(shown['uncertainty']), 2)}"
    unit = _SHORT.get(shown["unit"], shown["unit"])
    return name, value, format_number(shown["tolerance"], 3), unit, judged(mark) if mark else "not judged"


def cost(summary: Mapping[str, Any]) -> dict[str, str]:
    """Cost of the walk, by name."""
    margins, solver, timing = summary["margins"], summary["solver"], summary["timing"]
    torque, support = margins["torque"], margins["measured_polygon"]["value"]
    simulated, friction = format_number(timing["simulated"]), format_number(margins["friction"]["value"], 2)
    lines = {
        "outcome": f"{summary['outcome']}, {summary['steps_completed']} steps in {simulated} s",
        "feedback": f"command minus plan, RMS: ZMP x y {_millimetres(summary['effort']['zmp'], 2)} mm",
        "torque": f"{_scaled(torque['value'], 100, ' %')} of a motor's limit at most ({torque['where']})",
        "friction": f"{friction} used of {format_number(margins['friction_available'], 2)}",
        "support": f"measured ZMP at least {_scaled(support, 1000, ' mm', 1)} inside",
        "knee": f"bent by {format_number(margins['knee']['value'], 3)} rad at least",
        "QP": f"{solver['ticks']} ticks, {solver['unsolved']} unsolved, "
        f"{_scaled(solver['time_median'], 1e6, ' us')} median, "
        f"{_scaled(solver['time_p99'], 1e6, ' us')} at the 99th percentile",
        "speed": f"closed loop at {format_number(timing['real_time_factor'], 3)} times real time",
    }
    if solver["time_median"] is None:  # of a controller of one's own
        lines["QP"] = "none"
    if observed := summary.get("instrument"):
        sizes = {cause: _numbers(windows["run"]["rmse"]) for cause, windows in observed["causes"].items()}
        known = {cause: math.hypot(*rmse) for cause, rmse in sizes.items() if not any(map(math.isnan, rmse))}
        most = f", most of it by {max(known, key=known.__getitem__).replace('_', ' ')}" if known else ""
        off = _millimetres(observed["zmp_error"]["run"]["rmse"], 3)
        lines["instrument"] = f"{observed['name']} shows the ZMP x y {off} mm off (RMS){most}"
    return lines


def _numbers(values: Any) -> list[float]:
    return [math.nan if value is None else float(value) for value in values]


def _millimetres(values: Any, digits: int) -> str:
    return " ".join(format_number(1000 * value, digits) for value in _numbers(values))


def _scaled(value: float | None, scale: float, unit: str, decimals: int = 0) -> str:
    return ABSENT if value is None else f"{scale * value:.{decimals}f}{unit}"
