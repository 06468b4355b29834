"""One run of a sweep on a worker: from parameters to a row, also for runs that fail.

A run is limited by simulated time (its steps, the checks of :mod:`validation.trial`) and by iterations of
solvers, which are parameters of the run: they give the same row on every machine. The wall-clock limit only
ends hung runs: a C thread independent of Python ends the process, and the sweep's own process writes
``timed_out``.
"""

from __future__ import annotations

import faulthandler
import hashlib
import os
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ampm.exceptions import InputError
from ampm.parameters import RunParameters
from ampm.run_file import changes
from validation.judge.profiles import profile as find_profile
from validation.progress import Progress, StageClock
from validation.store.folders import disk_is_full
from validation.store.identity import code, code_hash, parameter_values
from validation.study.sweep.design import SweepDefinition
from validation.study.sweep.exceptions import SweepStopped
from validation.study.sweep.schema import clean_text, error_columns, make_row, walk_columns
from validation.study.sweep.store import RECORDINGS, disk_full
from validation.trial.users import UsersError

if TYPE_CHECKING:
    from validation.run.trial import Trial
    from validation.trial.plan import PlannedWalk

Row = dict[str, Any]
Result = tuple[Row, str]
"""Row of a run, and the traceback if it crashed, else an empty text."""

KEPT = 1500
"""Largest number of solved motions in the user's cache: a sweep could fill the disk."""
_TRIM_EVERY = 100  # runs of a sweep

_DRAW = "import sys, pathlib, validation.run.trial as run; run.draw_run(pathlib.Path(sys.argv[1]))"
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
        push: pushes, as texts.
        keep: whether the walk keeps a run folder.
        folder: of the sweep, for kept runs.
        wall_clock: after which the process is ended [s]; None for no guard.
        code: hash of the code of the sweep's own process, which the worker must have, too.
        varied: parameters that differ from run to run, by key.
    """

    run: int
    name: str
    parameters: RunParameters
    profile: str
    instrument: str | None = None
    push: tuple[str, ...] = ()
    keep: bool = False
    folder: str = ""
    wall_clock: float | None = None
    code: str = ""
    varied: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, definition: SweepDefinition, run: int, folder: Path, **changes: Any) -> Task:
        """One run of a sweep, which is kept in a folder.

        Raises:
            InputError: a parameter is beyond its bounds.
        """
        same = ("profile", "instrument", "push", "wall_clock")
        task = cls(
            run=run,
            name=definition.name_of(run),
            parameters=definition.parameters(run),
            keep=definition.recordings == "all",
            folder=str(folder),
            code=code_hash(),
            varied=definition.varied(run),
            **{name: getattr(definition, name) for name in same},
        )
        return replace(task, **changes)

    def row(self, found: Row, worker: str | None = None) -> Row:
        """The run's row: these columns, its parameters, and its environment."""
        return make_row(self.run, self.name, parameter_values(self.parameters), found, worker, 1)

    def plan(self, progress: Progress | None = None) -> PlannedWalk:
        """Plan the walk.

        Raises:
            InputError, RefusedGait: there is no such walk.
        """
        # Imported here: the sweep's own process needs neither simulator nor body.
        from validation.trial.plan import Request, plan_walk

        return plan_walk(Request(self.name, self.parameters, self.varied), progress)

    def walk(self, planned: PlannedWalk, seconds: dict[str, float] | None = None) -> Trial:
        """Walk and measure; ``seconds`` are of earlier stages."""
        from validation.run.walk import walk_planned  # loads the simulator
        from validation.trial.disturbances import parse_push

        return walk_planned(
            planned,
            find_profile(self.profile),
            disturbances=[parse_push(text) for text in self.push],
            seconds=seconds,
        )


