"""What a user sees: results on stdout, everything else on stderr.

Progress is a bar on a terminal and one plain line per stage elsewhere (logs, pipes).
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
)
from rich.table import Table

from validation.cli.entry import interruption

_FILE_WIDTH = 160
"""Columns of a table that is written to a file or a pipe."""


class Stage:
    """One stage of a pipeline, seen from inside: where it says how far it is. This one tells nobody."""

    def advance(self, done: int, total: int) -> None:
        """Report how much is done, in the stage's unit."""

    def note(self, text: str) -> None:
        """Report in words."""


class Silent:
    """Reports nothing: for calls from Python, and the base of what does report."""

    @contextmanager
    def stage(self, label: str, unit: str = "") -> Iterator[Stage]:
        """Enter one stage.

        Args:
            label: what is being done.
            unit: what ``done`` and ``total`` of :meth:`Stage.advance` count.
        """
        yield Stage()


class _Bar(Stage):
    def __init__(self, bar: Progress, task: TaskID, label: str) -> None:
        self.bar, self.task, self.label = bar, task, label

    def advance(self, done: int, total: int) -> None:
        self.bar.update(self.task, completed=done, total=total)

    def note(self, text: str) -> None:
        self.bar.update(self.task, description=f"{self.label} ({text})")


class Narrator(Silent):
    """Reports stages on stderr: a bar that vanishes when done on a terminal, and one line in any case."""

    def __init__(self) -> None:
        self.console = Console(stderr=True, highlight=False, soft_wrap=True)

    @contextmanager
    def stage(self, label: str, unit: str = "") -> Iterator[Stage]:
        """Enter one stage; see :meth:`Silent.stage`."""
        interruption.check()
        start = time.perf_counter()
        if not self.console.is_terminal:
            yield Stage()
        else:
            count = (MofNCompleteColumn(), TextColumn("{task.fields[unit]}")) if unit else ()
            columns = (
                SpinnerColumn(),
                TextColumn("{task.description}", markup=False),
                BarColumn(),
                *count,
                TimeElapsedColumn(),
            )
            with Progress(*columns, console=self.console, transient=True) as bar:
                yield _Bar(bar, bar.add_task(label, total=None, unit=unit), label)
        self.console.print(f"{label}: {time.perf_counter() - start:.1f} s", style="dim", markup=False)
        interruption.check()

    def say(self, text: str) -> None:
        """One line on stderr."""
        self.console.print(text, markup=False)


def print_json(value: Any) -> None:
    """Print JSON on stdout; infinite numbers become ``"inf"``, undefined ones null."""
    print(json.dumps(json_ready(value), indent=2, allow_nan=False))  # noqa: T201  # stdout is the result


def json_ready(value: Any) -> Any:
    """Copy of a nested value in which every number is one that JSON has.

    ``inf`` becomes ``"inf"`` (which ``--set`` reads back), NaN becomes None, numpy numbers become Python's.
    """
    if isinstance(value, Mapping):
        return {str(key): json_ready(item) for key, item in value.items()}
    if isinstance(value, str) or value is None or isinstance(value, bool | int):
        return value
    if isinstance(value, float):
        if math.isnan(value):
            return None
        return float(value) if math.isfinite(value) else ("inf" if value > 0 else "-inf")
    if hasattr(value, "tolist"):  # numpy scalar or array
        return json_ready(value.tolist())
    if isinstance(value, Sequence):
        return [json_ready(item) for item in value]
    return str(value)


def print_table(title: str, columns: Sequence[tuple[str, str]], rows: Sequence[Sequence[str]]) -> None:
    """Print a table on stdout.

    Args:
        title: line above.
        columns: header and justification (``"left"`` or ``"right"``) of each column.
        rows: cells, rich markup allowed.
    """
    table = Table()
    for number, (header, justify) in enumerate(columns):
        right = justify == "right"
        table.add_column(header, justify="right" if right else "left", no_wrap=right or number == 0)
    for row in rows:
        table.add_row(*row)
    console = Console(highlight=False)
    if not console.is_terminal:  # a file or a pipe has no edge to wrap at
        console.width = max(console.width, _FILE_WIDTH)
    # The title is padded to the table's width otherwise, and a file keeps such blanks.
    console.print(f"[bold]{title}[/]", soft_wrap=True)
    console.print(table)


def print_line(text: str) -> None:
    """Print one line on stdout, unwrapped."""
    Console(highlight=False, soft_wrap=True).print(text)


def figure(value: float | None, digits: int = 4) -> str:
    """A number for a table: significant digits, or a dash where there is none."""
    if value is None or math.isnan(value):
        return "-"
    return f"{value:.{digits}g}"
