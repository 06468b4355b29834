"""Studies of many walks that go on where they were stopped: folder, journal, workers."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Collection, Iterable, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, TypeVar

from ampm.exceptions import InputError
from validation.store.folders import check_target
from validation.store.json import json_ready
from validation.store.machine import cores

if TYPE_CHECKING:
    from validation.study.sweep.workers import WorkerPool

Item = TypeVar("Item")
Result = TypeVar("Result")


def study_folder(
    out: str | Path | None, files: Collection[str], journal: str, *, what: str, resume: bool, force: bool
) -> Path | None:
    """Folder of a study, checked; None if nothing is to be written.

    Args:
        out: the folder.
        files: all that a study writes there.
        journal: that of these by which a study is known.
        what: the kind of study.
        resume: whether to go on with what is there.
        force: whether to replace it.

    Raises:
        InputError: there is no folder to go on with, or it must not be written.
    """
    if out is None:
        if resume:
            raise InputError("--resume needs the folder of a study; give --out DIR.")
        return None
    way_out = "resume (--resume) to go on with its study, or force (--force) to replace it"
    check_target(Path(out), files, force=force or resume, what=what, marks={journal}, way_out=way_out)
    return Path(out)


class Journal:
    """Results, one row each, in memory and as lines of a file.

    Args:
        path: of the file; None keeps nothing.
        identity: of what is studied, code and definition: the first line.
        resume: go on with the file.

    Attributes:
        rows: those found in the file.

    Raises:
        InputError: the file is of another study.
    """

    def __init__(self, path: Path | None, identity: Mapping[str, Any], *, resume: bool) -> None:
        self.rows: list[dict[str, Any]] = []
        self._file = None
        if path is None:
            return
        first = json.dumps(json_ready(dict(identity)), sort_keys=True)
        if resume and path.is_file():
            self._read(path, first)
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = path.open("a" if self.rows else "w", encoding="utf-8")
        if not self.rows:
            self._write(first)

    def _read(self, path: Path, first: str) -> None:
        lines = path.read_text(encoding="utf-8").splitlines()
        if lines and lines[0] != first:
            new = json.loads(first)
            try:
                old = dict(json.loads(lines[0]))
            except ValueError:  # cut off
                old = {}
            other = ", ".join(key for key in new if old.get(key) != new[key])
            raise InputError(
                f"{path} is of another study: it differs in {other}; repeat that study's options, "
                "give another folder, or leave out --resume."
            )
        for line in lines[1:]:
            try:
                self.rows.append(json.loads(line))
            except ValueError:  # the last line of a killed study
                break
        # A line that was cut off must not stay before those that follow.
        kept = "\n".join(lines[: 1 + len(self.rows)]) + "\n"
        path.write_text(kept, encoding="utf-8")

    def keep(self, row: Mapping[str, Any]) -> None:
        """Add a row; it is on the disk when this returns."""
        self._write(json.dumps(json_ready(row)))

    def _write(self, line: str) -> None:
        if self._file is not None:
            self._file.write(line + "\n")
            self._file.flush()
            os.fsync(self._file.fileno())

    def __enter__(self) -> Self:
        """Nothing is opened here."""
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: TracebackType | None) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()


def processes(workers: int | None) -> int:
    """Number of processes, None for one a core.

    Raises:
        InputError: no process.
    """
    count = cores() if workers is None else workers
    if count < 1:
        raise InputError(f"--workers {count}: at least one process has to walk.", value=count)
    return count


def work_off(
    items: Iterable[Item],
    runner: Callable[[Item], Result],
    kept: Callable[[Item, Result], Item | None],
    *,
    workers: int | None,
    scheduler: str | None,
    report: Callable[[str], None],
) -> None:
    """Run items until none is left.

    Args:
        items: at first.
        runner: runs one of them, in a worker.
        kept: called here with an item and its result; what it returns is run next.
        workers: processes, None for one a core; one is this very process.
        scheduler: address of a dask scheduler that is running already.
        report: called with warnings.

    Raises:
        InputError: no process, or no scheduler.
    """
    count, waiting = processes(workers), list(items)
    if scheduler is None and count == 1:
        while waiting:
            item = waiting.pop(0)
            if (further := kept(item, runner(item))) is not None:
                waiting.insert(0, further)
        return
    if not waiting:
        return
    from distributed import as_completed  # imported here because dask is slow to load

    from validation.study.sweep.workers import local_pool, remote_pool

    pools: AbstractContextManager[WorkerPool] = (
        local_pool(min(count, len(waiting))) if scheduler is None else remote_pool(scheduler, report)
    )
    with pools as pool:
        flying: dict[Any, Item] = {pool.client.submit(runner, item, pure=False): item for item in waiting}
        running = as_completed(list(flying), loop=pool.client.loop)
        for future in running:
            if (further := kept(flying.pop(future), future.result())) is not None:
                new = pool.client.submit(runner, further, pure=False)
                flying[new] = further
                running.add(new)
