"""Sends the runs of a sweep to workers, takes the rows back, and writes them as they come.

Few runs are out at a time, so that millions of cases never flood a scheduler. A run that is lost with its
worker is sent again; one that ends its worker's process :data:`DEATHS` times, or is still going when the
guard on the wall clock ends it, becomes a row that says so.
"""

from __future__ import annotations

import queue
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any, Protocol
from uuid import uuid4

from distributed import Future
from distributed.scheduler import KilledWorker

from validation.study.sweep.cluster import Crew
from validation.study.sweep.columns import tidy
from validation.study.sweep.exceptions import SweepStopped
from validation.study.sweep.faults import clean_row, clean_text
from validation.study.sweep.rows import (
    environment_columns,
    first_columns,
    one_line,
    timed_out_columns,
    worker_died_columns,
)
from validation.study.sweep.work import Answer, Task, walk_task

PER_WORKER = 2
"""Runs that are out per worker: one that is walked, and one that waits there, so that no worker waits."""
DEATHS = 5
"""Times that a run may end its worker's process before it is blamed; others may have killed it."""
ATTEMPTS = 25
"""Times that a run is sent out at most, whoever is to blame."""
FLUSH = 1.0
"""Time after which a finished row is on the disk at the latest [s]."""
_BATCH = 1000
_WAIT = 0.5
_FILL = 0.2
_EARLY = 0.5  # a guard that goes off is seen this much before its time at most [s]
_LATE = 30.0  # time after which a guard has failed [s]
_GATHER = 20.0


class Sink(Protocol):
    """Where rows go."""

    def append(self, rows: list[dict[str, Any]]) -> None:
        """Make rows durable, and return when they are."""


class Watcher(Protocol):
    """Who is told of what happens."""

    def row(self, row: Mapping[str, Any]) -> None:
        """A run has ended."""

    def trace(self, name: str, text: str) -> None:
        """A run has crashed, with this traceback."""

    def tick(self, workers: int) -> None:
        """Some time has passed."""


@dataclass
class _Flight:
    """A run that is out."""

    key: str
    task: Task
    future: Future
    began: float | None = None
    address: str = ""
    expired: int = 0


