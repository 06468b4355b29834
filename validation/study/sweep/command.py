"""``ampm sweep``: from a definition to a finished folder, in as many calls as it takes."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from ampm.exceptions import InputError, RefusedGait
from ampm.parameters import RunParameters
from ampm.planner.periodic import plan_gait
from validation.cli.console import Narrator, print_json
from validation.cli.options import Status
from validation.progress import interruption
from validation.store.json import json_ready
from validation.study.sweep.columns import column, reproducible_columns, run_key, schema, tidy
from validation.study.sweep.design import SweepDefinition, load_sweep
from validation.study.sweep.forecast import ACCEPTED, screen
from validation.study.sweep.identity import code_hash
from validation.study.sweep.opening import Options, check_folder, holds_sweep, open_folder, resume_command
from validation.study.sweep.progress import SweepProgress, state_of
from validation.study.sweep.rows import environment_columns, first_columns, refused_columns
from validation.study.sweep.sampling import Cases
from validation.study.sweep.sampling import cases as cases_of
from validation.study.sweep.store import (
    CRASHES,
    RECORDINGS,
    SUMMARY,
    Store,
    latest,
    table_metadata,
)
from validation.study.sweep.summary import print_summary, status_of, summarise, unfinished, worst_runs
from validation.study.sweep.work import Task


def run(file: Path, options: Options, *, as_json: bool = False, narrator: Narrator | None = None) -> Status:
    """One call of ``ampm sweep``.

    Raises:
        InputError: bad options, a bad definition, or a folder that must not be written.
        SweepStopped: a full disk or a lost scheduler; what is finished is kept.
        KeyboardInterrupt: Ctrl-C; what is finished is kept.
    """
    narrator = narrator or Narrator()
    options.check()
    definition = load_sweep(file)
    try:
        summary = run_sweep(definition, options, narrator=narrator)
    except KeyboardInterrupt as error:
        if options.out is not None and holds_sweep(options.out):
            error.add_note(f"every finished row is kept; go on with: {resume_command(file, options)}")
        raise
    if as_json:
        print_json({**summary, "directory": str(options.out)})
    else:
        print_summary(summary, str(options.out))
    return status_of(summary)


def run_sweep(
    definition: SweepDefinition, options: Options, *, narrator: Narrator | None = None
) -> dict[str, Any]:
    """Walk a sweep, or what is missing of it, and finish its folder.

    Returns:
        Contents of ``sweep.json``.

    Raises:
        InputError, SweepStopped, KeyboardInterrupt: as :func:`run`.
    """
    from validation.study.sweep.cluster import default_workers, local_crew, remote_crew
    from validation.study.sweep.execute import Execution

    narrator = narrator or Narrator()
    options.check()
    if options.out is None:
        raise TypeError("a dry run walks nothing")
    start = time.monotonic()
    cases = cases_of(definition)
    metadata = table_metadata(definition)
    with ExitStack() as stack:
        crew = None
        if options.scheduler and not holds_sweep(options.out):
            # First of all: a scheduler that does not answer shall leave no folder behind.
            check_folder(options.out, resume=options.resume)
            crew = stack.enter_context(remote_crew(options.scheduler, narrator.say))
        store = stack.enter_context(open_folder(options.out, definition, metadata, options, narrator.say))
        kept = store.rows()
        missing = _missing(kept, len(cases), options.retry)
        jobs = _Jobs(definition, cases, store.folder)
        counts = _counts(kept, missing)
        table = kept
        if missing.any() or _to_keep(definition, kept, metadata):
            accepted = screen(cases) == ACCEPTED
            walks = int((missing & accepted).sum())
            count = min(options.workers or default_workers(), max(walks, 1))
            with ExitStack() as work:
                if crew is None:
                    crew = work.enter_context(
                        remote_crew(options.scheduler, narrator.say)
                        if options.scheduler
                        else local_crew(count, narrator.say)
                    )
                watcher = _Watcher(SweepProgress(len(cases), walks, counts, narrator.console), store)
                sink = _Again(store, kept, missing)
                with watcher.progress:
                    Execution(crew, jobs.missing(missing, accepted), sink, watcher).run()
                interruption.check()
                table = store.rows()
                if table is None:
                    raise InputError("the sweep has no runs.")
                if definition.recordings == "worst":
                    table = _keep_worst(jobs, table, metadata, store, crew, narrator)
        if table is None:
            raise InputError("the sweep has no runs.")
        return _finish(store, table, metadata, time.monotonic() - start, narrator)


# ------------------------------------------------------------------------- what is there


def _missing(kept: pa.Table | None, total: int, retry: Sequence[str] = ()) -> np.ndarray:
    """Runs that have no row yet, one that is no answer, or an outcome to retry, shape (N,), bool."""
    missing = np.ones(total, dtype=bool)
    if kept is not None:
        again = unfinished(kept) | np.isin(np.array(kept["outcome"].to_pylist(), dtype=object), list(retry))
        answered = kept["run"].to_numpy()[~again]
        missing[answered] = False
    return missing


def _counts(kept: pa.Table | None, missing: np.ndarray) -> dict[str, int]:
    """What earlier calls have found, by state."""
    counts: dict[str, int] = {}
    if kept is not None:
        for row in kept.select(["run", "outcome", "verdict"]).to_pylist():
            if not missing[row["run"]]:
                state = state_of(row)
                counts[state] = counts.get(state, 0) + 1
    return counts


class _Again:
    """Writes rows; of a run that had one before, first removes what its new row does not speak of."""

    def __init__(self, store: Store, kept: pa.Table | None, missing: np.ndarray) -> None:
        self._store = store
        runs = np.zeros(0, dtype=np.int64) if kept is None else kept["run"].to_numpy()
        self._before = frozenset(runs[missing[runs]].tolist())

    def append(self, rows: list[dict[str, Any]]) -> None:
        for row in rows:
            if row["run"] in self._before:
                if row["recording"] is None:
                    shutil.rmtree(self._store.folder / RECORDINGS / row["name"], ignore_errors=True)
                if row["outcome"] != "crashed":
                    (self._store.folder / CRASHES / f"{row['name']}.txt").unlink(missing_ok=True)
        self._store.append(rows)


class _Watcher:
    """Shows progress, and keeps the traceback of a crash in a file of the sweep's folder."""

    def __init__(self, progress: SweepProgress, store: Store) -> None:
        self.progress, self._store = progress, store

    def row(self, row: Mapping[str, Any]) -> None:
        self.progress.row(row)

    def trace(self, name: str, text: str) -> None:
        self.progress.trace(name, text)
        (self._store.folder / CRASHES).mkdir(exist_ok=True)
        self._store.write_text(f"{CRASHES}/{name}.txt", text)

    def tick(self, workers: int) -> None:
        interruption.check()
        self.progress.tick(workers)


