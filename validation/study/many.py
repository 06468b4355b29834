"""Many walks by one engine: every task once, on this machine or on any dask scheduler, resumable.

A finished run is one line of ``rows.jsonl``, written before it is reported. To resume is to call
:func:`walk_many` again with ``resume``: a task whose row is there is not walked.
"""

import hashlib
import inspect
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sized
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from reprlib import recursive_repr
from types import MappingProxyType
from typing import Any, TypedDict, Unpack

from pydantic import BaseModel

from ampm.exceptions import InputError, StudyStopped
from ampm.parameters import RunParameters
from ampm.section import unknown
from validation.judge.metrics import added_metrics
from validation.progress import Progress, interruption
from validation.run.trial import Trial
from validation.run.walk import walk_planned
from validation.store.environment import code_hash, users_sources
from validation.store.folders import check_target, disk_is_full
from validation.store.machine import cores
from validation.study.pool import ThisProcess, Workers, connect, open_pool
from validation.study.row_file import ROWS, Row, RowFile
from validation.trial.outcome import OutcomeName
from validation.trial.plan import Request, plan_walk
from validation.trial.users import users_classes, users_files


@dataclass(frozen=True)
class Task:
    """One run: ``work(**options)`` returns the columns of its row, which JSON can write."""

    key: str  # unique in the study
    work: Callable[..., Row]  # function of a module, called on a worker
    # its arguments: parameters, plain values, and classes or objects of a user
    options: Mapping[str, Any] = field(default_factory=dict)
    known: Row | None = None  # columns of a run that needs no walk, such as a refusal by formula

    @cached_property
    def digest(self) -> str:
        """Hash of all that decides on the row: options, code, and the sources of a user's classes."""
        text = "\n".join(map(identity, (self.work, self.options, added_metrics(), code_hash())))
        return hashlib.sha256(text.encode()).hexdigest()[:16]


@recursive_repr()
def identity(value: Any) -> str:
    """Text that is equal for equal values, in every process."""
    if isinstance(value, BaseModel):  # with the keys that count as given
        own = (users_files(value), users_classes(value)) if isinstance(value, RunParameters) else ""
        return f"{value.model_dump_json()}{value.model_dump_json(exclude_unset=True)}{identity(own)}"
    if isinstance(value, Path) and value.is_file():
        return f"{value} {hashlib.sha256(value.read_bytes()).hexdigest()}"
    if isinstance(value, set | frozenset):  # in another order in every process
        return identity(sorted(map(identity, value)))
    if type(value) in (dict, MappingProxyType):
        return "{" + ", ".join(f"{key!r}: {identity(item)}" for key, item in value.items()) + "}"
    if type(value) in (list, tuple):
        return "[" + ", ".join(map(identity, value)) + "]"
    if inspect.isroutine(value) or inspect.isclass(value):
        held = [cell.cell_contents for cell in getattr(value, "__closure__", None) or ()]
        names = ("defaults", "kwdefaults", "self", "wrapped")
        held += [getattr(value, f"__{name}__", None) for name in names]
        return f"{value.__module__}:{value.__qualname__} {users_sources(value.__module__)} {identity(held)}"
    if type(value).__module__ != "builtins":  # all that a pickle of it would hold
        with suppress(Exception):
            held = [list(item) if isinstance(item, Iterator) else item for item in value.__reduce_ex__(2)]
            return f"{identity(type(value))} {identity(held)}"
    return repr(value)


class Execution(TypedDict, total=False):
    """How every study is run and kept.

    Attributes:
        workers: processes of this machine; None for one a core, 0 to walk in this very process.
        scheduler: address of a dask scheduler or its scheduler file; its workers are used instead.
        progress: where to report; silent by default.
        out: folder of every walk and of the result; None writes nothing.
        resume: go on with what is in ``out``: walk what has no row of these options and this code.
    """

    workers: int | None
    scheduler: str | None
    progress: Progress | None
    out: str | Path | None
    resume: bool


def study_folder(execution: Execution) -> Path | None:
    """Folder of a study, checked before anything is walked; None if nothing is to be written.

    Raises :class:`InputError` of unknown or contradicting options, if there is no study to resume, or the
    folder is used otherwise. Users' sources count from here on as they are now.
    """
    users_sources.cache_clear()
    for name in execution.keys() - Execution.__annotations__.keys():
        raise unknown(name, Execution.__annotations__, "option of a study")
    workers = execution.get("workers")
    if workers is not None and workers < 0:
        raise InputError(f"--workers {workers} must not be negative; give the number of processes.")
    if workers is not None and execution.get("scheduler") is not None:
        raise InputError("--workers and --scheduler exclude each other: a scheduler has its own workers.")
    out, resume = execution.get("out"), execution.get("resume", False)
    if out is None:
        if resume:
            raise InputError("--resume needs the folder of the study; give --out DIR.")
        return None
    check_target(
        Path(out), None, force=resume, what="study", marks=(ROWS,), way_out="--resume to go on with its study"
    )
    return Path(out)


