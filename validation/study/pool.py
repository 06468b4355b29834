"""Worker processes of a study, on this machine or on any dask scheduler.

dask starts workers again that die, and gives their runs to others. Two things it does not do are done here:
a run that hangs ends its process by a timer of C, and the client learns when a run has begun.
"""

import faulthandler
import json
import logging
import math
import os
import queue
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any
from uuid import uuid4

import cloudpickle

from ampm.exceptions import InputError, RefusedGait, StudyStopped
from ampm.files import read_text
from validation.judge.metrics import added_metrics, set_metrics
from validation.judge.profiles import Profile
from validation.progress import interruption
from validation.run.walk import compile_once
from validation.store.environment import code_hash, users_file
from validation.store.folders import disk_is_full
from validation.store.machine import cores, hidden_main
from validation.study.row_file import Row
from validation.trial.users import SENT, UsersError, users_classes

_STARTED = "ampm-run-started"  # topic of dask's events by which a worker says that it begins a run
GRACE = 3.0
"""Time after the limit at which a worker ends itself, so that the client knows first [s]."""
_NO_WORKER = 120.0  # time without any worker after which a study on this machine stops [s]
_WAIT, _CONNECT = 0.5, 30.0  # for a result, for a scheduler [s]
_NANNY = "distributed.nanny.pre-spawn-environ"
_SETTINGS: Mapping[str, Any] = {
    # A run whose worker dies six times is the cause. With 3, innocent runs were blamed under many kills.
    "distributed.scheduler.allowed-failures": 5,
    # A run that hangs in C sends no heartbeat. Its own timer ends it.
    "distributed.scheduler.worker-ttl": None,
    # A cluster gives up a worker that is dead 15 s after an earlier death of its. Nannies start it again.
    "distributed.deploy.lost-worker-timeout": "1000 days",
    # Memory that is given back after every array doubles the time of a measurement.
    f"{_NANNY}.MALLOC_MMAP_THRESHOLD_": str(2**25),
    f"{_NANNY}.MALLOC_TRIM_THRESHOLD_": str(2**27),
    f"{_NANNY}.MUJOCO_GL": "disable",
}
"""What differs from dask's defaults, and why. By default a worker has one thread of linear algebra."""
_one_at_a_time = threading.Lock()  # a worker with several threads still walks one run after the other

Work = Callable[..., Row]
Options = Mapping[str, Any]


def call(data: bytes, limit: float | None, client_code: str) -> Row:
    """Walk one run on a worker: cloudpickle's bytes of work and options, and a limit of time [s].

    With them come the user's metrics and classes, which are added to those of this process. Raises
    :class:`StudyStopped` if the run cannot be walked here: other code, missing modules, a full disk.
    """
    if client_code != code_hash():
        raise StudyStopped("a worker has other code or versions of ampm", "use the same during a whole study")
    from distributed import get_worker  # slow to load

    with _one_at_a_time, open(os.devnull, "w", encoding="utf-8") as nowhere:
        try:  # imports do not count as time of the run
            work, options, metrics, classes = cloudpickle.loads(data)
            set_metrics(metrics)
            for name in {name for metric in metrics for name in metric.tolerances}:
                Profile(name)  # the user's too, which only the client has made
            SENT.update(classes)
        except Exception as error:
            raise StudyStopped(
                f"a worker cannot load a class or module of yours ({type(error).__name__}: {error})",
                "install what it needs on every worker",
            ) from error
        worker = get_worker()
        worker.log_event(_STARTED, (worker.get_current_task(), worker.address))
        if limit is not None:
            faulthandler.dump_traceback_later(limit + GRACE, exit=True, file=nowhere)
        try:
            return {"worker": str(worker.name), **attempt(work, options)}
        finally:
            faulthandler.cancel_dump_traceback_later()


def attempt(work: Work, options: Options) -> Row:
    """Columns of a run that is walked in this process, whatever ends it."""
    start = time.perf_counter()
    try:
        columns = work(**options)
    except StudyStopped:
        raise
    except (Exception, SystemExit) as error:
        if disk_is_full(error):
            raise StudyStopped(f"the disk is full ({error})", "free some space") from error
        columns = error_columns(error)
    return {**columns, "timing_total": time.perf_counter() - start}


