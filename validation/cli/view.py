"""``ampm view``: recordings in Rerun's viewer, on this machine alone.

Commands import what they run: simulator, Pinocchio and NumPy take long to load.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ampm.exceptions import InputError
from validation.cli.console import Narrator
from validation.cli.options import Status, option
from validation.progress import Progress, interruption
from validation.show.viewer import show_recording, viewer_command
from validation.store.folders import check_output_file, output_file

if TYPE_CHECKING:
    from validation.cli.view_sources import Source

app = typer.Typer()


@app.command()
def view(
    targets: Annotated[
        list[Path], typer.Argument(help="Folders of runs, recordings, or a sweep.", metavar="DIR|FILE.rrd...")
    ],
    runs: Annotated[
        str | None, option("--runs", "Runs of a sweep; by default the worst one and the median.", "3,17")
    ] = None,
    save: Annotated[
        Path | None, option("--save", "Write what would be shown; opens nothing.", "FILE.rrd")
    ] = None,
    web: Annotated[bool, option("--web", "Show it in a web browser.")] = False,
    force: Annotated[bool, option("--force", "Replace an earlier file at --save.")] = False,
) -> int:
    """Open recordings in the Rerun viewer, side by side or overlaid, aligned on the phase of the gait.

    One run opens as it is. Of a sweep, the chosen runs stand beside each other. Several runs of one gait, say
    of two revisions, lie over each other in colours of their own; of different gaits they stand beside each
    other.
    """
    from validation.cli.view_sources import choose  # loads all that reads a run

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
    viewer_command(sources[0].path, ports=(0, 0) if web else None)  # refuses where nothing can show it
    with tempfile.TemporaryDirectory(prefix="ampm-view-") as folder:
        shown = sources[0].path
        if len(sources) > 1:
            shown = Path(folder) / "recordings.rrd"
            write_sources(sources, shown, narrator, one_sweep=one_sweep)
        status = show_recording(shown, web=web)
    interruption.acknowledge()  # Ctrl-C is how the web server is stopped
    return status


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
    from validation.show.rerun.merge import merge, read_part  # here, not above: rerun takes long to load

    if len(sources) == 1:
        read_part(sources[0].path, "", "")
        shutil.copyfile(sources[0].path, path)
    elif not merge(sources, path, overlay=False if one_sweep else None) and not one_sweep:
        progress.say("the recordings are of different gaits: beside each other, aligned on the gait's phase")
