"""Where the runs of a sweep are walked: processes of this machine, or any dask scheduler.

Distribution is dask's. What is set here is that nothing of it shows (logs, dashboard), that it costs next to
nothing (no profiler, no monitors), that every worker has one thread, also in BLAS, and that a worker that
dies takes no run along: the sweep itself decides what becomes of it.
"""

from __future__ import annotations

import logging
import os
import signal
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

import dask
from dask.system import CPU_COUNT
from distributed import Client, LocalCluster

from ampm.exceptions import InputError
from validation.sweep.exceptions import SweepStopped

ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "MUJOCO_GL": "disable",
}
"""Environment of a worker, set before its process starts and so before it loads numpy."""

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
    "distributed.scheduler.allowed-failures": 0,  # see validation.sweep.execute
    "distributed.nanny.pre-spawn-environ": ONE_THREAD,
}
_COUNT_EVERY = 2.0
_CLOSE_TIME = 10.0


@dataclass
class Crew:
    """The workers of a sweep.

    Attributes:
        client: of dask.
        local: number of processes of our own, None on a scheduler given by address.
        address: of the scheduler.
    """

    client: Client
    local: int | None
    address: str
    _size: int = 0
    _counted: float = -1e9

    @property
    def size(self) -> int:
        """Workers at present; 0 while there are none yet."""
        if self.local is not None:
            return self.local
        now = time.monotonic()
        if now - self._counted > _COUNT_EVERY:
            self._counted = now
            with suppress(OSError, TimeoutError):
                self._size = len(self.client.scheduler_info(n_workers=-1)["workers"])
        return self._size

    def restart(self, address: str) -> None:
        """End a worker's process and start it anew, without waiting for it."""
        if self.client.loop is not None:
            self.client.loop.add_callback(self._restart, address)

    async def _restart(self, address: str) -> None:
        with suppress(Exception):  # it may be gone by itself, or have nobody to restart it
            await self.client._restart_workers([address], timeout=60, raise_for_error=False)


def default_workers() -> int:
    """One process per core that this program may use."""
    return max(1, int(CPU_COUNT))


@contextmanager
def local_crew(workers: int) -> Iterator[Crew]:
    """Processes of this machine."""
    _silence()
    with tempfile.TemporaryDirectory(prefix="ampm-sweep-") as scratch, dask.config.set(_QUIET):
        # Ctrl-C reaches every process of a terminal, and workers are to finish what they do: threads and
        # processes that are started here inherit that it is blocked.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            cluster = LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                processes=True,
                dashboard_address=None,
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
            yield Crew(client, workers, cluster.scheduler_address)
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
def remote_crew(address: str, timeout: float = 30.0) -> Iterator[Crew]:
    """Workers of a scheduler that is running already.

    Raises:
        InputError: nothing answers at that address.
    """
    _silence()
    settings = {name: value for name, value in _QUIET.items() if name.startswith("distributed.admin")}
    with dask.config.set(settings):
        try:
            client = Client(address, timeout=timeout, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            reason = " ".join(str(error).split())
            raise InputError(
                f"no dask scheduler answers at --scheduler {address} ({reason}); start one with 'dask "
                "scheduler', or leave the option out to run on this machine."
            ) from None
        try:
            yield Crew(client, None, address)
        finally:
            with suppress(Exception):
                client.close(timeout=_CLOSE_TIME)


def lost(client: Client) -> SweepStopped | None:
    """The reason to stop if the scheduler is gone for good."""
    if client.status in ("closed", "closing", "failed"):
        return SweepStopped(
            "the dask scheduler is gone; every row until now is kept: start it again and go on with --resume."
        )
    return None


def _silence() -> None:
    for name in ("distributed", "tornado", "asyncio", "bokeh"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
