"""Standard output is for results. What users' code and libraries print goes to standard error."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from typing import TextIO

_outer: list[TextIO] = []  # standard output as it was before `only_results`


def results() -> TextIO:
    """The stream that results are printed to."""
    return _outer[-1] if _outer else sys.stdout


@contextmanager
def only_results() -> Iterator[None]:
    """Let only results reach standard output; all else that is printed in this process goes to stderr."""
    _outer.append(results())
    try:
        with redirect_stdout(sys.stderr):
            yield
    finally:
        _outer.pop()


def own_descriptor() -> None:
    """Give standard output a descriptor of its own, as libraries in C and worker processes use the first."""
    if sys.stdout is None or sys.stderr is None:  # a closed stream
        return
    sys.stdout.flush()
    buffering = 1 if sys.stdout.isatty() else -1
    errors = "backslashreplace"  # names of files may have any bytes
    out = open(os.dup(1), "w", buffering, encoding=sys.stdout.encoding, errors=errors)  # noqa: SIM115
    os.dup2(2, 1)
    sys.stdout = out


def close_output() -> OSError | None:
    """Write what is buffered, and the error if that cannot be written: a full disk, a reader that is gone."""
    found = None
    for stream in filter(None, (sys.stdout, sys.stderr)):
        try:
            stream.flush()
        except OSError as error:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())  # else the exit would try again
            found = found or error if stream is sys.stdout else found
    return found
