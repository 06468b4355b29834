"""A run of a sweep, kept as the folder that ``ampm validate`` would have left."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from ampm.exceptions import InputError
from validation.run.files import write_inputs, write_observation, write_signals, write_summary
from validation.store.environment import describe_environment
from validation.store.folders import run_folder
from validation.store.record import save_record
from validation.study.sweep.exceptions import SweepStopped
from validation.study.sweep.store import RECORDINGS, disk_is_full

if TYPE_CHECKING:
    from validation.judge.examine import Walk

_DRAW = (
    "import sys; from pathlib import Path; from validation.show.report import write_report; "
    "from validation.show.rerun.record import write_recording; folder = Path(sys.argv[1]); "
    "write_recording(folder); write_report(folder)"
)

_FULL = re.compile(
    r"no space left|no room is left|quota exceeded|file too large|(?:errno|os error|OSError) (?:27|28|122)\b",
    re.IGNORECASE,
)
"""Words of a full disk or quota, by whichever library meets it."""


def keep_run(
    walk: Walk, folder: Path, name: str, timing: Mapping[str, float], instrument: str | None = None
) -> str:
    """Write a run's folder, recording and report included; an earlier one of that run is replaced.

    Args:
        walk: of the run.
        folder: of the sweep.
        name: of the run.
        timing: wall-clock times of its stages [s].
        instrument: preset or TOML file of a sensor model that looks on.

    Returns:
        The run's folder, relative to the sweep's.

    Raises:
        SweepStopped: it cannot be written.
    """
    relative = f"{RECORDINGS}/{name}"
    try:
        with run_folder(folder / relative, force=True) as work:
            _write(walk, work, name, timing, instrument)
            # Drawing needs the viewer's library and matplotlib, which a worker is better off without.
            done = subprocess.run(
                [sys.executable, "-c", _DRAW, str(work)],
                capture_output=True,
                encoding="utf-8",
                errors="replace",
                check=False,
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
        if _FULL.search(done.stderr):
            raise SweepStopped(
                f"no room is left for recording and report of {folder / relative} ({last}); every row until "
                "now is kept: free some space and go on with --resume."
            )
        raise SweepStopped(
            f"recording and report of {folder / relative} could not be drawn ({last}); every row until now "
            "is kept: go on with --resume."
        )
    return relative


def _write(walk: Walk, work: Path, name: str, timing: Mapping[str, float], instrument: str | None) -> None:
    planned, record = walk.planned, walk.record
    if planned.body is None:
        raise TypeError("a walk has a body")
    environment = describe_environment()
    write_inputs(work, planned.request.run, planned.body.model, environment)
    save_record(record, work)
    write_signals(work, walk.evaluation)
    stages = ("planning", "simulation", "measurement", "real_time_factor")
    told = {key: timing[key] for key in stages if key in timing}
    told["simulated"] = float(record.time[-1] - record.time[0])
    more = {}
    if instrument is not None:
        from validation.measure.instruments.model import load_instrument

        more["instrument"] = write_observation(work, load_instrument(instrument), planned, record)
    write_summary(work, planned, walk.evaluation, name=name, timing=told, environment=environment, more=more)
