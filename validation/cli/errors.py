"""Report of an error on the command line: one sentence, an exit status, a JSON object."""

from __future__ import annotations

import os
import tempfile
import traceback
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import typer

from ampm.exceptions import AmpmError, InputError, RefusedGait, SolverError
from validation.cli.options import Status
from validation.store.folders import disk_is_full
from validation.study.sweep.exceptions import SweepStopped

_TUNE = " Values that you did not give may be found by 'ampm tune', or by 'ampm validate --tune'."


_KINDS = {
    Status.REFUSED: "input",
    Status.NOT_COMPLETED: "solver",
    Status.STOPPED: "stopped",
    Status.INTERRUPTED: "interrupted",
}


def describe_error(error: BaseException) -> dict[str, Any]:
    """JSON object of an error: ``{"error": {"kind", "message"}}``.

    ``kind`` is ``input``, ``mathematical``, ``bodily``, ``solver``, ``stopped`` (a sweep, from outside),
    ``interrupted`` or ``crash``; the two refusals of a gait add ``reason``, ``value``, ``limit``, ``unit``
    and ``way_out``; bad input adds what is known of ``key``, ``value``, ``limit``, ``way_out`` and
    ``nearest``.
    """
    status, message = explain(error)
    answer: dict[str, Any] = {"kind": _KINDS.get(status, "crash"), "message": message}
    if isinstance(error, RefusedGait):
        answer["kind"] = error.kind
        for name in ("reason", "value", "limit", "unit", "way_out"):
            answer[name] = getattr(error, name)
    elif isinstance(error, InputError):
        answer.update(error.details)
    return {"error": answer}


def explain(error: BaseException) -> tuple[Status, str]:
    """Exit status and one sentence for an error."""
    if isinstance(error, KeyboardInterrupt | typer.Abort):
        return Status.INTERRUPTED, "interrupted" + _notes(error)
    if isinstance(error, typer.TyperException):
        context = getattr(error, "ctx", None)  # of the command that did not understand its options
        command = "ampm" if context is None else context.command_path
        return Status.REFUSED, f"{_sentence(error.format_message())} See '{command} --help'."
    if isinstance(error, SweepStopped):
        return Status.STOPPED, _sentence(str(error))
    if isinstance(error, SolverError):
        return Status.NOT_COMPLETED, _sentence(str(error) + _notes(error))
    if isinstance(error, RefusedGait):
        tuned = type(error).__name__ == "NoFeasibleChoice"  # of ampm.tune, which takes long to load
        return Status.REFUSED, _sentence(str(error)) + ("" if tuned else _TUNE)
    if isinstance(error, AmpmError):
        return Status.REFUSED, _sentence(str(error))
    if disk_is_full(error):
        return Status.STOPPED, _sentence(
            f"no room is left on the disk ({_one_line(str(error))}){_notes(error)}; free some, or give "
            "a folder on another disk"
        )
    if isinstance(error, OSError) and error.filename is not None:
        return Status.REFUSED, f"{error.filename}: {error.strerror}; give another file or folder."
    name = type(error).__name__
    return Status.CRASH, f"crash of ampm itself ({name}: {_one_line(str(error))})" + _notes(error)


def _notes(error: BaseException) -> str:
    """Notes added to an error."""
    return "".join(f"; {_one_line(note)}" for note in getattr(error, "__notes__", ()))


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _sentence(text: str) -> str:
    """One line that ends like a sentence."""
    text = _one_line(text)
    return text if text.endswith((".", "?", "!")) else f"{text}."


def keep_traceback(error: BaseException) -> Path | None:
    """Write an error's traceback to a file of its own."""
    stamp = datetime.now(UTC).strftime("%Y%m%d-%H%M%S")
    try:
        handle, name = tempfile.mkstemp(prefix=f"ampm-crash-{stamp}-", suffix=".txt")
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            traceback.print_exception(error, file=file)
    except OSError:
        return None
    return Path(name)
