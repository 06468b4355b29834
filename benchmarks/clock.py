"""Clocks and statistics: what was timed, and how it is summed up."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Statistics:
    """Median and tail of repeated measurements of one thing; NaN where nothing was measured.

    The mean is left out on purpose: one interruption by another process moves it, and the median not.

    Attributes:
        median: [unit of the samples].
        p99: 99th percentile.
        maximum: largest sample.
        count: number of samples.
    """

    median: float
    p99: float
    maximum: float
    count: int

    @classmethod
    def of(cls, samples: Sequence[float] | np.ndarray) -> Statistics:
        """Sum up samples."""
        values = np.asarray(samples, dtype=np.float64)
        if values.size == 0:
            return cls(float("nan"), float("nan"), float("nan"), 0)
        median, p99 = np.percentile(values, [50.0, 99.0])
        return cls(float(median), float(p99), float(values.max()), values.size)

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return asdict(self)


def repeat(work: Callable[[], object], times: int) -> Statistics:
    """Time ``work`` that often, after one call that is not counted [s]."""
    work()
    spans = np.empty(times)
    for k in range(times):
        start = time.perf_counter()
        work()
        spans[k] = time.perf_counter() - start
    return Statistics.of(spans)


def least(rounds: Sequence[Sequence[float] | np.ndarray]) -> np.ndarray:
    """The least time of every single piece of work over several rounds of the very same work [s].

    A piece that another process interrupted in one round is hardly interrupted in all of them, so that what
    is left differs by what the piece itself has to do.
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
