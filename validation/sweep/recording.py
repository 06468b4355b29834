"""A run of a sweep, kept as the folder that ``ampm validate`` would have left."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ampm.exceptions import InputError
from ampm.parameters import dump_run
from validation.console import json_ready
from validation.environment import describe_environment
from validation.folders import run_folder
from validation.record import save_record
from validation.signals import save_signals, signals_table
from validation.sweep.exceptions import SweepStopped
from validation.sweep.rows import memory_peak
from validation.sweep.store import RECORDINGS, disk_is_full
from validation.verdict import build_summary

if TYPE_CHECKING:
    from validation.trial import Walk

_DRAW = (
    "import sys; from pathlib import Path; from validation.report import write_report; "
    "from validation.rerun_log import write_recording; folder = Path(sys.argv[1]); "
    "write_recording(folder); write_report(folder)"
)


def keep_run(walk: Walk, folder: Path, name: str, timing: Mapping[str, float]) -> str:
    """Write a run's folder, recording and report included; an earlier one of that run is replaced.

    Args:
        walk: of the run.
        folder: of the sweep.
        name: of the run.
        timing: wall-clock times of its stages [s].

    Returns:
        The run's folder, relative to the sweep's.

    Raises:
        SweepStopped: it cannot be written.
    """
    relative = f"{RECORDINGS}/{name}"
    try:
        with run_folder(folder / relative, force=True) as work:
            _write(walk, work, name, timing)
            # Drawing needs the viewer's library and matplotlib, which a worker is better off without.
            done = subprocess.run(
                [sys.executable, "-c", _DRAW, str(work)], capture_output=True, text=True, check=False
            )
    except OSError as error:
        what = "no room is left" if disk_is_full(error) else "a worker cannot write"
        raise SweepStopped(
            f"{what} for {folder / relative} ({error.strerror}); every row until now is kept: free some "
            "space, or on other machines mount the folder at the same path, and go on with --resume."
        ) from error
    except InputError as error:  # of the folder, not of the run
        raise SweepStopped(
            f"{str(error).partition(';')[0]}; every row until now is kept: go on with --resume."
        ) from error
    if done.returncode:
        last = done.stderr.strip().rpartition("\n")[2] or f"exit status {done.returncode}"
        raise SweepStopped(
            f"recording and report of {folder / relative} could not be drawn ({last}); every row until now "
            "is kept: go on with --resume."
        )
    return relative


def _write(walk: Walk, work: Path, name: str, timing: Mapping[str, float]) -> None:
    planned, record, found = walk.planned, walk.record, walk.findings
    body, motion = planned.body, planned.motion
    if body is None or motion is None:
        raise TypeError("a walk has a body")
    environment = describe_environment()
    (work / "run.toml").write_text(dump_run(planned.request.run), encoding="utf-8")
    (work / "model.xml").write_text(body.model.xml, encoding="utf-8")
    _write_json(work / "environment.json", environment)
    save_record(record, work)
    signals = signals_table(
        planned.plan,
        record,
        found.measured,
        found.comparison,
        motion_angular_momentum_z=found.motion_angular_momentum_z,
    )
    save_signals(signals, work / "signals.parquet")
    stages = ("planning", "simulation", "measurement", "real_time_factor")
    summary = build_summary(
        record,
        found.measured,
        found.comparison,
        found.verdict,
        timing={key: timing[key] for key in stages if key in timing}
        | {"simulated": float(record.time[-1] - record.time[0])},
        environment=environment,
        extra={
            "gait": name,
            "motion": motion.report.as_dict(),
            "standing": asdict(found.standing),
            "memory_peak": {"value": memory_peak(), "unit": "MB"},
        },
    )
    _write_json(work / "summary.json", summary)


def _write_json(path: Path, value: Any) -> None:
    path.write_text(json.dumps(json_ready(value), indent=2, allow_nan=False) + "\n", encoding="utf-8")
