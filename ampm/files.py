"""Files that a user names, read whole: regular files of limited size, texts in UTF-8, columns named once."""

import json
import os
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from ampm.exceptions import InputError

LARGEST_TEXT = 2**26
"""Most bytes of a file that is read as text at once: run files, footsteps, studies."""
LARGEST_TABLE = 2**31
"""Most bytes of a table of numbers."""


def check_regular(path: Path) -> None:
    """Refuse what is there and is not a regular file: a pipe would wait for its writer, a device has no end.

    Raises InputError of a folder, a pipe or a device.
    """
    if path.exists() and not path.is_file():
        wrong = "a folder; name a file of it" if path.is_dir() else "not a regular file; name another"
        raise InputError(f"the file {str(path)!r} cannot be read: it is {wrong}.")


def read_file(path: Path, largest: int = LARGEST_TEXT) -> bytes:
    """Read a file; raises InputError if there is none, it is not a regular one, too large, or unreadable."""
    try:
        check_regular(path)
        if (size := path.stat().st_size) > largest:
            raise InputError(
                f"the file {str(path)!r} has {size:,} bytes, more than {largest:,}; give a shorter one."
            )
        return path.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(f"there is no file {str(path)!r}; correct the name.", value=str(path)) from None
    except (OSError, ValueError) as error:  # a zero byte in its name is a ValueError
        raise InputError(f"the file {str(path)!r} cannot be read ({error}); give a readable file.") from None


def read_text(path: Path, largest: int = LARGEST_TEXT) -> str:
    """Read a file of text; a byte order mark is skipped. Raises as :func:`read_file` does."""
    content = read_file(path, largest)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise InputError(
            f"the file {str(path)!r} has the byte {content[error.start]:#x} in line {line}; save it as UTF-8."
        ) from None


def separator(text: str) -> str:
    """What parts the columns of a table, as its first line does: commas, semicolons or tabs."""
    return max(",;\t", key=text.partition("\n")[0].count)


def check_columns(names: Iterable[str], path: Path) -> None:
    """Refuse a table in which two columns have one name, by an InputError."""
    if twice := [name for name, number in Counter(names).items() if number > 1]:
        raise InputError(f"{path} has the column {twice[0]!r} twice; remove one of them.")


def absolute(name: str) -> str:
    """The name of a file with its folder, so that it holds everywhere; a text without an ending unchanged."""
    return str(Path(name).resolve()) if Path(name).suffix and os.path.isfile(name) else name


def quoted(text: str) -> str:
    """A text as the value of a ``key=value`` setting, whatever its characters."""
    return json.dumps(text, ensure_ascii=False)
