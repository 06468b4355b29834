"""Output of the command line: results on stdout, everything else on stderr.

Progress is a bar on a terminal and one plain line per stage elsewhere (logs, pipes).
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich import progress as bars
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    SpinnerColumn,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
)

from validation.progress import Progress, Stage, interruption
from validation.store.json import json_ready

_LINE_EVERY = 30.0  # [s]


class _Bar(Stage):
    def __init__(self, bar: bars.Progress, task: TaskID, label: str) -> None:
        self.bar, self.task, self.label = bar, task, label

    def advance(self, done: int, total: int) -> None:
        self.bar.update(self.task, completed=done, total=total)

    def note(self, text: str) -> None:
        self.bar.update(self.task, description=f"{self.label} ({text})")


class _Lines(Stage):
    """Where there is no terminal: a line now and then."""

    def __init__(self, console: Console, label: str) -> None:
        self.console, self.label = console, label
        self.printed, self.done = time.monotonic(), ""

    def advance(self, done: int, total: int) -> None:
        self.done = f"{done} of {total}"

    def note(self, text: str) -> None:
        if time.monotonic() - self.printed > _LINE_EVERY:
            self.printed = time.monotonic()
            words = ", ".join(part for part in (self.done, text) if part)
            self.console.print(f"{self.label}: {words}", markup=False)


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
            yield _Lines(self.console, label)
        else:
            count = (MofNCompleteColumn(), TextColumn("{task.fields[unit]}")) if unit else ()
            columns = (
                SpinnerColumn(),
                TextColumn("{task.description}", markup=False),
                BarColumn(),
                *count,
                TimeElapsedColumn(),
            )
            with bars.Progress(*columns, console=self.console, transient=True) as bar:
                yield _Bar(bar, bar.add_task(label, total=None, unit=unit), label)
        self.console.print(f"{label}: {time.perf_counter() - start:.1f} s", style="dim", markup=False)
        interruption.check()

    def say(self, text: str) -> None:
        """Print one line on stderr."""
        self.console.print(text, markup=False)

    def wrote(self, *paths: Path | None) -> None:
        """Name the files that were written; None stands for one that nobody asked for."""
        for path in paths:
            if path is not None:
                self.say(f"wrote {path}")


def print_json(value: Any) -> None:
    """Print JSON on stdout; infinite numbers become ``"inf"``, undefined ones null."""
    print(json.dumps(json_ready(value), indent=2, allow_nan=False))  # noqa: T201  # stdout is the result
