"""Output of the command line: results on stdout, everything else on stderr.

Progress is a bar on a terminal and one plain line per stage elsewhere (logs, pipes).
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
)
from rich.progress import Progress as Bars

from validation.progress import Progress, Stage, interruption
from validation.store.json import dump_json

_LINE_EVERY = 30.0  # [s]


class _Bar(Stage):
    def __init__(self, bars: Bars, task: TaskID, label: str) -> None:
        self.bars, self.task, self.label = bars, task, label

    def advance(self, done: int, total: int) -> None:
        self.bars.update(self.task, completed=done, total=total)

    def note(self, text: str) -> None:
        self.bars.update(self.task, description=f"{self.label} ({text})")


class _Lines(Stage):
    """Progress without a terminal: one line at intervals."""

    def __init__(self, progress: Progress, label: str) -> None:
        self.progress, self.label = progress, label
        self.printed, self.done = time.monotonic(), ""

    def advance(self, done: int, total: int) -> None:
        self.done = f"{done} of {total}, "

    def note(self, text: str) -> None:
        if time.monotonic() - self.printed > _LINE_EVERY:
            self.printed = time.monotonic()
            self.progress.say(f"{self.label}: {self.done}{text}")


class Narrator(Progress):
    """Reports stages on stderr: a bar that vanishes when done on a terminal, and one line in any case."""

    def __init__(self) -> None:
        self.console = Console(stderr=True, highlight=False, soft_wrap=True)

    @contextmanager
    def stage(self, label: str, unit: str = "") -> Iterator[Stage]:
        """Enter one stage; see :meth:`Progress.stage`."""
        interruption.check()
        start = time.perf_counter()
        if not self.console.is_terminal:
            yield _Lines(self, label)
        else:
            words = TextColumn("{task.description}", markup=False)
            count = (MofNCompleteColumn(), TextColumn("{task.fields[unit]}")) if unit else ()
            columns = (SpinnerColumn(), words, BarColumn(), *count, TimeElapsedColumn())
            with Bars(*columns, console=self.console, transient=True) as bars:
                yield _Bar(bars, bars.add_task(label, total=None, unit=unit), label)
        self.console.print(f"{label}: {time.perf_counter() - start:.1f} s", style="dim", markup=False)
        interruption.check()

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
    print(dump_json(value))  # noqa: T201  # stdout is the result
