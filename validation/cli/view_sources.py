"""Which recordings are to be seen: of runs, of files, of chosen runs of sweeps."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ampm.exceptions import InputError
from validation.store.saved import RECORDING_FILE

if TYPE_CHECKING:
    from validation.study.sweep.table import SweepTable

SWEEP_FILE = "sweep.toml"


@dataclass(frozen=True)
class Source:
    """One recording to be seen.

    Attributes:
        label: name for people.
        prefix: of its entities beside others.
        path: of the file.
    """

    label: str
    prefix: str
    path: Path


def find_recording(target: Path) -> Path:
    """The recording that a folder or file name means.

    Raises:
        InputError: there is none.
    """
    recording = target / RECORDING_FILE if target.is_dir() else target
    if not recording.is_file():
        raise InputError(f"there is no recording {recording}; give the folder of a run, or an .rrd file.")
    if recording.suffix != ".rrd":
        raise InputError(f"{recording} is no recording; give an .rrd file or the folder of a run.")
    return recording


def is_sweep(target: Path) -> bool:
    """Whether a folder is that of a sweep."""
    return (target / SWEEP_FILE).is_file()


def parse_runs(text: str) -> list[int]:
    """Numbers of runs, as in ``3,17``.

    Raises:
        InputError: something else, or a number twice.
    """
    try:
        runs = [int(part) for part in text.split(",")]
    except ValueError:
        raise InputError(f"--runs {text!r} is no list of runs; write numbers as in 3,17.") from None
    if len(set(runs)) < len(runs) or min(runs) < 0:
        raise InputError(f"--runs {text!r} must name runs from 0 on, each once; write for example 3,17.")
    return runs


def choose(targets: Sequence[Path], runs: str | None) -> tuple[list[Source], list[str]]:
    """Recordings that targets mean, and what is to be said of the choice.

    Args:
        targets: folders of runs or sweeps, or recordings.
        runs: which runs of a sweep; by default the worst one and the median.

    Raises:
        InputError: a target has no recording, or ``runs`` without a sweep.
    """
    sweeps = [target for target in targets if is_sweep(target)]
    if not sweeps:
        if runs is not None:
            raise InputError("--runs names runs of a sweep; give the --out folder of 'ampm sweep'.")
        if len(targets) == 1:
            return [Source(_label(targets[0]), "a", find_recording(targets[0]))], []
        labels = _labels(targets)
        letters = "abcdefghijklmnopqrstuvwxyz"
        return [
            Source(
                label, letters[number % len(letters)] * (1 + number // len(letters)), find_recording(target)
            )
            for number, (label, target) in enumerate(zip(labels, targets, strict=True))
        ], []
    if len(sweeps) < len(targets):
        raise InputError("runs and sweeps do not go together; give runs alone, or sweeps with --runs.")
    if len(sweeps) > 1 and runs is None:
        raise InputError("of several sweeps --runs says which runs to show; write for example --runs 3.")
    sources: list[Source] = []
    notes: list[str] = []
    for number, (sweep, label) in enumerate(zip(sweeps, _labels(sweeps), strict=True)):
        found, said = _of_sweep(sweep, None if runs is None else parse_runs(runs))
        if len(sweeps) > 1:
            found = [
                Source(f"{label}, {s.label}", f"{'abcdefghijklmnop'[number % 16]}_{s.prefix}", s.path)
                for s in found
            ]
        sources += found
        notes += said
    return sources, notes


def _label(target: Path) -> str:
    """Name of a target: of its folder, or of the file if it has a name of its own."""
    path = Path(os.path.realpath(target))  # a loop of links is left as it is
    if path.is_dir():
        return path.name
    return path.parent.name if path.name == RECORDING_FILE else path.stem


def _labels(targets: Sequence[Path]) -> list[str]:
    """Names that tell targets apart: as much of their paths as that needs."""
    labels = [_label(target) for target in targets]
    if len(set(labels)) == len(labels):
        return labels
    longer = [f"{_folder(target).parent.name}/{label}" for target, label in zip(targets, labels, strict=True)]
    if len(set(longer)) == len(longer):
        return longer
    return [f"{label} ({number})" for number, label in enumerate(labels, start=1)]


def _folder(target: Path) -> Path:
    path = Path(os.path.realpath(target))  # a loop of links is left as it is
    return path if path.is_dir() or path.name != RECORDING_FILE else path.parent


def _of_sweep(folder: Path, runs: Sequence[int] | None) -> tuple[list[Source], list[str]]:
    from validation.study.sweep.table import read_sweep  # loads pyarrow

    sweep = read_sweep(folder)
    numbers = sweep.table["run"].to_pylist()
    kept = {
        row: folder / name / RECORDING_FILE
        for row, name in enumerate(sweep.words("recording"))
        if name and (folder / name / RECORDING_FILE).is_file()
    }
    if runs is None:
        if not kept:
            raise InputError(
                f'the sweep in {folder} has kept no recording; set recordings = "worst" or "all" in its '
                "definition, or walk a run by itself: its row in report.html has the command."
            )
        return _worst_and_median(sweep, kept)
    rows = []
    for run in runs:
        if run not in numbers:
            raise InputError(f"the sweep in {folder} has no run {run}; it has {len(sweep)} rows, from 0 on.")
        rows.append(numbers.index(run))
        if rows[-1] not in kept:
            others = ", ".join(str(numbers[row]) for row in sorted(kept)[:12]) or "no run"
            raise InputError(
                f"run {run} of {folder} has no recording, but {others}{', ...' if len(kept) > 12 else ''} "
                'has; walk it by itself (its row in report.html has the command), or set recordings = "all".'
            )
    return [_source(sweep, kept, row) for row in rows], []


def _worst_and_median(sweep: SweepTable, kept: dict[int, Path]) -> tuple[list[Source], list[str]]:
    rank = {row: place for place, row in enumerate(sweep.worst)}
    shown = [row for row in sweep.worst if row in kept] or sorted(kept)
    middle = len(rank) // 2
    runs = sweep.table["run"]
    worst, rest = shown[0], shown[1:]
    exact = rank.get(worst) == 0
    notes = [f"run {runs[worst]}: {'the worst' if exact else 'the worst that has a recording'}"]
    if not rest:
        return [_source(sweep, kept, worst)], notes
    median = min(rest, key=lambda row: abs(rank.get(row, len(rank)) - middle))
    exact = rank.get(median) == middle
    notes.append(
        f"run {runs[median]}: {'the median' if exact else 'the nearest to the median that has a recording'}"
    )
    return [_source(sweep, kept, worst), _source(sweep, kept, median)], notes


def _source(sweep: SweepTable, kept: dict[int, Path], row: int) -> Source:
    run = sweep.table["run"][row].as_py()
    return Source(f"run {run} ({sweep.state(row).label})", f"run_{run}", kept[row])