def error_columns(error: BaseException) -> Row:
    """Columns of a run that an error ended: refused by a refusal, crashed by anything else."""
    text = error.fault if isinstance(error, UsersError) else str(error)  # the row has the traceback
    cause = _printable(" ".join(text.split()))[:400] or type(error).__name__
    behind = error.__cause__ or error.__context__
    refused = isinstance(error, RefusedGait | InputError) and not isinstance(error, UsersError)
    if refused and not isinstance(behind, OSError | MemoryError):
        return {"outcome": "refused", "reason": getattr(error, "reason", "bad_parameter"), "cause": cause}
    trace = _printable("".join(traceback.format_exception(error))[-4000:])
    return {"outcome": "crashed", "reason": type(error).__name__, "cause": cause, "traceback": trace}


def _printable(text: str) -> str:
    """A text that UTF-8 can hold; names of files may have other bytes."""
    return text.encode("utf-8", "backslashreplace").decode()


def pickled(value: Any, *, by_value: bool = True) -> bytes:
    """Bytes of a value, with users' modules by value, or by name as far as they have one."""
    loaded = list(sys.modules.items()) if by_value else []
    modules = [module for name, module in loaded if name != "__main__" and users_file(module)]
    for module in modules:
        cloudpickle.register_pickle_by_value(module)
    try:
        return bytes(cloudpickle.dumps(value))
    finally:
        for module in modules:
            cloudpickle.unregister_pickle_by_value(module)


class Workers:
    """Workers of a dask client, one run each at a time.

    A run has a limit of wall-clock time [s]. Remote workers cannot import users' modules, but may come late.
    """

    def __init__(self, client: Any, limit: float | None, *, remote: bool) -> None:
        self._client, self._limit, self._remote = client, limit, remote
        self._patience = math.inf if remote else _NO_WORKER  # without any worker [s]
        self._flying: dict[str, Any] = {}  # futures by name
        self._started: dict[str, tuple[str, float]] = {}  # worker and time at which the last attempt began
        self._workers = 0  # when last asked
        self._done: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._alive = time.monotonic()
        client.subscribe_topic(_STARTED, self._note)

    def _note(self, event: tuple[float, tuple[str, str]]) -> None:
        name, address = event[1]
        self._started[name] = address, time.monotonic()

    def size(self) -> int:
        """Workers at present; StudyStopped if the scheduler is gone, or no worker came up for a long time."""
        if self._client.status in ("closed", "closing", "failed"):
            raise StudyStopped("the dask scheduler is gone", "start it again")
        with suppress(OSError, TimeoutError):
            self._workers = len(self._client.nthreads())
        now = time.monotonic()
        if self._workers:
            self._alive = now
        elif now - self._alive > self._patience:
            raise StudyStopped("no worker process comes up on this machine", "see what ends them (memory?)")
        return self._workers

    def send(self, work: Work, options: Options) -> str:
        """Submit a run, with added metrics and the classes that its options name; returns its name.

        Raises :class:`InputError` if one of them cannot be sent.
        """
        classes = users_classes(options)  # imports their modules
        try:
            data = pickled((work, dict(options), added_metrics(), classes), by_value=self._remote)
        except Exception as error:
            what = ", ".join(classes) or "an option"
            raise InputError(
                f"{what} cannot be sent to a worker ({type(error).__name__}: {error}); keep what cannot be "
                "pickled out of modules and options, such as by making it in __init__, or give --workers 0."
            ) from error
        name = f"ampm-{uuid4().hex}"
        future = self._client.submit(call, data, self._limit, code_hash(), key=name)
        self._flying[name] = future
        future.add_done_callback(self._done.put)
        return name

    def wait(self) -> Iterator[tuple[str, Row]]:
        """Names and columns of runs that have ended, or have exceeded the limit."""
        with suppress(queue.Empty):
            future = self._done.get(timeout=_WAIT)
            if self._flying.pop(future.key, None) is not None:
                yield future.key, self._result(future)
        now = time.monotonic()
        for name in list(self._flying):
            address, began = self._started.get(name, ("", math.inf))
            if self._limit is not None and now - began > self._limit and self._walks(address, name):
                self._flying.pop(name).cancel()  # its worker ends itself
                cause = f"the run had not ended after {self._limit:g} s"
                yield name, {"outcome": "timed_out", "reason": "wall_clock", "cause": cause}

    def _walks(self, address: str, name: str) -> bool:
        """Whether a worker is still at a run. A worker that died since is known to the scheduler only."""
        with suppress(OSError, TimeoutError):
            return name in self._client.processing().get(address, ())
        return False

    def _result(self, future: Any) -> Row:
        from distributed.scheduler import KilledWorker  # slow to load

        try:
            return future.result()
        except KilledWorker:
            cause = "the worker's process died in every attempt"
            return {"outcome": "crashed", "reason": "worker_died", "cause": cause}
        except StudyStopped:
            raise
        except CancelledError as error:
            raise StudyStopped("the dask scheduler is gone", "start it again") from error
        except Exception as error:
            raise StudyStopped(
                f"a worker could not take a run ({type(error).__name__}: {error})",
                "install this version of ampm on every worker",
            ) from error


