"""Text of ``ampm sweep --dry-run``."""

from __future__ import annotations

from pathlib import Path

from rich.markup import escape

from validation.cli.console import Narrator, print_json
from validation.cli.options import Status
from validation.show.text import format_duration, print_line, print_table
from validation.store.machine import cores
from validation.study.sweep.design import load_sweep
from validation.study.sweep.forecast import Forecast, forecast


def dry_run(file: Path, workers: int | None, *, as_json: bool) -> Status:
    """Print what a sweep would be.

    Raises:
        InputError: bad options or a bad definition.
    """
    found = forecast(load_sweep(file), cores() if workers is None else workers, progress=Narrator())
    if as_json:
        print_json(found.as_dict())
    else:
        print_forecast(found)
    return Status.REFUSED if found.all_refused else Status.PASS


def print_forecast(found: Forecast) -> None:
    """Print a forecast for a reader."""
    definition = found.definition
    rows = [("runs", f"{found.runs:,}", f"of {escape(definition.gait)}, {definition.steps} steps each")]
    rows += [(f"refused: {item.reason}", f"{item.runs:,}", escape(item.example)) for item in found.refused]
    sample = "" if found.exact else f" (of {found.checked} of {found.gaits:,} gaits)"
    for item in found.body_refused:
        rows.append((f"the body refuses{sample}: {item.reason}", f"{item.runs:,}", escape(item.example)))
    about = "" if found.exact else "about "
    rows.append(("can walk, at most", f"{about}{found.walking:,}", ""))
    print_table(
        f"dry run of {escape(definition.name)}: {', '.join(definition.keys)}",
        (("", "left"), ("runs", "right"), ("for example", "left")),
        rows,
    )
    if found.all_refused:
        print_line("every run is refused: nothing would walk")
    elif found.seconds is None or found.wall_clock is None:
        print_line("no run that was tried could be walked, so its time is unknown")
    else:
        print_line(
            f"one run takes about {format_duration(found.seconds)}, the sweep "
            f"{format_duration(found.wall_clock)} with {found.workers} workers"
        )
    for text in found.motion_refused:
        print_line(f"tried to time it, and refused: {escape(text)}")
    print_line("not seen: motions that do not close or reach a joint limit, and falls")
    for note in definition.notes():
        print_line(f"note: {note}")
