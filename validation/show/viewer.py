"""Rerun's viewer, started on this machine and reachable from it only."""

import os
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from urllib.parse import quote

from ampm.exceptions import InputError
from validation.show.text import print_line

_HOST = "127.0.0.1"
_PAGE_PORT, _DATA_PORT = 9090, 9876


def show_recording(recording: Path, *, web: bool = False) -> int:
    """Open one recording and wait until the viewer is closed.

    Args:
        recording: file to open.
        web: show it in a web browser instead of a window.

    Returns:
        The viewer's exit status; 0 if Ctrl-C stopped the web server.

    Raises:
        InputError: see :func:`viewer_command`.
    """
    ports = (_free_port(_PAGE_PORT), _free_port(_DATA_PORT)) if web else None
    command = viewer_command(recording, ports=ports)
    environment: Mapping[str, str] = os.environ
    if ports is not None:
        environment = {"RUST_LOG": "warn", **os.environ}  # otherwise it reports telemetry and ports
        print_line(f"{page_address(*ports)}\nCtrl-C ends it.")
    # A process group: the command is a launcher, and ending only that would leave the viewer running.
    process = subprocess.Popen(command, env=environment, start_new_session=True)
    try:
        return process.wait()
    except KeyboardInterrupt:  # the usual way to stop the web server
        os.killpg(process.pid, signal.SIGTERM)
        process.wait()
        return 0


def page_address(page_port: int, data_port: int) -> str:
    """Address of the viewer's page on this machine."""
    return f"http://{_HOST}:{page_port}?url={quote(f'rerun+http://{_HOST}:{data_port}/proxy', safe='')}"


def _free_port(wanted: int) -> int:
    """The wanted TCP port, or any other if something already listens there."""
    for port in (wanted, 0):
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((_HOST, port))
            except OSError:
                continue
            return int(probe.getsockname()[1])
    return wanted


def viewer_command(recording: Path, *, ports: tuple[int, int] | None = None) -> list[str]:
    """Command line of the viewer.

    Args:
        recording: file to open.
        ports: serve it to browsers of this machine on these ports, of page and data; a window if None.

    Raises:
        InputError: the viewer is not installed, or there is no display for its window.
    """
    beside = Path(sys.executable).with_name("rerun")
    program = str(beside) if beside.is_file() else shutil.which("rerun")
    if program is None:
        raise InputError("the viewer 'rerun' is not installed; install it with 'pip install rerun-sdk'.")
    serve = [program, "--bind", _HOST]  # its window listens for data, too
    if ports is not None:
        page, data = (str(port) for port in ports)
        return [*serve, "--web-viewer", "--web-viewer-port", page, "--port", data, str(recording)]
    on_linux = sys.platform.startswith("linux")
    if on_linux and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise InputError(
            f"there is no display here; view {recording} in a browser (web=True, --web), or copy it (--save) "
            "to a machine that has one."
        )
    return [*serve, str(recording)]
