"""Where the runs of a sweep are walked: processes of this machine, or any dask scheduler.

Distribution is dask's. What is set here is that nothing of it shows (logs, dashboard), that it costs next to
nothing (no profiler, no monitors), that every worker has one thread, also in BLAS, and that a worker that
dies takes no run along: the sweep itself decides what becomes of it.
"""

from __future__ import annotations

import logging
import math
import os
import signal
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any

import dask
from dask.system import CPU_COUNT
from distributed import Client, LocalCluster

from ampm.exceptions import InputError
from validation.study.sweep.exceptions import SweepStopped

ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "BLIS_NUM_THREADS": "1",
    "VECLIB_MAXIMUM_THREADS": "1",
    "MUJOCO_GL": "disable",
}
"""Environment of a worker that is started here, whatever the shell says; see :func:`environment`."""

_QUIET: dict[str, Any] = {
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
    "distributed.scheduler.allowed-failures": 0,  # see validation.study.sweep.execute
    "distributed.nanny.pre-spawn-environ": ONE_THREAD,
}
_COUNT_EVERY = 2.0
_PATIENCE = 20.0  # time in which a nanny brings its worker up again [s]
_VAIN = 4  # times that all workers may be replaced without one of them coming up
_CLOSE_TIME = 10.0


def _silent(text: str) -> None:
    """Nobody listens."""


class Crew:
    """The workers of a sweep, on whatever scheduler.

    Args:
        client: of dask.
        say: tells a user what he should know.
    """

    def __init__(self, client: Client, say: Callable[[str], None] = _silent) -> None:
        self.client = client
        self._say, self._warned = say, False
        self._size, self._counted = 0, -math.inf

    def saw(self, threads: int | None) -> None:
        """A worker has said how many threads its BLAS takes; a warning, once, if they are several."""
        if threads is not None and threads > 1 and not self._warned:
            self._warned = True
            self._say(
                f"ampm: a worker has {threads} BLAS threads; walks are slower so, and may differ in their "
                "last bits: start workers with OMP_NUM_THREADS=1 and OPENBLAS_NUM_THREADS=1."
            )

    def size(self) -> int:
        """Workers at present; 0 while there are none yet."""
        now = time.monotonic()
        if now - self._counted > _COUNT_EVERY:
            self._counted = now
            with suppress(OSError, TimeoutError):
                self._size = self._count()
        return self._size

    def tend(self) -> None:
        """See that there are workers; called now and then.

        Raises:
            SweepStopped: the scheduler is gone, or no worker comes up.
        """
        if self.client.status in ("closed", "closing", "failed"):
            raise SweepStopped(
                "the dask scheduler is gone; every row until now is kept: start it again and go on with "
                "--resume."
            )

    def _count(self) -> int:
        return len(self.client.scheduler_info(n_workers=-1).get("workers", ()))

    def restart(self, address: str) -> None:
        """End a worker's process and start it anew, without waiting for it."""
        if self.client.loop is not None:
            self.client.loop.add_callback(self._restart, address)

    async def _restart(self, address: str) -> None:
        with suppress(Exception):  # it may be gone by itself, or have nobody to restart it
            await self.client._restart_workers([address], timeout=60, raise_for_error=False)


class LocalCrew(Crew):
    """Processes of this machine.

    A nanny starts a worker again that has died, but not one that dies while it starts; then another takes its
    place here.

    Args:
        client: of dask.
        cluster: without workers yet.
        wanted: processes.
        say: tells a user what he should know.
    """

    def __init__(
        self, client: Client, cluster: LocalCluster, wanted: int, say: Callable[[str], None] = _silent
    ) -> None:
        super().__init__(client, say)
        self._cluster, self._wanted = cluster, wanted
        self._short = time.monotonic()
        self._vain = 0
        cluster.scale(wanted)

    def tend(self) -> None:
        """See that there are workers, and replace those that are gone for good; see :meth:`Crew.tend`."""
        super().tend()
        now = time.monotonic()
        missing = self._wanted - self._count()
        if missing <= 0:
            self._short, self._vain = now, 0
        elif now - self._short > _PATIENCE:
            self._vain = 0 if missing < self._wanted else self._vain + 1
            if self._vain > _VAIN:
                raise SweepStopped(
                    "no worker process comes up on this machine; every row until now is kept: look for what "
                    "ends them (memory?), and go on with --resume."
                )
            self._short = now
            self._cluster.scale(len(self._cluster.worker_spec) + missing)

    def _count(self) -> int:
        scheduler = self._cluster.scheduler
        return 0 if scheduler is None else len(scheduler.workers)


def default_workers() -> int:
    """One process per core that this program may use."""
    return max(1, int(CPU_COUNT))


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


@contextmanager
def local_crew(workers: int, say: Callable[[str], None] = _silent) -> Iterator[Crew]:
    """Processes of this machine."""
    _silence()
    with (
        tempfile.TemporaryDirectory(prefix="ampm-sweep-") as scratch,
        dask.config.set(_QUIET),
        environment(ONE_THREAD),  # to the end: a worker that dies is started again
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
            yield LocalCrew(client, cluster, workers, say)
        finally:
            _end_workers(cluster)
            with suppress(Exception):
                client.close(timeout=_CLOSE_TIME)
            with suppress(Exception):
                cluster.close(timeout=_CLOSE_TIME)


def _end_workers(cluster: LocalCluster) -> None:
    """End the workers at once: a run that is still going is walked again, and closing would wait for it."""
    for nanny in list(cluster.workers.values()):
        with suppress(Exception):
            nanny.close_gracefully()  # it does not start the worker again
            if nanny.pid:
                os.kill(nanny.pid, signal.SIGKILL)


@contextmanager
def remote_crew(address: str, say: Callable[[str], None] = _silent, timeout: float = 30.0) -> Iterator[Crew]:
    """Workers of a scheduler that is running already.

    Raises:
        InputError: nothing answers at that address.
    """
    _silence()
    settings = {name: value for name, value in _QUIET.items() if name.startswith("distributed.admin")}
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
            yield Crew(client, say)
        finally:
            with suppress(Exception):
                client.close(timeout=_CLOSE_TIME)


def _silence() -> None:
    """No log of dask's: what a user should know is said in a sentence."""
    names = [name for name in logging.root.manager.loggerDict if name.startswith("distributed")]
    for name in (*names, "distributed", "tornado", "asyncio"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
