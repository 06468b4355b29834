"""Timers, and the lines of a benchmark: statistics of what was timed."""

from __future__ import annotations

import time
import timeit
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from validation.show.text import format_duration

Samples = Sequence[float] | np.ndarray


@dataclass(frozen=True)
class Line:
    """Median and tail of repeated measurements of one thing; NaN where nothing was measured.

    There is no mean: one interruption by another process changes it, but not the median.

    Attributes:
        name: of the thing.
        unit: of the numbers: s, 1, MB or MB/s.
        median, p99, maximum: of the samples, with the 99th percentile; [unit].
        count: number of samples.
        limit: what the median should not exceed, None if there is none [unit].
        of_loop: the median as a share of that of the closed loop, None if it is no part of it [1].
    """

    name: str
    unit: str
    median: float
    p99: float
    maximum: float
    count: int
    limit: float | None = None
    of_loop: float | None = None

    @classmethod
    def of(
        cls,
        name: str,
        samples: Samples | float,
        unit: str = "s",
        limit: float | None = None,
        loop: float = 0.0,
    ) -> Line:
        """Sum up samples; ``loop`` is the closed loop's median, 0 if this is no part of it."""
        values = np.atleast_1d(np.asarray(samples, dtype=np.float64))
        if values.size == 0:
            return cls(name, unit, float("nan"), float("nan"), float("nan"), 0)
        median, p99 = np.percentile(values, [50.0, 99.0]).tolist()
        share = median / loop if loop > 0.0 else None
        return cls(name, unit, median, p99, float(values.max()), values.size, limit, share)

    def cells(self) -> tuple[str, ...]:
        """Name, median, 99th percentile, maximum, and the share of the loop or the limit."""
        tail = (self._text(self.p99), self._text(self.maximum)) if self.count > 1 else ("", "")
        note = "" if self.of_loop is None else f"{self.of_loop:.0%}"
        if self.limit is not None:
            note = f"at most {self._text(self.limit)}"
        return self.name, self._text(self.median), *tail, note

    def _text(self, value: float) -> str:
        if self.unit == "s":
            return format_duration(value)
        return f"{value:.3g}" + ("" if self.unit == "1" else f" {self.unit}")


def repeat(work: Callable[[], object], times: int) -> list[float]:
    """Times of ``work``, repeated that often after one call that is not counted [s]."""
    return timeit.repeat(work, setup=work, number=1, repeat=times)


def least(rounds: Sequence[Samples]) -> np.ndarray:
    """The least time of every single piece of work over several rounds of the very same work [s].

    Another process rarely interrupts the same piece in all rounds, so the least times are those of the work
    itself.
    """
    return np.min(np.stack([np.asarray(spans, dtype=np.float64) for spans in rounds]), axis=0)


class Stopwatch:
    """Splits the time of a repeated call into parts, by timing methods of the objects that take part in it.

    A part's time is exclusive: what a timed method spends in another timed method counts for the other. The
    methods are wrapped on the objects themselves, get the same arguments and give the same results.
    """

    def __init__(self) -> None:
        self.rounds: dict[str, list[float]] = {}
        self._current: dict[str, float] = {}
        self._inner: list[float] = []

    def time(self, part: str, owner: object, *methods: str) -> None:
        """Count methods of an object as one part.

        Args:
            part: name of the part; several calls may add to the same.
            owner: the object.
            methods: names of its methods.

        Raises:
            AttributeError: it has no such method: the benchmark has to follow the code.
        """
        self.rounds.setdefault(part, [])
        self._current.setdefault(part, 0.0)
        for name in methods:
            setattr(owner, name, self._timed(part, getattr(owner, name)))

    def _timed(self, part: str, method: Callable[..., Any]) -> Callable[..., Any]:
        current, inner, clock = self._current, self._inner, time.perf_counter

        def timed(*arguments: Any, **named: Any) -> Any:
            inner.append(0.0)
            start = clock()
            try:
                return method(*arguments, **named)
            finally:
                span = clock() - start
                current[part] += span - inner.pop()
                if inner:
                    inner[-1] += span

        return timed

    def end_round(self) -> None:
        """Keep what the parts took since the last round."""
        for part, spans in self.rounds.items():
            spans.append(self._current[part])
            self._current[part] = 0.0
