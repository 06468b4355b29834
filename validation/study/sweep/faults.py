"""What the machine does to a run, which says nothing of its gait; and error texts that any file can hold."""

from __future__ import annotations

import errno
from collections.abc import Iterator, Mapping
from typing import Any

from validation.study.sweep.rows import WORKER_DIED

OUT_OF_MEMORY = "MemoryError"
_TRANSIENT = (errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.EIO, errno.EAGAIN, errno.ESTALE)

MACHINE_FAULTS = frozenset({WORKER_DIED, OUT_OF_MEMORY, *(errno.errorcode[number] for number in _TRANSIENT)})
"""Reasons of crashes that are no answer: ``--resume`` walks these runs again."""


def machine_fault(error: BaseException) -> str | None:
    """The machine's part in an error, a member of :data:`MACHINE_FAULTS`; None if it has none.

    Libraries wrap what they meet, and bad input may be a file that could not be opened just now: what an
    error was raised from, or beside, is looked at too.
    """
    for item in _chain(error):
        if isinstance(item, MemoryError):
            return OUT_OF_MEMORY
        if isinstance(item, OSError) and item.errno in _TRANSIENT:
            return errno.errorcode[item.errno]
    return None


def clean_text(text: str) -> str:
    """Text that UTF-8 can hold: a lone surrogate, which stands for a byte that was none, is spelled out."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def clean_row(row: Mapping[str, Any]) -> dict[str, Any]:
    """A row whose texts can be written."""
    return {name: clean_text(value) if isinstance(value, str) else value for name, value in row.items()}


def _chain(error: BaseException) -> Iterator[BaseException]:
    """An error and all that it came from."""
    seen: set[int] = set()
    waiting: list[BaseException | None] = [error]
    while waiting:
        item = waiting.pop()
        if item is not None and id(item) not in seen:
            seen.add(id(item))
            yield item
            waiting += [item.__cause__, item.__context__]
