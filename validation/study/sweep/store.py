"""A sweep's folder: rows that are durable as soon as they are written, and one table at the end.

Rows are appended as Parquet parts. A part is written under a temporary name in the same folder, flushed to
the disk, renamed, and the folder flushed: under its own name a part is always whole, whatever is killed. Many
small parts are merged into few larger ones on the way, so that a long sweep stays a handful of files; a part
that was merged but not yet removed says the same twice, and the later one counts.
"""

from __future__ import annotations

import errno
import fcntl
import json
import os
import re
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from ampm.exceptions import InputError
from validation.judge.profiles import profile as find_profile
from validation.study.sweep.columns import TABLE_METADATA, described_columns, schema, table_of
from validation.study.sweep.design import SweepDefinition, dump_sweep, parse_sweep
from validation.study.sweep.exceptions import SweepStopped

DEFINITION = "sweep.toml"
IDENTITY = "identity.json"
RESULTS = "results.parquet"
SUMMARY = "sweep.json"
REPORT = "report.html"
PARTS = "parts"
RECORDINGS = "recordings"
CRASHES = "crashes"
LOCK = "sweep.lock"
SWEEP_FILES = frozenset({DEFINITION, IDENTITY, RESULTS, SUMMARY, REPORT, PARTS, RECORDINGS, CRASHES, LOCK})
"""All that a sweep writes into its folder."""

MERGE = 64
"""Parts of one size that are merged into one of the next."""

_PART = re.compile(r"part-(\d{8})-(\d)\.parquet")
_TEMPORARY = ".tmp"
_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}


@dataclass(frozen=True)
class Results:
    """What a sweep has found.

    Attributes:
        table: one row per run, sorted by run; see :mod:`validation.study.sweep.columns`.
        definition: what was swept.
        metadata: of the table: definition (TOML), profile, tolerances, seed, columns in words.
        directory: the sweep's folder.
        complete: whether the sweep has come to its end.
    """

    table: pa.Table
    definition: SweepDefinition
    metadata: Mapping[str, Any]
    directory: Path
    complete: bool


def load_results(directory: str | Path) -> Results:
    """Read a sweep's folder, finished or not.

    Raises:
        InputError: the folder holds no sweep, or no result yet.
    """
    folder = Path(directory)
    if not folder.is_dir():
        raise InputError(f"there is no folder {folder}; give the folder of a sweep.")
    try:
        definition = parse_sweep((folder / DEFINITION).read_text(encoding="utf-8"), folder=folder)
    except (OSError, ValueError) as error:
        raise InputError(
            f"{folder} holds no sweep ({DEFINITION}: {_first_line(error)}); give the --out folder of one."
        ) from None
    table = read_rows(folder)
    if table is None:
        raise InputError(f"the sweep in {folder} has no result yet; wait for its first rows.")
    stored = (table.schema.metadata or {}).get(TABLE_METADATA)
    metadata = table_metadata(definition) if stored is None else json.loads(stored)
    complete = (folder / RESULTS).is_file() and not _parts(folder / PARTS)
    return Results(
        table.replace_schema_metadata(schema(metadata).metadata), definition, metadata, folder, complete
    )


def table_metadata(definition: SweepDefinition) -> dict[str, Any]:
    """What a table says of its sweep: a function of the definition alone, JSON-ready.

    ``definition`` (TOML), ``name``, ``seed``, ``steps``, ``runs``, ``varied`` (keys), ``profile``,
    ``tolerances`` (metric to ``limit``, ``unit`` and ``reason``; forces in body weights) and ``columns``
    (name to ``unit`` and ``words``).
    """
    profile = find_profile(definition.profile)
    return {
        "definition": dump_sweep(definition),
        "name": definition.name,
        "seed": definition.seed,
        "steps": definition.steps,
        "runs": len(definition),
        "varied": list(definition.keys),
        "profile": profile.name,
        "tolerances": {
            item.metric: {"limit": item.limit, "unit": item.unit, "reason": item.reason}
            for item in profile.tolerances
        },
        "columns": described_columns(),
    }


