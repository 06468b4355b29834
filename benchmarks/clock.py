"""Timers, and the lines of a benchmark: statistics of what was timed."""

import timeit
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Self

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
    ) -> Self:
        """Sum up samples; ``loop`` is the closed loop's median, 0 if this is no part of it."""
        values = np.atleast_1d(np.asarray(samples, dtype=np.float64))
        if values.size == 0:
            return cls(name, unit, float("nan"), float("nan"), float("nan"), 0)
        median, p99 = np.percentile(values, [50.0, 99.0]).tolist()
        share = median / loop if loop > 0.0 else None
        return cls(name, unit, median, p99, float(values.max()), values.size, limit, share)

    def cells(self) -> tuple[str, ...]:
        """Name, median, 99th percentile, and the share of the loop or the limit."""
        tail = self._text(self.p99) if self.count > 1 else ""
        note = "" if self.of_loop is None else f"{self.of_loop:.0%}"
        if self.limit is not None:
            note = f"at most {self._text(self.limit)}"
        return self.name, self._text(self.median), tail, note

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
