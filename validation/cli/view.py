"""``ampm view``: recordings of runs and of files, in Rerun's viewer."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from string import ascii_lowercase
from typing import Annotated, NamedTuple

import typer

from ampm.exceptions import InputError
from validation.cli.console import Narrator
from validation.cli.options import Status, option
from validation.show.viewer import show_recording, viewer_command
from validation.store.folders import check_new_file, output_file

app = typer.Typer()

RECORDING_FILE, SUMMARY_FILE = "recording.rrd", "summary.json"


class Source(NamedTuple):
    """A recording to show: prefix of its entities beside others, name for people, and file."""

    prefix: str
    label: str
    path: Path


@app.command()
def view(
    targets: Annotated[
        list[Path], typer.Argument(help="Folders of runs, or recordings.", metavar="DIR|FILE.rrd")
    ],
    save: Annotated[
        Path | None, option("--save", "Write what would be shown; opens nothing.", "FILE.rrd")
    ] = None,
    web: Annotated[bool, option("--web", "Show it in a web browser.")] = False,
    force: Annotated[bool, option("--force", "Replace an earlier file at --save.")] = False,
) -> int:
    """Open recordings in the Rerun viewer, one or several.

    One run opens unchanged. Several are aligned on the phase of the gait: the bodies stand side by side, and
    the curves lie over each other.
    """
    if save is not None:
        check_new_file(save, ".rrd", force=force)
    narrator = Narrator()
    sources = choose(targets)
    if save is not None:
        with output_file(save, force=force) as work:
            write_sources(sources, work)
        narrator.wrote(save)
        return Status.PASS
    viewer_command(sources[0].path, web=web)  # refuses if there is no viewer or display
    with tempfile.TemporaryDirectory(prefix="ampm-view-") as folder:
        shown = sources[0].path
        if len(sources) > 1:
            shown = Path(folder) / "recordings.rrd"
            write_sources(sources, shown)
        return show_recording(shown, web=web)


def write_sources(sources: Sequence[Source], path: Path) -> None:
    """Write one file of all recordings, a copy of a single one; an existing file is replaced.

    Raises:
        InputError: a source is not a recording.
    """
    from validation.show.rerun.merge import merge, read_chunks  # imported here because rerun is slow to load

    if len(sources) == 1:
        read_chunks(sources[0].path)
        shutil.copyfile(sources[0].path, path)
    else:
        merge(sources, path)


def choose(targets: Sequence[Path]) -> list[Source]:
    """Recordings of the targets, which are folders of runs or recordings.

    Raises:
        InputError: a target has no recording, or a file of a run has changed.
    """
    from validation.store.saved import SUMMARY_FILE, check_files

    for target in targets:
        if (target / SUMMARY_FILE).is_file():
            check_files(target)
    paths = [recording_of(target) if target.is_dir() else target for target in targets]
    for path in paths:
        if not path.is_file() or path.suffix != ".rrd":
            raise InputError(
                f"{path} is not a recording; give the folder of a run, such as recordings/NAME of a sweep, "
                "or an .rrd file."
            )
    names = [path.parent.name if path.name == RECORDING_FILE else path.stem for path in paths]
    if len(set(names)) < len(names):  # two revisions of one gait
        names = [str(target) for target in targets]
    return [
        Source(letter, name, path) for letter, name, path in zip(ascii_lowercase, names, paths, strict=False)
    ]


def recording_of(folder: Path) -> Path:
    """Recording of a run's folder; a run that was kept without one gets it."""
    path = folder / RECORDING_FILE
    if not path.is_file() and (folder / SUMMARY_FILE).is_file():
        # Imported here because rerun is slow to load.
        from validation.show.rerun.record import write_recording
        from validation.store.saved import load_saved_run

        with Narrator().stage(f"{folder.name}: recording"):
            write_recording(load_saved_run(folder))
    return path