# ------------------------------------------------------------------------- the runs


class _Jobs:
    """Rows and tasks of a sweep's runs.

    Args:
        definition: of the sweep.
        cases: its runs.
        folder: of the sweep.
    """

    def __init__(self, definition: SweepDefinition, cases: Cases, folder: Path) -> None:
        self.definition, self.cases, self.folder = definition, cases, folder.resolve()
        self._shared = {
            key: value
            for key, value in first_columns(0, "", definition.run, definition.profile, None).items()
            if "." in key
        }

    def missing(self, missing: np.ndarray, accepted: np.ndarray) -> Iterator[dict[str, Any] | Task]:
        """Everything that has no answer yet: rows of refused runs, tasks of the others."""
        for case in np.flatnonzero(missing).tolist():
            try:
                run = self.cases.run(case)
                if not accepted[case]:
                    plan_gait(run.gait, run.body.mass)  # it says why, in words
            except InputError as error:
                yield self._impossible(case, error)
            except RefusedGait as error:
                yield self._refused(case, run, error)
            else:
                yield self.task(case, run)

    def task(self, case: int, run: RunParameters | None = None, *, keep: bool = False) -> Task:
        """One run, for a worker."""
        definition = self.definition
        recordings = definition.recordings if definition.recordings != "worst" else "none"
        return Task(
            run=case,
            name=self.cases.name(case),
            parameters=run or self.cases.run(case),
            profile=definition.profile,
            instrument=definition.instrument,
            recordings="all" if keep else recordings,
            folder=str(self.folder),
            wall_clock=definition.limits.wall_clock,
            code=code_hash(),
            tune=definition.tune,
        )

    def _refused(self, case: int, run: RunParameters, error: RefusedGait) -> dict[str, Any]:
        definition = self.definition
        row = first_columns(case, self.cases.name(case), run, definition.profile, definition.instrument)
        return tidy({**row, **refused_columns(error, run), **_here()})

    def _impossible(self, case: int, error: InputError) -> dict[str, Any]:
        """A run whose parameters are beyond their bounds."""
        values = {**self._shared, **self.cases.row(case)}
        kinds = {"real": float, "whole": int, "text": str, "flag": bool}
        values = {key: kinds[column(key).kind](value) for key, value in values.items()}
        name, definition = self.cases.name(case), self.definition
        key = run_key(values, definition.profile, definition.instrument)
        row = {"run": case, "name": name, "key": key, **values}
        return tidy({**row, **refused_columns(error, None), **_here()})


