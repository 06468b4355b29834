"""One run of a sweep, as a worker walks it: parameters in, a row out, whatever happens in between.

Limits on a run are in simulated time (its steps, the checks of :mod:`validation.trial`) and in iterations of
solvers, which are parameters of the run: they give the same row everywhere. The wall clock only guards
against a hang: a thread of C that needs no Python ends the process, and the sweep's own process writes
``timed_out``.
"""

from __future__ import annotations

import faulthandler
import hashlib
import os
import re
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from ampm.exceptions import InputError
from ampm.parameters import RunParameters
from validation.judge.profiles import profile as find_profile
from validation.progress import Progress, Stage, interruption
from validation.store.identity import code, code_hash, parameter_values
from validation.store.machine import THREAD_VARIABLES, cores
from validation.study.sweep.exceptions import SweepStopped
from validation.study.sweep.schema import (
    clean_text,
    environment_columns,
    error_columns,
    first_columns,
    tidy,
    walk_columns,
)
from validation.study.sweep.store import RECORDINGS, disk_full, disk_is_full

if TYPE_CHECKING:
    from validation.run.trial import Trial

MOTIONS_KEPT = 1500
"""Solved motions that the user's cache may hold; a sweep over gaits would fill the disk with them."""
_TRIM_EVERY = 100  # runs of a sweep

_DRAW = "import sys, pathlib, validation.run.trial as run; run.draw_run(pathlib.Path(sys.argv[1]))"
_FULL = re.compile(
    r"no space left|no room is left|quota exceeded|file too large|(?:errno|os error|OSError) (?:27|28|122)\b",
    re.IGNORECASE,
)
"""Words of a full disk or quota, by whichever library meets it."""

_one_at_a_time = threading.Lock()  # a worker with several threads still walks one run after the other


@dataclass(frozen=True)
class Task:
    """One run, complete.

    Attributes:
        run: number in the sweep.
        name: the same as text; of its folder.
        parameters: all of them.
        profile: tolerances.
        instrument: sensor model beside the simulator's truth, if any.
        keep: which walks keep a run folder.
        folder: of the sweep; where it is kept.
        wall_clock: after which the process is ended [s]; None for no guard.
        code: hash of the code that the sweep's own process has, which must be the worker's.
        attempt: times that the run was sent out, from 1.
        tune: make the free choices first; the parameters know which keys were named.
    """

    run: int
    name: str
    parameters: RunParameters
    profile: str
    instrument: str | None = None
    keep: Literal["none", "failures", "all"] = "none"
    folder: str = ""
    wall_clock: float | None = None
    code: str = ""
    attempt: int = 1
    tune: bool = False

    def row(self, columns: Mapping[str, Any], worker: str | None = None) -> dict[str, Any]:
        """The run's row, with these columns beside those of its parameters and of where it ran."""
        first = first_columns(self.run, self.name, parameter_values(self.parameters))
        return tidy({**first, **columns, **environment_columns(worker, self.attempt)})


Runner = Callable[[Task, dict[str, float]], dict[str, Any]]
"""From a task to columns; adds wall-clock times to the table that it is given, even if it raises."""


@dataclass(frozen=True)
class TaskResult:
    """Result that a worker sends back.

    Attributes:
        row: of the table, complete.
        trace: traceback, if the run crashed.
    """

    row: dict[str, Any]
    trace: str | None = None


class Listener:
    """Receives what an execution gives; this one collects the rows."""

    def __init__(self) -> None:
        self.rows: list[dict[str, Any]] = []

    def keep(self, rows: list[dict[str, Any]]) -> None:
        """Make rows durable, and return when they are."""
        self.rows += rows

    def ended(self, row: Mapping[str, Any], trace: str | None) -> None:
        """A run has ended; with this traceback, if it has crashed."""

    def tick(self, workers: int) -> None:
        """Some time has passed."""
        interruption.check()


def walk_task(task: Task, trial: Runner | None = None) -> TaskResult:
    """Walk one run on a worker: one at a time, guarded.

    Args:
        task: the run.
        trial: plan and walk, by default.

    Raises:
        SweepStopped: the worker's code is another, or its disk is full.
    """
    with _one_at_a_time:
        if task.code and task.code != code_hash():
            own = ", ".join(f"{name} {value}" for name, value in code().items())
            raise SweepStopped(
                f"a worker has other code or versions than this program, so its results would differ ({own})",
                "install the same on both",
            )
        with _guard(task.wall_clock):
            result = _perform(task, trial or _walk)
        if task.run % _TRIM_EVERY == 0:
            _trim_cache()
        return result


def _perform(task: Task, trial: Runner) -> TaskResult:
    """The row of a run, whatever becomes of it."""
    wall, cpu = time.perf_counter(), time.thread_time()
    timing: dict[str, float] = {}
    trace = None
    try:
        columns = trial(task, timing)
    except SweepStopped:
        raise
    except (Exception, SystemExit) as error:
        # The plan of a gait that could not be tuned is none that would walk.
        columns = error_columns(error, None if task.tune else task.parameters)
        if columns["outcome"] == "crashed":
            trace = clean_text("".join(traceback.format_exception(error)))
    timing |= {"total": time.perf_counter() - wall, "cpu_total": time.thread_time() - cpu}
    columns |= {f"timing_{name}": value for name, value in timing.items()}
    return TaskResult(task.row(columns, _worker_name()), trace)