def walk_many(
    tasks: Iterable[Task],
    *,
    count: int = 0,
    limit: float | None = None,
    label: str = "walks",
    unit: str = "runs",
    **execution: Unpack[Execution],
) -> Iterator[Row]:
    """Walk every task once; yield its row, with ``key`` and ``digest``, as soon as it is there.

    A run that raises, that ends its worker's process again and again, or that exceeds the limit is a row
    like any other, with an ``outcome`` (refused, crashed, timed_out), a ``reason`` and a ``cause``.

    Args:
        tasks: runs, taken one by one as workers get free.
        count: tasks of an iterator, for the progress.
        limit: wall-clock time of a run [s]; none in this very process.
        label: what is done, for the progress.
        unit: what the tasks are, likewise.
        execution: workers and folder, see :class:`Execution`.

    Raises:
        InputError: bad options, or a folder that cannot be used.
        StudyStopped: a full disk, a lost scheduler, a worker that cannot work; finished runs are kept.
        KeyboardInterrupt: Ctrl-C; finished runs are kept.
    """
    workers, scheduler = execution.get("workers"), execution.get("scheduler")
    folder, progress = study_folder(execution), execution.get("progress") or Progress()
    total = len(tasks) if isinstance(tasks, Sized) else count
    if scheduler is not None:
        connect(scheduler).close()  # refused before the folder is made
    elif total:
        workers = min(cores() if workers is None else workers, total)
    rows, outcomes, flying = RowFile(folder), Counter[str](), dict[str, Task]()

    def counted(row: Row) -> Row:
        outcomes[row.get("outcome", "finished")] += 1
        return row

    def finished(task: Task, columns: Row) -> Row:
        row = {"key": task.key, "digest": task.digest, **columns}
        rows.append(row)
        return counted(row)

    def show(*more: str) -> None:
        """Report the progress, unless Ctrl-C was pressed."""
        interruption.check()
        parts = [f"{number} {word.replace('_', ' ')}" for word, number in outcomes.most_common()]
        if total:
            stage.advance(outcomes.total(), total)
        stage.note(", ".join([*parts, *more]))

    def landed(pool: Workers | ThisProcess) -> Iterator[Row]:
        """Wait for walks that end."""
        for name, columns in pool.wait():
            yield finished(flying.pop(name), columns)
        show(*["waiting for workers"] * (not pool.size()))

    try:
        with closing(rows), progress.stage(label, unit) as stage, ExitStack() as opened:
            pool: Workers | ThisProcess | None = None  # no process without a walk
            for task in tasks:
                if (row := rows.get(task.key, task.digest)) is not None:
                    yield counted(row)
                elif task.known is not None:
                    yield finished(task, task.known)
                else:
                    pool = pool or opened.enter_context(open_pool(workers, scheduler, limit))
                    while len(flying) >= pool.size():
                        yield from landed(pool)
                    flying[pool.send(task.work, task.options)] = task
                show()
            while pool is not None and flying:
                yield from landed(pool)
    except KeyboardInterrupt as error:
        if folder is not None:
            more = "" if execution.get("resume") else " with --resume"
            error.add_note(f"finished runs are kept in {folder}; go on by the same command{more}")
        raise
    except OSError as error:
        if disk_is_full(error):
            raise StudyStopped(f"the disk is full ({error})", "free some space") from error
        raise


def walk_request(request: Request, profile: str | None = None) -> Trial:
    """Plan, walk and judge one run, by default by its own profile; KeyboardInterrupt after Ctrl-C."""
    trial = walk_planned(plan_walk(request), profile)
    if trial.record.outcome.name == OutcomeName.INTERRUPTED:
        raise KeyboardInterrupt
    return trial


def keep_run(folder: str, **options: Any) -> Row:
    """Walk one run and write its folder as ``ampm validate`` does; the same options give the same bits."""
    trial = walk_request(**options)
    trial.save(folder, force=True)
    values = {name: metric.value for name, metric in trial.metrics.items() if math.isfinite(metric.value)}
    return {"outcome": str(trial.record.outcome.name), "metrics": values}
