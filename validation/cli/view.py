"""``ampm view``: recordings in Rerun's viewer, on this machine alone."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated
from urllib.parse import quote

import typer

from ampm.exceptions import InputError
from validation.cli.console import Narrator
from validation.cli.options import Status
from validation.cli.view_sources import Source, choose
from validation.progress import Progress, interruption
from validation.show.text import print_line
from validation.store.folders import check_output_file, output_file

app = typer.Typer()

_HOST = "127.0.0.1"
_PAGE_PORT, _DATA_PORT = 9090, 9876


@app.command()
def view(
    targets: Annotated[
        list[Path], typer.Argument(help="Folders of runs, recordings, or a sweep.", metavar="DIR|FILE.rrd...")
    ],
    runs: Annotated[
        str | None,
        typer.Option(
            "--runs", metavar="3,17", help="Runs of a sweep; by default the worst one and the median."
        ),
    ] = None,
    save: Annotated[
        Path | None,
        typer.Option("--save", metavar="FILE.rrd", help="Write what would be shown; opens nothing."),
    ] = None,
    web: Annotated[bool, typer.Option("--web", help="Show it in a web browser.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace an earlier file at --save.")] = False,
) -> int:
    """Open recordings in the Rerun viewer, side by side or overlaid, aligned on the phase of the gait.

    One run opens as it is. Of a sweep, the chosen runs stand beside each other. Several runs of one gait, say
    of two revisions, lie over each other in colours of their own; of different gaits they stand beside each
    other.
    """
    narrator = Narrator()
    if save is not None:
        if save.suffix != ".rrd":
            raise InputError(f"--save {save} must end in .rrd.")
        check_output_file(save, force=force)
    sources, notes = choose(targets, runs)
    for note in notes:
        narrator.say(note)
    one_sweep = len(targets) == 1
    if save is not None:
        with output_file(save, force=force) as work:
            write_sources(sources, work, narrator, one_sweep=one_sweep)
        narrator.wrote(save)
        return Status.PASS
    if len(sources) == 1:
        return _show(sources[0].path, web=web)
    viewer_command(sources[0].path, ports=(0, 0) if web else None)  # refuses where nothing can show it
    with tempfile.TemporaryDirectory(prefix="ampm-view-") as folder:
        merged = Path(folder) / "recordings.rrd"
        write_sources(sources, merged, narrator, one_sweep=one_sweep)
        return _show(merged, web=web)


def write_sources(sources: Sequence[Source], path: Path, progress: Progress, *, one_sweep: bool) -> None:
    """Write one file of all recordings.

    Args:
        sources: of one file it is a copy, several are merged.
        path: of the file; an existing one is replaced.
        progress: where to report a choice.
        one_sweep: whether all are of one sweep: those stand beside each other.

    Raises:
        InputError: a source is no recording.
    """
    from validation.show.rerun.beside import merge  # here, not above: rerun takes long to load
    from validation.show.rerun.merge import read_part

    if len(sources) == 1:
        read_part(sources[0].path, "", "")
        shutil.copyfile(sources[0].path, path)
        return
    over = merge([(s.prefix, s.label, s.path) for s in sources], path, overlay=False if one_sweep else None)
    if not over and not one_sweep:
        progress.say("the recordings are of different gaits: beside each other, aligned on the gait's phase")


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
        interruption.acknowledge()
        return Status.PASS


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
            f"there is no display here; use --web, or --save FILE.rrd and a machine that has one "
            f"(the recording is {recording})."
        )
    return [*serve, str(recording)]
