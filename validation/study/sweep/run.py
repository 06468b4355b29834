"""A sweep from its definition to a finished folder, in one or several calls."""

from __future__ import annotations

import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ampm.exceptions import InputError
from validation.progress import Progress, Stage, interruption
from validation.show.text import format_duration
from validation.store.folders import check_target
from validation.store.identity import parameter_values
from validation.store.json import dump_json
from validation.store.machine import cores
from validation.study.sweep.design import SweepDefinition, load_sweep
from validation.study.sweep.forecast import ACCEPTED, refusal, screen
from validation.study.sweep.schema import error_columns, make_row
from validation.study.sweep.store import (
    CRASHES,
    DEFINITION,
    LOCK,
    REPORT,
    SUMMARY,
    Store,
    is_sweep,
    open_store,
)
from validation.study.sweep.table import STATES, State, SweepTable, read_sweep, wrap_table
from validation.study.sweep.task import Result, Row, Task

if TYPE_CHECKING:
    from validation.study.sweep.workers import WorkerPool

    Pool = Callable[[int], AbstractContextManager[WorkerPool]]

_COMPLETED = (State.PASS, State.OUT_OF_TOLERANCE, State.NOT_MEASURED)
RETRIED = tuple(state.value for state in State if state not in _COMPLETED)
"""Outcomes that can be walked again on request."""
FLUSH = 1.0
"""Time after which a finished row is on the disk at the latest [s]."""
_LEAST = 3  # walks after which there is a rate


def sweep(
    definition: SweepDefinition | str | Path,
    out: str | Path | None = None,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    resume: bool = False,
    force: bool = False,
    retry: Sequence[str] = (),
    progress: Progress | None = None,
) -> SweepTable:
    """Walk many runs; ``sweep("slopes.toml").table.to_pandas()``, with the extra pandas, gives a row per run.

    Args:
        definition: TOML file, or a loaded definition.
        out: folder of the sweep; without one only the table is kept, and no recording.
        workers: processes of this machine, one per core by default.
        scheduler: address of a dask scheduler to run on instead, or its scheduler file.
        resume: continue in the folder: walk runs without a row, or with a row that is no result.
        force: continue although the code has changed.
        retry: outcomes of finished runs that are walked again, of :data:`RETRIED`.
        progress: where to report; silent by default.

    Raises:
        InputError: bad options, a bad definition, or a folder that cannot be used.
        SweepStopped: a full disk, a lost scheduler, no workers; finished runs are kept.
        KeyboardInterrupt: Ctrl-C; finished runs are kept.
    """
    if not isinstance(definition, SweepDefinition):
        definition = load_sweep(definition)
    if workers is not None and workers < 1:
        raise InputError(f"--workers {workers} must be at least 1.")
    if workers is not None and scheduler is not None:
        raise InputError("--workers and --scheduler exclude each other: a scheduler has its own workers.")
    if (force or retry) and not resume:
        raise InputError("--force and --retry go with --resume: no sweep is ever replaced; add it.")
    for name in retry:
        if name not in RETRIED:
            raise InputError(f"--retry {name!r} must be of {', '.join(RETRIED)}; correct it.")
    progress = progress or Progress()
    if out is None:
        with tempfile.TemporaryDirectory(prefix="ampm-sweep-") as folder:
            unkept = definition.model_copy(update={"recordings": "none"})
            found = sweep(
                unkept, Path(folder) / "out", workers=workers, scheduler=scheduler, progress=progress
            )
            return replace(found, directory=None, source=definition.name)

    def pool(walks: int) -> AbstractContextManager[WorkerPool]:
        from validation.study.sweep.workers import local_pool, remote_pool  # load dask

        return (
            remote_pool(scheduler, progress.say) if scheduler else local_pool(min(workers or cores(), walks))
        )

    start, out = time.monotonic(), Path(out)
    way_out = "resume (--resume) to go on with its sweep"
    check_target(out, None, force=resume, what="sweep", marks=(DEFINITION, LOCK), way_out=way_out)
    if scheduler and not is_sweep(out):
        with pool(1):  # first, so that no folder is left if the scheduler does not answer
            pass
    with open_store(out) as store:
        if not store.begin(definition, force=force) and resume:
            progress.say(f"nothing to resume in {out}; starting the sweep")
        _walk_missing(definition, store, pool, retry, progress)
        if definition.recordings in ("failures", "worst"):
            _keep_worst(definition, store, pool, progress)
        store.finish()
        found = read_sweep(out)
        summary = found.summary(time.monotonic() - start)
        if summary["environments"] > 1:
            progress.say("ampm: the table mixes rows of different code; environment_code has which")
        store.write_text(SUMMARY, dump_json(summary) + "\n")
        with progress.stage("report"):
            from validation.study.sweep.report import write_sweep_report  # loads Vega's JavaScript engine

            write_sweep_report(out)
        return found