def _walk(task: Task, timing: dict[str, float]) -> dict[str, Any]:
    """Plan, walk and measure."""
    # Here, not above: the sweep's own process needs neither simulator nor body.
    from validation.run.walk import walk_planned
    from validation.trial.plan import Request, plan_walk
    from validation.trial.tune import tune_walk

    stages = _Clock()
    cpu = time.thread_time()
    try:
        request = Request(task.name, task.parameters)
        planned = tune_walk(request, stages) if task.tune else plan_walk(request, stages)
    finally:
        timing |= stages.timing() | {"cpu_planning": time.thread_time() - cpu}
    cpu = time.thread_time()
    walked = walk_planned(planned, find_profile(task.profile), seconds={"planning": timing["planning"]})
    timing |= {**walked.timing, "cpu_walk": time.thread_time() - cpu}
    del timing["simulated"]  # outcome_time has it
    row = parameter_values(planned.run) | walk_columns(walked)
    if task.instrument is not None:
        from validation.measure.instruments.observe import instrument_columns  # loads SciPy

        row |= instrument_columns(walked.planned, walked.record, task.instrument)
    if task.keep == "all" or (task.keep == "failures" and row["verdict"] != "pass"):
        start = time.perf_counter()
        row["recording"] = keep_run(walked, task)
        timing["recording"] = time.perf_counter() - start
    return row


class _Clock(Progress):
    """Times the stages of planning."""

    def __init__(self) -> None:
        self._start = time.perf_counter()
        self._motion: dict[str, float] = {}

    @contextmanager
    def stage(self, label: str, unit: str = "") -> Iterator[Stage]:
        start = time.perf_counter()
        yield Stage()
        if label.endswith("whole-body motion"):
            self._motion["motion"] = time.perf_counter() - start

    def timing(self) -> dict[str, float]:
        """Seconds until now, and of the motion if it was reached."""
        return {"planning": time.perf_counter() - self._start} | self._motion


# ------------------------------------------------------------------------------ the run's folder


def keep_run(trial: Trial, task: Task) -> str:
    """Write a run's folder as ``ampm validate`` does; an earlier one of that run is replaced.

    Returns:
        The run's folder, relative to the sweep's.

    Raises:
        SweepStopped: it cannot be written.
    """
    from validation.measure.instruments.model import load_instrument  # loads SciPy

    relative = f"{RECORDINGS}/{task.name}"
    target = Path(task.folder) / relative
    instrument = None if task.instrument is None else load_instrument(task.instrument)
    try:
        trial.save(target, force=True, recording=False, instrument=instrument)
        # Drawing needs the viewer's library and matplotlib, which a worker is better off without.
        command = [sys.executable, "-c", _DRAW, str(target)]
        done = subprocess.run(command, capture_output=True, encoding="utf-8", errors="replace", check=False)
    except OSError as error:
        if disk_is_full(error):
            raise disk_full(target, error.strerror) from error
        raise SweepStopped(
            f"a worker cannot write {target} ({error.strerror})",
            "on other machines mount the folder at the same path",
        ) from error
    except InputError as error:  # of the folder, not of the run
        raise SweepStopped(str(error).partition(";")[0], "clear the folder") from error
    if done.returncode:
        last = done.stderr.strip().rpartition("\n")[2] or f"exit status {done.returncode}"
        if _FULL.search(done.stderr):
            raise disk_full(target, last)
        raise SweepStopped(f"recording and report of {target} could not be drawn ({last})", "fix the cause")
    return relative


# ------------------------------------------------------------------------------ the worker


def _worker_name() -> str | None:
    """Name of this worker; None outside a cluster. An address is hashed: a table names no machines."""
    from distributed import get_worker  # of a worker; a call from Python needs no dask

    try:
        name = get_worker().name
    except ValueError:
        return None
    return str(name) if isinstance(name, int) else hashlib.sha256(str(name).encode()).hexdigest()[:8]


def blas_threads() -> int:
    """Threads that this process's BLAS takes, by the variables that it has read when it was loaded."""
    for name in THREAD_VARIABLES:
        value = os.environ.get(name, "").partition(",")[0]
        if value.isdecimal() and int(value):
            return int(value)
    return cores()


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
    """Remove the oldest solved motions of the user's cache."""
    from validation.trial.plan import motion_cache  # loaded by a worker that has walked

    folder = motion_cache()
    with suppress(OSError):  # another worker was first
        found = sorted((path.stat().st_mtime, path) for path in folder.glob("motion-*.npz")) if folder else []
        for _, path in found[:-MOTIONS_KEPT]:
            path.unlink(missing_ok=True)
