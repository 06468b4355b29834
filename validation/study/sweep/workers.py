"""Worker processes of a sweep, on this machine or on any dask scheduler, and their tasks.

dask distributes the runs. It is configured without logs, dashboard and profiler, and with one thread per
worker, also in BLAS.
"""

from __future__ import annotations

import logging
import os
import queue
import signal
import tempfile
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple
from uuid import uuid4

import dask
from distributed import Client, Future, LocalCluster, Worker, WorkerPlugin
from distributed.comm import resolve_address
from distributed.scheduler import KilledWorker

from ampm.exceptions import InputError
from validation.judge.metrics import add_metrics, added_metrics
from validation.store.machine import THREAD_VARIABLES, cores, hidden_main, set_variables
from validation.study.sweep.exceptions import SweepStopped
from validation.study.sweep.schema import WORKER_DIED, one_line
from validation.study.sweep.task import Result, Task, walk_task

ONE_THREAD = {
    **dict.fromkeys(THREAD_VARIABLES, "1"),
    **dict.fromkeys(("MKL_NUM_THREADS", "BLIS_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"), "1"),
    "MUJOCO_GL": "disable",
}
"""Environment of a worker that is started here, independent of the shell's."""
DEATHS = 5
"""Number of times that a run may end its worker's process before it counts as the cause."""
RESTART_TIMEOUT = 20.0
"""Time for a nanny to start its worker again, before another nanny takes its place [s]."""
GIVE_UP = 120.0
"""Time without any worker after which a sweep on this machine stops [s]."""

_SETTINGS: dict[str, Any] = {
    "distributed.worker.profile.enabled": False,
    # dask's own threshold of 64 kB returns memory to the system after every array, which doubles the time of
    # a measurement. These keep what a run needs, and the peak does not grow from run to run.
    "distributed.nanny.pre-spawn-environ": {
        "MALLOC_MMAP_THRESHOLD_": str(2**25),
        "MALLOC_TRIM_THRESHOLD_": str(2**27),
    },
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "10s",
    "distributed.scheduler.worker-ttl": None,  # a run that hangs in C sends no heartbeat; the guard ends it
    "distributed.scheduler.allowed-failures": 0,  # the first death of a worker is reported
}
_COUNT_EVERY = 2.0
_CLOSE_TIME = 10.0
_WAIT = 0.5
_LATE = 60.0  # time after which a guard has failed [s]
_GATHER = 20.0


# ------------------------------------------------------------------------------ execution


class _Flight(NamedTuple):
    """A run that was sent to a worker.

    Attributes:
        task: the run.
        future: dask's, of its result.
        began: when it was sent out [s].
        attempt: number of times that it was sent, from 1.
    """

    task: Task
    future: Future
    began: float
    attempt: int

    def ended(self, outcome: str, reason: str, cause: str) -> Result:
        """Row of a run without a result of its worker, and no traceback."""
        row = self.task.row({"outcome": outcome, "reason": reason, "cause": cause})
        return {**row, "environment_attempts": self.attempt}, ""

    def timed_out(self, late: float = 0.0) -> Result | None:
        """The same if the run has exceeded its time limit by ``late`` [s]; None if not."""
        limit = self.task.wall_clock
        if limit is None or time.monotonic() - self.began < limit + late:
            return None
        return self.ended("timed_out", "wall_clock", f"the run had not ended after wall_clock = {limit:g} s")

    def result(self) -> Result | None:
        """Row and traceback of a run that has ended; None if it was lost with its worker.

        Raises:
            TimeoutError: the result was lost with its worker; dask walks the run again.
            SweepStopped: a full disk, or a worker that cannot work.
        """
        try:
            row, trace = self.future.result(timeout=_GATHER)
        except (TimeoutError, SweepStopped):
            raise
        except (KilledWorker, CancelledError):  # the latter where the connection to the scheduler was lost
            if (late := self.timed_out()) or self.attempt < DEATHS:
                return late
            cause = f"the worker's process died in this run, {DEATHS} times out of {DEATHS}"
            return self.ended("crashed", WORKER_DIED, cause)
        except Exception as error:
            raise SweepStopped(
                f"a worker could not take a run ({type(error).__name__}: {one_line(error)})",
                "install this version of ampm on every worker",
            ) from error
        return {**row, "environment_attempts": self.attempt}, trace