def walk_task(task: Task, trial: Callable[[Task, dict[str, float]], Row] | None = None) -> Result:
    """Walk one run on a worker: one at a time, guarded.

    Args:
        task: the run.
        trial: from a task to columns, plan and walk by default; adds wall-clock times to the table that it is
            given, even if it raises.

    Raises:
        SweepStopped: the worker's code is another, or its disk is full.
    """
    if task.code and task.code != code_hash():
        own = ", ".join(f"{name} {value}" for name, value in code().items())
        raise SweepStopped(
            f"a worker has other code or versions than this program, so its results would differ ({own})",
            "install the same on both",
        )
    timing: dict[str, float] = {}
    trace = ""
    with _one_at_a_time, _guard(task.wall_clock):
        wall, cpu = time.perf_counter(), time.thread_time()
        try:
            found = (trial or _trial)(task, timing)
        except SweepStopped:
            raise
        except (Exception, SystemExit) as error:
            # The plan of a gait for which nothing was found is none that would walk.
            found = error_columns(error, None if changes(task.parameters) else task.parameters)
            if found["outcome"] == "crashed":
                trace = clean_text("".join(traceback.format_exception(error)))
        timing |= {"total": time.perf_counter() - wall, "cpu_total": time.thread_time() - cpu}
    if task.run % _TRIM_EVERY == 0:
        _trim_cache()
    found |= {f"timing_{name}": value for name, value in timing.items()}
    return task.row(found, _worker_name()), trace


def _trial(task: Task, timing: dict[str, float]) -> Row:
    """Plan, walk and measure."""
    stages = StageClock()
    wall, cpu = time.perf_counter(), time.thread_time()
    try:
        planned = task.plan(stages)
    finally:
        timing |= {"planning": time.perf_counter() - wall, "cpu_planning": time.thread_time() - cpu}
        if motion := stages.seconds.get("whole-body motion"):
            timing["motion"] = motion
    cpu = time.thread_time()
    walked = task.walk(planned, {"planning": timing["planning"]})
    if walked.record.outcome.name == "crashed":  # no result about the gait, as if at once
        raise UsersError(walked.record.outcome.cause)
    timing |= {**walked.timing, "cpu_walk": time.thread_time() - cpu}
    del timing["simulated"]  # outcome_time has it
    row = parameter_values(planned.run) | walk_columns(walked)
    if task.instrument is not None:
        from validation.measure.instruments.observe import instrument_columns  # loads SciPy

        row |= instrument_columns(walked.planned, walked.record, task.instrument)
    if task.keep:
        start = time.perf_counter()
        row["recording"] = keep_run(walked, task)
        timing["recording"] = time.perf_counter() - start
    return row


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
        # In a process of its own: drawing loads the viewer's library and matplotlib.
        command = [sys.executable, "-c", _DRAW, str(target)]
        subprocess.run(command, capture_output=True, encoding="utf-8", errors="replace", check=True)
    except subprocess.CalledProcessError as error:
        last = error.stderr.strip().rpartition("\n")[2] or f"exit status {error.returncode}"
        raise SweepStopped(
            f"recording and report of {target} could not be drawn ({last})", "mend that, or free some space"
        ) from error
    except OSError as error:
        if disk_is_full(error):
            raise disk_full(target, error.strerror) from error
        raise SweepStopped(
            f"a worker cannot write {target} ({error.strerror})",
            "on other machines mount the folder at the same path",
        ) from error
    except InputError as error:  # of the folder, not of the run
        raise SweepStopped(str(error).partition(";")[0], "clear the folder") from error
    return relative


def _worker_name() -> str | None:
    """Name of this worker; None outside a cluster. An address is hashed: a table names no machines."""
    from distributed import get_worker  # of a worker; a call from Python needs no dask

    try:
        name = str(get_worker().name)
    except ValueError:
        return None
    return name if name.isdecimal() else hashlib.sha256(name.encode()).hexdigest()[:8]


@contextmanager
def _guard(seconds: float | None) -> Iterator[None]:
    """End this process if the body of the ``with`` takes too long, even within C code."""
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
    if folder is None:
        return
    with suppress(OSError):  # another worker was first
        found = sorted((path.stat().st_mtime, path) for path in folder.glob("motion-*.npz"))
        for _, path in found[:-KEPT]:
            path.unlink(missing_ok=True)
