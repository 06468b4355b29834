"""A sweep from its definition to a finished folder, in as many calls as it takes."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from ampm.exceptions import InputError, RefusedGait
from ampm.planner.periodic import plan_gait
from validation.progress import Progress, Stage, interruption
from validation.show.text import format_duration
from validation.store.folders import check_target
from validation.store.identity import code_hash, parameter_values
from validation.store.json import dump_json
from validation.store.machine import cores
from validation.study.sweep.design import SweepDefinition, load_sweep
from validation.study.sweep.forecast import ACCEPTED, screen
from validation.study.sweep.sampling import Cases, cases
from validation.study.sweep.schema import (
    OUTCOMES,
    environment_columns,
    first_columns,
    refused_columns,
    reproducible_columns,
    tidy,
)
from validation.study.sweep.store import (
    CRASHES,
    DEFINITION,
    LOCK,
    RECORDINGS,
    REPORT,
    SUMMARY,
    Store,
    check_identity,
    is_sweep,
    open_store,
)
from validation.study.sweep.table import STATES, State, SweepTable, read_sweep, wrap_table
from validation.study.sweep.task import Listener, Task

if TYPE_CHECKING:
    from validation.study.sweep.workers import WorkerPool

    Pool = Callable[[int], AbstractContextManager[WorkerPool]]

RETRIED = tuple(name for name in OUTCOMES if name != "completed")
"""Outcomes that can be walked again on request."""
_WINDOW = 300.0  # over which the rate is taken [s]
_BATCH = 1000  # refused runs that are kept at a time
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
    """Walk many runs; ``sweep("slopes.toml").table.to_pandas()`` gives one row per run.

    Args:
        definition: TOML file, or a definition that is loaded already.
        out: folder of the sweep; without one only the table is kept, and no recording.
        workers: processes of this machine, one per core by default.
        scheduler: address of a dask scheduler to run on instead, or its scheduler file.
        resume: go on with what is in the folder: walk what has no row, or a row that is no answer.
        force: go on although the code has changed.
        retry: outcomes of finished runs that are walked again, of :data:`RETRIED`.
        progress: where to report; silent by default.

    Raises:
        InputError: bad options, a bad definition, or a folder that must not be written.
        SweepStopped: a full disk, a lost scheduler, no workers; what is finished is kept.
        KeyboardInterrupt: Ctrl-C; what is finished is kept.
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
    pool = partial(_pool, workers, scheduler, progress)
    if out is None:
        with tempfile.TemporaryDirectory(prefix="ampm-sweep-") as folder:
            unkept = definition.model_copy(update={"recordings": "none"})
            found = sweep(
                unkept, Path(folder) / "out", workers=workers, scheduler=scheduler, progress=progress
            )
            return replace(found, directory=None, source=definition.name)
    start, out = time.monotonic(), Path(out)
    way_out = "resume (--resume) to go on with its sweep"
    check_target(out, None, force=resume, what="sweep", marks=(DEFINITION, LOCK), way_out=way_out)
    if scheduler and not is_sweep(out):
        with pool(1):  # first of all: a scheduler that does not answer leaves no folder behind
            pass
    with open_store(out) as store:
        if check_identity(out, definition, force=force) and resume:
            progress.say(f"nothing to resume in {out}; starting the sweep")
        store.begin(definition)
        jobs = _Jobs(definition, cases(definition), out.resolve())
        _walk_missing(jobs, store, pool, retry, progress)
        if definition.recordings == "worst":
            _keep_worst(jobs, store, pool, progress)
        store.finish(store.rows())
        found = read_sweep(out)
        summary = found.summary(time.monotonic() - start)
        if summary["environments"] > 1:
            progress.say("ampm: the table mixes rows of different code; environment_code tells them apart")
        store.write_text(SUMMARY, dump_json(summary) + "\n")
        with progress.stage("report"):
            from validation.study.sweep.report import write_sweep_report  # loads Vega's JavaScript engine

            write_sweep_report(out)
        return found


def _pool(
    workers: int | None, scheduler: str | None, progress: Progress, walks: int
) -> AbstractContextManager[WorkerPool]:
    """Workers for this many walks."""
    from validation.study.sweep.workers import local_pool, remote_pool  # load dask

    return remote_pool(scheduler, progress.say) if scheduler else local_pool(min(workers or cores(), walks))


def _execute(pool: Pool, tasks: Iterator[Task], walks: int, listener: Listener) -> None:
    from validation.study.sweep.execution import Execution  # loads dask

    with pool(walks) as workers:
        Execution(workers, tasks, listener).run()


# ------------------------------------------------------------------------------ walking


class _Jobs:
    """Rows and tasks of a sweep's runs.

    Args:
        definition: of the sweep.
        runs: of it.
        folder: of the sweep.
    """

    def __init__(self, definition: SweepDefinition, runs: Cases, folder: Path) -> None:
        self.definition, self.runs, self.folder = definition, runs, folder

    def refused(self, case: int) -> dict[str, Any]:
        """Row of a run without a plan, or with a parameter beyond its bounds."""
        run = None
        try:
            run = self.runs.run(case)
            plan_gait(run.gait, run.body.mass)
        except (InputError, RefusedGait) as error:
            values = self.runs.row(case) if run is None else {}
            values = parameter_values(run or self.definition.run) | values
            first = first_columns(case, self.runs.name(case), values)
            return tidy({**first, **refused_columns(error, run), **environment_columns()})
        raise ValueError(f"run {case} is not refused")

    def task(self, case: int, **changes: Any) -> Task:
        """One run, for a worker."""
        definition = self.definition
        task = Task(
            run=case,
            name=self.runs.name(case),
            parameters=self.runs.run(case),
            profile=definition.profile,
            instrument=definition.instrument,
            keep="none" if definition.recordings == "worst" else definition.recordings,
            folder=str(self.folder),
            wall_clock=definition.limits.wall_clock,
            code=code_hash(),
            tune=definition.tune,
        )
        return replace(task, **changes)


