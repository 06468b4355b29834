"""Output of the command line: results on stdout, everything else on stderr.

Every command reports its progress by :class:`Narrator`: a bar on a terminal, and elsewhere (logs, pipes) at
most a line every half minute and one at the end of each stage.
"""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    SpinnerColumn,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.progress import Progress as Bars

from validation.output import results
from validation.progress import Progress, Stage, interruption
from validation.show.text import format_duration
from validation.store.json import dump_json

_LINE_EVERY = 30.0  # [s]
_WHOLE_STAGE = 1e6  # time over which the bar averages the speed of a stage [s]


class _Bar(Stage):
    """Progress on a terminal."""

    def __init__(self, bars: Bars, task: TaskID, label: str) -> None:
        self._bars, self._task, self._label = bars, task, label

    def advance(self, done: int, total: int) -> None:
        self._bars.update(self._task, completed=done, total=total)

    def note(self, text: str) -> None:
        self._bars.update(self._task, description=f"{self._label} ({text})" if text else self._label)


class _Lines(Stage):
    """Progress without a terminal: a line when something is reported, if the last one is long ago."""

    def __init__(self, console: Console, label: str, unit: str) -> None:
        self._console, self._label, self._unit = console, label, unit
        self._start = self._last = time.monotonic()
        self._before: int | None = None  # done at the first report, as stored rows say nothing of the speed
        self._note = ""

    def advance(self, done: int, total: int) -> None:
        now = time.monotonic()
        if self._before is None:
            self._start, self._before = now, done
        if now - self._last < _LINE_EVERY:
            return
        self._last = now
        line = f"{self._label}: {done:,} of {total:,} {self._unit}"
        if done > self._before:
            left = (now - self._start) * (total - done) / (done - self._before)
            line += f", about {format_duration(round(left))} left"
        self._console.print(line + self._note, markup=False)

    def note(self, text: str) -> None:
        self._note = f", {text}" if text else ""


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
            yield _Lines(self.console, label, unit)
        self.console.print(f"{label}: {time.perf_counter() - start:.1f} s", style="dim", markup=False)
        interruption.check()

    @contextmanager
    def _bar(self, label: str, unit: str) -> Iterator[Stage]:
        words = TextColumn("{task.description}", markup=False)
        count = (MofNCompleteColumn(), TextColumn(unit)) if unit else ()
        left = (TimeRemainingColumn(), TextColumn("left")) if unit else ()
        columns = (SpinnerColumn(), words, BarColumn(), *count, TimeElapsedColumn(), *left)
        with Bars(*columns, console=self.console, transient=True, speed_estimate_period=_WHOLE_STAGE) as bars:
            yield _Bar(bars, bars.add_task(label, total=None), label)

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
