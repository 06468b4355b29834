"""A sweep's folder: rows in SQLite while it runs, one Parquet table at the end.

SQLite writes with ``synchronous = FULL``: a row that :meth:`Store.append` has returned from survives a kill
and a power cut. While the database is there, it holds all rows, those of earlier calls included; it is
removed once ``results.parquet`` is on the disk. So one of the two is always complete, also after a kill.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import shutil
import sqlite3
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from ampm.exceptions import InputError
from validation.judge.profiles import profile as find_profile
from validation.store.folders import disk_is_full
from validation.store.identity import code
from validation.study.sweep.design import SweepDefinition, dump_sweep
from validation.study.sweep.exceptions import SweepStopped
from validation.study.sweep.schema import columns, schema
from validation.trial.controllers import source_of
from validation.trial.planners import planner_file

DEFINITION = "sweep.toml"
ROWS = "rows.sqlite"
RESULTS = "results.parquet"
SUMMARY = "sweep.json"
REPORT = "report.html"
RECORDINGS = "recordings"
CRASHES = "crashes"
LOCK = "sweep.lock"
TABLE_METADATA = b"ampm_sweep"
"""Schema metadata of a table: JSON, see :func:`table_metadata`."""

_BATCH = 10_000  # rows that are turned into a table at a time
_BUSY = 60.0  # time that reader and writer of the database wait for each other [s]


def disk_full(place: Path, error: object) -> SweepStopped:
    """The disk is full: a file or folder cannot be written."""
    return SweepStopped(f"no room is left to write {place} ({error})")


def table_metadata(definition: SweepDefinition) -> dict[str, Any]:
    """Description of a table, JSON-ready.

    ``definition`` (TOML), ``name``, ``seed``, ``steps``, ``runs``, ``varied`` (keys), ``profile``,
    ``options`` (of ``ampm validate``, beside ``--set``, that walk one of the runs),
    ``tolerances`` (metric to ``limit``, ``unit`` and ``reason``; forces in body weights), ``columns``
    (name to ``unit`` and ``words``) and ``identity`` (what must not change on resume).
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
        "options": [word for push in definition.push for word in ("--push", push)],
        "tolerances": {
            item.metric: {"limit": item.limit, "unit": item.unit, "reason": item.reason}
            for item in profile.tolerances
        },
        "columns": {item.name: {"unit": item.unit, "words": item.words} for item in columns()},
        "identity": _identity(definition),
    }


def is_sweep(folder: Path) -> bool:
    """Whether a folder is one of a sweep."""
    return (folder / DEFINITION).is_file()


def read_table(path: Path) -> pa.Table:
    """A sweep's Parquet table.

    Raises:
        InputError: it cannot be read, or is no table of a sweep.
    """
    try:
        table = pq.read_table(path, use_threads=False)
    except (pa.ArrowException, OSError) as error:
        raise InputError(f"{path} is no Parquet file that can be read ({_first_line(error)}).") from error
    if TABLE_METADATA not in (table.schema.metadata or {}):
        raise InputError(f"{path} is no table of a sweep: it lacks the metadata {TABLE_METADATA.decode()!r}.")
    return table


def read_rows(folder: Path) -> tuple[pa.Table | None, bool]:
    """All durable rows of a sweep's folder, sorted by run, and whether they are those of a finished sweep.

    Raises:
        InputError: what is there cannot be read.
    """
    if (folder / ROWS).is_file():
        with _database(folder) as rows, _errors(folder / ROWS):
            if _exists(rows):
                return _table(rows), False
    return (read_table(folder / RESULTS), True) if (folder / RESULTS).is_file() else (None, False)


# ------------------------------------------------------------------------------ identity


def _identity(definition: SweepDefinition) -> dict[str, Any]:
    """Part of the definition that must not change on resume: all except name and wall-clock limit."""
    table = tomllib.loads(dump_sweep(definition))
    del table["sweep"]["name"], table["sweep"]["wall_clock"]
    settings = _flat({**table, "vary": {str(n): block for n, block in enumerate(table["vary"], start=1)}})
    if definition.instrument is not None:
        from validation.measure.instruments.model import load_instrument  # loads simulator and measurement

        settings["sweep.instrument"] = repr(load_instrument(definition.instrument))  # a file may change
    for name in definition.controllers:
        digest = hashlib.sha256(source_of(name).read_bytes()).hexdigest()
        settings[f"controller {name}"] = f"of a file {digest[:8]}"
    for name in definition.planners:
        digest = hashlib.sha256(planner_file(name).read_bytes()).hexdigest()
        settings[f"planner {name}"] = f"of a file {digest[:8]}"
    return {"settings": settings, "code": code()}