def _walk_missing(jobs: _Jobs, store: Store, pool: Pool, retry: Sequence[str], progress: Progress) -> None:
    """Walk the runs that have no row yet, one that is no answer, or an outcome to retry."""
    found = wrap_table(store.rows(), store.folder)
    again = found.unanswered | np.isin(np.array(found.words("outcome"), dtype=object), list(retry))
    missing = np.ones(len(jobs.runs), dtype=bool)
    missing[found.table["run"].to_numpy()[~again]] = False
    if not missing.any():
        return
    accepted = screen(jobs.runs) == ACCEPTED
    refused, walked = (np.flatnonzero(missing & rows).tolist() for rows in (~accepted, accepted))
    counts = Counter(STATES[state] for state in found.states[~again])
    with progress.stage("sweep", "runs") as stage:
        listener = _Keeper(store, stage, progress, len(jobs.runs), len(walked), counts)
        for start in range(0, len(refused), _BATCH):
            rows = [jobs.refused(case) for case in refused[start : start + _BATCH]]
            for row in rows:
                listener.ended(row, None)
            listener.keep(rows)
            listener.tick(0)
        if walked:
            _execute(pool, map(jobs.task, walked), len(walked), listener)
    progress.say(f"sweep: {listener.done} of {len(jobs.runs)} runs, {listener.text()}")
    interruption.check()


class _Keeper(Listener):
    """Keeps rows and tracebacks in the folder, and reports how far the sweep is.

    Args:
        store: of the sweep.
        stage: of the walks.
        progress: where to report in words.
        total: runs of the sweep.
        walks: how many of them have to be walked from now on.
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
        self._total, self._left, self._counts = total, walks, counts
        self._recent: deque[float] = deque()
        self._start = time.monotonic()
        self._workers = 0

    @property
    def done(self) -> int:
        """Runs that have ended, those of earlier calls included."""
        return sum(self._counts.values())

    def keep(self, rows: list[dict[str, Any]]) -> None:
        """Make rows durable; remove what an earlier row of the same run left."""
        for row in rows:
            if row["recording"] is None:
                shutil.rmtree(self._store.folder / RECORDINGS / row["name"], ignore_errors=True)
            if row["outcome"] != "crashed":
                (self._store.folder / CRASHES / f"{row['name']}.txt").unlink(missing_ok=True)
        self._store.append(rows)

    def ended(self, row: Mapping[str, Any], trace: str | None) -> None:
        """Count a run, and keep its traceback."""
        self._counts[State.of(row["outcome"], row["verdict"])] += 1
        if row["environment_attempts"]:
            self._left -= 1
            self._recent.append(time.monotonic())
        if trace is not None:
            self._progress.say(f"run {row['name']} crashed: {trace.strip().rpartition(chr(10))[2]}")
            self._store.write_text(f"{CRASHES}/{row['name']}.txt", trace)

    def tick(self, workers: int) -> None:
        """Report, and answer Ctrl-C."""
        interruption.check()
        self._workers = workers
        self._stage.advance(self.done, self._total)
        self._stage.note(self.text())

    def text(self) -> str:
        """Counts, rate and time left."""
        parts = [f"{number} {state.label}" for state in State if (number := self._counts[state])]
        now = time.monotonic()
        while self._recent and now - self._recent[0] > _WINDOW:
            self._recent.popleft()
        if len(self._recent) >= _LEAST:
            rate = len(self._recent) / max(min(now - self._start, _WINDOW), 1e-9)
            parts.append(f"{rate:.3g}/s" if rate >= 1.0 else f"{60.0 * rate:.3g}/min")
            if self._left > 0:
                parts.append(f"{format_duration(self._left / rate)} left")
        if not self._workers and self._left > 0:
            parts.append("waiting for workers")
        return ", ".join(parts)


# ------------------------------------------------------------------------------ recordings


def _keep_worst(jobs: _Jobs, store: Store, pool: Pool, progress: Progress) -> None:
    """Walk the worst runs again and keep their folders."""
    found = wrap_table(store.rows(), store.folder)
    definition, passed = jobs.definition, found.is_state(State.PASS)
    # Runs that passed keep a recording only if the definition says how many it wants.
    chosen = [row for row in found.worst if "worst" in definition.model_fields_set or not passed[row]]
    runs, names = found.table["run"].to_pylist(), found.words("name")
    kept = {runs[row]: f"{RECORDINGS}/{names[row]}" for row in chosen[: definition.worst]}
    wanted = [run for run, name in kept.items() if not (store.folder / name / REPORT).is_file()]
    if wanted:
        again = Listener()
        # Without a guard on the clock: they have come to their end before.
        tasks = (jobs.task(run, keep="all", wall_clock=None) for run in wanted)
        with progress.stage(f"recordings of the worst runs ({len(wanted)})"):
            _execute(pool, tasks, len(wanted), again)
        interruption.check()
        for row in again.rows:
            before = found.table.slice(runs.index(row["run"]), 1).to_pylist()[0]
            compared = (name for name in reproducible_columns() if name != "recording")
            if differing := next((name for name in compared if row[name] != before[name]), None):
                progress.say(
                    f"ampm: run {row['name']} gave another {differing} when it was walked again for its "
                    "recording; the table keeps the first"
                )
    changed = [
        kept.get(run) != path for run, path in zip(runs, found.table["recording"].to_pylist(), strict=True)
    ]
    rows = found.table.filter(pa.array(changed)).to_pylist()
    store.append([{**row, "recording": kept.get(row["run"])} for row in rows])