class Execution:
    """Walks what an iterator yields, until it ends or is stopped.

    Args:
        crew: the workers.
        todo: rows that need no worker, and tasks that do, in any order.
        sink: where rows go.
        watcher: who is told.
        work: what a worker does with a task.
    """

    def __init__(
        self,
        crew: Crew,
        todo: Iterator[dict[str, Any] | Task],
        sink: Sink,
        watcher: Watcher,
        work: Callable[[Task], Answer] = walk_task,
    ) -> None:
        self._crew, self._todo, self._sink, self._watcher = crew, todo, sink, watcher
        self._work = work
        self._topic = f"ampm-{uuid4().hex[:12]}"
        self._again: deque[Task] = deque()
        self._suspects: deque[Task] = deque()  # last of all, so that they hold up nothing else
        self._flying: dict[str, _Flight] = {}  # by key of the future
        self._deaths: dict[int, int] = {}
        self._events: queue.SimpleQueue[tuple[str, Any, float]] = queue.SimpleQueue()
        self._rows: list[dict[str, Any]] = []
        self._oldest = 0.0
        self._exhausted = False

    def run(self) -> None:
        """Walk everything; whatever happens, finished rows are written before this returns or raises.

        Raises:
            SweepStopped: a full disk, a lost scheduler, a worker that cannot work.
            KeyboardInterrupt: Ctrl-C.
        """
        self._crew.client.subscribe_topic(self._topic, self._on_event)
        try:
            while True:
                more = self._fill()
                if not (self._flying or self._again or self._suspects) and self._exhausted:
                    break
                wait = _WAIT if not self._rows else min(_WAIT, self._until_flush())
                self._take(0.0 if more else wait)
                self._look_at_clocks()
                if self._rows and (self._until_flush() <= 0.0 or len(self._rows) >= _BATCH):
                    self._flush()
                self._crew.tend()
                self._watcher.tick(self._crew.size())
        except SweepStopped:
            self._salvage()
            raise
        except KeyboardInterrupt:
            self._salvage()
            raise
        self._flush()

    # ------------------------------------------------------------------ out

    def _fill(self) -> bool:
        """Send out what there is room for; rows without a walk are taken for a moment only.

        Returns:
            Whether there is more to do at once.
        """
        if self._crew.client.status != "running":  # the connection is lost, and sought again
            return False
        end = time.monotonic() + _FILL
        room = PER_WORKER * max(1, self._crew.size())
        while len(self._flying) < room:
            if self._again:
                self._send(self._again.popleft())
                continue
            item = None if self._exhausted else next(self._todo, None)
            if item is None:
                self._exhausted = True
                if not self._suspects:
                    return False
                item = self._suspects.popleft()
            if isinstance(item, Task):
                self._send(item)
            else:
                self._keep(item)
                if time.monotonic() > end or len(self._rows) >= _BATCH:
                    return True
        return False

    def _send(self, task: Task) -> None:
        task = replace(task, topic=self._topic)
        key = self._key(task.run, task.attempt)
        future = self._crew.client.submit(self._work, task, key=key, pure=False)
        self._flying[key] = _Flight(key, task, future)
        future.add_done_callback(self._on_done)

    def _key(self, run: int, attempt: int) -> str:
        return f"{self._topic}-{run}-{attempt}"

    # ------------------------------------------------------------------ back

    def _on_event(self, event: tuple[float, Mapping[str, Any]]) -> None:
        """A worker begins a run (on the client's own thread)."""
        self._events.put(("began", event[1], time.monotonic()))

    def _on_done(self, future: Future) -> None:
        """A run is over, one way or another (on a thread of the client)."""
        self._events.put(("done", future, time.monotonic()))

    def _take(self, wait: float) -> None:
        """Deal with what has happened, waiting for the first of it."""
        try:
            kind, value, when = self._events.get(timeout=max(wait, 0.0))
            while True:
                if kind == "began":
                    self._began(value, when)
                else:
                    self._done(value, when)
                kind, value, when = self._events.get_nowait()
        except queue.Empty:
            return

    def _began(self, event: Mapping[str, Any], when: float) -> None:
        self._crew.saw(event.get("threads"))
        flight = self._flying.get(self._key(event["run"], event["attempt"]))
        if flight is None:
            return
        first, address = flight.began, str(event["address"])
        for other in self._flying.values():
            if other.address == address and other is not flight:
                other.began = None  # its row is on the way: a worker walks one run after the other
        flight.began, flight.address = when, address
        if first is None:
            return
        # The scheduler has sent it out again by itself, as its worker is gone. When that was is not known,
        # only when the next one began: so a guard is believed the second time.
        limit = flight.task.wall_clock
        if limit is not None and when - first >= limit - _EARLY:
            flight.expired += 1
            if flight.expired > 1:
                self._conclude(flight, timed_out_columns(limit), restart=True)
        elif self._count_death(flight.task.run) >= DEATHS:
            self._conclude(flight, worker_died_columns(DEATHS), restart=True)

    def _done(self, future: Future, when: float) -> None:
        flight = self._flying.get(str(future.key))
        if flight is None:
            return
        if future.status == "finished":
            try:
                answer = future.result(timeout=_GATHER)
            except TimeoutError:  # lost with its worker after all, and being walked again
                future.add_done_callback(self._on_done)
                return
            except Exception as error:
                self._failed(flight, error, when)
                return
            del self._flying[flight.key]
            self._answer(answer)
        elif future.status == "error":
            self._failed(flight, future.exception(timeout=_GATHER), when)
        else:  # cancelled: the connection to the scheduler was lost
            self._send_again(flight)

    def _answer(self, answer: Answer) -> None:
        if answer.trace is not None:
            self._watcher.trace(answer.row["name"], clean_text(answer.trace))
        self._keep(answer.row)

    def _failed(self, flight: _Flight, error: BaseException | None, when: float) -> None:
        """A run that has no row: its worker is gone, or could not work at all."""
        if isinstance(error, SweepStopped):
            raise error
        if not isinstance(error, KilledWorker):
            what = f"{type(error).__name__}: {one_line(error)}" if error is not None else "no reason given"
            raise SweepStopped(
                f"a worker could not take a run ({what}); every row until now is kept: install this version "
                "of ampm on every worker, and go on with --resume."
            )
        limit = flight.task.wall_clock
        if flight.began is None:  # it only waited there
            if flight.task.attempt >= ATTEMPTS:
                self._conclude(flight, worker_died_columns(ATTEMPTS))
            else:
                self._send_again(flight)
        elif limit is not None and when - flight.began >= limit - _EARLY:
            self._conclude(flight, timed_out_columns(limit))
        elif self._count_death(flight.task.run) >= DEATHS:
            self._conclude(flight, worker_died_columns(DEATHS))
        else:
            self._send_again(flight, suspect=True)

    def _count_death(self, run: int) -> int:
        self._deaths[run] = self._deaths.get(run, 0) + 1
        return self._deaths[run]

    def _send_again(self, flight: _Flight, *, suspect: bool = False) -> None:
        del self._flying[flight.key]
        task = replace(flight.task, attempt=flight.task.attempt + 1)
        (self._suspects if suspect else self._again).append(task)

    def _look_at_clocks(self) -> None:
        """Conclude what hangs although its guard should have ended it."""
        now = time.monotonic()
        for flight in list(self._flying.values()):
            limit = flight.task.wall_clock
            if limit is not None and flight.began is not None and now - flight.began > limit + _LATE:
                self._conclude(flight, timed_out_columns(limit), restart=True)

    def _conclude(self, flight: _Flight, columns: Mapping[str, Any], *, restart: bool = False) -> None:
        """Give a run its row here, as its worker cannot."""
        task = flight.task
        del self._flying[flight.key]
        flight.future.cancel()
        if restart and flight.address:
            self._crew.restart(flight.address)
        row = first_columns(task.run, task.name, task.parameters, task.profile, task.instrument)
        time_ = datetime.now(UTC).isoformat(timespec="milliseconds")
        place = {**environment_columns(None, task.attempt, time_), "environment_memory_peak": None}
        self._keep(tidy({**row, **columns, **place}))

    # ------------------------------------------------------------------ rows

    def _keep(self, row: dict[str, Any]) -> None:
        if not self._rows:
            self._oldest = time.monotonic()
        row = clean_row(row)  # one text that no file can hold would end the sweep, on every resume again
        self._rows.append(row)
        self._watcher.row(row)

    def _until_flush(self) -> float:
        return self._oldest + FLUSH - time.monotonic()

    def _flush(self) -> None:
        if self._rows:
            self._sink.append(self._rows)
            self._rows = []

    def _salvage(self) -> None:
        """Write what is finished, whatever made us stop."""
        try:
            while True:
                kind, value, _ = self._events.get_nowait()
                if kind == "done" and value.status == "finished":
                    answer = value.result(timeout=1.0)
                    if self._flying.pop(str(value.key), None) is not None:
                        self._answer(answer)
        except queue.Empty:
            pass
        except Exception:  # what cannot be had any more is walked again
            pass
        self._flush()
