"""Logs in formats of others, read as columns: each by a library of its own, of the extra ``logs``.

What they hold is named as in the file; ``--columns`` gives it the names of :mod:`validation.measure.log`.
"""

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

from ampm.exceptions import InputError


def reader_of(path: Path) -> Callable[[Path], dict[str, Any]] | None:
    """What reads a file as columns, None for a table; raises InputError without its library."""
    if (suffix := path.suffix.lower()) not in (".c3d", ".mcap"):
        return None
    try:
        return import_module(f"{__name__}{suffix}").read
    except ModuleNotFoundError as error:
        raise InputError(f"{path} needs {error.name}; install the extra: pip install 'ampm[logs]'.") from None
