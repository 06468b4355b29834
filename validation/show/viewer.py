"""Opens recordings in Rerun's viewer."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from urllib.parse import quote

from ampm.exceptions import InputError
from validation.show.text import print_line
from validation.show.view_sources import Source, choose
from validation.store.folders import check_output_file, output_file

_HOST = "127.0.0.1"
_PAGE_PORT, _DATA_PORT = 9090, 9876


def view(
    targets: Sequence[Path],
    *,
    runs: str | None = None,
    web: bool = False,
    save: Path | None = None,
    force: bool = False,
    say: Callable[[str], None] = print_line,
) -> int:
    """Open recordings and wait until the viewer is closed, or write them into one file.

    Runs of a sweep stand beside each other. Several runs or recordings lie over each other if they are of one
    gait, and stand beside each other if not. Both are aligned on the phase of the gait.

    Args:
        targets: recordings, or folders of runs or sweeps.
        runs: which runs of a sweep, as in ``3,17``; by default the worst one and the median.
        web: show it in a web browser instead of a window.
        save: write a recording instead of showing anything.
        force: replace an earlier file at ``save``.
        say: is told what was chosen.

    Returns:
        0, or the viewer's own exit status.

    Raises:
        InputError: no recording there, no viewer installed, no display to show it on, or ``save`` must not
            be written.
    """
    if save is not None:
        _check_save(save, force=force)
    sources, notes = choose(targets, runs)
    for note in notes:
        say(note)
    if save is not None:
        with output_file(save, force=force) as work:
            _write(sources, targets, work, say)
        return 0
    if len(sources) == 1:
        return _show(sources[0].path, web=web)
    viewer_command(sources[0].path, ports=(0, 0) if web else None)  # nothing to show it on: say so at once
    with tempfile.TemporaryDirectory(prefix="ampm-view-") as folder:
        merged = Path(folder) / "recordings.rrd"
        _write(sources, targets, merged, say)
        return _show(merged, web=web)


def _write(
    sources: Sequence[Source], targets: Sequence[Path], path: Path, say: Callable[[str], None]
) -> None:
    """Write one file of all recordings."""
    if len(sources) == 1:
        shutil.copyfile(sources[0].path, path)
        return
    from validation.show.rerun.beside import merge

    one_sweep = len(targets) == 1
    over = merge([(s.prefix, s.label, s.path) for s in sources], path, overlay=False if one_sweep else None)
    if not over and not one_sweep:
        say("the recordings are of different gaits: beside each other, aligned on the phase of the gait")


def _check_save(save: Path, *, force: bool) -> None:
    if save.suffix != ".rrd":
        raise InputError(f"--save {save} must end in .rrd.")
    check_output_file(save, force=force)


def _show(recording: Path, *, web: bool) -> int:
    """Open one recording and wait until the viewer is closed."""
    ports = (_free_port(_PAGE_PORT), _free_port(_DATA_PORT)) if web else None
    command = viewer_command(recording, ports=ports)
    environment: Mapping[str, str] = os.environ
    if ports is not None:
        environment = {"RUST_LOG": "warn", **os.environ}  # it tells of its telemetry and ports otherwise
        print_line(f"{page_address(*ports)}\nCtrl-C ends it.")
    # A group of its own: the command is a launcher, and ending it would leave the viewer behind.
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
    if ports is not None:
        page, data = (str(port) for port in ports)
        serve = ["--web-viewer", "--bind", _HOST, "--web-viewer-port", page, "--port", data]
        return [program, *serve, str(recording)]
    on_linux = sys.platform.startswith("linux")
    if on_linux and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise InputError(
            f"there is no display here; use --web, or --save FILE.rrd and a machine that has one "
            f"(the recording is {recording})."
        )
    return [program, str(recording)]
