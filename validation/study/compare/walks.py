"""The walks of a comparison: gaits, or finished runs, with what differs between them as their names."""

import json
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from itertools import combinations
from pathlib import Path
from string import ascii_lowercase
from types import MappingProxyType
from typing import Any

from ampm.exceptions import InputError
from ampm.run_file import load_run
from validation.judge.profiles import own_profile
from validation.judge.uncertainty import Uncertainty, load_uncertainty, matching
from validation.progress import Progress
from validation.run.walk import walk_planned
from validation.store.machine import cores
from validation.store.saved import RUN_FILE, SUMMARY_FILE
from validation.study.compare.comparison import WalkComparison, comparison_of, load_side
from validation.study.many import Task, walk_many
from validation.study.row_file import Row
from validation.study.walk_options import users_classes
from validation.trial.outcome import OutcomeName
from validation.trial.plan import Request, load_request, plan_walk
from validation.trial.users import UsersError

CHOICES = {
    "planner": "gait.planner",
    "body": "body.source",
    "controller": "controller.name",
    "engine": "simulation.engine",
}
"""Options of which one may be given for each walk, and their keys."""
_HALF = "-half-step"


def compare_walks(
    walks: Sequence[str] = (),
    settings: Sequence[str] = (),
    *,
    choices: Mapping[str, Sequence[str]] = MappingProxyType({}),
    as_is: bool = False,
    half_step: bool = True,
    uncertainty: Sequence[Path] = (),
    folder: Path | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> WalkComparison:
    """Walk or load two or more gaits and compare them.

    Args:
        walks: presets, TOML files, folders of runs. A single one is compared with `ipm`, or walked with every
            value of the option that has several; if none, it is `normal` or the own gait of another body.
        settings: ``key=value`` texts for the gaits that are to be walked.
        choices: option of :data:`CHOICES` to its value for all walks, or to one value for each.
        as_is: find nothing that the gaits leave open.
        half_step: walk every gait at half the time step, too.
        uncertainty: ``convergence.json`` of all gaits; a metric's bound takes the place of its change.
        folder: keeps runs and rows, and what is there is not walked again; None keeps nothing.
        workers: processes, one per core by default, 0 to walk in this very process.
        progress: where to report.

    Raises:
        InputError, MathematicalRefusal, BodilyRefusal: a gait or folder cannot be used.
        StudyStopped: a full disk, or workers that cannot work; finished runs are kept.
        KeyboardInterrupt: Ctrl-C; finished runs are kept.
    """
    progress = progress or Progress()
    texts: list[str | None] = list(walks) or [None]
    varied = _varied(choices, len(texts))
    if len(texts) == 1:
        texts = texts * len(choices[varied]) if varied else [*texts, "ipm"]
    if len(texts) > len(ascii_lowercase):
        raise InputError(f"{len(texts)} walks are too many; give {len(ascii_lowercase)} at most, or sweep.")
    sources = [
        _source(text, [*settings, *_of_side(choices, side)], as_is=as_is) for side, text in enumerate(texts)
    ]
    gaits = [source for source in sources if isinstance(source, Request)]
    if not gaits and (settings or any(choices.values())):
        raise InputError(
            "all walks are finished runs, so options of a gait have nothing to change; leave them out."
        )
    for one, two in combinations(range(len(sources)), 2):
        first, second = sources[one], sources[two]
        if isinstance(first, Request) and isinstance(second, Request) and first.run == second.run:
            raise InputError(
                f"walks {one + 1} and {two + 1} are the same walk of {first.name}; give another gait, or "
                "--planner, --body, --controller or --engine for each."
            )
    labels = [item.name if isinstance(item, Request) else item.resolve().name for item in sources]
    if varied:
        labels = [
            f"{label}, {varied} {Path(choices[varied][side]).name}" for side, label in enumerate(labels)
        ]
    names = ascii_lowercase[: len(sources)]
    if len(set(labels)) < len(labels):
        labels = [f"{label} ({name.upper()})" for label, name in zip(labels, names, strict=True)]
    studies = [load_uncertainty(file) for file in uncertainty]
    # With the values that are found; a refused gait is named before the first walk.
    requests = {
        name: plan_walk(source, progress).request
        for name, source in zip(names, sources, strict=True)
        if isinstance(source, Request)
    }
    place = nullcontext(folder) if folder else tempfile.TemporaryDirectory(prefix="ampm-compare-")
    with place as path:
        at = Path(path)
        known = [
            _study(studies, requests.get(name, source)) for name, source in zip(names, sources, strict=True)
        ]
        halves = _walk(requests, at, half_step=half_step, workers=workers, progress=progress)
        sides = []
        with progress.stage("comparison"):
            for name, label, source, study in zip(names, labels, sources, known, strict=True):
                run = source if isinstance(source, Path) else at / name
                sides.append(load_side(label, run, at / f"{name}{_HALF}" if name in halves else None, study))
    return comparison_of(sides)


def _varied(choices: Mapping[str, Sequence[str]], walks: int) -> str:
    """The option that has a value for each walk; empty if there is none.

    Raises:
        InputError: there are two, or it has not one value for each of several walks.
    """
    several = {option: len(values) for option, values in choices.items() if len(values) > 1}
    if len(several) > 1 or (walks > 1 and any(count != walks for count in several.values())):
        times = ", ".join(f"--{option} is given {count} times" for option, count in several.items())
        of = f" of the {walks} walks" if walks > 1 else " walk"
        raise InputError(f"{times}; give one option once for each{of}, and any other once, for all.")
    return next(iter(several), "")


def _of_side(choices: Mapping[str, Sequence[str]], side: int) -> list[str]:
    """Settings of the options of one side, by its place; a file's path is absolute."""
    values = {CHOICES[option]: given[min(side, len(given) - 1)] for option, given in choices.items() if given}
    return [
        f"{key}={json.dumps(str(Path(value).resolve()) if Path(value).is_file() else value)}"
        for key, value in values.items()
    ]


def _source(text: str | None, settings: Sequence[str], *, as_is: bool) -> Request | Path:
    """A gait, or the folder of a finished run.

    Raises:
        InputError: it is neither.
    """
    if not text or not Path(text).is_dir():
        return load_request(text, settings, as_is=as_is)
    if not (Path(text) / SUMMARY_FILE).is_file():
        raise InputError(
            f"{text} is no folder of a finished run; give a preset, a TOML file, the folder of a run, or two "
            "sweeps."
        )
    return Path(text)


def _study(studies: Sequence[Uncertainty], source: Request | Path) -> Uncertainty | None:
    """The convergence study of a side, None if no study was given.

    Raises:
        InputError: none of them is of it.
    """
    if not studies:
        return None
    if isinstance(source, Path):
        source = Request(source.name, load_run(source / RUN_FILE, ()))
    return matching(studies, source)


def walk_side(
    request: Request, folder: str, controller: Any = None, planner: Any = None, estimator: Any = None
) -> Row:
    """Walk one side, on a worker, and keep the run in a folder."""
    profile = own_profile(request.name, request.run)
    trial = walk_planned(
        plan_walk(request, planner=planner), profile, controller=controller, estimator=estimator
    )
    if trial.record.outcome.name == OutcomeName.INTERRUPTED:
        raise KeyboardInterrupt
    trial.save(folder, force=True, recording=False)
    return {"outcome": str(trial.record.outcome.name)}


def _walk(
    requests: Mapping[str, Request],
    place: Path,
    *,
    half_step: bool,
    workers: int | None,
    progress: Progress,
) -> list[str]:
    """Walk all requests into folders of their names; returns those that completed at half the time step, too.

    Raises:
        InputError, UsersError: a walk was refused, or a user's class failed.
        RuntimeError: a walk crashed.
    """
    tasks = []
    for name, request in requests.items():
        runs = {name: request.run}
        if half_step:  # it takes longest, so it begins first
            time_step = 0.5 * request.run.simulation.time_step
            runs = {f"{name}{_HALF}": request.run.replace({"simulation.time_step": time_step}), **runs}
        for key, run in runs.items():
            options = {"request": Request(request.name, run, request.changed), "folder": str(place / key)}
            tasks.append(Task(key, walk_side, {**options, **users_classes(run)}))
    if not tasks:
        return []
    halves, count = [], min(cores() if workers is None else workers, len(tasks))
    for row in walk_many(tasks, place, workers=count, label="walks", progress=progress):
        name, cause = row["key"].removesuffix(_HALF), row.get("cause", "")
        if row["key"] != name:
            if row["outcome"] == OutcomeName.COMPLETED:
                halves.append(name)
            else:
                progress.say(f"{name.upper()} at half the time step: {row['outcome']}. {cause}")
        elif "reason" in row:
            text = f"{requests[name].title}: {cause}"
            kinds = {"refused": InputError, UsersError.__name__: UsersError}
            raise kinds.get(row["outcome"], kinds.get(row["reason"], RuntimeError))(text)
    return halves
