"""One run of a sweep, as a worker does it: parameters in, a row out, whatever happens in between.

Limits on a run are in simulated time (its steps, :mod:`validation.trial.watch`) and in iterations of
solvers, which
are parameters of the run: they give the same row everywhere. The wall clock only guards against a hang: a
thread of C that needs no Python ends the process, and the sweep's own process says ``timed_out``.
"""

from __future__ import annotations

import faulthandler
import hashlib
import os
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ampm.exceptions import InputError, RefusedGait
from ampm.parameters import RunParameters
from validation.judge.profiles import profile as find_profile
from validation.progress import Progress, Stage
from validation.study.sweep.columns import parameter_values, tidy
from validation.study.sweep.exceptions import SweepStopped
from validation.study.sweep.faults import clean_row, clean_text, machine_fault
from validation.study.sweep.identity import code, code_hash
from validation.study.sweep.rows import (
    crashed_columns,
    environment_columns,
    first_columns,
    motion_columns,
    refused_columns,
    walk_columns,
)

if TYPE_CHECKING:
    from validation.judge.examine import Walk

MOTIONS_KEPT = 1500
"""Solved motions that the user's cache may hold; a sweep over gaits would fill the disk with them."""
_TRIM_EVERY = 100

_one_at_a_time = threading.Lock()  # a worker with several threads still walks one run after the other
_done = 0


@dataclass(frozen=True)
class Task:
    """One run, complete.

    Attributes:
        run: number in the sweep.
        name: the same as text; of its folder.
        parameters: all of them.
        profile: tolerances.
        instrument: sensor model beside the simulator's truth, if any.
        recordings: ``none``, ``failures`` or ``all``: whether this run keeps its folder.
        folder: of the sweep; where it keeps it.
        wall_clock: after which the process is ended [s]; None for no guard.
        code: hash of the code that the sweep's own process has, which must be the worker's.
        topic: of the events in which a worker says that it begins.
        attempt: times that the run was sent out, from 1.
        tune: make the free choices first; the parameters know which keys were named.
    """

    run: int
    name: str
    parameters: RunParameters
    profile: str
    instrument: str | None = None
    recordings: str = "none"
    folder: str = ""
    wall_clock: float | None = None
    code: str = ""
    topic: str = ""
    attempt: int = 1
    tune: bool = False


@dataclass(frozen=True)
class Answer:
    """What a worker sends back.

    Attributes:
        row: of the table, complete.
        trace: traceback, if the run crashed.
    """

    row: dict[str, Any]
    trace: str | None = None


def walk_task(task: Task) -> Answer:
    """Walk one run on a worker.

    Raises:
        SweepStopped: the worker's code is another, or its disk is full.
    """
    with on_worker(task) as worker:
        answer = answer_of(task, _trial, worker)
    _trim_cache()
    return answer


@contextmanager
def on_worker(task: Task) -> Iterator[str | None]:
    """One run at a time, of the right code, announced and guarded; yields the worker's name.

    Raises:
        SweepStopped: the worker's code is another.
    """
    with _one_at_a_time:
        if task.code and task.code != code_hash():
            ours = ", ".join(f"{name} {value}" for name, value in code().items())
            raise SweepStopped(
                "a worker has other code or versions than this program, so its results would be others "
                f"(its own: {ours}); install the same on both, and go on with --resume."
            )
        worker = _announce(task)
        with _guard(task.wall_clock):
            yield worker


def answer_of(
    task: Task, trial: Callable[[Task, dict[str, float]], dict[str, Any]], worker: str | None
) -> Answer:
    """The row of a run, whatever becomes of it.

    Args:
        task: the run.
        trial: from a task to columns; adds wall-clock times to the table that it is given.
        worker: name of the worker, for the row.

    Raises:
        SweepStopped: the disk is full.
    """
    wall, cpu = time.perf_counter(), time.thread_time()
    row = first_columns(task.run, task.name, task.parameters, task.profile, task.instrument)
    timing: dict[str, float] = {}
    trace = None
    try:
        row |= trial(task, timing)
    except SweepStopped:
        raise
    except (Exception, SystemExit) as error:
        fault = machine_fault(error)
        if fault is None and isinstance(error, RefusedGait | InputError):
            # The plan of a gait that could not be tuned is none that would walk.
            row |= refused_columns(error, None if task.tune else task.parameters)
        else:
            row |= crashed_columns(error)
            row["reason"] = fault or row["reason"]
            trace = clean_text("".join(traceback.format_exception(error)))
    timing |= {"total": time.perf_counter() - wall, "cpu_total": time.thread_time() - cpu}
    row |= {f"timing_{name}": value for name, value in timing.items()}
    row |= environment_columns(worker, task.attempt, datetime.now(UTC).isoformat(timespec="milliseconds"))
    return Answer(clean_row(tidy(row)), trace)


