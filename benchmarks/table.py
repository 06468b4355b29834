"""One table of a benchmark, for the terminal and for the documentation."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

from ampm.exceptions import InputError
from benchmarks.clock import Statistics
from benchmarks.recording import MOST_SHARE, MOST_SIZE, RecordingCost
from benchmarks.run import BenchmarkResult
from benchmarks.walking import WalkTiming

DOCUMENT = Path(__file__).resolve().parents[1] / "docs" / "benchmarks.md"
BEGIN = "<!-- benchmark table: written by python -m benchmarks --markdown -->"
END = "<!-- end of the benchmark table -->"

HEADER = ("", "median", "p99", "maximum", "of the loop")


@dataclass(frozen=True)
class Row:
    """One line: a heading if it has no cells."""

    name: str
    cells: tuple[str, ...] = ()
    depth: int = 0


def rows(result: BenchmarkResult) -> list[Row]:
    """Lines of the table, sections first by what is done once, then by QP solver."""
    lines = [
        Row("once per gait"),
        _times("plan, closed form", result.plan),
        _times("plan with feet", result.plan_with_feet),
        _times("periodic motion", result.orbit),
        _times("tick of the inverse kinematics", result.ik_tick),
    ]
    for solver, walk in result.walks.items():
        lines += [Row(f"walk with {solver.upper()}, {_ending(walk)}"), *_walk_rows(walk)]
    return [*lines, *_recording_rows(result.recording)]


def _recording_rows(cost: RecordingCost) -> list[Row]:
    def row(name: str, text: str, note: str = "", depth: int = 0) -> Row:
        return Row(name, (text, "", "", note), depth)

    return [
        Row("trial in a process of its own"),
        row("planning, simulation, measurement", duration(cost.run)),
        row("recording", duration(cost.recording)),
        row("share of the run's time", f"{cost.share:.1%}", f"at most {MOST_SHARE:.0%}", 1),
        row("per simulated second", f"{cost.rate / 1e6:.2f} MB", f"at most {MOST_SIZE / 1e6:.0f} MB", 1),
        row("report", duration(cost.report)),
        row("memory peak", f"{cost.memory_peak:.0f} MB"),
    ]


def _walk_rows(walk: WalkTiming) -> list[Row]:
    loop = walk.closed_loop_tick.median
    return [
        _times("closed loop, one control period", walk.closed_loop_tick, loop),
        _times("control tick", walk.control_tick, loop),
        *(_times(name, part, loop, depth=1) for name, part in walk.parts.items()),
        _times("QP: update and solve", walk.qp, loop),
        _numbers("QP: iterations", walk.iterations),
        _times("physics alone, one control period", walk.physics_tick, loop),
        Row("closed loop, times real time", (f"{walk.times_real_time:.2f}", "", "", "")),
        Row("with set-up and record", (f"{walk.times_real_time_whole:.2f}", "", "", ""), depth=1),
        Row("undisturbed", (f"{walk.times_real_time_undisturbed:.2f}", "", "", ""), depth=1),
        Row("physics alone, times real time", (f"{walk.physics_times_real_time:.1f}", "", "", "")),
    ]


def _ending(walk: WalkTiming) -> str:
    text = f"{walk.steps_completed} steps"
    if walk.outcome != "completed":
        text += f", {walk.outcome}"
    if walk.unsolved:
        text += f", {walk.unsolved} QPs unsolved"
    if walk.limited:
        text += f", {walk.limited} ticks at a torque or joint limit"
    if not walk.same_walk:
        text += ", NOT the same walk each time"
    return text


def _times(name: str, what: Statistics, loop: float | None = None, depth: int = 0) -> Row:
    tail = (duration(what.p99), duration(what.maximum)) if what.count > 1 else ("", "")
    share = "" if loop is None or not loop > 0.0 else f"{what.median / loop:.0%}"
    return Row(name, (duration(what.median), *tail, share), depth)


def _numbers(name: str, what: Statistics) -> Row:
    return Row(name, (f"{what.median:.0f}", f"{what.p99:.0f}", f"{what.maximum:.0f}", ""))


def duration(seconds: float) -> str:
    """A time with the unit that suits it."""
    if math.isnan(seconds):
        return "-"
    for unit, size in (("s", 1.0), ("ms", 1e-3)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds * 1e6:.{0 if seconds >= 1e-5 else 1}f} µs"


def conditions(result: BenchmarkResult) -> str:
    """One sentence: what the figures were measured on."""
    known = result.environment
    versions = known["versions"]
    named = ", ".join(
        f"{title} {versions[name]}"
        for title, name in (("MuJoCo", "mujoco"), ("Pinocchio", "pin"), ("OSQP", "osqp"), ("numpy", "numpy"))
    )
    changed = "".join(f" {setting}" for setting in result.settings)
    return (
        f"{result.gait}{changed}, {result.steps} steps; {known['processor']}, one of {known['cores']} cores, "
        f"load {result.load:.1f} at the start; Python {known['python']}, {named}; memory peak "
        f"{result.memory_peak:.0f} MB."
    )


def print_result(result: BenchmarkResult) -> None:
    """Print the table on stdout."""
    table = Table(title="benchmark", title_justify="left", title_style="bold", caption=conditions(result))
    table.caption_justify = "left"
    for number, header in enumerate(HEADER):
        table.add_column(header, justify="right" if number else "left", no_wrap=True)
    for row in rows(result):
        if not row.cells:
            table.add_section()
            table.add_row(f"[bold]{row.name}[/bold]")
        else:
            table.add_row("  " * row.depth + row.name, *row.cells)
    Console(highlight=False).print(table)


def markdown(result: BenchmarkResult) -> str:
    """The table for the documentation, with its conditions below."""
    lines = ["| " + " | ".join(HEADER) + " |", "|---|" + "--:|" * (len(HEADER) - 1)]
    for row in rows(result):
        if not row.cells:
            cells = (f"**{row.name}**", *[""] * (len(HEADER) - 1))
        else:
            cells = ("&emsp;" * row.depth + row.name, *row.cells)
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join([*lines, "", conditions(result)])


def update_document(result: BenchmarkResult, document: Path = DOCUMENT) -> None:
    """Replace the table between the marks of a Markdown file.

    Raises:
        InputError: the file is missing or has no marks.
    """
    try:
        text = document.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"{document} cannot be read ({error.strerror}); run from a checkout.") from error
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise InputError(f"{document} has no marks for the table; put '{BEGIN}' and '{END}' into it.")
    document.write_text(f"{before}{BEGIN}\n\n{markdown(result)}\n\n{END}{after}", encoding="utf-8")
