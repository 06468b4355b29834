"""Finished runs of a study, one line of JSON each, in ``rows.jsonl``; infinity is a word, and NaN null."""

import errno
import fcntl
import json
import os
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ampm.exceptions import InputError
from ampm.files import check_regular
from validation.store.json import json_ready

Row = dict[str, Any]

ROWS = "rows.jsonl"
UNFINISHED = frozenset({"crashed", "timed_out"})
"""Outcomes that are no result: their runs are walked again on resume."""
_SYNC_EVERY = 1.0  # of the disk [s]


class RowFile:
    """Rows of a folder, or of a temporary file. One process at a time may have a folder open.

    Only the last row of a key counts, whose run a folder holds, and only if it has the digest: not one of
    other parameters or other code. Only the places of the lines are kept in memory. Raises
    :class:`InputError` if another program has the folder open, or its file is damaged.
    """

    def __init__(self, folder: Path | None) -> None:
        self._lines: dict[str, tuple[str, int, int]] = {}  # by key: digest, begin, length of its last line
        self._synced = 0.0
        if folder is None:
            self._file: Any = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115  # closed by close()
            return
        folder.mkdir(parents=True, exist_ok=True)
        check_regular(folder / ROWS)
        self._file = (folder / ROWS).open("a+b", buffering=0)
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            for start, length, row in _lines(folder / ROWS):
                if row is None:
                    self._file.truncate(start)
                else:
                    digest = "" if row.get("outcome") in UNFINISHED else row["digest"]
                    self._lines[row["key"]] = digest, start, length
        except (BlockingIOError, InputError) as error:
            self._file.close()
            if isinstance(error, InputError):
                raise
            raise InputError(f"another program is writing {folder}; wait until it has ended.") from None

    def get(self, key: str, digest: str) -> Row | None:
        """The row of a task, None if it has not finished."""
        known, start, length = self._lines.get(key, ("", 0, 0))
        self._file.seek(start)
        return json.loads(self._file.read(length)) if known == digest else None

    def append(self, row: Row) -> None:
        """Add a row. It survives a kill when this returns, and a power cut a second later.

        Raises :class:`OSError` if the disk is full; no part of the row stays.
        """
        start = self._file.seek(0, os.SEEK_END)
        line = json.dumps(json_ready(row), allow_nan=False).encode() + b"\n"
        if self._file.write(line) != len(line):
            self._file.truncate(start)
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self._file.name))
        self._lines[row["key"]] = row["digest"], start, len(line)
        if time.monotonic() - self._synced > _SYNC_EVERY:
            os.fsync(self._file)
            self._synced = time.monotonic()

    def close(self) -> None:
        """Wait until the disk has all rows, and close the file, which other programs may then open."""
        os.fsync(self._file)
        self._file.close()


def read_rows(folder: Path) -> Iterator[Row]:
    """Whole rows of a folder, as they were written; a later row of a key replaces an earlier one.

    Raises :class:`InputError` if the file is not a regular one, or damaged.
    """
    check_regular(folder / ROWS)
    return (row for _, _, row in _lines(folder / ROWS) if row is not None)


def _lines(path: Path) -> Iterator[tuple[int, int, Row | None]]:
    """Begin, length and row of every line; no row of one that a kill or a full disk cut off."""
    start = 0
    with path.open("rb") as lines:
        for number, line in enumerate(lines, start=1):
            yield start, len(line), _parsed(line, number, path) if line.endswith(b"\n") else None
            start += len(line)


def _parsed(line: bytes, number: int, path: Path) -> Row:
    """The row of a line, which has a key and a digest."""
    try:
        row: Row = json.loads(line)
        if isinstance(row["key"], str) and isinstance(row["digest"], str):
            return row
    except (ValueError, KeyError, TypeError, RecursionError):
        pass
    raise InputError(f"line {number} of {path} is damaged; remove it, or give another folder.")
