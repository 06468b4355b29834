"""Worker processes of a sweep, on this machine or on any dask scheduler.

Distribution is dask's. What is set here is that nothing of it shows (logs, dashboard), that it costs next to
nothing (no profiler, no monitors), and that every worker has one thread, also in BLAS.
"""

from __future__ import annotations

import logging
import os
import signal
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any

import dask
from distributed import Client, LocalCluster, Worker, WorkerPlugin

from ampm.exceptions import InputError
from validation.judge.metrics import dump_added, load_added
from validation.store.machine import THREAD_VARIABLES, hidden_main
from validation.study.sweep.exceptions import SweepStopped
from validation.study.sweep.task import blas_threads

ONE_THREAD = {
    **dict.fromkeys(THREAD_VARIABLES, "1"),
    **dict.fromkeys(("MKL_NUM_THREADS", "BLIS_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"), "1"),
    "MUJOCO_GL": "disable",
}
"""Environment of a worker that is started here, whatever the shell says."""

_SETTINGS: dict[str, Any] = {
    "distributed.worker.profile.enabled": False,
    "distributed.worker.daemon": True,
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
    "distributed.worker.memory.terminate": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.tick.limit": "1h",
    "distributed.admin.system-monitor.interval": "10s",
    "distributed.admin.system-monitor.disk": False,
    "distributed.admin.system-monitor.gil.enabled": False,
    "distributed.scheduler.worker-ttl": None,  # a run stuck in C sends no heartbeat; the guard ends it
    "distributed.scheduler.allowed-failures": 0,  # the first death of a worker is reported
    "distributed.nanny.pre-spawn-environ": ONE_THREAD,
}
_COUNT_EVERY = 2.0
RESTART_TIMEOUT = 20.0  # time for a nanny to start its worker again [s]
MAX_FAILED_RESTARTS = 4  # times that all workers may be replaced without one of them coming up
_CLOSE_TIME = 10.0


class _Registered(WorkerPlugin):
    """Registers on every worker the metrics that a user has registered here."""

    name = "ampm-metrics"

    def __init__(self, metrics: bytes) -> None:
        self._metrics = metrics

    def setup(self, worker: Worker) -> None:
        load_added(self._metrics)


class WorkerPool:
    """The workers of a sweep.

    Args:
        client: of dask.
        cluster: of this machine, without workers yet; None for a scheduler that is running already.
        wanted: processes of this machine.
    """

    def __init__(self, client: Client, cluster: LocalCluster | None = None, wanted: int = 0) -> None:
        self.client, self._cluster, self._wanted = client, cluster, wanted
        self._size, self._counted, self._failed_restarts = 0, -_COUNT_EVERY, 0
        self._short = time.monotonic()
        if metrics := dump_added():
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
        """See that there are workers; called now and then.

        A nanny starts a worker again that has died, but not one that dies while it starts; another takes its
        place here.

        Raises:
            SweepStopped: the scheduler is gone, or no worker comes up.
        """
        if self.client.status in ("closed", "closing", "failed"):
            raise SweepStopped("the dask scheduler is gone", "start it again")
        if self._cluster is None:
            return
        now, missing = time.monotonic(), self._wanted - self.size()
        if missing <= 0:
            self._short, self._failed_restarts = now, 0
        elif now - self._short > RESTART_TIMEOUT:
            self._failed_restarts = 0 if missing < self._wanted else self._failed_restarts + 1
            if self._failed_restarts > MAX_FAILED_RESTARTS:
                raise SweepStopped(
                    "no worker process comes up on this machine", "find out what ends them (memory?)"
                )
            self._short = now
            self._cluster.scale(len(self._cluster.worker_spec) + missing)


@contextmanager
def local_pool(workers: int) -> Iterator[WorkerPool]:
    """Processes of this machine."""
    _silence()
    with (
        tempfile.TemporaryDirectory(prefix="ampm-sweep-") as scratch,
        dask.config.set(_SETTINGS),
        environment(ONE_THREAD),  # to the end: a worker that dies is started again
        hidden_main(),
    ):
        # Ctrl-C reaches every process of a terminal, and workers are to finish what they do: threads and
        # processes that are started here inherit that it is blocked.
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
                env=dict(ONE_THREAD),
                protocol="tcp://",
            )
            client = Client(cluster, set_as_default=False)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        try:
            yield WorkerPool(client, cluster, workers)
        finally:
            # A run that is still going is walked again, and closing would wait for it.
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
    settings = {name: value for name, value in _SETTINGS.items() if name.startswith("distributed.admin")}
    with dask.config.set(settings):
        # What 'dask scheduler --scheduler-file' has written is as good as an address.
        where = {"scheduler_file": address} if address.endswith(".json") else {"address": address}
        try:
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


@contextmanager
def environment(variables: Mapping[str, str]) -> Iterator[None]:
    """Variables of this process while the body of the ``with`` runs, as they were afterwards.

    Processes inherit them before they load any library. A nanny's own setting yields to a variable that the
    shell has set, or comes when numpy is loaded already.
    """
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _close(opened: Client | LocalCluster) -> None:
    with suppress(Exception):
        opened.close(timeout=_CLOSE_TIME)


def _silence() -> None:
    """No log of dask's: warnings to the user are one sentence."""
    names = [name for name in logging.root.manager.loggerDict if name.startswith("distributed")]
    for name in (*names, "distributed", "tornado", "asyncio"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