def _flat(table: Mapping[str, Any]) -> dict[str, str]:
    """Settings of nested tables: place to value, as texts."""
    flat: dict[str, str] = {}
    for key, value in table.items():
        inner = {f".{place}": text for place, text in _flat(value).items()} if isinstance(value, dict) else {}
        flat |= {key + place: text for place, text in (inner or {"": repr(value)}).items()}
    return flat


def _check_identity(folder: Path, definition: SweepDefinition, *, force: bool) -> bool:
    """Refuse to mix the rows of a folder with those of another definition, or of other code unless forced.

    Returns:
        Whether there are rows.

    Raises:
        InputError: the rows are of another sweep, or of other code.
    """
    rows, now = read_rows(folder)[0], _identity(definition)
    if rows is None:
        return False
    before = json.loads(rows.schema.metadata[TABLE_METADATA])["identity"]
    kept, new = before["settings"], now["settings"]
    if list(kept.items()) != list(new.items()):  # the order of the keys numbers the runs
        place = next((key for key in {**new, **kept} if kept.get(key) != new.get(key)), "order of keys")
        raise InputError(
            f"--out {folder} holds another sweep than this file defines: {place} is "
            f"{kept.get(place, 'another')} in the folder and {new.get(place, 'another')} in the file; give "
            "another folder, or that definition."
        )
    old, new = before["code"], now["code"]
    changed = [f"{name} {old.get(name)} -> {new[name]}" for name in new if old.get(name) != new[name]]
    if changed and not force:
        raise InputError(
            f"the rows in {folder} come from other code ({', '.join(changed)}), and results may "
            "differ; go back to it, give another folder, or --force to mix them (environment_code names it)."
        )
    return True


# ------------------------------------------------------------------------------ writing


