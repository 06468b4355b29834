"""``ampm view``: recordings of runs and of files, in Rerun's viewer."""

import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path

import typer

from ampm.exceptions import InputError
from validation.cli import options
from validation.cli.console import Narrator
from validation.cli.options import Status, option
from validation.show.viewer import show_recording, viewer_command
from validation.store.folders import check_new_file, output_file
from validation.trial.files import RunFile

app = typer.Typer()


@app.command(rich_help_panel=options.LOOK)
def view(
    targets: list[Path] = typer.Argument(
        ..., help="Folders of runs, or one recording to show.", metavar="DIR|FILE.rrd"
    ),
    save: Path | None = option("--save", "Write what would be shown; opens nothing.", "FILE.rrd"),
    web: bool = option("--web", "Show it in a web browser."),
    force: bool = option("--force", "Replace an earlier file at --save."),
) -> int:
    """Open recordings in the Rerun viewer, one or several.

    One run opens unchanged. Several are aligned on the phase of the gait: the bodies stand side by side, and
    the curves lie over each other.
    """
    if save is not None and web:
        raise InputError("--save opens nothing; leave it out, or --web.")
    if force and save is None:
        raise InputError("--force needs --save FILE.rrd; give it, or leave --force out.")
    if save is None and len(targets) == 1 and targets[0].suffix == ".rrd" and targets[0].is_file():
        show_recording(targets[0], web=web)
        return Status.PASS
    if missing := [target for target in targets if not (target / RunFile.SUMMARY).is_file()]:
        what = "is not a run" if missing[0].exists() else "does not exist"
        raise InputError(f"{missing[0]} {what}; give folders, or one .rrd file alone without --save.")
    if save is None:
        viewer_command(targets[0], web=web)  # refuses if there is no display
    else:
        check_new_file(save, ".rrd", force=force)
    with tempfile.TemporaryDirectory(prefix="ampm-view-") as folder:
        shown = recording_of(targets, Path(folder))
        if save is None:
            show_recording(shown, web=web)
            return Status.PASS
        with output_file(save, force=force) as work:
            shutil.copyfile(shown, work)
    Narrator().wrote(save)
    return Status.PASS


def recording_of(targets: Sequence[Path], folder: Path) -> Path:
    """The recording of one run, or a file in a folder with those of several.

    Raises :class:`InputError` if a file of a run has changed, or a run is given twice.
    """
    from validation.show.rerun.record import write_recording, write_several
    from validation.store.saved import load_saved_run

    runs = [load_saved_run(target) for target in targets]
    if len(runs) == 1 and (targets[0] / RunFile.RECORDING).is_file():
        return targets[0] / RunFile.RECORDING
    with Narrator().stage("recording"):
        if len(runs) == 1:
            return write_recording(runs[0])
        names = [target.resolve().name for target in targets]
        if len(set(names)) < len(names):  # two revisions of one gait
            names = [str(target) for target in targets]
        if len(set(names)) < len(names):
            raise InputError(f"{', '.join(names)}: give every run once.")
        write_several(dict(zip(names, runs, strict=True)), folder / RunFile.RECORDING)
    return folder / RunFile.RECORDING
