"""Sends the runs of a sweep to workers, and takes the rows back as they come.

Every worker has one run at a time, so that millions of runs never flood a scheduler, and the run that is to
blame for a dead worker is known. A run that ends its worker's process :data:`DEATHS` times, or is still going
when the guard on the wall clock ends it, becomes a row that says so.
"""

from __future__ import annotations

import queue
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any
from uuid import uuid4

from distributed import Future
from distributed.scheduler import KilledWorker

from validation.study.sweep.exceptions import SweepStopped
from validation.study.sweep.schema import WORKER_DIED, one_line
from validation.study.sweep.task import Listener, Task, TaskResult, walk_task
from validation.study.sweep.workers import WorkerPool

DEATHS = 5
"""Times that a run may end its worker's process before it is blamed; others may have killed it."""
FLUSH = 1.0
"""Time after which a finished row is on the disk at the latest [s]."""
_WAIT = 0.5
_LATE = 60.0  # time after which a guard has failed [s]
_GATHER = 20.0


@dataclass
class _Flight:
    """A run that is out."""

    task: Task
    future: Future
    began: float


class Execution:
    """Walks what an iterator yields, until it ends or is stopped.

    Args:
        pool: the workers.
        tasks: the runs.
        listener: receives rows.
        work: what a worker does with a task.
    """

    def __init__(
        self,
        pool: WorkerPool,
        tasks: Iterator[Task],
        listener: Listener,
        work: Callable[[Task], TaskResult] = walk_task,
    ) -> None:
        self._pool, self._tasks, self._listener, self._work = pool, tasks, listener, work
        self._again: deque[Task] = deque()
        self._flying: dict[str, _Flight] = {}  # by key of the future
        self._done: queue.SimpleQueue[Future] = queue.SimpleQueue()
        self._rows: list[dict[str, Any]] = []
        self._oldest = 0.0
        self._exhausted = False
        self._name = uuid4().hex[:12]

    def run(self) -> None:
        """Walk everything; whatever happens, finished rows are written before this returns or raises.

        Raises:
            SweepStopped: a full disk, a lost scheduler, a worker that cannot work.
            KeyboardInterrupt: Ctrl-C.
        """
        try:
            while not (self._exhausted and not self._flying and not self._again):
                self._fill()
                self._take(_WAIT)
                self._check_clocks()
                if self._rows and time.monotonic() > self._oldest + FLUSH:
                    self._flush()
                self._pool.check()
                self._listener.tick(self._pool.size())
        except (SweepStopped, KeyboardInterrupt):
            with suppress(Exception):  # what cannot be had any more is walked again
                self._take(0.0)
            self._flush()
            raise
        self._flush()

    def _fill(self) -> None:
        """Send out a run for every free worker."""
        if self._pool.client.status != "running":  # the connection is lost, and sought again
            return
        while len(self._flying) < self._pool.size():
            # A run that was lost with its worker comes last, so that it holds up nothing else.
            item = None if self._exhausted else next(self._tasks, None)
            if item is None:
                self._exhausted = True
                if not self._again:
                    return
                item = self._again.popleft()
            key = f"ampm-{self._name}-{item.run}-{item.attempt}"
            future = self._pool.client.submit(self._work, item, key=key, pure=False)
            self._flying[key] = _Flight(item, future, time.monotonic())
            future.add_done_callback(self._done.put)

    def _take(self, wait: float) -> None:
        """Deal with what has ended, waiting for the first of it."""
        with suppress(queue.Empty):
            self._end(self._done.get(timeout=wait))
            while True:
                self._end(self._done.get_nowait())

    def _end(self, future: Future) -> None:
        flight = self._flying.get(str(future.key))
        if flight is None:
            return
        try:
            result: TaskResult = future.result(timeout=_GATHER)
        except TimeoutError:  # lost with its worker after all, and being walked again
            future.add_done_callback(self._done.put)
            return
        except SweepStopped:
            raise
        except (KilledWorker, CancelledError):  # the latter where the connection to the scheduler was lost
            self._lost(flight)
        except Exception as error:
            raise SweepStopped(
                f"a worker could not take a run ({type(error).__name__}: {one_line(error)})",
                "install this version of ampm on every worker",
            ) from error
        else:
            self._keep(result.row, result.trace)
        del self._flying[str(future.key)]

    def _lost(self, flight: _Flight) -> None:
        """A run that has no row, as its worker is gone."""
        task, limit = flight.task, flight.task.wall_clock
        if limit is not None and time.monotonic() - flight.began >= limit:
            self._keep(task.row(_timed_out(limit)))
        elif task.attempt >= DEATHS:
            cause = f"the worker's process died in this run, {DEATHS} times out of {DEATHS}"
            self._keep(task.row({"outcome": "crashed", "reason": WORKER_DIED, "cause": cause}))
        else:
            self._again.append(replace(task, attempt=task.attempt + 1))

    def _check_clocks(self) -> None:
        """Give up a run that hangs although its guard should have ended it."""
        now = time.monotonic()
        for key, flight in list(self._flying.items()):
            limit = flight.task.wall_clock
            if limit is not None and now - flight.began > limit + _LATE:
                del self._flying[key]
                flight.future.cancel()
                self._keep(flight.task.row(_timed_out(limit)))

    def _keep(self, row: dict[str, Any], trace: str | None = None) -> None:
        if not self._rows:
            self._oldest = time.monotonic()
        self._rows.append(row)
        self._listener.ended(row, trace)

    def _flush(self) -> None:
        if self._rows:
            self._listener.keep(self._rows)
            self._rows = []


def _timed_out(limit: float) -> dict[str, Any]:
    cause = f"the run had not ended after limits.wall_clock = {limit:g} s"
    return {"outcome": "timed_out", "reason": "wall_clock", "cause": cause}