def execute(
    pool: WorkerPool,
    runs: Iterable[int],
    task: Callable[[int], Task],
    work: Callable[[Task], Result] = walk_task,
) -> Iterator[Result | None]:
    """Walk runs; yield row and traceback of each as it ends, and None at intervals in between.

    Every worker has one run at a time. This bounds the scheduler's load, and the run that ended a worker is
    known. A run that ends its worker's process :data:`DEATHS` times, or exceeds the wall-clock limit, gets a
    row with this reason.

    Args:
        pool: the workers.
        runs: their numbers.
        task: of a number.
        work: what a worker does with a task.

    Raises:
        SweepStopped: a full disk, a lost scheduler, a worker that cannot work.
    """
    waiting, attempts = deque(runs), Counter[int]()
    flying: dict[str, _Flight] = {}
    done: queue.SimpleQueue[Future] = queue.SimpleQueue()
    while waiting or flying:
        pool.check()
        while waiting and pool.client.status == "running" and len(flying) < pool.size():
            run = waiting.popleft()
            attempts[run] += 1
            item, key = task(run), f"ampm-{uuid4().hex}"
            future = pool.client.submit(work, item, key=key, pure=False)
            flying[key] = _Flight(item, future, time.monotonic(), attempts[run])
            future.add_done_callback(done.put)
        found = None
        with suppress(queue.Empty):
            future = done.get(timeout=_WAIT)
            if flight := flying.pop(str(future.key), None):  # not given up in the meantime
                try:
                    found = flight.result()
                    if found is None:
                        waiting.append(flight.task.run)  # last, after all other runs
                except TimeoutError:
                    flying[str(future.key)] = flight
                    future.add_done_callback(done.put)
        yield found
        for key, flight in list(flying.items()):
            if late := flight.timed_out(_LATE):  # its guard should have ended it
                del flying[key]
                flight.future.cancel()
                yield late


# ------------------------------------------------------------------------------ workers


class WorkerPool:
    """The workers of a sweep.

    Args:
        client: of dask.
        cluster: of this machine, without workers yet; None for a scheduler that is running already.
        wanted: processes of this machine.
    """

    def __init__(self, client: Client, cluster: LocalCluster | None = None, wanted: int = 0) -> None:
        self.client, self._cluster, self._wanted = client, cluster, wanted
        self._size, self._counted = 0, -_COUNT_EVERY
        self._complete = self._alive = time.monotonic()  # when all workers, and when any were there last
        if metrics := added_metrics():
            client.register_plugin(_Registered(metrics))
        if cluster is not None:
            cluster.scale(wanted)

    def size(self) -> int:
        """Workers at present; 0 while there are none yet."""
        now = time.monotonic()
        if self._cluster is not None:
            self._size = len(self._cluster.scheduler.workers) if self._cluster.scheduler else 0
        elif now - self._counted > _COUNT_EVERY:
            self._counted = now
            with suppress(OSError, TimeoutError):
                self._size = len(self.client.scheduler_info(n_workers=-1).get("workers", ()))
        return self._size

    def check(self) -> None:
        """Check that there are workers, and replace those that fail to start; called at intervals.

        A nanny starts a worker again that has died, but not one that dies while it starts; another nanny
        takes its place here.

        Raises:
            SweepStopped: the scheduler is gone, or no worker comes up.
        """
        if self.client.status in ("closed", "closing", "failed"):
            raise SweepStopped("the dask scheduler is gone", "start it again")
        if self._cluster is None:
            return
        now, size = time.monotonic(), self.size()
        if size:
            self._alive = now
        if size >= self._wanted:
            self._complete = now
        if now - self._alive > GIVE_UP:
            raise SweepStopped(
                "no worker process comes up on this machine", "find out what ends them (memory?)"
            )
        if now - self._complete > RESTART_TIMEOUT:
            self._complete = now
            self._cluster.scale(len(self._cluster.worker_spec) + self._wanted - size)


