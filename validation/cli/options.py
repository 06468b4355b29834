"""What all commands of the command line share: exit statuses and common options."""

from __future__ import annotations

from enum import IntEnum
from typing import Annotated

import typer


class Status(IntEnum):
    """Exit statuses."""

    PASS = 0
    OUT_OF_TOLERANCE = 1
    REFUSED = 2
    NOT_COMPLETED = 3
    CRASH = 4
    STOPPED = 5
    INTERRUPTED = 130
    BROKEN_PIPE = 141


Debug = Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")]
Force = Annotated[bool, typer.Option("--force", help="Replace an earlier result at --out.")]
Json = Annotated[bool, typer.Option("--json", help="Print JSON, and nothing else, on stdout.")]
