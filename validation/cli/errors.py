"""Report of an error on the command line: one sentence, an exit status, a JSON object."""

import reprlib
from typing import Any

import typer

from ampm.exceptions import AmpmError, InputError, RefusedGait, SolverError, StudyStopped, words_of
from validation.cli.options import Status
from validation.store.folders import disk_is_full

_STATUSES: tuple[tuple[type | tuple[type, ...], Status], ...] = (
    ((KeyboardInterrupt, typer.Abort), Status.INTERRUPTED),
    (StudyStopped, Status.STOPPED),
    (SolverError, Status.NOT_COMPLETED),
    ((AmpmError, typer.TyperException), Status.REFUSED),
)
"""Exit status by classes of errors; the first match counts."""
_KINDS = {Status.REFUSED: "input", Status.NOT_COMPLETED: "solver"}
"""Kinds of errors that are not named as their exit status."""


def describe_error(error: BaseException) -> dict[str, Any]:
    """JSON object of an error: ``{"error": {"kind", "message"}}``.

    ``kind`` is ``input``, ``mathematical``, ``bodily``, ``solver``, ``stopped`` (a study, from outside),
    ``interrupted`` or ``crash``; the two refusals of a gait add ``reason``, ``value``, ``limit``, ``unit``
    and ``way_out``; bad input adds those known of ``key``, ``value``, ``limit``, ``way_out`` and ``nearest``.
    """
    status, message = explain(error)
    answer: dict[str, Any] = {"kind": _KINDS.get(status, status.name.lower()), "message": message}
    if isinstance(error, RefusedGait):
        names = ("kind", "reason", "value", "limit", "unit", "way_out")
        answer |= {name: getattr(error, name) for name in names}
    elif isinstance(error, InputError):
        answer |= error.details
    return {"error": answer}


def explain(error: BaseException) -> tuple[Status, str]:
    """Exit status and one sentence for an error."""
    status = next((status for kind, status in _STATUSES if isinstance(error, kind)), Status.CRASH)
    text, way_out = words_of(error), ""
    if status is Status.INTERRUPTED:
        text = "interrupted"
    elif isinstance(error, typer.TyperException):
        context = getattr(error, "ctx", None)  # of the command that did not understand its options
        text = _bad_value(error) or error.format_message()
        way_out = f" See '{'ampm' if context is None else context.command_path} --help'."
    elif disk_is_full(error):
        status, text = Status.STOPPED, f"the disk is full ({text}); free space, or give another disk"
    elif isinstance(error, OSError) and error.filename is not None:
        status, text = Status.REFUSED, f"{error.filename}: {error.strerror}; give another file or folder"
    elif isinstance(error, FileNotFoundError):
        status, text = Status.REFUSED, "the working directory was removed; change to another one"
    elif "MUJOCO_GL" in text:  # MuJoCo's own refusal, when it is imported
        status, text = Status.REFUSED, f"{text}; unset it, or set it to disable"
    elif status is Status.CRASH:
        text = f"crash of ampm itself ({type(error).__name__}: {text}); please report it."
    for note in getattr(error, "__notes__", ()):
        text = f"{text.removesuffix('.')}; {note}"
    text = " ".join(text.split())
    if status not in (Status.INTERRUPTED, Status.CRASH):
        text += way_out if text.endswith((".", "?", "!")) else f".{way_out}"
    return status, text


def _bad_value(error: Any) -> str:
    """Sentence about an option's value that its type refuses; empty for any other error."""
    from pydantic import ValidationError  # slow to load

    from ampm.section import limit_of

    if not isinstance(error.__cause__, ValidationError):
        return ""
    detail, name = error.__cause__.errors()[0], error.param.opts[0]
    example = " ".join([str(10 if error.param.default is None else error.param.default)] * error.param.nargs)
    given = reprlib.repr(detail["input"])
    return f"{name} {given} {limit_of(detail)}; write for example {name} {example}."
