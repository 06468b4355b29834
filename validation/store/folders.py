"""Output files and folders: nothing is replaced without ``--force``, and files appear complete.

A run is written into a folder beside its target, ``<name>.partial-...``, and takes the target's name when it
is complete, so a folder under its own name is always a whole run. If the program is killed before, the
partial folder stays with the files written so far, until it is removed by hand.
"""

import errno
import shutil
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from uuid import uuid4

from ampm.exceptions import InputError
from ampm.presets import PRESETS
from validation.trial.files import RunFile


def names_folder(text: str | Path) -> bool:
    """Whether a text names a folder of results, there or not; the name of a preset never does."""
    path = Path(text)
    return str(text) not in PRESETS and (path.is_dir() or (len(path.parts) > 1 and not path.suffix))


def new_folder(name: str) -> Path:
    """Default folder of a result."""
    return Path("runs", f"{name}-{datetime.now():%Y%m%d-%H%M%S-%f}")


def check_target(
    target: Path,
    known: Collection[str] | None,
    *,
    force: bool,
    what: str = "run",
    marks: Collection[str] = (),
    way_out: str = "force (--force) to replace it",
) -> None:
    """Refuse a folder that must not be written.

    The folder of an earlier result (``what`` names its kind) holds one of the ``marks`` and only ``known``
    files, or any if that is None. Such a folder may be written again with ``force``, the option that
    ``way_out`` names. Raises :class:`InputError` for any other folder that is not empty, and for a file.
    """
    if not target.is_dir():
        if target.exists() or target.is_symlink():
            raise InputError(f"{target} is a file, not a folder; give another folder.")
        return
    entries = {entry.name for entry in target.iterdir()}
    if not entries:
        return
    foreign, holds = [] if known is None else sorted(entries - set(known)), ""
    if foreign or (marks and not entries & set(marks)):
        holds = f"holds {foreign[0]!r}, which no {what} writes" if foreign else f"holds no {what}"
    if not force:
        other = "" if holds else f", or {way_out}"
        raise InputError(f"{target} exists and is not empty; give another folder{other}.")
    if holds:
        raise InputError(f"{target} {holds}, so it is never replaced; give another folder.")


def check_run_folder(target: Path, *, force: bool) -> None:
    """Refuse a folder that a run must not be written into; see :func:`check_target`."""
    check_target(target, frozenset(RunFile), force=force, marks={RunFile.RUN})
    if target.is_mount() or target.resolve() == Path.cwd():
        where = "is a mounted volume or the working folder, which cannot be renamed"
        raise InputError(f"{target} {where}; give another folder.")


def _make_folder(folder: Path) -> None:
    """Create a folder with those above it; raises InputError if that cannot be."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        shown = str(folder).partition(".partial-")[0]
        raise InputError(f"{shown} cannot be written ({error.strerror}); give another place.") from error


@contextmanager
def run_folder(target: Path, *, force: bool) -> Iterator[Path]:
    """Write a run folder atomically: the body of the ``with`` fills a partial folder, renamed at the end.

    An earlier run is replaced only with ``force``. On an exception the folder is kept if it holds a record.
    Raises as :func:`check_run_folder` does, and :class:`InputError` if the folder cannot be created.
    """
    target = target.resolve()
    check_run_folder(target, force=force)
    work = target.with_name(f"{target.name}.partial-{uuid4().hex[:8]}")
    _make_folder(work)
    try:
        yield work
        check_run_folder(target, force=force)  # something may have appeared there in the meantime
    except BaseException as error:
        if (work / RunFile.JOINTS).exists():
            error.add_note(f"what was recorded is in {work}")
        else:
            shutil.rmtree(work, ignore_errors=True)
        raise
    old = work.with_name(f"{work.name}.old")
    if target.exists():
        target.rename(old)
    work.rename(target)
    shutil.rmtree(old, ignore_errors=True)


def disk_is_full(error: BaseException) -> bool:
    """Whether an error means a full disk or an exhausted quota."""
    return isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


@contextmanager
def output_file(target: Path, *, force: bool = True) -> Iterator[Path]:
    """Write a file atomically: the body of the ``with`` fills a temporary path with the same suffix.

    Raises :class:`InputError` as :func:`check_output_file` does.
    """
    check_output_file(target, force=force)
    work = target.with_name(f".{target.stem}-{uuid4().hex[:8]}{target.suffix}")
    _make_folder(target.parent)
    try:
        yield work
        work.replace(target)
    except (PermissionError, FileNotFoundError) as error:
        raise InputError(f"{target} cannot be written ({error.strerror}); give another place.") from error
    finally:
        work.unlink(missing_ok=True)


def write_whole(target: Path, content: str | bytes) -> Path:
    """Write a file, of a text in UTF-8, and return it; see :func:`output_file`."""
    with output_file(target) as work:
        work.write_bytes(content.encode() if isinstance(content, str) else content)
    return target


def check_output_file(target: Path, *, force: bool) -> None:
    """Refuse a folder, and a file that exists unless ``force`` is on."""
    if target.is_dir():
        raise InputError(f"{target} is a folder; give the name of a file.")
    if target.exists() and not force:
        raise InputError(f"{target} exists; give another file, or force (--force) to replace it.")


def check_new_file(target: Path, *suffixes: str, force: bool) -> None:
    """Refuse a file of another suffix, without a folder, or that must not be written, before all work."""
    if target.suffix not in suffixes:
        raise InputError(f"{target} must end in {' or '.join(suffixes)}; the suffix chooses the format.")
    if not target.parent.is_dir():  # probably a typing error
        raise InputError(f"there is no folder {target.parent} for {target}; create it, or give another file.")
    check_output_file(target, force=force)
