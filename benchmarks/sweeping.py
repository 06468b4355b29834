"""Times a sweep: what two workers gain over one, what a run costs beside its trial, what a worker holds.

The same runs are made four times: bare, one after the other in one warm process that does nothing else; then
as a sweep with one worker and with two; and bare in two processes at once. Everything of a sweep is counted:
the start of the workers, scheduler, progress, durable rows, the table, the report. What two bare processes
gain is what the machine has to give: cores that share memory and heat do not double.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from ampm.exceptions import InputError
from validation.cli.console import Narrator
from validation.show.text import print_line, print_table
from validation.store.environment import describe_environment
from validation.store.folders import check_output_file, output_file
from validation.store.json import json_ready
from validation.study.sweep.cluster import ONE_THREAD, environment
from validation.study.sweep.command import Options, run_sweep
from validation.study.sweep.design import SweepDefinition, parse_sweep
from validation.study.sweep.sampling import cases as cases_of
from validation.study.sweep.store import load_results
from validation.study.sweep.work import Task

RATIO, OVERHEAD, MEMORY = 1.85, 0.03, 500.0
"""Targets: throughput of two workers over one, share of a run beside its trial, peak of a worker [MB]."""

PAGE = Path(__file__).resolve().parents[1] / "docs" / "sweeps.md"
MARKS = ("<!-- speed -->", "<!-- end of speed -->")

_DEFINITION = """
[sweep]
name = "benchmark"
gait = "{gait}"
steps = {steps}
recordings = "none"

