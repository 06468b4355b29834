"""Which recordings are shown: of runs, of files, of chosen runs of sweeps."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from string import ascii_lowercase
from typing import NamedTuple

from ampm.exceptions import InputError
from validation.store.saved import RECORDING_FILE
from validation.study.sweep.store import is_sweep
from validation.study.sweep.table import SweepTable, read_sweep


class Source(NamedTuple):
    """One recording to show.

    Attributes:
        prefix: of its entities beside others.
        label: name for people.
        path: of the file.
    """

    prefix: str
    label: str
    path: Path


def choose(targets: Sequence[Path], runs: str | None) -> tuple[list[Source], list[str]]:
    """Recordings that targets mean, and a note on the choice.

    Args:
        targets: folders of runs or sweeps, or recordings.
        runs: which runs of a sweep, as in ``3,17``; by default the worst one and the median.

    Raises:
        InputError: a target has no recording, or ``runs`` without a sweep.
    """
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
        else:
            sources.append(Source(letter, label, _recording(target)))
    return sources, []


def _recording(target: Path) -> Path:
    """The recording that a folder or file name means."""
    recording = target / RECORDING_FILE if target.is_dir() else target
    if not recording.is_file():
        raise InputError(f"there is no recording {recording}; give the folder of a run, or an .rrd file.")
    if recording.suffix != ".rrd":
        raise InputError(f"{recording} is no recording; give an .rrd file or the folder of a run.")
    return recording


def _labels(targets: Sequence[Path]) -> list[str]:
    """Names that distinguish targets: of folder or file, if need be with the folder above, or a number."""
    paths = [Path(os.path.realpath(target)) for target in targets]  # a loop of links is left as it is
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
    try:
        runs = [int(part) for part in text.split(",")]
    except ValueError:
        raise InputError(f"--runs {text!r} is no list of runs; write numbers as in 3,17.") from None
    if len(set(runs)) < len(runs) or min(runs) < 0:
        raise InputError(f"--runs {text!r} must name runs from 0 on, each once; write for example 3,17.")
    return runs


def _of_sweep(folder: Path, runs: str | None) -> tuple[list[Source], list[str]]:
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
                f'the sweep in {folder} has kept no recording; set recordings = "worst" or "all" in its '
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
                'has; walk it by itself (its row in report.html has the command), or set recordings = "all".'
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
