"""A sweep from its definition to a finished folder, in one or several calls."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Unpack

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from ampm.exceptions import InputError, RefusedGait
from ampm.planner.step_planners import STEP_PLANNERS
from validation.judge.metrics import METRICS
from validation.progress import Progress
from validation.run.walk import timed
from validation.store.environment import parameter_values
from validation.store.folders import output_file, write_whole
from validation.store.json import write_json
from validation.store.machine import cores
from validation.study.many import Execution, Task, keep_run, study_folder, walk_many, walk_request
from validation.study.pool import error_columns
from validation.study.row_file import ROWS, UNFINISHED, Row, read_rows
from validation.study.sweep.design import SweepDefinition, check_classes, dump_sweep, load_sweep
from validation.study.sweep.report import write_sweep_report
from validation.study.sweep.schema import walk_columns
from validation.study.sweep.table import RunState, SweepFile, SweepTable, build_table, key_of
from validation.table import Table, Tabled, format_duration
from validation.trial.plan import Request, check_formula
from validation.trial.users import UsersError, users_classes

_CHECKED, _TRIED = 1000, 8  # runs that a dry run checks; that it tries until one of them can be walked


def sweep(definition: SweepDefinition | str | Path, **execution: Unpack[Execution]) -> SweepTable:
    """Walk many runs; ``sweep("slopes.toml").table.to_pandas()``, with the extra pandas, gives a row per run.

    Args:
        definition: TOML file, or a loaded definition.
        execution: workers and folder, see :class:`validation.study.many.Execution`; without a folder only the
            table is kept, and no recording.

    Raises:
        InputError: bad options, a bad definition, or a folder that cannot be used.
        StudyStopped: a full disk, a lost scheduler, no workers; finished runs are kept.
        KeyboardInterrupt: Ctrl-C; finished runs are kept.
    """
    if not isinstance(definition, SweepDefinition):
        definition = load_sweep(definition)
    check_classes(definition)
    folder, progress = study_folder(execution), execution.get("progress") or Progress()
    tasks, count, limit = _tasks(definition, folder), len(definition), definition.wall_clock
    rows = walk_many(tasks, count=count, limit=limit, label="sweep", **execution)
    found = SweepTable(build_table(definition, rows), folder, definition.name)
    if folder is None:
        return found
    passed, names = found.is_state(RunState.PASS), found.words("name")
    worst = [row for row in found.worst if definition.recordings == "worst" or not passed[row]]
    runs = {names[row]: int(names[row]) for row in worst[: definition.worst]}
    there: Execution = {**execution, "out": folder / SweepFile.RECORDINGS, "resume": True}
    written = keep_runs(definition, found, {} if definition.recordings == "none" else runs, **there)
    kept = [f"{SweepFile.RECORDINGS}/{name}" if name in written else None for name in names]
    column = found.table.schema.get_field_index("recording")
    table = found.table.set_column(column, found.table.field(column), pa.array(kept, pa.string()))
    found = replace(found, table=table)
    with output_file(folder / SweepFile.RESULTS) as file:
        pq.write_table(found.table, file, compression="zstd")
    write_json(folder / SweepFile.SUMMARY, found.as_dict())
    with progress.stage("report"):
        write_sweep_report(folder)
    return found


def _tasks(definition: SweepDefinition, folder: Path | None) -> Iterator[Task]:
    """Every run; before the first, when the engine has locked the folder, the definition is written there."""
    if folder is not None:
        (folder / SweepFile.RESULTS).unlink(missing_ok=True)
        write_whole(folder / SweepFile.DEFINITION, dump_sweep(definition))
        (folder / ROWS).touch()  # a sweep that ends before its first row can be resumed
    for run in range(len(definition)):
        yield task_of(definition, run)


def task_of(definition: SweepDefinition, run: int) -> Task:
    """One run of a sweep; one whose keys do not go together, or that the formula refuses, needs no walk."""
    key = key_of(definition, run)
    try:
        options = _options(definition, run)
        users_classes(options)
        if options["request"].run.gait.planner in STEP_PLANNERS:
            check_formula(options["request"])
    except (InputError, RefusedGait) as error:
        return Task(key, walk_run, {"varied": definition.varied(run)}, error_columns(error))
    return Task(key, walk_run, options)


def _options(definition: SweepDefinition, run: int) -> dict[str, Any]:
    """Arguments of :func:`validation.study.many.walk_request`."""
    request = Request(definition.name_of(run), definition.parameters(run), definition.varied(run))
    return {"request": request, "profile": definition.judged_by.name}


def walk_run(**options: Any) -> Row:
    """Walk one run on a worker, see :func:`validation.study.many.walk_request`."""
    trial = walk_request(**options)
    if trial.record.outcome.name == "crashed":  # an error of the user's code is no result about the gait
        raise UsersError(trial.record.outcome.cause)
    requested, found = (parameter_values(run) for run in (options["request"].run, trial.run))
    return {**{key: found[key] for key in found if found[key] != requested[key]}, **walk_columns(trial)}


def keep_runs(
    sweep: SweepDefinition, found: SweepTable, runs: Mapping[str, int], **execution: Unpack[Execution]
) -> list[str]:
    """Walk runs of a sweep again, each into a folder of its name with report and recording; those written.

    Tells which of them were not written, or did not walk as in the table.
    """
    folder = study_folder(execution)
    if folder is None or not runs:
        return []
    tasks = [
        Task(name, keep_run, {"folder": str(folder.resolve() / name), **_options(sweep, run)})
        for name, run in runs.items()
    ]
    progress, numbers = execution.get("progress") or Progress(), found.table["run"].to_pylist()
    for row in walk_many(tasks, label="recordings", **execution):
        line, values = numbers.index(runs[row["key"]]), row.get("metrics", {})
        if "reason" in row:
            progress.say(f"ampm: {folder / row['key']} was not written ({row['cause']}).")
        elif any(found.numbers(METRICS[name].column)[line] != value for name, value in values.items()):
            progress.say(
                f"ampm: {folder / row['key']} is not the walk of the table: a class of its run was edited or "
                "is not deterministic, or the sweep was walked on another machine."
            )
    return [name for name in runs if (folder / name / SweepFile.REPORT).is_file()]


@dataclass(frozen=True)
class Forecast(Tabled):
    """What a sweep would walk."""

    refused: SweepTable  # refused runs, of those that were checked
    found: Mapping[str, Any]  # numbers of runs, and times [s]; None if no tried run can be walked

    def as_dict(self) -> dict[str, Any]:
        """Plain values, times in s."""
        return {**self.found, "refused": self.refused.as_dict()["refusals"]}

    def tables(self) -> list[Table]:
        """Numbers of runs, with examples of the refusals."""
        found, refused = self.found, self.refused.tables()[0]
        names = ("runs", "checked", "finished")
        rows: list[Sequence[str]] = [(name, f"{found[name]:,}", "") for name in names]
        rows += [*refused.rows, ("can walk, at most", f"{found['walking']:,}", "")]
        note = "nothing is left to walk" if found["finished"] else "no run that was tried can be walked"
        if found["seconds"] is not None:
            one, every = (format_duration(found[name]) for name in ("seconds", "wall_clock"))
            note = f"one run takes about {one}, the sweep about {every} with {found['workers']} workers"
            if found["kept"]:
                note += f"; up to {found['kept']} of them are walked again, with report and recording"
        notes = [*refused.notes, note]
        return [Table(f"dry run of {self.refused.name}", ("", ">runs", "for example"), rows, notes)]


def forecast(definition: SweepDefinition, **execution: Unpack[Execution]) -> Forecast:
    """Count refusals by formula, of a large sweep in a sample, and of the runs tried to time one walk.

    With ``resume``, runs that the folder has are finished.
    """
    check_classes(definition)
    progress, planned = execution.get("progress") or Progress(), len(definition)
    folder = study_folder(execution if execution.get("resume") else {**execution, "out": None})
    kept_rows = read_rows(folder) if folder is not None and (folder / ROWS).is_file() else ()
    known = {row["key"]: row["digest"] for row in kept_rows if row.get("outcome") not in UNFINISHED}
    runs = np.unique(np.linspace(0, planned - 1, min(planned, _CHECKED)).astype(int)).tolist()
    with progress.stage("refusals by formula", "runs") as stage:
        tasks = []
        for number, run in enumerate(runs):
            stage.advance(number, len(runs))
            tasks.append(task_of(definition, run))
    tasks = [task for task in tasks if known.get(task.key) != task.digest]
    rows = [{"key": task.key, **task.known} for task in tasks if task.known is not None]
    taken: dict[str, float] = {}
    for task in [task for task in tasks if task.known is None][:_TRIED]:
        try:
            with progress.stage("walk of one run, to time it"), timed(taken, "walk"):
                walk_request(**task.options)
            break
        except (InputError, RefusedGait) as error:
            rows.append({"key": task.key, **error_columns(error)})
    refused = SweepTable(build_table(definition, rows), None, definition.name)
    walking = round(planned * (len(tasks) - len(rows)) / len(runs))
    kept = 0 if definition.recordings == "none" else min(definition.worst, walking)
    processes = execution.get("workers")
    workers = min(cores() if processes is None else max(processes, 1), planned)
    rounds = math.ceil(walking / workers) + math.ceil(kept / workers)
    numbers = {"runs": planned, "checked": len(runs), "finished": len(runs) - len(tasks)}
    numbers |= {"walking": walking, "kept": kept, "workers": workers}
    seconds = taken.get("walk")
    return Forecast(refused, numbers | {"seconds": seconds, "wall_clock": seconds and seconds * rounds})
