"""Output of the command line: results on stdout, everything else on stderr.

Every command reports its progress by :class:`Narrator`: a bar on a terminal, and elsewhere (logs, pipes) at
most a line every half minute and one at the end of each stage.
"""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich import progress as bars
from rich.console import Console
from rich.text import Text

from validation.output import results
from validation.progress import Progress, Stage, interruption
from validation.store.json import dump_json
from validation.table import format_duration

_LINE_EVERY = 30.0  # [s]
_WHOLE_STAGE = 1e6  # time over which the bar averages the speed of a stage [s]


def _lines(console: Console, label: str, unit: str) -> Stage:
    """Progress without a terminal: a line when something is reported, if the last one is long ago."""
    start = last = time.monotonic()
    before: int | None = None  # done at the first report, as stored rows say nothing of the speed
    note = ""

    def advance(done: int, total: int) -> None:
        from ampm.compiled import compilation  # slow to load

        nonlocal start, last, before
        now = time.monotonic()
        busy = now - compilation.seconds  # compiling says nothing of the speed
        if before is None:
            start, before = busy, done
        if now - last < _LINE_EVERY:
            return
        last = now
        line = f"{label}: {done:,} of {total:,} {unit}"
        if done > before:
            left = (busy - start) * (total - done) / (done - before)
            line += f", about {format_duration(round(left))} left"
        console.print(line + note, markup=False)

    def remember(text: str) -> None:
        nonlocal note
        note = f", {text}" if text else ""

    return Stage(advance, remember)


class Narrator(Progress):
    """Reports stages on stderr: a bar that vanishes when done on a terminal, and one line in any case."""

    def __init__(self) -> None:
        self.console = Console(stderr=True, highlight=False, soft_wrap=True)

    @contextmanager
    def stage(self, label: str, unit: str = "") -> Iterator[Stage]:
        """Enter one stage; see :meth:`Progress.stage`."""
        interruption.check()
        start = time.perf_counter()
        if self.console.is_terminal:
            with self._bar(label, unit) as stage:
                yield stage
        else:
            yield _lines(self.console, label, unit)
        self.console.print(f"{label}: {time.perf_counter() - start:.1f} s", style="dim", markup=False)
        interruption.check()

    @contextmanager
    def _bar(self, label: str, unit: str) -> Iterator[Stage]:
        words = bars.TextColumn("{task.description}", markup=False)
        count = (bars.MofNCompleteColumn(), bars.TextColumn(unit)) if unit else ()
        left = (bars.TimeRemainingColumn(), bars.TextColumn("left")) if unit else ()
        columns = (bars.SpinnerColumn(), words, bars.BarColumn(), *count, bars.TimeElapsedColumn(), *left)
        with bars.Progress(
            *columns, console=self.console, transient=True, speed_estimate_period=_WHOLE_STAGE
        ) as shown:
            task = shown.add_task(label, total=None)
            yield Stage(
                lambda done, total: shown.update(task, completed=done, total=total),
                lambda text: shown.update(task, description=f"{label} ({text})" if text else label),
            )

    def say(self, text: str) -> None:
        """Print one line on stderr."""
        self.console.print(text, markup=False)

    def wrote(self, *paths: Path | None) -> None:
        """Name the files that were written; None stands for one that was not requested."""
        for path in paths:
            if path is not None:
                self.say(f"wrote {path}")


def print_json(value: Any) -> None:
    """Print JSON on stdout; infinite numbers become ``"inf"``, undefined ones null."""
    print(dump_json(value), file=results())


def print_line(text: str | Text = "", style: str = "") -> None:
    """Print one line on stdout, unwrapped and unchanged."""
    console = Console(file=results(), highlight=False, markup=False, emoji=False, soft_wrap=True)
    console.print(text, style=style)
