"""Times a sweep: gain of two workers over one, overhead of a run beside its trial, memory of a worker.

The same runs are made four times: bare, one after the other in one warm process that does nothing else; then
as a sweep with one worker and with two; and bare in two processes at once. Everything of a sweep is counted:
the start of the workers, scheduler, progress, durable rows, the table, the report. The gain of two bare
processes is the machine's limit: cores share memory and thermal limits.
"""

import multiprocessing
import os
import tempfile
import time
from collections import defaultdict
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from ampm.exceptions import InputError
from validation.progress import Progress
from validation.store.environment import describe_environment
from validation.store.machine import set_variables
from validation.study.pool import ONE_THREAD
from validation.study.row_file import read_rows
from validation.study.sweep.design import SweepDefinition, parse_sweep
from validation.study.sweep.run import sweep
from validation.trial.plan import Request, plan_walk

RATIO, OVERHEAD, MEMORY = 1.85, 0.03, 500.0
"""Targets: throughput of two workers over one, share of a run beside its trial, peak of a worker [MB]."""

DEFINITION = """
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
_FEWEST = 32  # runs
_WARM = 16  # runs after which a worker's memory should not grow


def time_sweep(gait: str, steps: int, runs: int, progress: Progress) -> dict[str, Any]:
    """Make the runs in all ways.

    Returns:
        Times in seconds, of the whole sweep with ``one`` and ``two`` workers and of a ``bare`` run;
        throughputs and overheads as ratios; peaks of the workers' memory and their growth after the 16th run
        in MB; ``load`` of the machine at the start, versions and processor. :func:`rows` makes a table of it.

    Raises:
        InputError: too few runs.
    """
    if runs < _FEWEST:
        raise InputError(f"--runs {runs} are too few for a result; take at least {_FEWEST}.")
    load = os.getloadavg()[0]
    definition = parse_sweep(DEFINITION.format(gait=gait, steps=steps, runs=runs))
    requests = [Request(definition.name_of(i), definition.parameters(i)) for i in range(runs)]
    with progress.stage(f"{runs} bare runs"):
        bare = bare_runs([requests])
    with tempfile.TemporaryDirectory(prefix="ampm-benchmark-") as folder:
        one, peaks = _swept(definition, Path(folder) / "one", 1, progress)
        two, more = _swept(definition, Path(folder) / "two", 2, progress)
    with progress.stage(f"{runs} bare runs in two processes"):
        pair = bare_runs([requests[0::2], requests[1::2]])
    peaks += more
    return {
        "gait": gait,
        "steps": steps,
        "runs": runs,
        "bare": bare,
        "one": one,
        "two": two,
        "ratio": one / two,
        "machine_ratio": 2.0 * bare / pair,
        "overhead": one / runs / bare - 1.0,
        "memory_peak": max(max(item) for item in peaks),
        "memory_growth": max(item[-1] - item[min(_WARM, len(item)) - 1] for item in peaks),
        "load": load,
        "environment": describe_environment(),
    }


def is_met(timing: Mapping[str, Any]) -> bool:
    """Whether all targets are met."""
    good = timing["ratio"] >= RATIO and timing["overhead"] <= OVERHEAD and timing["memory_peak"] < MEMORY
    return bool(good)


def rows(timing: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Quantity, measured, target."""
    return [
        ("throughput, 2 workers over 1", f"{timing['ratio']:.3f}", f">= {RATIO}"),
        ("the same of two bare processes", f"{timing['machine_ratio']:.3f}", ""),
        ("overhead per run, everything", f"{timing['overhead']:.2%}", f"<= {OVERHEAD:.0%}"),
        ("memory of a worker, peak", f"{timing['memory_peak']:.0f} MB", f"< {MEMORY:g} MB"),
        ("growth of that after 16 runs", f"{timing['memory_growth']:.1f} MB", ""),
        ("a bare run", f"{timing['bare']:.3f} s", ""),
        ("whole sweep, 1 worker", f"{timing['one']:.1f} s", ""),
        ("whole sweep, 2 workers", f"{timing['two']:.1f} s", ""),
    ]


def bare_runs(lists: Sequence[Sequence[Request]]) -> float:
    """Mean time of a run, each list in a process of its own, at the same time [s]."""
    with (
        set_variables(ONE_THREAD),
        ProcessPoolExecutor(len(lists), mp_context=multiprocessing.get_context("spawn")) as pool,
    ):
        list(pool.map(_walk_all, [requests[:1] for requests in lists]))  # imports and caches
        return float(np.mean([seconds for found in pool.map(_walk_all, lists) for seconds in found]))


def _walk_all(requests: Sequence[Request]) -> list[float]:
    """Seconds of plan, walk and verdict of every run, and nothing else."""
    # Imported here: a worker's process loads the simulator, this one does not.
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
    definition: SweepDefinition, folder: Path, workers: int, progress: Progress
) -> tuple[float, list[list[float]]]:
    """Time of a sweep [s], and peaks of the memory of every worker in the order of its runs [MB]."""
    start = time.perf_counter()
    sweep(definition, folder, workers=workers, progress=progress)
    whole = time.perf_counter() - start
    peaks = defaultdict(list)
    for row in read_rows(folder):
        peaks[row["worker"]].append(row["memory_peak"])
    return whole, list(peaks.values())