def _trial(task: Task, timing: dict[str, float]) -> dict[str, Any]:
    """Plan and walk; ``timing`` keeps what was measured even if this raises."""
    # Here, not above: the sweep's own process needs neither simulator nor body.
    from validation.judge.examine import walk
    from validation.trial.plan import Request, plan_walk
    from validation.trial.tune import tune_walk

    clock = _Clock()
    cpu = time.thread_time()
    profile = find_profile(task.profile)
    try:
        request = Request(task.name, task.parameters)
        planned = tune_walk(request, clock).planned if task.tune else plan_walk(request, clock)
    finally:
        timing |= clock.timing() | {"cpu_planning": time.thread_time() - cpu}
    row = parameter_values(planned.run) | motion_columns(planned)
    cpu = time.thread_time()
    walked = walk(planned, profile)
    simulated = float(walked.record.time[-1])
    timing |= {
        **walked.seconds,
        "cpu_walk": time.thread_time() - cpu,
        "real_time_factor": simulated / walked.seconds["simulation"],
    }
    row |= walk_columns(walked)
    if task.instrument is not None:
        from validation.measure.instruments.columns import instrument_columns

        row |= instrument_columns(walked.planned, walked.record, task.instrument)
    if task.recordings == "all" or (task.recordings == "failures" and row["verdict"] != "pass"):
        start = time.perf_counter()
        row["recording"] = _keep(walked, task, timing)
        timing["recording"] = time.perf_counter() - start
    return row


def _keep(walked: Walk, task: Task, timing: dict[str, float]) -> str:
    from validation.study.sweep.recording import keep_run

    return keep_run(walked, Path(task.folder), task.name, timing, task.instrument)


class _Clock(Progress):
    """Times the stages of planning."""

    def __init__(self) -> None:
        self._start = time.perf_counter()
        self._motion: float | None = None

    @contextmanager
    def stage(self, label: str, unit: str = "") -> Iterator[Stage]:
        start = time.perf_counter()
        yield Stage()
        if label.endswith("whole-body motion"):
            self._motion = time.perf_counter() - start

    def timing(self) -> dict[str, float]:
        """Seconds until now, and of the motion if it was reached."""
        found = {"planning": time.perf_counter() - self._start}
        return found if self._motion is None else found | {"motion": self._motion}


def _announce(task: Task) -> str | None:
    """Tell the sweep's own process that this run begins here; the worker's name, if this is one."""
    from distributed import get_worker
    from distributed.utils import sync

    try:
        worker = get_worker()
    except ValueError:  # called from Python, without a cluster
        return None
    if task.topic:
        message = {
            "run": task.run,
            "attempt": task.attempt,
            "address": worker.address,
            "threads": blas_threads(),
        }
        # Until the scheduler has it: who is to blame must be known even if the process dies at once.
        sync(worker.loop, worker.scheduler.log_event, topic=task.topic, msg=message)
    name = worker.name
    # A name that was not chosen is an address, and a table names no machines.
    return str(name) if isinstance(name, int) else hashlib.sha256(str(name).encode()).hexdigest()[:8]


def blas_threads() -> int:
    """Threads that this process's BLAS takes, by the variables that it has read when it was loaded."""
    for name in ("OPENBLAS_NUM_THREADS", "GOTO_NUM_THREADS", "OMP_NUM_THREADS"):
        value = os.environ.get(name, "").partition(",")[0]
        if value.isdecimal() and int(value):
            return int(value)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def _guard(seconds: float | None) -> Iterator[None]:
    """End this process if the body of the ``with`` takes too long, even if it is stuck in C."""
    if seconds is None:
        yield
        return
    with open(os.devnull, "w", encoding="utf-8") as nowhere:
        faulthandler.dump_traceback_later(seconds, exit=True, file=nowhere)
        try:
            yield
        finally:
            faulthandler.cancel_dump_traceback_later()


def _trim_cache() -> None:
    """Now and then, remove the oldest solved motions of the user's cache."""
    global _done
    _done += 1
    if _done % _TRIM_EVERY:
        return
    from validation.trial.plan import motion_cache

    folder = motion_cache()
    if folder is None:
        return
    try:
        found = sorted((path.stat().st_mtime, path) for path in folder.glob("motion-*.npz"))
        for _, path in found[:-MOTIONS_KEPT]:
            path.unlink(missing_ok=True)
    except OSError:  # another worker was first
        return
