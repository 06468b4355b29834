"""Exit statuses, and the options and arguments that commands share."""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer

from ampm.run_file import preset_names
from validation.cli.console import print_json


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


Result = TypeVar("Result")

_PRESETS = ", ".join(preset_names())

Gait = Annotated[str, typer.Argument(help=f"Preset ({_PRESETS}) or TOML file.", metavar="[GAIT]")]
Gaits = Annotated[
    list[str] | None,
    typer.Argument(help=f"Presets ({_PRESETS}) or TOML files; normal if none.", metavar="[GAIT]..."),
]
RunFolder = Annotated[Path, typer.Argument(help="Folder of a run.", metavar="DIR")]
Settings = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="KEY=VALUE", help="Change one parameter, e.g. gait.c_s=1.2; see 'ampm keys'."
    ),
]
Steps = Annotated[int | None, typer.Option("--steps", metavar="N", help="Short for gait.steps=N.")]
Uncertainty = Annotated[
    list[Path] | None,
    typer.Option(
        "--uncertainty",
        metavar="FILE",
        help="convergence.json of a gait, from 'ampm convergence': a value closer to its limit, or to the "
        "value beside it, than its numerical uncertainty is undecided. Repeatable, one per gait.",
    ),
]
Workers = Annotated[
    int | None, typer.Option("--workers", metavar="N", help="Processes; one per core by default.")
]
Force = Annotated[bool, typer.Option("--force", help="Replace an earlier result at --out.")]
Json = Annotated[bool, typer.Option("--json", help="Print JSON, and nothing else, on stdout.")]


def answer(
    result: Result, describe: Callable[[Result], Any], show: Callable[[Result], None], *, as_json: bool
) -> None:
    """Print a result, as JSON or for a reader."""
    if as_json:
        print_json(describe(result))
    else:
        show(result)
