"""Rerun's viewer, started on this machine and reachable from it only."""

import os
import signal
import subprocess
import sys
from pathlib import Path

from ampm.exceptions import InputError


def show_recording(recording: Path, *, web: bool = False) -> None:
    """Open one recording, with ``web`` in a browser, until it is closed; InputError if the viewer fails."""
    # The command starts the viewer proper: both are of one group, which a signal to ours does not reach.
    viewer = subprocess.Popen(viewer_command(recording, web=web), start_new_session=True)
    try:
        status = viewer.wait()
    except BaseException:
        os.killpg(viewer.pid, signal.SIGTERM)
        raise
    if status > 0:
        raise InputError("the viewer ended with the error above; close another one, if it is open.")


def viewer_command(recording: Path, *, web: bool = False) -> list[str]:
    """Command line of the viewer, with ``web`` for browsers of this machine.

    Raises :class:`InputError` if there is no display for the viewer's window.
    """
    command = [sys.executable, "-m", "rerun", "--bind", "127.0.0.1"]  # its window listens for data, too
    if web:
        return [*command, "--web-viewer", str(recording)]
    on_linux = sys.platform.startswith("linux")
    if on_linux and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise InputError(
            f"there is no display here; view {recording} in a browser (--web, in Python web=True), or write "
            "a file (--save) for a machine that has one."
        )
    return [*command, str(recording)]
