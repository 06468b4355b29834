"""``ampm view``: recordings of runs and of files, in Rerun's viewer."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ampm.exceptions import InputError
from validation.cli import options
from validation.cli.console import Narrator
from validation.cli.options import option
from validation.show.viewer import show_recording

app = typer.Typer()

RECORDING_FILE, SUMMARY_FILE = "recording.rrd", "summary.json"


@app.command(rich_help_panel=options.LOOK)
def view(
    targets: Annotated[
        list[Path], typer.Argument(help="Folders of runs, or recordings.", metavar="DIR|FILE.rrd")
    ],
    web: Annotated[bool, option("--web", "Show them in a web browser.")] = False,
) -> int:
    """Open recordings in the Rerun viewer, one or several.

    The folder of a run gets its recording.rrd if it has none. Of several recordings the viewer shows the one
    that is chosen on its left.
    """
    return show_recording(*map(recording_of, targets), web=web)


def recording_of(target: Path) -> Path:
    """The recording of a run, drawn if it has none, or a recording itself.

    Raises:
        InputError: a target is neither, or a file of the run has changed.
    """
    if target.suffix == ".rrd" and target.is_file():
        return target
    if not (target / SUMMARY_FILE).is_file():
        raise InputError(
            f"{target} is not a run; give folders of runs, such as recordings/NAME of a sweep, or .rrd files."
        )
    # Imported here because rerun is slow to load.
    from validation.show.rerun.record import write_recording
    from validation.store.saved import load_saved_run

    saved = load_saved_run(target)
    if (target / RECORDING_FILE).is_file():
        return target / RECORDING_FILE
    with Narrator().stage("recording"):
        return write_recording(saved)
