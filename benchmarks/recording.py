"""Cost of a recording: its share of a run's time and its size, in a process as a user has it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from validation.progress import Progress, Stage
from validation.store.machine import memory_peak

MOST_SHARE = 0.10
"""Share of a run's time that a recording may cost."""

MOST_SIZE = 1e6
"""Bytes per simulated second that it may take."""

_RUN = ("planning", "simulation", "measurement")
"""Stages of a run whose time a recording's is held against; reading, writing and the report come on top."""


@dataclass(frozen=True)
class RecordingCost:
    """Cost of one run's recording; times in seconds, of every stage the least of several equal runs.

    Attributes:
        run: planning with a motion that was not known, simulation and measurement.
        recording: writing the recording, the import of the viewer's library included.
        report: writing the report, the import of matplotlib included.
        size: of the recording [bytes].
        simulated: simulated time [s].
        memory_peak: largest resident memory of the process, drawing included [MB].
    """

    run: float
    recording: float
    report: float
    size: int
    simulated: float
    memory_peak: float

    @property
    def share(self) -> float:
        """Time of the recording over that of the run [1]."""
        return self.recording / self.run

    @property
    def rate(self) -> float:
        """Size per simulated second [bytes/s]."""
        return self.size / self.simulated

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {**asdict(self), "share": self.share, "bytes_per_second": self.rate}


def time_recording(run_file: Path, *, rounds: int) -> RecordingCost:
    """Run the same trial several times, each in a process of its own and without a known motion.

    Args:
        run_file: complete parameters (TOML).
        rounds: how many trials.

    Raises:
        RuntimeError: a trial failed.
    """
    found = [_one(run_file) for _ in range(rounds)]
    return RecordingCost(
        run=sum(min(one[stage] for one in found) for stage in _RUN),
        recording=min(one["recording"] for one in found),
        report=min(one["report"] for one in found),
        size=int(found[0]["size"]),
        simulated=found[0]["simulated"],
        memory_peak=max(one["memory_peak"] for one in found),
    )


def _one(run_file: Path) -> dict[str, float]:
    with tempfile.TemporaryDirectory(prefix="ampm-benchmark-") as folder:
        done = subprocess.run(
            [sys.executable, "-m", "benchmarks.recording", str(run_file), str(Path(folder) / "run")],
            env={**os.environ, "XDG_CACHE_HOME": folder},
            cwd=Path(__file__).resolve().parents[1],
            capture_output=True,
            text=True,
            check=False,
        )
    if done.returncode:
        raise RuntimeError(f"the trial of the recording's benchmark failed:\n{done.stderr}")
    answer: dict[str, float] = json.loads(done.stdout)
    return answer


class _Times(Progress):
    """Keeps how long every stage took."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def stage(self, label: str, unit: str = "") -> Iterator[Stage]:
        """Time one stage."""
        start = time.perf_counter()
        yield Stage()
        self.seconds[label.rpartition(": ")[2]] = time.perf_counter() - start


def _trial(run_file: Path, target: Path) -> dict[str, float]:
    """The trial itself, in a fresh process."""
    # Here, not above: the process that only starts the trials needs neither simulator nor body.
    from validation.run import validate as run
    from validation.trial.plan import load_request

    stages = _Times()
    summary = run.validate(load_request(str(run_file)), target, progress=stages)
    timing = summary["timing"]
    return {
        **{stage: timing[stage] for stage in _RUN if stage in timing},
        **{stage: stages.seconds[stage] for stage in ("measurement", "recording", "report")},
        "simulated": timing["simulated"],
        "size": (target / "recording.rrd").stat().st_size,
        "memory_peak": memory_peak() or float("nan"),
    }


if __name__ == "__main__":
    print(json.dumps(_trial(Path(sys.argv[1]), Path(sys.argv[2]))))