def _here() -> dict[str, Any]:
    """Environment of a row that this process makes."""
    now = datetime.now(UTC).isoformat(timespec="milliseconds")
    return {**environment_columns(None, 0, now), "environment_memory_peak": None}


# ------------------------------------------------------------------------- the end


def _to_keep(definition: SweepDefinition, table: pa.Table | None, metadata: dict[str, Any]) -> bool:
    """Whether the worst runs of a finished table still lack their folders."""
    if table is None or definition.recordings != "worst":
        return False
    worst = pc.is_in(table["run"], pa.array(worst_runs(table, metadata, definition.worst), pa.int64()))
    return bool(pc.any(pc.and_(worst, pc.is_null(table["recording"]))).as_py())


def _keep_worst(
    jobs: _Jobs,
    table: pa.Table,
    metadata: dict[str, Any],
    store: Store,
    crew: Any,
    narrator: Narrator,
) -> pa.Table:
    """Walk the worst runs again and keep their folders; the table with their names in ``recording``."""
    from validation.study.sweep.execute import Execution

    worst = worst_runs(table, metadata, jobs.definition.worst)
    wanted = [run for run in worst if not (jobs.folder / RECORDINGS / jobs.cases.name(run)).is_dir()]
    again = _Collected()
    those = "worst run" if len(worst) == 1 else f"{len(worst)} worst runs"
    with narrator.stage(f"recordings of the {those}", "runs") as stage:
        if wanted:
            # Without a guard on the clock: they have come to their end before.
            todo = (replace(jobs.task(run, keep=True), wall_clock=None) for run in wanted)
            Execution(crew, todo, again, _Stage(stage, len(wanted))).run()
    interruption.check()
    names = {run: f"{RECORDINGS}/{jobs.cases.name(run)}" for run in worst}
    recording = pa.array([names.get(run) for run in table["run"].to_pylist()], pa.string())
    place = table.schema.get_field_index("recording")
    named = table.set_column(place, schema().field("recording"), recording)
    for row in again.rows:
        if differing := _differing(row, named):
            narrator.say(
                f"ampm: run {row['name']} gave another {differing} when it was walked again for its "
                "recording; the table keeps the first"
            )
    return named


def _differing(row: Mapping[str, Any], table: pa.Table) -> str | None:
    """The first column in which a run that was walked again differs from the table."""
    one = table.filter(pc.equal(table["run"], row["run"])).to_pylist()[0]
    names = (name for name in reproducible_columns() if name != "recording")
    return next((name for name in names if row[name] != one[name]), None)


class _Collected:
    """Rows that are compared, not kept."""

    def __init__(self) -> None:
        self.rows: list[dict[str, Any]] = []

    def append(self, rows: list[dict[str, Any]]) -> None:
        self.rows += rows


class _Stage:
    """Progress of the recordings."""

    def __init__(self, stage: Any, total: int) -> None:
        self._stage, self._total, self._done = stage, total, 0

    def row(self, row: Mapping[str, Any]) -> None:
        self._done += 1
        self._stage.advance(self._done, self._total)

    def trace(self, name: str, text: str) -> None:
        pass

    def tick(self, workers: int) -> None:
        interruption.check()


def _finish(
    store: Store, table: pa.Table, metadata: dict[str, Any], seconds: float, narrator: Narrator
) -> dict[str, Any]:
    """Table, summary and report."""
    table = latest([table])
    store.finish(table)
    store.tidy()
    summary = summarise(table, metadata, seconds=seconds)
    if summary["environments"] > 1:
        narrator.say("ampm: the table mixes rows of different code; environment_code tells them apart")
    store.write_text(SUMMARY, json.dumps(json_ready(summary), indent=2, allow_nan=False) + "\n")
    with narrator.stage("report"):
        _report(store.folder)
    return summary


def _report(folder: Path) -> None:
    from validation.study.sweep.report import write_sweep_report

    write_sweep_report(folder)
