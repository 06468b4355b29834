"""The stages of a run, from planning to the report, and what it takes of memory and disk."""

import math
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from validation.progress import Progress, Stage
from validation.run.validate import validate
from validation.store.machine import memory_peak
from validation.table import Table, format_duration
from validation.trial.plan import Request


class Cost(NamedTuple):
    """One cost of a run."""

    name: str  # what costs
    value: float  # in `unit`; NaN if unknown
    unit: str = "s"  # s, MB, or MB/s for megabytes per simulated second


class StageClock(Progress):
    """Measures the duration of every stage.

    Attributes:
        seconds: wall-clock time by the stage's label, without the name of the gait before a colon [s].
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def stage(self, label: str, unit: str = "") -> Iterator[Stage]:
        """Time one stage; a stage that raises is not counted."""
        start = time.perf_counter()
        yield Stage()
        self.seconds[label.rpartition(": ")[2]] = time.perf_counter() - start


def time_run(request: Request, runs: int, progress: Progress) -> list[Cost]:
    """Make the same run several times, with report and recording; of each stage the least time counts."""
    found: list[dict[str, float]] = []
    with progress.stage(f"{runs} runs"), tempfile.TemporaryDirectory(prefix="ampm-benchmark-") as folder:
        for number in range(runs):
            target, clock = Path(folder) / str(number), StageClock()
            summary = validate(request, target, progress=clock)
            size = (target / "recording.rrd").stat().st_size / 1e6
            found.append(
                {
                    **summary["timing"],
                    "recording": clock.seconds["recording"],
                    "report": clock.seconds["report"],
                    "size": size / summary["timing"]["simulated"],
                }
            )
    stages = ("planning", "simulation", "measurement", "recording", "report")
    return [
        *(Cost(stage, min(run[stage] for run in found)) for stage in stages),
        Cost("size of the recording", found[0]["size"], "MB/s"),
        Cost("memory peak", memory_peak() or math.nan, "MB"),
    ]


def cost_table(costs: list[Cost]) -> Table:
    """One row for each cost."""
    rows = [(name, format_duration(x) if unit == "s" else f"{x:.3g} {unit}") for name, x, unit in costs]
    return Table("run", ("", ">"), rows)
