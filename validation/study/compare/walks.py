"""The walks of a comparison: finished runs, or gaits that are walked for it."""

import json
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from itertools import zip_longest
from pathlib import Path
from types import MappingProxyType
from typing import Any, Unpack

from ampm.exceptions import InputError
from validation.judge.profiles import own_profile
from validation.judge.uncertainty import load_uncertainty, matching
from validation.store.saved import load_saved_run
from validation.study.compare.comparison import Side, WalkComparison, comparison_of
from validation.study.many import Execution, Task, open_study, walk_many
from validation.study.robustness.result import load_robustness
from validation.study.row_file import Row
from validation.study.walk_options import users_classes, walk_request
from validation.trial.plan import Request, load_request, plan_walk
from validation.trial.users import UsersError

CHOICES = {
    "planner": "gait.planner",
    "body": "body.source",
    "controller": "controller.name",
    "engine": "simulation.engine",
}
"""Options of which one may be given for each walk, and their keys."""


def compare_runs(
    folders: Sequence[str | Path],
    labels: Sequence[str] = (),
    uncertainty: Sequence[Path] = (),
    robustness: Sequence[Path] = (),
) -> WalkComparison:
    """Compare two or more finished runs.

    Args:
        folders: of the runs.
        labels: names in tables; those of the folders by default.
        uncertainty: ``convergence.json`` of all gaits; a bound takes the place of an assumed change.
        robustness: ``robustness.json`` of each walk, in their order, or none.

    Raises:
        InputError: a folder cannot be used, or no study is of one of the gaits.
    """
    known = [load_uncertainty(file) for file in uncertainty]
    labels = _distinct(labels or [Path(folder).resolve().name for folder in folders])
    if len(robustness) not in (0, len(labels)):
        raise InputError(f"--robustness is given {len(robustness)} times; give it once for each walk.")
    sides = []
    for label, folder, file in zip_longest(labels, folders, robustness):
        run = load_saved_run(folder)
        study = matching(known, Request(label, run.parameters)) if known else None
        sides.append(Side(label, run, study, load_robustness(file) if file else None))
    return comparison_of(sides)


def compare_gaits(
    gaits: Sequence[str] = (),
    settings: Sequence[str] = (),
    *,
    choices: Mapping[str, Sequence[str]] = MappingProxyType({}),
    as_is: bool = False,
    uncertainty: Sequence[Path] = (),
    robustness: Sequence[Path] = (),
    **execution: Unpack[Execution],
) -> WalkComparison:
    """Walk two or more gaits and compare them.

    Args:
        gaits: presets or TOML files. A single one is compared with `ipm`, or walked with every value of the
            option that has several; if none, it is `normal` or the own gait of another body.
        settings: ``key=value`` texts for all gaits.
        choices: option of :data:`CHOICES` to its value for all walks, or to one value for each; behind a
            comma a planner or controller has its own options, ``mine:Planner,gain=2``.
        as_is: find nothing that the gaits leave open.
        uncertainty: as in :func:`compare_runs`.
        robustness: likewise.
        execution: workers and folder, see :class:`validation.study.many.Execution`.

    Raises:
        InputError, MathematicalRefusal, BodilyRefusal: a gait cannot be walked.
        StudyStopped: a full disk, or workers that cannot work; finished runs are kept.
        KeyboardInterrupt: Ctrl-C; finished runs are kept.
        UsersError: a user's class failed.
        RuntimeError: a walk crashed.
    """
    folder, pool = open_study(execution)
    texts: list[str | None] = list(gaits) or [None]
    varied = _varied(choices, len(texts))
    if len(texts) == 1:
        texts = texts * len(choices[varied]) if varied else [*texts, "ipm"]
    chosen_ones = [
        {name: given[min(place, len(given) - 1)] for name, given in choices.items() if given}
        for place in range(len(texts))
    ]
    requests, labels = [], []
    for text, chosen in zip(texts, chosen_ones, strict=True):
        own = [f"{CHOICES[name]}={json.dumps(_absolute(value))}" for name, value in chosen.items()]
        request = load_request(text, [*own, *settings], as_is=as_is)
        # With the values that are found; a refused gait is named before the first walk.
        requests.append(plan_walk(request, pool.get("progress")).request)
        alike = varied and len(set(texts)) == 1
        labels.append(Path(chosen[varied]).name if alike else request.name)
    known = [load_uncertainty(file) for file in uncertainty]
    for request in requests if known else ():
        matching(known, request)
    with nullcontext(folder) if folder else tempfile.TemporaryDirectory(prefix="ampm-compare-") as home:
        place = Path(home).resolve()
        folders = [str(place / f"walk-{number}") for number in range(1, len(requests) + 1)]
        titles = {path: request.title for path, request in zip(folders, requests, strict=True)}
        tasks = [
            Task(path, walk_gait, {"request": request, "folder": path, **users_classes(request.run)})
            for path, request in zip(folders, requests, strict=True)
        ]
        for row in walk_many(tasks, place, **pool):
            if "reason" in row:
                kinds = {"refused": InputError, UsersError.__name__: UsersError}
                kind = kinds.get(row["outcome"], kinds.get(row["reason"], RuntimeError))
                raise kind(f"{titles[row['key']]}: {row['cause']}")
        return compare_runs(folders, labels, uncertainty, robustness)


def _distinct(labels: Sequence[str]) -> Sequence[str]:
    """Labels with their numbers, unless all differ."""
    if len(set(labels)) == len(labels):
        return labels
    return [f"{label} ({number})" for number, label in enumerate(labels, start=1)]


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


def _absolute(value: str) -> str:
    """The value of an option; a file's path is absolute."""
    return str(Path(value).resolve()) if Path(value).is_file() else value


def walk_gait(request: Request, folder: str, **users: Any) -> Row:
    """Walk one gait, on a worker, and keep the run in a folder."""
    trial = walk_request(request, own_profile(request.name, request.run), **users)
    trial.save(folder, force=True)
    return {"outcome": str(trial.record.outcome.name)}