class ThisProcess:
    """In place of :class:`Workers`, this very process: it walks a run when it is waited for."""

    def size(self) -> int:
        """One run at a time."""
        return 1

    def send(self, work: Work, options: Options) -> str:
        """Keep a run until :meth:`wait`; returns its name."""
        self._run = work, options
        return "this process"

    def wait(self) -> Iterator[tuple[str, Row]]:
        """Name and columns of the run."""
        yield "this process", {"worker": "", **attempt(*self._run)}


@contextmanager
def open_pool(
    workers: int | None, scheduler: str | None, limit: float | None
) -> Iterator[Workers | ThisProcess]:
    """Processes of this machine, None for one a core and 0 for this one, or workers of a dask scheduler.

    Raises :class:`InputError` if nothing answers at that address.
    """
    if workers == 0:
        yield ThisProcess()
        return
    import dask  # slow to load
    import distributed  # noqa: F401  # sets its defaults once: within `config.set` they would be lost at the end

    for name in ("distributed", "tornado", "asyncio", *logging.root.manager.loggerDict):
        if name.partition(".")[0] in ("distributed", "tornado", "asyncio"):
            logging.getLogger(name).setLevel(logging.CRITICAL)
    with (
        dask.config.set(_SETTINGS),
        _local(workers or cores()) if scheduler is None else connect(scheduler) as client,
    ):
        yield Workers(client, limit, remote=scheduler is not None)


@contextmanager
def _local(workers: int) -> Iterator[Any]:
    """Client of processes of this machine, which end with it."""
    from distributed import Client, LocalCluster  # slow to load

    if workers > 1:
        compile_once()
    with hidden_main():  # to the end: a worker that dies is started again
        # Ctrl-C reaches every process of a terminal. Threads and processes that are started here inherit the
        # blocked signal, so that only the client ends. The tracker's start would unblock it.
        resource_tracker.ensure_running()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        held, interruption.holding = interruption.holding, True  # a cluster that is half started cannot end
        try:
            cluster = LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                memory_limit=0,  # a worker that spills or pauses would halt the study
                dashboard_address="127.0.0.1:0",  # None would mean port 8787 of all interfaces
                silence_logs=logging.CRITICAL,
            )
            client = Client(cluster, set_as_default=False)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
            interruption.holding = held
        try:
            interruption.check()
            yield client
        finally:
            for nanny in list(cluster.workers.values()):  # closing would wait for runs that are not finished
                with suppress(Exception):
                    nanny.close_gracefully()
                    os.kill(nanny.pid, signal.SIGKILL)
            for opened in (client, cluster):
                with suppress(Exception):
                    opened.close(timeout=10.0)


def connect(address: str) -> Any:
    """Client of a scheduler that is running already; InputError if nothing answers at that address."""
    from distributed import Client  # slow to load
    from distributed.comm import resolve_address

    try:
        at = json.loads(read_text(Path(address)))["address"] if address.endswith(".json") else address
        resolve_address(at)  # with an invalid address a client waits for a minute
        return Client(at, timeout=_CONNECT, set_as_default=False)
    except (OSError, ValueError, TypeError, LookupError, AttributeError, TimeoutError) as error:
        why = "it holds no address" if isinstance(error, LookupError | TypeError | AttributeError) else error
        raise InputError(
            f"no dask scheduler answers at --scheduler {address} ({why}); start one with 'dask scheduler', "
            "or leave the option out to run on this machine."
        ) from None
