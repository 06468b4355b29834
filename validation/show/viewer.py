"""Rerun's viewer, started on this machine and reachable from it only."""

import os
import subprocess
import sys
from pathlib import Path

from ampm.exceptions import InputError


def show_recording(*recordings: Path, web: bool = False) -> int:
    """Open recordings, with ``web`` in a browser of this machine; wait until the viewer is closed.

    Returns:
        The viewer's exit status.

    Raises:
        InputError: there is no display for the viewer's window.
    """
    return subprocess.call(viewer_command(*recordings, web=web))


def viewer_command(*recordings: Path, web: bool = False) -> list[str]:
    """Command line of the viewer; see :func:`show_recording`."""
    command = [sys.executable, "-m", "rerun", "--bind", "127.0.0.1"]  # its window listens for data, too
    has_display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if not web and sys.platform.startswith("linux") and not has_display:
        raise InputError(
            f"there is no display here; view {recordings[0]} in a browser (web=True, --web), or copy it to a "
            "machine that has one."
        )
    return [*command, *["--web-viewer"] * web, *map(str, recordings)]