def _walk_missing(
    definition: SweepDefinition, store: Store, pool: Pool, retry: Sequence[str], progress: Progress
) -> None:
    """Walk the runs without a row, with a row that is no result, or with an outcome to retry."""
    found = wrap_table(store.rows(), store.folder)
    again = found.unanswered | np.isin(np.array(found.words("outcome"), dtype=object), list(retry))
    missing = np.ones(len(definition), dtype=bool)
    missing[found.table["run"].to_numpy()[~again]] = False
    if not missing.any():
        return
    accepted = screen(definition) == ACCEPTED
    refused, walked = (np.flatnonzero(missing & rows).tolist() for rows in (~accepted, accepted))
    counts = Counter(STATES[state] for state in found.states[~again])
    with progress.stage("sweep", "runs") as stage:
        keeper = _Keeper(store, stage, progress, len(definition), len(walked), counts)
        try:
            for run in refused:
                keeper.take((_refused(definition, run), ""))
            if walked:
                _walk(definition, walked, store, pool, keeper.take)
        finally:
            keeper.flush()
    progress.say(f"sweep: {keeper.done} of {len(definition)} runs, {keeper.text()}")
    interruption.check()


def _refused(definition: SweepDefinition, run: int) -> Row:
    """Row of a run without a plan, or with a parameter beyond its bounds."""
    error = refusal(definition, run)
    if error is None:
        raise ValueError(f"run {run} is not refused")
    values = parameter_values(definition.shared) | definition.varied(run)
    return make_row(run, definition.name_of(run), values, error_columns(error, None))


def _walk(
    definition: SweepDefinition,
    runs: Sequence[int],
    store: Store,
    pool: Pool,
    take: Callable[[Result | None, int], None],
    **changes: Any,
) -> None:
    """Walk runs; ``take`` is called with every result, or None in between, and the number of workers."""
    from validation.study.sweep.workers import execute  # loads dask

    folder = store.folder.resolve()
    with pool(len(runs)) as found:
        for result in execute(found, runs, lambda run: Task.of(definition, run, folder, **changes)):
            take(result, found.size())


class _Keeper:
    """Stores rows and tracebacks in the folder, and reports progress.

    Args:
        store: of the sweep.
        stage: of the walks.
        progress: where to report messages.
        total: runs of the sweep.
        walks: number of runs to walk in this call.
        counts: runs of earlier calls, by state.
    """

    def __init__(
        self,
        store: Store,
        stage: Stage,
        progress: Progress,
        total: int,
        walks: int,
        counts: Counter[State],
    ) -> None:
        self._store, self._stage, self._progress = store, stage, progress
        self._total, self._walks, self._counts = total, walks, counts
        self._rows: list[Row] = []
        self._start = self._flushed = time.monotonic()
        self._walked = self._workers = 0

    @property
    def done(self) -> int:
        """Number of finished runs, including earlier calls."""
        return sum(self._counts.values())

    def take(self, result: Result | None, workers: int = 0) -> None:
        """Store a result; report, and handle Ctrl-C."""
        self._workers = workers
        if result is not None:
            row, trace = result
            self._rows.append(row)
            self._counts[State.of(row["outcome"], row["verdict"])] += 1
            self._walked += row["environment_attempts"] > 0
            if trace:
                self._progress.say(f"run {row['name']} crashed: {trace.strip().rpartition(chr(10))[2]}")
                self._store.write_text(f"{CRASHES}/{row['name']}.txt", trace)
        if time.monotonic() - self._flushed > FLUSH:
            self.flush()
        interruption.check()
        self._stage.advance(self.done, self._total)
        self._stage.note(self.text())

    def flush(self) -> None:
        """Make rows durable."""
        rows, self._rows = self._rows, []
        self._store.append(rows)
        self._flushed = time.monotonic()

    def text(self) -> str:
        """Counts, rate and time left."""
        parts = [f"{number} {state.label}" for state in State if (number := self._counts[state])]
        left = self._walks - self._walked
        if self._walked >= _LEAST:
            rate = self._walked / max(time.monotonic() - self._start, 1e-9)
            parts.append(f"{rate:.3g}/s" if rate >= 1.0 else f"{60.0 * rate:.3g}/min")
            if left > 0:
                parts.append(f"{format_duration(left / rate)} left")
        if not self._workers and left > 0:
            parts.append("waiting for workers")
        return ", ".join(parts)


def _keep_worst(definition: SweepDefinition, store: Store, pool: Pool, progress: Progress) -> None:
    """Walk the worst runs, or the worst failures, again, to the same bits, and keep their folders."""
    found = wrap_table(store.rows(), store.folder)
    passed = found.is_state(State.PASS)
    every = definition.recordings == "worst"
    chosen = [row for row in found.worst if every or not passed[row]][: definition.worst]
    runs, kept = found.table["run"].to_numpy(), found.words("recording")
    others = np.setdiff1d(np.flatnonzero(kept), chosen)
    store.append([{**row, "recording": None} for row in found.table.take(others).to_pylist()])
    wanted = [row for row in chosen if not (kept[row] and (store.folder / kept[row] / REPORT).is_file())]

    def take(result: Result | None, workers: int) -> None:
        interruption.check()
        if result and result[0]["recording"]:
            store.append([result[0]])

    if wanted:
        with progress.stage(f"recordings of the worst runs ({len(wanted)})"):
            # Without time limit: they ended before.
            _walk(definition, runs[wanted].tolist(), store, pool, take, keep=True, wall_clock=None)
        interruption.check()
