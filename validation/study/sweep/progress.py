"""How far a sweep is: a bar on a terminal, a line now and then elsewhere, on stderr."""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Mapping
from types import TracebackType
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn

_LINE_EVERY = 30.0
_WINDOW = 300.0  # over which the rate is taken [s]
_LEAST = 3  # walks after which there is a rate


class SweepProgress:
    """Counts what has ended, and shows it.

    Args:
        total: runs of the sweep.
        walks: how many of them have to be walked from now on.
        counts: what an earlier call has found, see :func:`state_of`.
        console: on stderr.
    """

    def __init__(self, total: int, walks: int, counts: Mapping[str, int], console: Console) -> None:
        self.total, self.walks = total, walks
        self.counts: Counter[str] = Counter(counts)
        self.walked = 0
        self.console = console
        self._recent: deque[float] = deque()
        self._started = self._line = time.monotonic()
        self._workers = 0
        self._bar: Progress | None = None

    def __enter__(self) -> SweepProgress:
        self._started = self._line = time.monotonic()
        if self.console.is_terminal:
            self._bar = Progress(
                SpinnerColumn(),
                TextColumn("sweep"),
                BarColumn(),
                MofNCompleteColumn(),
                TextColumn("{task.fields[text]}", markup=False),
                console=self.console,
                transient=True,
                refresh_per_second=2,
            )
            self._bar.start()
            self._task = self._bar.add_task("", total=self.total, text="")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()
        runs = "run" if self.total == 1 else "runs"
        self.console.print(f"sweep: {self.done} of {self.total} {runs}, {self.text()}", markup=False)

    @property
    def done(self) -> int:
        """Runs that have ended, earlier calls included."""
        return sum(self.counts.values())

    def row(self, row: Mapping[str, Any]) -> None:
        """A run has ended."""
        self.counts[state_of(row)] += 1
        if row.get("timing_total") is not None or row.get("outcome") != "refused":
            self.walked += 1
            self._recent.append(time.monotonic())

    def trace(self, name: str, text: str) -> None:
        """A run has crashed."""
        last = text.strip().rpartition("\n")[2]
        self.console.print(f"run {name} crashed: {last}", markup=False)

    def tick(self, workers: int) -> None:
        """Show it, if it is time."""
        self._workers = workers
        if self._bar is not None:
            self._bar.update(self._task, completed=self.done, text=self.text())
        elif time.monotonic() - self._line > _LINE_EVERY:
            self._line = time.monotonic()
            self.console.print(f"{self.done} of {self.total} runs, {self.text()}", markup=False)

    def rate(self) -> float | None:
        """Walks per second of late; None if there were too few."""
        now = time.monotonic()
        while self._recent and now - self._recent[0] > _WINDOW:
            self._recent.popleft()
        if len(self._recent) < _LEAST:
            return None
        return len(self._recent) / max(min(now - self._started, _WINDOW), 1e-9)

    def text(self) -> str:
        """Counts, rate and time left."""
        parts = [f"{number} {name}" for name in _ORDER if (number := self.counts[name])]
        rate, left = self.rate(), max(self.walks - self.walked, 0)
        if rate is not None:
            parts.append(f"{rate:.3g}/s" if rate >= 1.0 else f"{60.0 * rate:.3g}/min")
            if left:
                parts.append(f"{duration(left / rate)} left")
        if not self._workers and left:
            parts.append("waiting for workers")
        return ", ".join(parts)


_ORDER = (
    "pass",
    "fail",
    "not measured",
    "fell",
    "diverged",
    "infeasible",
    "refused",
    "crashed",
    "timed out",
    "interrupted",
)


def state_of(row: Mapping[str, Any]) -> str:
    """One word or two for what became of a run, from its ``outcome`` and ``verdict``."""
    name = row["verdict"] if row["outcome"] == "completed" and row["verdict"] else row["outcome"]
    return str(name).replace("_", " ")


def duration(seconds: float) -> str:
    """A time for people: ``3:07`` minutes, ``2:03:07`` hours."""
    whole = round(seconds)
    hours, minutes = divmod(whole // 60, 60)
    tail = f"{minutes:02d}:{whole % 60:02d}" if hours else f"{minutes}:{whole % 60:02d}"
    return f"{hours}:{tail}" if hours else tail
