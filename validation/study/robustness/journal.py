"""Results of levels on disk, one line each: a study that was killed goes on where it was."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from ampm.exceptions import InputError
from validation.store.json import json_ready
from validation.study.robustness.walks import Level, LevelResult

FILE = "levels.jsonl"


class Journal:
    """Levels that were walked, in memory and in a file.

    Args:
        path: of the file; None keeps nothing.
        identity: of gait, code and definition: the first line.
        resume: go on with the file.

    Raises:
        InputError: the file is of another study.
    """

    def __init__(self, path: Path | None, identity: Mapping[str, Any], *, resume: bool) -> None:
        self.done: dict[tuple[str, float], LevelResult] = {}
        self._file = None
        if path is None:
            return
        first = json.dumps(json_ready(dict(identity)), sort_keys=True)
        if resume and path.is_file():
            self._read(path, first)
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = path.open("a" if self.done else "w", encoding="utf-8")
        if not self.done:
            self._write(first)

    def _read(self, path: Path, first: str) -> None:
        lines = path.read_text(encoding="utf-8").splitlines()
        if lines and lines[0] != first:
            raise InputError(
                f"{path} is of another gait, definition or code; give another folder, or leave out --resume."
            )
        for line in lines[1:]:
            try:
                found = json.loads(line)
            except ValueError:  # the last line of a killed study
                break
            zmp = tuple(math.nan if value is None else value for value in found.pop("zmp"))
            key = found.pop("cell"), found.pop("value")
            self.done[key] = LevelResult(**{**found, "causes": tuple(found["causes"]), "zmp": zmp})
        # A line that was cut off must not stay before those that follow.
        kept = "\n".join(lines[: 1 + len(self.done)]) + "\n"
        path.write_text(kept, encoding="utf-8")

    def keep(self, level: Level, result: LevelResult) -> None:
        """Add a level; it is on the disk when this returns."""
        self.done[level.cell.name, level.value] = result
        row = {"cell": level.cell.name, "value": level.value, **asdict(result)}
        self._write(json.dumps(json_ready(row)))

    def _write(self, line: str) -> None:
        if self._file is not None:
            self._file.write(line + "\n")
            self._file.flush()
            os.fsync(self._file.fileno())

    def __enter__(self) -> Self:
        """Nothing is opened here."""
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: TracebackType | None) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()
