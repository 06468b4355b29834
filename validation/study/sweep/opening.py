"""The folder that ``ampm sweep`` is given: new, one to go on with, or none of ours."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ampm.exceptions import InputError
from validation.store.environment import describe_environment
from validation.study.sweep.columns import OUTCOMES
from validation.study.sweep.design import SweepDefinition, dump_sweep, parse_sweep
from validation.study.sweep.identity import changes, differences, identity
from validation.study.sweep.store import DEFINITION, IDENTITY, SWEEP_FILES, Store, open_store

RETRIED = tuple(name for name in OUTCOMES if name != "completed")
"""Outcomes that ``--retry`` takes."""
_TOLD = 3  # differences that are told in full


@dataclass(frozen=True)
class Options:
    """How a sweep is run.

    Attributes:
        out: its folder; only a dry run needs none.
        workers: processes of this machine, one per core by default.
        scheduler: address of a dask scheduler to run on instead.
        resume: go on with what is there.
        force: go on although the code has changed.
        retry: outcomes of finished runs that are walked again.
    """

    out: Path | None = None
    workers: int | None = None
    scheduler: str | None = None
    resume: bool = False
    force: bool = False
    retry: tuple[str, ...] = ()

    def check(self) -> None:
        """Refuse what does not go together.

        Raises:
            InputError: so it is.
        """
        if self.workers is not None and self.workers < 1:
            raise InputError(f"--workers {self.workers} must be at least 1.")
        if self.workers is not None and self.scheduler is not None:
            raise InputError("--workers and --scheduler exclude each other: a scheduler has its own workers.")
        if self.out is None:
            raise InputError("a sweep needs a folder; give --out DIR, or --dry-run to walk nothing.")
        if self.force and not self.resume:
            raise InputError(
                "--force goes with --resume: no sweep is ever replaced; remove the folder, or give another."
            )
        if self.retry and not self.resume:
            raise InputError("--retry goes with --resume: a new sweep has nothing to walk again; add it.")
        for name in self.retry:
            if name not in RETRIED:
                raise InputError(f"--retry {name!r} must be of {', '.join(RETRIED)}; correct it.")


def retried(text: str | None) -> tuple[str, ...]:
    """Outcomes of ``--retry crashed,timed_out``."""
    words = (word.strip().replace("-", "_") for word in (text or "").split(","))
    return tuple(dict.fromkeys(word for word in words if word))


def resume_command(file: Path, options: Options) -> str:
    """What a user types to go on."""
    words = ["ampm", "sweep", str(file), "--out", str(options.out), "--resume"]
    if options.workers is not None:
        words += ["--workers", str(options.workers)]
    if options.scheduler is not None:
        words += ["--scheduler", options.scheduler]
    if options.retry:
        words += ["--retry", ",".join(options.retry)]
    if options.force:
        words.append("--force")
    return shlex.join(words)


def holds_sweep(folder: Path) -> bool:
    """Whether there is a sweep to go on with."""
    return (folder / IDENTITY).is_file()


def check_folder(folder: Path, *, resume: bool) -> None:
    """Refuse a folder that must not be written.

    Raises:
        InputError: it holds something else, or a sweep that shall not be resumed.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"--out {folder} is a file, not a folder; give another folder.")
    entries = {entry.name for entry in folder.iterdir()} if folder.is_dir() else set()
    if entries and not resume:
        raise InputError(
            f"--out {folder} exists and is not empty; give another folder, or --resume to go on with its "
            "sweep."
        )
    foreign = sorted(name for name in entries - SWEEP_FILES if not name.startswith("."))
    if foreign and IDENTITY not in entries:
        raise InputError(f"--out {folder} holds {foreign[0]!r} and no sweep; give the folder of a sweep.")


def open_folder(
    folder: Path,
    definition: SweepDefinition,
    metadata: Mapping[str, Any],
    options: Options,
    say: Callable[[str], None],
) -> Store:
    """The sweep's folder, new or resumed.

    Raises:
        InputError: it holds something else, another sweep, or this one of other code.
    """
    check_folder(folder, resume=options.resume)
    now = identity(definition, describe_environment()["revision"])

    def check(before: Mapping[str, Any]) -> None:
        if not before:
            say(f"nothing to resume in {folder}; starting the sweep")
            return
        if before.get("cases") != now["cases"]:
            _refuse_other(folder, definition)
        changed = changes(before, now)
        if changed and not options.force:
            raise InputError(
                f"the rows in {folder} come from other code ({', '.join(changed)}), and results may differ; "
                "go back to it, give another folder, or --force to mix them (environment_code tells)."
            )
        if changed:
            say(f"ampm: rows of other code are kept ({', '.join(changed)}); environment_code tells")

    return open_store(
        folder, dump_sweep(definition), metadata, now, check if options.resume else lambda _: None
    )


def _refuse_other(folder: Path, definition: SweepDefinition) -> None:
    """Say in what a folder's sweep differs from the file's.

    Raises:
        InputError: always, unless it only seemed to differ: folders of before had the name in their hash.
    """
    kept = None
    with suppress(OSError, ValueError, InputError):
        kept = parse_sweep((folder / DEFINITION).read_text(encoding="utf-8"), folder=folder)
    found = [] if kept is None else differences(kept, definition)
    if kept is not None and not found:
        if definition.instrument is None:
            return
        found = [f"the contents of the instrument {definition.instrument}"]
    told = "; ".join(found[:_TOLD]) + (f"; and {len(found) - _TOLD} more" if len(found) > _TOLD else "")
    raise InputError(
        f"--out {folder} holds another sweep than this file defines"
        + (f": {told} (" if told else " (")
        + f"its own is in {folder / DEFINITION}); give another folder, or that definition."
    )
