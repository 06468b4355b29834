"""A sweep from its definition to a finished folder, in one or several calls."""

import math
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Unpack

import pyarrow as pa
import pyarrow.parquet as pq

from ampm.exceptions import InputError, RefusedGait
from ampm.planner.step_planners import STEP_PLANNERS
from validation.progress import Progress
from validation.run.walk import timed
from validation.show.text import format_duration
from validation.store.environment import parameter_values
from validation.store.folders import output_file
from validation.store.json import write_json
from validation.store.machine import cores
from validation.study.many import Pool, Task, study_folder, walk_many
from validation.study.pool import error_columns
from validation.study.row_file import Row
from validation.study.sweep.design import SweepDefinition, dump_sweep, load_sweep
from validation.study.sweep.schema import walk_columns
from validation.study.sweep.table import (
    DEFINITION,
    RECORDINGS,
    REPORT,
    RESULTS,
    SUMMARY,
    State,
    SweepTable,
    build_table,
    key_of,
    wrap_table,
)
from validation.study.walk_options import users_classes, walk_request
from validation.table import Table, Tabled
from validation.trial.plan import Request, check_formula
from validation.trial.users import UsersError

_TRIED = 8  # runs that a dry run tries until one of them can be walked


def sweep(
    definition: SweepDefinition | str | Path,
    out: str | Path | None = None,
    *,
    resume: bool = False,
    **pool: Unpack[Pool],
) -> SweepTable:
    """Walk many runs; ``sweep("slopes.toml").table.to_pandas()``, with the extra pandas, gives a row per run.

    Args:
        definition: TOML file, or a loaded definition.
        out: folder of the sweep; without one only the table is kept, and no recording.
        resume: go on in the folder: walk the runs that have no row of this definition and this code.
        pool: where to walk, see :class:`validation.study.many.Pool`.

    Raises:
        InputError: bad options, a bad definition, or a folder that cannot be used.
        StudyStopped: a full disk, a lost scheduler, no workers; finished runs are kept.
        KeyboardInterrupt: Ctrl-C; finished runs are kept.
    """
    if not isinstance(definition, SweepDefinition):
        definition = load_sweep(definition)
    folder = study_folder(out, resume=resume)
    progress = pool.get("progress") or Progress()
    rows = walk_many(_Runs(definition, folder), folder, limit=definition.wall_clock, label="sweep", **pool)
    found = wrap_table(build_table(definition, rows), folder, definition.name)
    if folder is None:
        return found
    kept = pa.array(_keep_worst(definition, found, folder, pool), pa.string())
    column = found.table.schema.get_field_index("recording")
    found = replace(found, table=found.table.set_column(column, "recording", kept))
    with output_file(folder / RESULTS) as file:
        pq.write_table(found.table, file, compression="zstd")
    write_json(folder / SUMMARY, found.summary())
    with progress.stage("report"):
        from validation.study.sweep.report import write_sweep_report  # loads Vega's JavaScript engine

        write_sweep_report(folder)
    return found


class _Runs:
    """Tasks of a sweep, made one by one.

    Args:
        definition: of the sweep.
        folder: where the definition is written, and the table of an earlier call removed, before the first
            task: the engine has then locked the folder.
    """

    def __init__(self, definition: SweepDefinition, folder: Path | None) -> None:
        self._definition, self._folder = definition, folder

    def __len__(self) -> int:
        return len(self._definition)

    def __iter__(self) -> Iterator[Task]:
        if self._folder is not None:
            (self._folder / RESULTS).unlink(missing_ok=True)
            (self._folder / DEFINITION).write_text(dump_sweep(self._definition), encoding="utf-8")
        for run in range(len(self)):
            yield task_of(self._definition, run)


def task_of(definition: SweepDefinition, run: int) -> Task:
    """One run of a sweep; what bounds or formula refuse needs no walk."""
    key = key_of(definition, run)
    try:
        options = _options(definition, run)
        if options["request"].run.gait.planner in STEP_PLANNERS:
            check_formula(options["request"])
    except (InputError, RefusedGait) as error:
        return Task(key, walk_run, {"varied": definition.varied(run)}, error_columns(error))
    return Task(key, walk_run, options)


def _options(definition: SweepDefinition, run: int) -> dict[str, Any]:
    """Arguments of :func:`validation.study.walk_options.walk_request`."""
    request = Request(definition.name_of(run), definition.parameters(run), definition.varied(run))
    return {"request": request, "profile": definition.profile, **users_classes(request.run)}


def walk_run(**options: Any) -> Row:
    """Walk one run on a worker, see :func:`validation.study.walk_options.walk_request`."""
    trial = walk_request(**options)
    if trial.record.outcome.name == "crashed":  # an error of the user's code is no result about the gait
        raise UsersError(trial.record.outcome.cause)
    requested, found = (parameter_values(run) for run in (options["request"].run, trial.run))
    return {**{key: found[key] for key in found if found[key] != requested[key]}, **walk_columns(trial)}