def is_sweep(directory: Path) -> bool:
    """Whether a folder is one of a sweep."""
    return (directory / DEFINITION).is_file()


def read_rows(folder: Path) -> pa.Table | None:
    """All durable rows of a sweep's folder, one per run, sorted by run; None if there are none."""
    paths = [path for path in (folder / RESULTS,) if path.is_file()]
    paths += [part.path for part in _parts(folder / PARTS)]
    if not paths:
        return None
    return latest([_read(path) for path in paths])


def latest(tables: Sequence[pa.Table]) -> pa.Table:
    """One row per run, sorted by run; of several rows of a run the last counts."""
    if len(tables) > 1:
        # Columns that a later version added are null in what an earlier one wrote.
        table = pa.concat_tables(tables, promote_options="default")
    else:
        table = tables[0]
    position = pa.array(range(table.num_rows), pa.int64())
    keyed = pa.table({"run": table["run"], "position": position})
    kept = keyed.group_by("run").aggregate([("position", "max")]).sort_by("run")
    if kept.num_rows == table.num_rows and pc.all(pc.equal(kept["position_max"], position)).as_py():
        return table.combine_chunks()
    return table.take(kept["position_max"]).combine_chunks()


class Store:
    """Writes a sweep's folder; the folder is locked while this is open.

    Args:
        folder: of the sweep, see :func:`open_store`.
        metadata: of the table.
    """

    def __init__(self, folder: Path, metadata: Mapping[str, Any], lock: BinaryIO) -> None:
        self.folder, self.metadata, self._lock = folder, metadata, lock
        self._parts = _parts(folder / PARTS)
        self._next = 1 + max((part.number for part in self._parts), default=0)

    def __enter__(self) -> Store:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._lock.close()  # and with it the lock

    def append(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Make rows durable, and return when they are.

        Raises:
            SweepStopped: the disk is full.
        """
        if rows:
            self.append_table(table_of([dict(row) for row in rows]))

    def append_table(self, table: pa.Table) -> None:
        """The same for rows that are a table already."""
        self._write_part(table, 0)
        size = 0
        while True:
            small = [part for part in self._parts if part.size == size]
            if len(small) < MERGE or size == 9:
                return
            self._write_part(latest([_read(part.path) for part in small]), size + 1)
            for part in small:
                part.path.unlink()
            self._parts = [part for part in self._parts if part.size != size]
            size += 1

    def rows(self) -> pa.Table | None:
        """What is durable so far."""
        return read_rows(self.folder)

    def finish(self, table: pa.Table) -> Path:
        """Write the one table, then remove the parts it is made of.

        Raises:
            SweepStopped: the disk is full; the parts are as they were.
        """
        path = self.folder / RESULTS
        table = table.cast(schema()).replace_schema_metadata(schema(self.metadata).metadata)
        with durable(path) as file:
            pq.write_table(table, file, compression="zstd")
        for part in self._parts:
            part.path.unlink()
        self._parts = []
        return path

    def tidy(self) -> None:
        """Remove what a killed worker has left half written."""
        _remove_temporaries(self.folder)

    def write_text(self, name: str, text: str) -> Path:
        """Write a small file of the folder, whole."""
        path = self.folder / name
        with durable(path) as file:
            file.write(text.encode(errors="backslashreplace"))
        return path

    def _write_part(self, table: pa.Table, size: int) -> None:
        part = _Part(self.folder / PARTS / f"part-{self._next:08d}-{size}.parquet", self._next, size)
        with durable(part.path) as file:
            if size:
                pq.write_table(table, file, compression="zstd")
            else:  # a row or two: what helps large tables only takes time here
                pq.write_table(table, file, compression="none", use_dictionary=False, write_statistics=False)
        self._next += 1
        self._parts.append(part)


def open_store(
    folder: Path,
    definition: str,
    metadata: Mapping[str, Any],
    identity: Mapping[str, Any],
    check: Callable[[Mapping[str, Any]], None],
) -> Store:
    """Create or reopen a sweep's folder, locked against a second program.

    Args:
        folder: created if it is not there.
        definition: TOML text, kept as ``sweep.toml``.
        metadata: of the table.
        identity: what must not change between interruption and resume, kept as ``identity.json``.
        check: called with the identity that the folder has, empty if it has none, before it is written over;
            what it raises is passed on.

    Raises:
        InputError: another program writes there, or the folder cannot be written.
        SweepStopped: the disk is full.
    """
    try:
        (folder / PARTS).mkdir(parents=True, exist_ok=True)
        lock = (folder / LOCK).open("ab")
    except OSError as error:
        if error.errno in _FULL:
            raise _full(folder, error) from error
        raise InputError(
            f"--out {folder} cannot be written ({error.strerror}); give another folder."
        ) from None
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        lock.close()
        raise InputError(
            f"another 'ampm sweep' is writing to {folder}; wait for it, or give another folder."
        ) from None
    try:
        check(read_identity(folder))
        _remove_temporaries(folder)
        store = Store(folder, metadata, lock)
        store.write_text(DEFINITION, definition)
        store.write_text(IDENTITY, json.dumps(dict(identity), indent=2, sort_keys=True) + "\n")
        _flush_folder(folder.parent)
    except BaseException:
        lock.close()
        raise
    return store


def read_identity(folder: Path) -> dict[str, Any]:
    """What the folder's sweep is: contents of ``identity.json``; empty if it is missing or damaged."""
    try:
        value = json.loads((folder / IDENTITY).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return value if isinstance(value, dict) else {}


@contextmanager
def durable(path: Path) -> Iterator[BinaryIO]:
    """Write a file so that, whatever is killed, there is either the old one or the whole new one.

    Raises:
        SweepStopped: the disk is full.
    """
    work = path.with_name(f".{path.name}{_TEMPORARY}")
    try:
        with work.open("wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        work.replace(path)
        _flush_folder(path.parent)
    except OSError as error:
        _discard(work)
        if error.errno in _FULL:
            raise _full(path.parent, error) from error
        raise
    except BaseException:
        _discard(work)
        raise


def disk_is_full(error: BaseException) -> bool:
    """Whether an error says that there is no more room, on the disk or in the user's quota."""
    return isinstance(error, OSError) and error.errno in _FULL


def _full(folder: Path, error: OSError) -> SweepStopped:
    return SweepStopped(
        f"no room is left for the results in {folder} ({error.strerror}); every row until now is kept: free "
        "some space and go on with --resume."
    )


@dataclass(frozen=True)
class _Part:
    """One part: ``number`` counts up, ``size`` says how often it was merged."""

    path: Path
    number: int
    size: int


def _parts(folder: Path) -> list[_Part]:
    """Whole parts in the order in which they were written."""
    if not folder.is_dir():
        return []
    found = []
    for path in folder.iterdir():
        if match := _PART.fullmatch(path.name):
            found.append(_Part(path, int(match[1]), int(match[2])))
    return sorted(found, key=lambda part: part.number)


def _read(path: Path) -> pa.Table:
    """A table from disk.

    Raises:
        InputError: it is damaged, which no interruption does.
    """
    try:
        with pq.ParquetFile(path) as file:
            return file.read(use_threads=False)
    except (pa.ArrowException, OSError) as error:
        raise InputError(
            f"{path} cannot be read ({_first_line(error)}); remove it, and --resume walks its runs again."
        ) from error


def _first_line(error: BaseException) -> str:
    return str(error).partition("\n")[0]


def _flush_folder(folder: Path) -> None:
    """Make a rename in a folder durable."""
    try:
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except OSError:  # a parent that may not be read
        return
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # file systems that know no such thing
            raise
    finally:
        os.close(handle)


def _discard(path: Path) -> None:
    with suppress(OSError):
        path.unlink(missing_ok=True)


def _remove_temporaries(folder: Path) -> None:
    """Remove what a killed program left half written."""
    for place in (folder, folder / PARTS):
        for path in place.glob(f".*{_TEMPORARY}"):
            path.unlink(missing_ok=True)
    if (folder / RECORDINGS).is_dir():
        for path in (folder / RECORDINGS).iterdir():
            if ".partial-" in path.name or ".old-" in path.name:
                shutil.rmtree(path, ignore_errors=True)