class Store:
    """Writes a sweep's folder; see :func:`open_store`.

    Args:
        folder: of the sweep.
        rows: its database.
    """

    def __init__(self, folder: Path, rows: sqlite3.Connection) -> None:
        self.folder, self._rows = folder, rows

    def begin(self, definition: SweepDefinition, *, force: bool = False) -> bool:
        """Prepare for rows of this sweep; those of an earlier call stay.

        Args:
            definition: of the sweep.
            force: mix rows of different code.

        Returns:
            Whether there are rows of an earlier call.

        Raises:
            InputError: the folder holds rows of another sweep, or of other code.
            SweepStopped: the disk is full.
        """
        earlier = _check_identity(self.folder, definition, force=force)
        _remove_partial(self.folder)
        metadata = table_metadata(definition)
        self.write_text(DEFINITION, metadata["definition"])
        with _errors(self.folder / ROWS), self._rows as rows:
            rows.execute("BEGIN IMMEDIATE")
            if not _exists(rows):
                rows.execute("CREATE TABLE sweep (metadata TEXT)")
                rows.execute("CREATE TABLE rows (run INTEGER PRIMARY KEY, state TEXT, row TEXT)")
                if (self.folder / RESULTS).is_file():
                    for batch in read_table(self.folder / RESULTS).to_batches(_BATCH):
                        _insert(rows, batch.to_pylist())
            rows.execute("DELETE FROM sweep")
            rows.execute("INSERT INTO sweep VALUES (?)", (json.dumps(metadata),))
        return earlier

    def append(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Make rows durable before returning; a row replaces an earlier one of its run.

        Raises:
            SweepStopped: the disk is full.
        """
        with _errors(self.folder / ROWS), self._rows:
            _insert(self._rows, rows)

    def rows(self) -> pa.Table:
        """Rows stored so far, sorted by run."""
        with _errors(self.folder / ROWS):
            return _table(self._rows)

    def finish(self) -> None:
        """Write the one table, remove recordings and tracebacks of rows before it, then the database.

        Raises:
            SweepStopped: the disk is full; the rows are unchanged.
        """
        table = self.rows()
        with durable(self.folder / RESULTS) as file:
            pq.write_table(table, file, compression="zstd")
        _remove_partial(self.folder)
        self._remove_unnamed(table)
        self._rows.close()
        (self.folder / ROWS).unlink()

    def _remove_unnamed(self, table: pa.Table) -> None:
        """Remove what earlier rows of a run have left: folders and tracebacks."""
        kept = set(table["recording"].to_pylist())
        for path in (self.folder / RECORDINGS).glob("*"):
            if f"{RECORDINGS}/{path.name}" not in kept:
                shutil.rmtree(path, ignore_errors=True)
        crashed = set(table.filter(pc.equal(table["outcome"], "crashed"))["name"].to_pylist())
        for path in (self.folder / CRASHES).glob("*.txt"):
            if path.stem not in crashed:
                path.unlink(missing_ok=True)

    def write_text(self, name: str, text: str) -> None:
        """Write a small file of the folder, whole."""
        path = self.folder / name
        path.parent.mkdir(exist_ok=True)
        with durable(path) as file:
            file.write(text.encode(errors="backslashreplace"))


@contextmanager
def open_store(folder: Path) -> Iterator[Store]:
    """A sweep's folder to write into, created if it is not there, and locked against a second program.

    Raises:
        InputError: another program writes there, or the folder cannot be written or read.
        SweepStopped: the disk is full.
    """
    with _errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        lock = (folder / LOCK).open("ab")
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise InputError(
                f"another 'ampm sweep' is writing to {folder}; wait for it, or give another folder."
            ) from None
        with _database(folder) as rows:
            yield Store(folder, rows)


@contextmanager
def durable(path: Path) -> Iterator[BinaryIO]:
    """Write a file atomically and durably: a kill leaves the old file or the complete new one.

    Raises:
        InputError: it cannot be written.
        SweepStopped: the disk is full.
    """
    work = path.with_name(f".{path.name}.tmp")
    with _errors(path):
        try:
            with work.open("wb") as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            work.replace(path)
        finally:
            work.unlink(missing_ok=True)
    with suppress(OSError):  # where the file system makes a rename durable
        folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def _remove_partial(folder: Path) -> None:
    """Remove partial files of a killed program."""
    for path in folder.glob(".*.tmp"):
        path.unlink(missing_ok=True)
    for pattern in ("*.partial-*", "*.old-*"):
        for path in (folder / RECORDINGS).glob(pattern):
            shutil.rmtree(path, ignore_errors=True)


# ------------------------------------------------------------------------------ database


@contextmanager
def _database(folder: Path) -> Iterator[sqlite3.Connection]:
    """The folder's database, created empty if there is none."""
    with _errors(folder / ROWS):
        rows = sqlite3.connect(folder / ROWS, timeout=_BUSY)
    with closing(rows):
        with _errors(folder / ROWS):
            rows.execute("PRAGMA synchronous = FULL")
        yield rows


@contextmanager
def _errors(place: Path) -> Iterator[None]:
    """Errors of disk and database in a sentence."""
    try:
        yield
    except (OSError, sqlite3.Error) as error:
        code = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_CORRUPT) & 0xFF
        if disk_is_full(error) or code in (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR):
            raise disk_full(place, error) from error
        damaged = code in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_ERROR)
        way_out = "free it, or give another folder"
        if damaged and isinstance(error, sqlite3.Error):
            way_out = "remove it, and --resume walks its runs again"
        raise InputError(f"{place} cannot be used ({error}); {way_out}.") from error


def _exists(rows: sqlite3.Connection) -> bool:
    return rows.execute("SELECT 1 FROM sqlite_master WHERE name = 'rows'").fetchone() is not None


def _insert(rows: sqlite3.Connection, values: Sequence[Mapping[str, Any]]) -> None:
    """Rows as JSON, which keeps every bit of a number; undefined values are omitted."""
    rows.executemany(
        "INSERT OR REPLACE INTO rows VALUES (?, ?, ?)",
        (
            (row["run"], row["outcome"], json.dumps({k: v for k, v in row.items() if v is not None}))
            for row in values
        ),
    )


def _table(rows: sqlite3.Connection) -> pa.Table:
    """All rows, sorted by run."""
    found = rows.execute("SELECT row FROM rows ORDER BY run")
    batches = []
    try:
        (text,) = rows.execute("SELECT metadata FROM sweep").fetchone()
        metadata = {TABLE_METADATA: text.encode()}
        while part := found.fetchmany(_BATCH):
            values = [json.loads(text) for (text,) in part]
            batches.append(pa.RecordBatch.from_pylist(values, schema=schema()))
    except (ValueError, TypeError) as error:
        raise sqlite3.DatabaseError(_first_line(error)) from error
    return pa.Table.from_batches(batches, schema()).combine_chunks().replace_schema_metadata(metadata)


def _first_line(error: BaseException) -> str:
    return str(error).partition("\n")[0]
