"""Cost of a recording: its share of a run's time and its size, in a fresh process."""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

from ampm.parameters import RunParameters
from ampm.run_file import dump_run
from benchmarks.clock import Line
from validation.progress import StageClock
from validation.store.machine import memory_peak

MOST_SHARE = 0.10
"""Share of a run's time that a recording may cost."""

MOST_SIZE = 1.0
"""Megabytes per simulated second that it may take."""


def time_recording(run: RunParameters, rounds: int) -> list[Line]:
    """Run the same trial several times, each in a process of its own and without a known motion.

    Args:
        run: complete parameters.
        rounds: how many trials; of every stage the least time counts.

    Raises:
        RuntimeError: a trial failed.
    """
    found = [run_alone(run) for _ in range(rounds)]
    least = {name: min(one[name] for one in found) for name in found[0]}
    # Reading, writing and the report come on top.
    whole = sum(least[stage] for stage in ("planning", "simulation", "measurement"))
    size = least["size"] / least["simulated"] / 1e6
    return [
        Line.of("planning, simulation, measurement", whole),
        Line.of("recording", least["recording"]),  # the import of the viewer's library included
        Line.of("recording, share of the run's time", least["recording"] / whole, "1", limit=MOST_SHARE),
        Line.of("recording, per simulated second", size, "MB", limit=MOST_SIZE),
        Line.of("report", least["report"]),  # the import of matplotlib included
        Line.of("memory peak", max(one["memory_peak"] for one in found), "MB"),
    ]


def run_alone(run: RunParameters) -> dict[str, float]:
    """Make a trial in a fresh process.

    Returns:
        Seconds by stage, sizes of recording and folder [byte], memory peak [MB].

    Raises:
        RuntimeError: the trial failed.
    """
    with tempfile.TemporaryDirectory(prefix="ampm-benchmark-") as folder:
        file = Path(folder) / "gait.toml"
        file.write_text(dump_run(run), encoding="utf-8")
        done = subprocess.run(
            [sys.executable, "-m", "benchmarks.recording", str(file), str(Path(folder) / "run")],
            cwd=Path(__file__).resolve().parents[1],
            capture_output=True,
            text=True,
            check=False,
        )
    if done.returncode:
        raise RuntimeError(f"the trial of the recording's benchmark failed:\n{done.stderr}")
    answer: dict[str, float] = json.loads(done.stdout)
    return answer


def _trial(run_file: Path, target: Path) -> dict[str, float]:
    """The trial itself, in a fresh process: times by stage, simulated time, size, peak of memory."""
    # Imported here: the process that only starts the trials needs neither simulator nor body.
    from validation.run.validate import validate
    from validation.trial.plan import load_request

    stages = StageClock()
    summary = validate(load_request(str(run_file)), target, progress=stages)
    sizes = {path.name: path.stat().st_size for path in target.iterdir()}
    return {
        **summary["timing"],
        **stages.seconds,
        "size": sizes["recording.rrd"],
        "folder": sum(sizes.values()),
        "memory_peak": memory_peak() or float("nan"),
    }


if __name__ == "__main__":
    print(json.dumps(_trial(Path(sys.argv[1]), Path(sys.argv[2]))))
