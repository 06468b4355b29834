"""Times a sweep: what two workers gain over one, what a run costs beside its trial, what a worker holds.

The same runs are made four times: bare, one after the other in one warm process that does nothing else; then
as a sweep with one worker and with two; and bare in two processes at once. Everything of a sweep is counted:
the start of the workers, scheduler, progress, durable rows, the table, the report. What two bare processes
gain is what the machine has to give: cores that share memory and heat do not double.
"""

from __future__ import annotations

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
from validation.progress import Progress
from validation.show.text import print_table
from validation.store.environment import describe_environment
from validation.store.json import write_json
from validation.study.sweep.design import SweepDefinition, parse_sweep
from validation.study.sweep.run import sweep as walk_sweep
from validation.study.sweep.workers import ONE_THREAD, environment
from validation.trial.plan import Request, plan_walk

RATIO, OVERHEAD, MEMORY = 1.85, 0.03, 500.0
"""Targets: throughput of two workers over one, share of a run beside its trial, peak of a worker [MB]."""

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
    """Times of a sweep, in seconds of the wall clock.

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


def time_sweep(gait: str, steps: int, runs: int, narrator: Progress) -> SweepTiming:
    """Make the runs in all ways.

    Raises:
        InputError: fewer than 32 runs.
    """
    if runs < 32:
        raise InputError(f"--runs {runs} are too few for a result; take at least 32.")
    load = os.getloadavg()[0]
    definition = parse_sweep(_DEFINITION.format(gait=gait, steps=steps, runs=runs))
    requests = [Request(definition.name_of(i), definition.parameters(i)) for i in range(runs)]
    with narrator.stage(f"{runs} bare runs"):
        bare = _bare([requests])
    with tempfile.TemporaryDirectory(prefix="ampm-benchmark-") as folder:
        one, steady, memory = _swept(definition, Path(folder) / "one", 1, narrator)
        two, _, more = _swept(definition, Path(folder) / "two", 2, narrator)
    with narrator.stage(f"{runs} bare runs in two processes"):
        pair = _bare([requests[0::2], requests[1::2]])
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


def _bare(lists: Sequence[Sequence[Request]]) -> list[float]:
    """Seconds of every run, each list in a process of its own, at the same time."""
    with (
        environment(ONE_THREAD),
        ProcessPoolExecutor(len(lists), mp_context=multiprocessing.get_context("spawn")) as pool,
    ):
        list(pool.map(_walk_all, [requests[:1] for requests in lists]))  # imports and caches
        return [seconds for found in pool.map(_walk_all, lists) for seconds in found]


def _walk_all(requests: Sequence[Request]) -> list[float]:
    """Seconds of plan, walk and verdict of every run, and nothing else."""
    # Here, not above: a worker's process loads the simulator, this one does not.
    from validation.run.walk import walk_planned

    seconds = []
    for request in requests:
        start = time.perf_counter()
        found = walk_planned(plan_walk(request))
        seconds.append(time.perf_counter() - start)
        if not found.record.outcome.completed:
            raise InputError("a run of the benchmark did not complete; take a gait that walks.")
    return seconds


def _swept(
    definition: SweepDefinition, folder: Path, workers: int, narrator: Progress
) -> tuple[float, float, list[list[float]]]:
    """Time of a sweep; time per run from the first row to the last; peaks of every worker [MB]."""
    start = time.perf_counter()
    table = walk_sweep(definition, folder, workers=workers, progress=narrator).table
    whole = time.perf_counter() - start
    ended = sorted(datetime.fromisoformat(when) for when in table["environment_time"].to_pylist())
    steady = (ended[-1] - ended[0]).total_seconds() / (len(ended) - 1)
    by_worker: dict[str, list[tuple[str, float]]] = {}
    names = ("environment_worker", "environment_time", "environment_memory_peak")
    for worker, when, peak in zip(*(table[name].to_pylist() for name in names), strict=True):
        by_worker.setdefault(worker, []).append((when, peak))
    return whole, steady, [[peak for _, peak in sorted(found)] for found in by_worker.values()]


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


app = typer.Typer(pretty_exceptions_enable=False, add_completion=False)


@app.command()
def sweep(
    gait: Annotated[str, typer.Option("--gait", metavar="GAIT", help="Preset or TOML file.")] = "normal",
    steps: Annotated[int, typer.Option("--steps", min=2, help="Walking steps of every run.")] = 30,
    runs: Annotated[int, typer.Option("--runs", help="Runs of every sweep.")] = 64,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write everything as JSON as well.")
    ] = None,
) -> int:
    """Time a sweep with one worker and with two, beside the same runs without a sweep.

    The default takes about fifteen minutes on an idle machine of two cores, and means little on a busy one.
    Exit status 1 if a target is missed.
    """
    timing = time_sweep(gait, steps, runs, Narrator())
    title = f"{runs} runs of {gait}, {steps} steps each, load {timing.load:.1f} at the start"
    print_table(title, ("", ">measured", ">target"), rows_of(timing))
    if json_file is not None:
        write_json(json_file, asdict(timing))
    met = timing.ratio >= RATIO and timing.overhead <= OVERHEAD and timing.memory_peak < MEMORY
    return 0 if met else 1
