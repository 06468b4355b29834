"""Opens a recording in Rerun's viewer."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

from ampm.exceptions import InputError

RECORDING_FILE = "recording.rrd"


def view(target: Path, *, web: bool = False) -> int:
    """Open a recording and wait until the viewer is closed.

    Args:
        target: a recording, or the folder of a run.
        web: show it in a web browser instead of a window.

    Returns:
        0, or the viewer's own exit status.

    Raises:
        InputError: no recording there, no viewer installed, or no display to show it on.
    """
    recording = find_recording(target)
    command = viewer_command(recording, web=web)
    process = subprocess.Popen(command)
    try:
        return process.wait()
    except KeyboardInterrupt:  # the usual way to stop the web server
        process.terminate()
        process.wait()
        return 0


def find_recording(target: Path) -> Path:
    """The recording that a folder or file name means.

    Raises:
        InputError: there is none.
    """
    recording = target / RECORDING_FILE if target.is_dir() else target
    if not recording.is_file():
        raise InputError(f"there is no recording {recording}; give the folder of a run, or an .rrd file.")
    if recording.suffix != ".rrd":
        raise InputError(f"{recording} is no recording; give an .rrd file or the folder of a run.")
    return recording


def viewer_command(recording: Path, *, web: bool) -> list[str]:
    """Command line of the viewer.

    Raises:
        InputError: the viewer is not installed, or there is no display for its window.
    """
    beside = Path(sys.executable).with_name("rerun")
    program = str(beside) if beside.is_file() else shutil.which("rerun")
    if program is None:
        raise InputError("the viewer 'rerun' is not installed; install it with 'pip install rerun-sdk'.")
    if web:
        return [program, "--web-viewer", str(recording)]
    on_linux = sys.platform.startswith("linux")
    if on_linux and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise InputError(
            f"there is no display here; use 'ampm view --web {recording}', "
            "or copy the file to a machine that has one."
        )
    return [program, str(recording)]