class _Registered(WorkerPlugin):
    """Registers on every worker the metrics that a user has registered here."""

    name = "ampm-metrics"

    def __init__(self, metrics: Any) -> None:
        self._metrics = metrics

    def setup(self, worker: Worker) -> None:
        add_metrics(self._metrics)


@contextmanager
def local_pool(workers: int) -> Iterator[WorkerPool]:
    """Processes of this machine."""
    if workers > 1:
        from validation.run.walk import compile_once  # loads simulator and controller

        compile_once()
    _silence()
    with (
        tempfile.TemporaryDirectory(prefix="ampm-sweep-") as scratch,
        dask.config.set(_SETTINGS),
        set_variables(ONE_THREAD),  # to the end: a worker that dies is started again
        hidden_main(),
    ):
        # Ctrl-C reaches every process of a terminal, but workers must finish their runs: threads and
        # processes that are started here inherit the blocked signal.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            cluster = LocalCluster(
                n_workers=0,
                threads_per_worker=1,
                processes=True,
                dashboard_address=None,
                scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},  # of its health page: any free port
                silence_logs=logging.CRITICAL,
                memory_limit=0,
                local_directory=scratch,
                protocol="tcp://",
            )
            client = Client(cluster, set_as_default=False)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        try:
            yield WorkerPool(client, cluster, workers)
        finally:
            # Closing would wait for unfinished runs, which are walked again.
            for nanny in list(cluster.workers.values()):
                with suppress(Exception):
                    nanny.close_gracefully()  # it does not start the worker again
                    if nanny.pid:
                        os.kill(nanny.pid, signal.SIGKILL)
            _close(client)
            _close(cluster)


@contextmanager
def remote_pool(address: str, report: Callable[[str], None], timeout: float = 30.0) -> Iterator[WorkerPool]:
    """Workers of a scheduler that is running already.

    Args:
        address: of the scheduler, or its scheduler file.
        report: called with a warning if workers have several threads.
        timeout: for its answer [s].

    Raises:
        InputError: nothing answers at that address.
    """
    _silence()
    # A file of 'dask scheduler --scheduler-file' replaces an address.
    where = {"scheduler_file": address} if address.endswith(".json") else {"address": address}
    try:
        if "address" in where:
            resolve_address(address)  # a client of an address that is none waits for a minute
        else:  # it would wait for its file for ever
            latest = time.monotonic() + timeout
            while not Path(address).exists() and time.monotonic() < latest:
                time.sleep(0.1)
            if not Path(address).exists():
                raise OSError("there is no such file")
        client = Client(**where, timeout=timeout, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        reason = " ".join(str(error).split())
        raise InputError(
            f"no dask scheduler answers at --scheduler {address} ({reason}); start one with 'dask "
            "scheduler', or leave the option out to run on this machine."
        ) from None
    try:
        with suppress(Exception):  # a worker without ampm, which its first run will report
            if max(client.run(blas_threads).values(), default=1) > 1:
                report(
                    "ampm: a worker has several BLAS threads; walks are slower so, and may differ in "
                    "their last bits: start workers with OMP_NUM_THREADS=1 and OPENBLAS_NUM_THREADS=1."
                )
        yield WorkerPool(client)
    finally:
        _close(client)


def blas_threads() -> int:
    """Number of this process's BLAS threads, by the variables that BLAS read when it was loaded."""
    for name in THREAD_VARIABLES:
        value = os.environ.get(name, "").partition(",")[0]
        if value.isdecimal() and int(value):
            return int(value)
    return cores()


def _close(opened: Client | LocalCluster) -> None:
    with suppress(Exception):
        opened.close(timeout=_CLOSE_TIME)


def _silence() -> None:
    """Silence dask's logs; the user gets warnings of one sentence."""
    names = [name for name in logging.root.manager.loggerDict if name.startswith("distributed")]
    for name in (*names, "distributed", "tornado", "asyncio"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
