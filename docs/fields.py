"""Comments of a class's fields as the section Attributes of its docstring, for the page of the Python API."""

from pathlib import Path
from typing import Any

import griffe

MARK = "# "


class Fields(griffe.Extension):
    """Adds the section to classes that have such comments and no section of their own."""

    def on_class_members(self, *, cls: griffe.Class, **_: Any) -> None:
        """Read the comment behind each public field, or else the lines of comment above it."""
        if (
            cls.docstring is None
            or "Attributes:" in cls.docstring.value
            or not isinstance(cls.filepath, Path)
        ):
            return
        lines = cls.filepath.read_text(encoding="utf-8").splitlines()
        found = {
            name: comment(lines, member.lineno, member.endlineno)
            for name, member in cls.members.items()
            if member.is_attribute and not name.startswith("_") and member.lineno and member.endlineno
        }
        section = "".join(f"\n    {name}: {text}" for name, text in found.items() if text)
        if section:
            cls.docstring.value += f"\n\nAttributes:{section}"


def comment(lines: list[str], first: int, last: int) -> str:
    """Comment of the statement in lines first to last, from 1; empty without one."""
    behind = lines[last - 1].rpartition(MARK)[2] if MARK in lines[last - 1] else ""
    above = []
    while not behind and (line := lines[first - 2].strip()).startswith(MARK):
        above.insert(0, line.removeprefix(MARK))
        first -= 1
    return behind or " ".join(above)