[[vary]]
method = "sobol"
count = {runs}
contact.friction = {{ from = 0.75, to = 0.85 }}
controller.com_damping = {{ from = 14.5, to = 15.5 }}
"""


@dataclass(frozen=True)
class SweepTiming:
    """What was found; times in seconds of the wall clock.

    Attributes:
        gait, steps, runs: what was swept.
        bare: time per run in one process that does nothing else.
        bare_pair: the same in each of two processes at once.
        one, two: whole sweep with one and with two workers.
        ratio: throughput of two workers over one.
        machine_ratio: the same of the bare processes: what the machine has to give.
        overhead: of a sweep with one worker, time per run beyond the bare run, over it.
        overhead_steady: the same without what is paid once: start of the workers, table, report.
        memory_peak: largest resident memory of any worker [MB].
        memory_growth: of a worker's peak, from its 16th run to its last [MB].
        load: processes that ran at the start, mean of the last minute.
        environment: versions, processor, revision.
    """

    gait: str
    steps: int
    runs: int
    bare: float
    bare_pair: float
    one: float
    two: float
    ratio: float
    machine_ratio: float
    overhead: float
    overhead_steady: float
    memory_peak: float
    memory_growth: float
    load: float
    environment: dict[str, Any]


def time_sweep(gait: str, steps: int, runs: int, narrator: Narrator) -> SweepTiming:
    """Make the runs in all ways.

    Raises:
        InputError: fewer than 32 runs.
    """
    if runs < 32:
        raise InputError(f"--runs {runs} are too few to tell; take at least 32.")
    load = os.getloadavg()[0]
    definition = parse_sweep(_DEFINITION.format(gait=gait, steps=steps, runs=runs))
    cases = cases_of(definition)
    tasks = [Task(i, cases.name(i), cases.run(i), "default") for i in range(runs)]
    with narrator.stage(f"{runs} bare runs"):
        bare = _bare([tasks])
    with tempfile.TemporaryDirectory(prefix="ampm-benchmark-") as folder:
        one, steady, memory = _swept(definition, Path(folder) / "one", 1, narrator)
        two, _, more = _swept(definition, Path(folder) / "two", 2, narrator)
    with narrator.stage(f"{runs} bare runs in two processes"):
        pair = _bare([tasks[0::2], tasks[1::2]])
    each, each_pair = float(np.mean(bare)), float(np.mean(pair))
    memory += more
    return SweepTiming(
        gait=gait,
        steps=steps,
        runs=runs,
        bare=each,
        bare_pair=each_pair,
        one=one,
        two=two,
        ratio=one / two,
        machine_ratio=2.0 * each / each_pair,
        overhead=one / runs / each - 1.0,
        overhead_steady=steady / each - 1.0,
        memory_peak=max(max(item) for item in memory),
        memory_growth=max(item[-1] - item[min(15, len(item) - 1)] for item in memory),
        load=load,
        environment=describe_environment(),
    )


def _bare(lists: Sequence[Sequence[Task]]) -> list[float]:
    """Seconds of every run, each list in a process of its own, at the same time."""
    with (
        environment(ONE_THREAD),
        ProcessPoolExecutor(len(lists), mp_context=multiprocessing.get_context("spawn")) as pool,
    ):
        list(pool.map(_walk_all, [tasks[:1] for tasks in lists]))  # imports and caches
        return [seconds for found in pool.map(_walk_all, lists) for seconds in found]


def _walk_all(tasks: Sequence[Task]) -> list[float]:
    """Seconds of plan, walk and verdict of every run, and nothing else."""
    from validation.judge.examine import walk
    from validation.trial.plan import Request, plan_walk

    seconds = []
    for task in tasks:
        start = time.perf_counter()
        found = walk(plan_walk(Request(task.name, task.parameters)))
        seconds.append(time.perf_counter() - start)
        if not found.record.outcome.completed:
            raise InputError("a run of the benchmark did not complete; take a gait that walks.")
    return seconds


def _swept(
    definition: SweepDefinition, folder: Path, workers: int, narrator: Narrator
) -> tuple[float, float, list[list[float]]]:
    """Time of a sweep; time per run from the first row to the last; peaks of every worker [MB]."""
    start = time.perf_counter()
    run_sweep(definition, Options(out=folder, workers=workers), narrator=narrator)
    whole = time.perf_counter() - start
    table = load_results(folder).table
    ended = sorted(datetime.fromisoformat(when) for when in table["environment_time"].to_pylist())
    steady = (ended[-1] - ended[0]).total_seconds() / (len(ended) - 1)
    by_worker: dict[str, list[tuple[str, float]]] = {}
    names = ("environment_worker", "environment_time", "environment_memory_peak")
    for worker, when, peak in zip(*(table[name].to_pylist() for name in names), strict=True):
        by_worker.setdefault(worker, []).append((when, peak))
    return whole, steady, [[peak for _, peak in sorted(found)] for found in by_worker.values()]


# ------------------------------------------------------------------------- words


def rows_of(timing: SweepTiming) -> list[tuple[str, str, str]]:
    """Quantity, measured, target."""
    return [
        ("throughput, 2 workers over 1", f"{timing.ratio:.3f}", f">= {RATIO}"),
        ("the same of two bare processes", f"{timing.machine_ratio:.3f}", ""),
        ("overhead per run, everything", f"{100 * timing.overhead:.2f} %", f"<= {100 * OVERHEAD:g} %"),
        ("overhead per run, between first and last row", f"{100 * timing.overhead_steady:.2f} %", ""),
        ("memory of a worker, peak", f"{timing.memory_peak:.0f} MB", f"< {MEMORY:g} MB"),
        ("growth of that after 16 runs", f"{timing.memory_growth:.1f} MB", ""),
        ("a bare run", f"{timing.bare:.3f} s", ""),
        (f"sweep of {timing.runs} runs, 1 worker", f"{timing.one:.1f} s", ""),
        (f"sweep of {timing.runs} runs, 2 workers", f"{timing.two:.1f} s", ""),
    ]


def page_text(timing: SweepTiming) -> str:
    """The table for the documentation."""
    place = timing.environment
    lines = [
        f"{timing.runs} runs of `{timing.gait}`, {timing.steps} steps each, {place['processor']}, "
        f"{place['cores']} cores, load {timing.load:.1f} at the start, "
        f"revision {str(place['revision'])[:10]}:",
        "",
        "| | measured | target |",
        "|---|---|---|",
        *(f"| {name} | {value} | {target} |" for name, value, target in rows_of(timing)),
    ]
    return "\n".join(lines)


def update_page(timing: SweepTiming) -> None:
    """Put the table into docs/sweeps.md."""
    text = PAGE.read_text(encoding="utf-8")
    head, _, rest = text.partition(MARKS[0])
    _, _, tail = rest.partition(MARKS[1])
    PAGE.write_text(f"{head}{MARKS[0]}\n{page_text(timing)}\n{MARKS[1]}{tail}", encoding="utf-8")


app = typer.Typer(
    name="benchmarks sweep",
    pretty_exceptions_enable=False,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.command()
def sweep(
    gait: Annotated[str, typer.Option("--gait", metavar="GAIT", help="Preset or TOML file.")] = "normal",
    steps: Annotated[int, typer.Option("--steps", min=2, help="Walking steps of every run.")] = 30,
    runs: Annotated[int, typer.Option("--runs", help="Runs of every sweep.")] = 64,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write all figures as JSON as well.")
    ] = None,
    to_document: Annotated[
        bool, typer.Option("--markdown", help="Put the table into docs/sweeps.md as well.")
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace an earlier FILE.")] = False,
) -> int:
    """Time a sweep with one worker and with two, beside the same runs without a sweep.

    The default takes about fifteen minutes on an idle machine of two cores, and means little on a busy one.
    Exit status 1 if a target is missed.
    """
    if json_file is not None:
        check_output_file(json_file, force=force)
    narrator = Narrator()
    timing = time_sweep(gait, steps, runs, narrator)
    columns = (("", "left"), ("measured", "right"), ("target", "right"))
    print_table(f"{runs} runs of {gait}, {steps} steps each", columns, rows_of(timing))
    print_line(f"load at the start {timing.load:.1f}")
    if json_file is not None:
        with output_file(json_file, force=force) as work:
            work.write_text(json.dumps(json_ready(asdict(timing)), indent=2) + "\n", encoding="utf-8")
    if to_document:
        update_page(timing)
    met = timing.ratio >= RATIO and timing.overhead <= OVERHEAD and timing.memory_peak < MEMORY
    return 0 if met else 1
