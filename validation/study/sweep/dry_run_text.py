"""A dry run in words."""

from __future__ import annotations

import math

from rich.markup import escape

from validation.show.text import print_line, print_table
from validation.study.sweep.dry_run import CONFIDENCE, DryRun
from validation.study.sweep.screening import Refusal

_EXAMPLES = 3  # bodily refusals told in full


def print_dry_run(dry: DryRun) -> None:
    """Print a dry run for a reader."""
    definition, probe, rates = dry.definition, dry.probe, dry.rates
    steps = "1 step" if definition.steps == 1 else f"{definition.steps} steps"
    rows = [("runs", _count(dry.runs), "", f"of {escape(definition.gait)}, {steps} each")]
    for item in dry.refusals:
        share = _share(item.count, dry.runs)
        rows.append((f"refused: {item.reason}", _count(item.count), share, _hint(item)))
    rows.append(("accepted by the formula", _count(dry.accepted), _share(dry.accepted, dry.runs), ""))
    of = "" if probe.complete else f"of {_count(probe.runs)} looked at"
    body = sorted(probe.refused.items(), key=lambda item: -item[1])
    for reason, count in body:
        rows.append((f"  the body refuses: {reason}", _count(count), _share(count, probe.runs), of))
    solved = dry.solved
    motions = sorted(solved.refused.items(), key=lambda item: -item[1])
    of = "" if solved.complete else f"of {_count(solved.runs)} whose motion was solved"
    for reason, count in motions:
        rows.append((f"  the motion refuses: {reason}", _count(count), _share(count, solved.runs), of))
    about = "" if dry.exact else "about "
    low, high = dry.interval
    span = "" if dry.exact else f"{_count(low)} ... {_count(high)} with {100 * CONFIDENCE:g} % confidence"
    rows.append(("walk, at most", about + _count(dry.walking), _share(dry.walking, dry.runs), span))
    print_table(
        f"dry run of {escape(definition.name)}: {', '.join(definition.keys)}",
        (("", "left"), ("runs", "right"), ("share", "right"), ("", "left")),
        rows,
    )
    for reason, _ in body[:_EXAMPLES]:
        print_line(f"  {reason}, for example: {escape(probe.examples[reason])}")
    for reason, _ in motions[:_EXAMPLES]:
        print_line(f"  {reason}, for example: {escape(solved.examples[reason])}")
    if dry.all_refused:
        print_line("  every run is refused: nothing would walk")
    if solved.motions:
        print_line(
            f"  looked at         {_count(probe.probed)} of {_count(probe.motions)} motions for soles and "
            f"legs; {solved.motions} of them solved, in {duration_text(solved.seconds)}"
        )
    print_line(
        f"  time              {duration_text(dry.wall_clock)} with {dry.workers} "
        f"worker{'s' if dry.workers > 1 else ''}: {duration_text(dry.processor)} of processor time for "
        f"{duration_text(dry.simulated)} of walking and at most {_count(probe.motions)} new "
        f"motion{'' if probe.motions == 1 else 's'}"
    )
    print_line(
        f"  assumed           {rates.real_time_factor():.1f} times real time at 500 Hz and 2 ms, "
        f"{rates.motion:g} s for a new motion, {rates.run:g} s for the rest of a run, on one core of a "
        "server; recordings come on top"
    )
    print_line(f"  not seen          {dry.unseen}")
    for note in dry.notes():
        print_line(f"  note              {note}")


def _hint(item: Refusal) -> str:
    """What was asked for, and what would pass."""
    asked = "" if item.asked is None else f"{item.key} is {_span(item.asked)}"
    way_out = item.way_out()
    if not way_out:
        return f"{item.meaning}; {asked}" if asked else item.meaning
    return f"{asked}; passes if {way_out.removeprefix(f'{item.key} ')}"


def duration_text(seconds: float) -> str:
    """A time in two words: ``3 h 20 min``."""
    if not math.isfinite(seconds):
        return "for ever"
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    if minutes < 90:
        return f"{minutes} min"
    hours, minutes = divmod(minutes, 60)
    if hours < 48:
        return f"{hours} h {minutes} min" if minutes else f"{hours} h"
    return f"{seconds / 86400:.1f} days"


def _count(number: int) -> str:
    return f"{number:,}"


def _share(number: int, total: int) -> str:
    return f"{100.0 * number / total:.3g} %" if total else "-"


def _span(ends: tuple[float, float]) -> str:
    low, high = (f"{value:.4g}" for value in ends)
    return low if low == high else f"{low} ... {high}"
