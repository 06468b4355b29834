"""A trial's summary for the terminal: the verdict, its figures, and beside them what the agreement cost."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from validation.show.text import format_number, print_line, print_table

_SHORT = {"% of body weight": "% of weight"}
"""Units as a terminal of 80 columns has room for them."""

_COLOURS = {"pass": "green", "fail": "red", "undecided": "yellow", "not_measured": "yellow"}


def print_result(summary: Mapping[str, Any], folder: Path) -> None:
    """Print a trial's ``summary.json`` for a reader.

    Args:
        summary: contents of the file.
        folder: that holds it.
    """
    print_table(
        f"{summary['gait']}: measured against plan, without the first step (profile {summary['profile']})",
        (("metric", "left"), ("value", "right"), ("limit", "right"), ("unit", "left"), ("", "left")),
        [
            _row(name, metric)
            for name, metric in summary["metrics"].items()
            if metric["tolerance"] is not None
        ],
    )
    for name, text in cost(summary):
        print_line(f"  {name:<18}{text}")
    colour = _COLOURS[summary["verdict"]]
    word = summary["verdict"].replace("_", " ").upper()
    print_line(f"[bold {colour}]{summary['gait']}: {word}[/]  {_escaped(summary['reason'])}")
    known = summary.get("uncertainty")
    if known is not None:
        print_line(f"  {_escaped(_studied(known))}")
    for file, what in (("recording.rrd", f"ampm view {folder}"), ("report.html", "open in a browser")):
        if (folder / file).is_file():
            print_line(f"  {_escaped(str(folder / file))}  ({_escaped(what)})")
    print_line("")


def _studied(known: Mapping[str, Any]) -> str:
    """What is inside the ±, and what is not."""
    inside = " + ".join(known.get("studies") or ())
    text = f"± numerical uncertainty{f' ({inside})' if inside else ''} of a convergence study of "
    text += f"{known['steps']} steps; a value closer to its limit than that is undecided"
    lacking = known.get("not_studied") or ()
    return text + (f"; not studied, so nothing is decided: {', '.join(lacking)}" if lacking else "")


def _row(name: str, metric: Mapping[str, Any]) -> tuple[str, ...]:
    shown = metric["display"]
    if metric.get("undecided"):
        mark = "[yellow]undecided[/]"
    elif metric["pass"] is None:
        mark = "not judged"
    else:
        mark = "[green]pass[/]" if metric["pass"] else "[red]FAIL[/]"
    unit = _SHORT.get(shown["unit"], shown["unit"])
    value = format_number(shown["value"], 3)
    if metric.get("not_studied"):
        known = shown["uncertainty_at_least"]
        value += " ± not studied" if known is None else f" ± ≥ {format_number(float(known), 2)}"
    elif "uncertainty" in shown:
        value += f" ± {format_number(float(shown['uncertainty']), 2)}"
    return (name, value, format_number(shown["tolerance"], 3), unit, mark)


def cost(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    """What the walk cost, as (name, text)."""
    margins, effort, solver = summary["margins"], summary["effort"], summary["solver"]
    timing, torque = summary["timing"], margins["torque"]
    feedback = " ".join(format_number(1000 * value, 2) for value in _numbers(effort["zmp"]))
    return [
        (
            "outcome",
            f"{summary['outcome']}, {summary['steps_completed']} steps in "
            f"{format_number(timing['simulated'])} s",
        ),
        ("feedback", f"command minus plan, RMS: ZMP x y {feedback} mm"),
        (
            "torque",
            f"{_percent(torque['value'])} of a motor's limit at most ({torque['where']})",
        ),
        (
            "friction",
            f"{format_number(margins['friction']['value'], 2)} used of "
            f"{format_number(margins['friction_available'], 2)}",
        ),
        (
            "support",
            f"measured ZMP at least {_millimetres(margins['measured_polygon']['value'])} inside",
        ),
        ("knee", f"bent by {format_number(margins['knee']['value'], 3)} rad at least"),
        (
            "QP",
            f"{solver['ticks']} ticks, {solver['unsolved']} unsolved, "
            f"{_micro(solver['time_median'])} median, {_micro(solver['time_p99'])} at the 99th percentile",
        ),
        ("speed", f"closed loop at {format_number(timing['real_time_factor'], 3)} times real time"),
        *_instrument(summary.get("instrument")),
    ]


def _instrument(seen: Mapping[str, Any] | None) -> list[tuple[str, str]]:
    """What an instrument makes of the ZMP, if one was asked for."""
    if seen is None:
        return []
    causes = {
        cause: math.hypot(*_numbers(windows["run"]["rmse"])) for cause, windows in seen["causes"].items()
    }
    known = {cause: size for cause, size in causes.items() if size == size}
    most = f", most of it by {max(known, key=lambda c: known[c]).replace('_', ' ')}" if known else ""
    off = " ".join(format_number(1000 * value, 3) for value in _numbers(seen["zmp_error"]["run"]["rmse"]))
    return [("instrument", f"{_escaped(seen['name'])} shows the ZMP x y {off} mm off (RMS){most}")]


def _numbers(values: Any) -> list[float]:
    return [float("nan") if value is None else float(value) for value in values]


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.0f} %"


def _millimetres(value: float | None) -> str:
    return "-" if value is None else f"{1000 * value:.1f} mm"


def _micro(value: float | None) -> str:
    return "-" if value is None else f"{1e6 * value:.0f} us"


def _escaped(text: str) -> str:
    return text.replace("[", "\\[")
