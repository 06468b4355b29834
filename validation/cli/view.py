"""``ampm view``: recordings of runs, of files, of chosen runs of sweeps, in Rerun's viewer on this machine.

Commands import what they run: simulator, Pinocchio and NumPy take long to load.
"""

from __future__ import annotations

import os
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
from validation.progress import Progress, interruption
from validation.show.viewer import show_recording, viewer_command
from validation.store.folders import check_output_file, output_file

if TYPE_CHECKING:
    from validation.study.sweep.table import SweepTable

app = typer.Typer()

RECORDING_FILE = "recording.rrd"


class Source(NamedTuple):
    """A recording to show: prefix of its entities beside others, name for people, and file."""

    prefix: str
    label: str
    path: Path


@app.command()
def view(
    targets: Annotated[
        list[Path], typer.Argument(help="Folders of runs, recordings, or a sweep.", metavar="DIR|FILE.rrd")
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

    Several are aligned on the phase of the gait. One run opens unchanged. Chosen runs of a sweep are shown
    side by side. Several runs of one gait, for example of two revisions, are overlaid in different colours;
    runs of different gaits are shown side by side.
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
    viewer_command(sources[0].path, ports=(0, 0) if web else None)  # refuses if there is no viewer or display
    with tempfile.TemporaryDirectory(prefix="ampm-view-") as folder:
        shown = sources[0].path
        if len(sources) > 1:
            shown = Path(folder) / "recordings.rrd"
            write_sources(sources, shown, narrator, one_sweep=one_sweep)
        status = show_recording(shown, web=web)
    interruption.acknowledge()  # Ctrl-C stops the web server
    return status


def write_sources(sources: Sequence[Source], path: Path, progress: Progress, *, one_sweep: bool) -> None:
    """Write one file of all recordings.

    Args:
        sources: of one file it is a copy, several are merged.
        path: of the file; an existing one is replaced.
        progress: where to report the stage and a choice.
        one_sweep: whether all are of one sweep: those stand beside each other.

    Raises:
        InputError: a source is no recording.
    """
    from validation.show.rerun.merge import merge, read_part  # imported here because rerun is slow to load

    if len(sources) == 1:
        read_part(sources[0].path, "", "")
        shutil.copyfile(sources[0].path, path)
        return
    with progress.stage(f"{len(sources)} recordings into one"):
        is_overlaid = merge(sources, path, overlay=False if one_sweep else None)
    if not (is_overlaid or one_sweep):
        progress.say("the recordings are of different gaits: beside each other, aligned on the gait's phase")


def choose(targets: Sequence[Path], runs: str | None) -> tuple[list[Source], list[str]]:
    """Recordings of the targets, and a note on the choice.

    Args:
        targets: folders of runs or sweeps, or recordings.
        runs: which runs of a sweep, as in ``3,17``; by default the worst one and the median.

    Raises:
        InputError: a target has no recording, or ``runs`` without a sweep.
    """
    from validation.study.sweep.table import is_sweep

    sweeps = sum(is_sweep(target) for target in targets)
    if sweeps == 0 and runs is not None:
        raise InputError("--runs names runs of a sweep; give the --out folder of 'ampm sweep'.")
    if 0 < sweeps < len(targets):
        raise InputError("runs and sweeps do not go together; give runs alone, or sweeps with --runs.")
    if sweeps > 1 and runs is None:
        raise InputError("of several sweeps --runs says which runs to show; write for example --runs 3.")
    if sweeps == 1:
        return _of_sweep(targets[0], runs)
    sources: list[Source] = []
    for number, (target, label) in enumerate(zip(targets, _labels(targets), strict=True)):
        letter = ascii_lowercase[number % 26] * (1 + number // 26)
        if sweeps:
            found, _ = _of_sweep(target, runs)
            sources += [Source(f"{letter}_{s.prefix}", f"{label}, {s.label}", s.path) for s in found]
            continue
        recording = target / RECORDING_FILE if target.is_dir() else target
        if not recording.is_file() or recording.suffix != ".rrd":
            raise InputError(f"{recording} is no recording; give the folder of a run, or an .rrd file.")
        sources.append(Source(letter, label, recording))
    return sources, []


def _labels(targets: Sequence[Path]) -> list[str]:
    """Names that distinguish targets: of folder or file, if need be with the folder above, or a number."""
    paths = [Path(os.path.realpath(target)) for target in targets]  # unchanged if its links form a loop
    paths = [path.parent if path.name == RECORDING_FILE else path for path in paths]
    labels = [path.name if path.is_dir() else path.stem for path in paths]
    longer = [f"{path.parent.name}/{label}" for path, label in zip(paths, labels, strict=True)]
    numbered = [f"{label} ({number})" for number, label in enumerate(labels, start=1)]
    return next(names for names in (labels, longer, numbered) if len(set(names)) == len(names))


def parse_runs(text: str) -> list[int]:
    """Numbers of runs, as in ``3,17``.

    Raises:
        InputError: something else, or a number twice.
    """
    numbers = [part.strip() for part in text.split(",")]
    if not all(number.isdecimal() for number in numbers) or len({*map(int, numbers)}) < len(numbers):
        raise InputError(f"--runs {text!r} must name runs from 0 on, each once; write for example 3,17.")
    return [int(number) for number in numbers]


def _of_sweep(folder: Path, runs: str | None) -> tuple[list[Source], list[str]]:
    from validation.study.sweep.table import read_sweep

    sweep = read_sweep(folder)
    numbers = sweep.table["run"].to_pylist()
    kept = {
        row: Source(f"run_{numbers[row]}", f"run {numbers[row]} ({sweep.state(row).label})", path)
        for row, name in enumerate(sweep.words("recording"))
        if name and (path := folder / name / RECORDING_FILE).is_file()
    }
    if runs is None:
        if not kept:
            raise InputError(
                f'the sweep in {folder} has kept no recording; set recordings = "worst" in its '
                "definition, or walk a run by itself: its row in report.html has the command."
            )
        chosen = _worst_and_median(sweep, kept)
        return [kept[row] for row in chosen], [f"run {numbers[row]}: {why}" for row, why in chosen.items()]
    sources = []
    for run in parse_runs(runs):
        if run not in numbers:
            raise InputError(f"the sweep in {folder} has no run {run}; it has {len(sweep)} rows, from 0 on.")
        if numbers.index(run) not in kept:
            others = ", ".join(str(numbers[row]) for row in sorted(kept)[:12]) or "no run"
            raise InputError(
                f"run {run} of {folder} has no recording, but {others}{', ...' if len(kept) > 12 else ''} "
                "has; walk it by itself: its row in report.html has the command."
            )
        sources.append(kept[numbers.index(run)])
    return sources, []


def _worst_and_median(sweep: SweepTable, kept: dict[int, Source]) -> dict[int, str]:
    """Row to reason of the worst run that has a recording, and of the one nearest to the median."""
    rank = {row: place for place, row in enumerate(sweep.worst)}
    worst, *rest = [row for row in sweep.worst if row in kept] or sorted(kept)
    chosen = {worst: "the worst" if rank.get(worst) == 0 else "the worst that has a recording"}
    if rest:
        middle = len(rank) // 2
        median = min(rest, key=lambda row: abs(rank.get(row, len(rank)) - middle))
        exact = rank.get(median) == middle
        chosen[median] = "the median" if exact else "the nearest to the median that has a recording"
    return chosen
