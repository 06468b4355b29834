"""``ampm view``: recordings of runs, of files and of chosen runs of sweeps, in Rerun's viewer."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from string import ascii_lowercase
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from ampm.exceptions import InputError
from validation.cli.console import Narrator
from validation.cli.options import Status, option
from validation.show.viewer import show_recording, viewer_command
from validation.store.folders import check_new_file, output_file

if TYPE_CHECKING:
    from validation.study.sweep.table import SweepTable

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
        list[Path], typer.Argument(help="Folders of runs, recordings, or one sweep.", metavar="DIR|FILE.rrd")
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
    """Open recordings in the Rerun viewer, one or several.

    One run opens unchanged. Several are aligned on the phase of the gait: the bodies stand side by side, and
    the curves lie over each other.
    """
    if save is not None:
        check_new_file(save, ".rrd", force=force)
    narrator = Narrator()
    sources = choose(targets, runs)
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


def choose(targets: Sequence[Path], runs: str | None) -> list[Source]:
    """Recordings of the targets.

    Args:
        targets: folders of runs, recordings, or one sweep.
        runs: which runs of a sweep, as in ``3,17``; by default the worst one and the median.

    Raises:
        InputError: a target has no recording, a file of a run has changed, or ``runs`` without a sweep.
    """
    from validation.store.saved import SUMMARY_FILE, check_files
    from validation.study.sweep.table import is_sweep

    if is_sweep(targets[0]) and len(targets) == 1:
        return _of_sweep(targets[0], runs)
    if any(is_sweep(target) for target in targets):
        raise InputError("a sweep is shown alone; of another one give the folders of runs, in recordings/.")
    if runs is not None:
        raise InputError("--runs names runs of a sweep; give the --out folder of 'ampm sweep'.")
    for target in targets:
        if (target / SUMMARY_FILE).is_file():
            check_files(target)
    paths = [recording_of(target) if target.is_dir() else target for target in targets]
    for path in paths:
        if not path.is_file() or path.suffix != ".rrd":
            raise InputError(f"{path} is not a recording; give the folder of a run, or an .rrd file.")
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


def parse_runs(text: str) -> list[int]:
    """Numbers of runs, as in ``3,17``.

    Raises:
        InputError: something else.
    """
    numbers = [part.strip() for part in text.split(",")]
    if not all(number.isdecimal() for number in numbers):
        raise InputError(f"--runs {text!r} must name runs from 0 on; write for example 3,17.")
    return [int(number) for number in numbers]


def _of_sweep(folder: Path, runs: str | None) -> list[Source]:
    """Recordings of chosen runs of a sweep, by default of the worst one and of the median."""
    from validation.study.sweep.table import read_sweep

    sweep = read_sweep(folder)
    kept = {}
    for row, name in enumerate(sweep.words("recording")):
        if name and (path := folder / name / RECORDING_FILE).is_file():
            run = sweep.table["run"][row].as_py()
            kept[run] = Source(f"run_{run}", f"run {run} ({sweep.state(row).label})", path)
    if not kept:
        raise InputError(
            f'the sweep in {folder} has kept no recording; set recordings = "worst" in its definition, or '
            "walk a run by itself: its row in report.html has the command."
        )
    chosen = _worst_and_median(sweep, list(kept)) if runs is None else parse_runs(runs)
    for run in chosen:
        if run not in kept:
            some = ", ".join(str(number) for number in sorted(kept)[:12])
            raise InputError(
                f"run {run} of {folder} has no recording, but for example {some}; walk it by itself: its row "
                "in report.html has the command."
            )
    return [kept[run] for run in dict.fromkeys(chosen)]


def _worst_and_median(sweep: SweepTable, kept: Sequence[int]) -> list[int]:
    """Of the runs that have a recording the worst one, and the one in the middle."""
    numbers = sweep.table["run"].to_pylist()
    ranked = [numbers[row] for row in sweep.worst if numbers[row] in kept] or list(kept)
    return [ranked[0], ranked[len(ranked) // 2]]
