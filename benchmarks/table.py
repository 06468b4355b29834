"""One table of a benchmark, for the terminal and for the documentation."""

from __future__ import annotations

from pathlib import Path

from rich.text import Text

from benchmarks.clock import Statistics
from benchmarks.recording import MOST_SHARE, MOST_SIZE, RecordingCost
from benchmarks.run import BenchmarkResult
from benchmarks.walking import WalkTiming
from validation.show.text import format_duration, markdown_table, print_line, print_table, replace_between

DOCUMENT = Path(__file__).resolve().parents[1] / "docs" / "benchmarks.md"
MARK = "benchmark table, written by python -m benchmarks --markdown"
"""Between the marks of this name the page has the table."""

HEADER = ("", "median", "p99", "maximum", "of the loop")

Row = tuple[str, str, str, str, str]


def rows(result: BenchmarkResult) -> list[Row]:
    """Lines of the table, sections first by what is done once, then by QP solver; headings have no cells."""
    lines = [
        _row("once per gait"),
        _times("plan, closed form", result.plan),
        _times("plan with feet", result.plan_with_feet),
        _times("periodic motion", result.orbit),
        _times("tick of the inverse kinematics", result.ik_tick),
    ]
    for solver, walk in result.walks.items():
        lines += [_row(f"walk with {solver.upper()}, {_ending(walk)}"), *_walk_rows(walk)]
    return [*lines, *_recording_rows(result.recording)]


def _recording_rows(cost: RecordingCost) -> list[Row]:
    return [
        _row("trial in a process of its own"),
        _row("planning, simulation, measurement", format_duration(cost.run)),
        _row("recording", format_duration(cost.recording)),
        _row("recording, share of the run's time", f"{cost.share:.1%}", f"at most {MOST_SHARE:.0%}"),
        _row("recording, per second", f"{cost.rate / 1e6:.2f} MB", f"at most {MOST_SIZE / 1e6:.0f} MB"),
        _row("report", format_duration(cost.report)),
        _row("memory peak", f"{cost.memory_peak:.0f} MB"),
    ]


def _walk_rows(walk: WalkTiming) -> list[Row]:
    loop = walk.closed_loop_tick.median
    qp = walk.iterations
    return [
        _times("closed loop, one control period", walk.closed_loop_tick, loop),
        _times("control tick", walk.control_tick, loop),
        *(_times(f"control tick, {name}", part, loop) for name, part in walk.parts.items()),
        _times("QP: update and solve", walk.qp, loop),
        ("QP: iterations", f"{qp.median:.0f}", f"{qp.p99:.0f}", f"{qp.maximum:.0f}", ""),
        _times("physics alone, one control period", walk.physics_tick, loop),
        _row("closed loop, times real time", f"{walk.times_real_time:.2f}"),
        _row("the same with set-up and record", f"{walk.times_real_time_whole:.2f}"),
        _row("the same undisturbed", f"{walk.times_real_time_undisturbed:.2f}"),
        _row("physics alone, times real time", f"{walk.physics_times_real_time:.1f}"),
    ]


def _ending(walk: WalkTiming) -> str:
    notes = {
        walk.outcome: walk.outcome != "completed",
        f"{walk.unsolved} QPs unsolved": walk.unsolved,
        f"{walk.limited} ticks at a torque or joint limit": walk.limited,
        "NOT the same walk each time": not walk.same_walk,
    }
    return ", ".join([f"{walk.steps_completed} steps", *(note for note, there in notes.items() if there)])


def _row(name: str, value: str = "", note: str = "") -> Row:
    return (name, value, "", "", note)


def _times(name: str, what: Statistics, loop: float | None = None) -> Row:
    tail = (format_duration(what.p99), format_duration(what.maximum)) if what.count > 1 else ("", "")
    share = "" if loop is None or not loop > 0.0 else f"{what.median / loop:.0%}"
    return (name, format_duration(what.median), *tail, share)


def conditions(result: BenchmarkResult) -> str:
    """One sentence: what it was measured on."""
    known = result.environment
    titles = {"MuJoCo": "mujoco", "Pinocchio": "pin", "OSQP": "osqp", "numpy": "numpy"}
    versions = ", ".join(f"{title} {known['versions'][name]}" for title, name in titles.items())
    peak = "unknown" if result.memory_peak is None else f"{result.memory_peak:.0f} MB"
    return (
        f"{' '.join([result.gait, *result.settings])}, {result.steps} steps; {known['processor']}, one of "
        f"{known['cores']} cores, load {result.load:.1f} at the start; Python {known['python']}, {versions}; "
        f"memory peak {peak}."
    )


def print_result(result: BenchmarkResult) -> None:
    """Print the table on stdout."""
    columns = [HEADER[0], *(f">{name}" for name in HEADER[1:])]
    cells = [row if any(row[1:]) else (Text(row[0], "bold"), *row[1:]) for row in rows(result)]
    print_table("benchmark", columns, cells)
    print_line(conditions(result))


def markdown(result: BenchmarkResult) -> str:
    """The table for the documentation, with its conditions below."""
    table = markdown_table(
        HEADER, [row if any(row[1:]) else (f"**{row[0]}**", *row[1:]) for row in rows(result)]
    )
    return f"{table}\n\n{conditions(result)}"


def update_document(result: BenchmarkResult, document: Path = DOCUMENT) -> None:
    """Replace the table between the marks of a Markdown file.

    Raises:
        ValueError: the file has no marks.
    """
    text = document.read_text(encoding="utf-8")
    document.write_text(replace_between(text, MARK, f"\n{markdown(result)}\n"), encoding="utf-8")
