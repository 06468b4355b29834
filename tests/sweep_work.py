"""Work for the tests of the sweep's execution: no physics, but every kind of failure."""

from __future__ import annotations

import ctypes
import os
import signal
import time
from pathlib import Path
from typing import Any

from ampm.exceptions import BodilyRefusal
from validation.study.sweep.task import Result, Task, walk_task


def act(task: Task) -> Result:
    """Do what the task's profile says."""
    return walk_task(task, _act)


def _act(task: Task, timing: dict[str, float]) -> dict[str, Any]:
    timing["simulation"] = 0.0
    match task.profile:
        case "die":  # as a segmentation fault would
            os.kill(os.getpid(), signal.SIGSEGV)
        case "die once":
            mark = Path(task.folder) / f"died-{task.run}"
            if not mark.exists():
                mark.touch()
                os.kill(os.getpid(), signal.SIGKILL)
        case "hang":  # in C, holding the interpreter's lock: no Python can run
            ctypes.PyDLL(None).usleep(ctypes.c_uint(600_000_000))
        case "raise":
            raise ValueError(f"no good at 0x7f001234 in /some/where/file.py of {task.run}")
        case "exit":
            raise SystemExit(3)
        case "refuse":
            raise BodilyRefusal(
                "too long", reason="leg_too_short", value=1.0, limit=0.5, unit="m", way_out="bend it"
            )
        case "sleep":
            time.sleep(0.2)
    return {"outcome": "completed", "verdict": "pass", "failed": "", "metric_zmp_x_rmse": task.run / 7.0}