# ------------------------------------------------------------------------------------------ kept folders


def keep_run(folder: str, **options: Any) -> Row:
    """Walk one run again, to the same bits, and write its folder as ``ampm validate`` does."""
    walk_request(**options).save(folder, force=True)
    return {"outcome": "kept"}


def _keep_worst(definition: SweepDefinition, found: SweepTable, folder: Path, pool: Pool) -> list[str | None]:
    """Keep the folders of the worst runs, or of the worst failures; returns the column ``recording``."""
    passed, numbers = found.is_state(State.PASS), found.table["run"].to_pylist()
    rows = [row for row in found.worst if definition.recordings == "worst" or not passed[row]]
    rows = [] if definition.recordings == "none" else rows[: definition.worst]
    names = {row: f"{RECORDINGS}/{definition.name_of(numbers[row])}" for row in rows}
    if not names:
        return [None] * len(found)
    tasks = [
        Task(name, keep_run, {"folder": str(folder.resolve() / name), **_options(definition, numbers[row])})
        for row, name in names.items()
    ]
    for row in walk_many(tasks, folder / RECORDINGS, label="recordings of the worst runs", **pool):
        if row["outcome"] != "kept":
            progress = pool.get("progress") or Progress()
            progress.say(f"ampm: {folder / row['key']} was not written ({row['cause']}).")
    return [
        name if name and (folder / name / REPORT).is_file() else None
        for name in map(names.get, range(len(found)))
    ]


# --------------------------------------------------------------------------------------------- dry run


@dataclass(frozen=True)
class Forecast(Tabled):
    """What a sweep would walk."""

    refused: SweepTable  # runs that bounds or formula refuse
    # wall-clock time of one run, from a walk; None if the tried runs cannot be walked [s]
    seconds: float | None
    drawing: float  # of its report and recording [s]
    kept: int  # runs that are walked once more at the end, at most, for their report and recording
    workers: int  # processes

    @property
    def walking(self) -> int:
        """Runs that can walk, at most."""
        return self.refused.planned - len(self.refused)

    def as_dict(self) -> dict[str, Any]:
        """Plain values, times in s."""
        return {
            "runs": self.refused.planned,
            "refused": self.refused.summary()["refusals"],
            "walking": self.walking,
            "seconds": self.seconds,
            "wall_clock": self.seconds and self.seconds * math.ceil(self.walking / self.workers),
            "kept": self.kept,
            "keeping": self.seconds and (self.seconds + self.drawing) * math.ceil(self.kept / self.workers),
            "workers": self.workers,
        }

    def tables(self) -> list[Table]:
        """Numbers of runs, with examples of the refusals."""
        rows = [
            ("runs", f"{self.refused.planned:,}", ""),
            *self.refused.result().rows,
            ("can walk, at most", f"{self.walking:,}", ""),
        ]
        note = "no run that was tried can be walked"
        if self.seconds is not None:
            found = self.as_dict()
            one, every, more = (format_duration(found[name]) for name in ("seconds", "wall_clock", "keeping"))
            note = f"one run takes about {one}, the sweep about {every} with {self.workers} workers"
            if self.kept:
                note += f"; to walk {self.kept} runs again and keep them with report and recording, {more}"
        return [Table(f"dry run of {self.refused.name}", ("", ">runs", "for example"), rows, [note])]


def forecast(
    definition: SweepDefinition, workers: int | None = None, *, progress: Progress | None = None
) -> Forecast:
    """Count runs and refusals by formula, and time one walk.

    Args:
        definition: the sweep.
        workers: processes that it would have, one per core by default.
        progress: where to report stages.
    """
    progress = progress or Progress()
    rows: list[Row] = []
    walking: list[Task] = []
    with progress.stage("refusals by formula", "runs") as stage:
        for run in range(len(definition)):
            stage.advance(run, len(definition))
            task = task_of(definition, run)
            if task.known is not None:
                rows.append({"key": task.key, **task.known})
            elif len(walking) < _TRIED:
                walking.append(task)
    taken: dict[str, float] = {}
    kept = 0 if definition.recordings == "none" else min(definition.worst, len(definition) - len(rows))
    for task in walking:
        with progress.stage("walk of one run, to time it"), suppress(InputError, RefusedGait):
            with timed(taken, "walk"):
                trial = walk_request(**task.options)
            if kept:
                with tempfile.TemporaryDirectory(prefix="ampm-forecast-") as folder, timed(taken, "drawing"):
                    trial.save(folder)
            break
    refused = wrap_table(build_table(definition, rows), None, definition.name)
    workers = min(workers or cores(), len(definition))
    return Forecast(refused, taken.get("walk"), taken.get("drawing", 0.0), kept, workers)
