"""Exit statuses, and the options and arguments that commands share."""

from collections.abc import Callable
from enum import IntEnum
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer

from ampm.exceptions import InputError
from ampm.presets import preset_names
from validation.cli.console import print_json
from validation.store.folders import check_folder_of, check_output_file

PICTURES = (".png", ".svg", ".pdf")
PROFILES = "default, strict, wide, jumps, footsteps or odometry"


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


def option(name: str, help: str, metavar: str | None = None, *, least: int | None = None) -> Any:
    """Declare an option of a command; a bracket in its help is no markup; a number may have a least value."""
    return typer.Option(name, help=help.replace("[", r"\["), metavar=metavar, min=least)


_PRESETS = ", ".join(preset_names())

Gait = Annotated[
    str | None, typer.Argument(help=f"Preset ({_PRESETS}) or TOML file; normal if none.", metavar="GAIT")
]
Gaits = Annotated[
    list[str] | None,
    typer.Argument(help=f"Presets ({_PRESETS}) or TOML files; normal if none.", metavar="GAIT"),
]
RunFolder = Annotated[Path, typer.Argument(help="Folder of a run.", metavar="DIR")]
Settings = Annotated[
    list[str] | None,
    option("--set", "Change one parameter, e.g. gait.c_s=1.2; see 'ampm keys'.", "KEY=VALUE"),
]
AsIs = Annotated[
    bool,
    option("--as-is", "Keep the values that the gait leaves open: those of the preset, or defaults."),
]
Body = Annotated[
    str | None,
    option(
        "--body",
        "Body that walks: human, or a name of 'ampm body list', or its description. Without a gait it walks "
        "one of its size.",
        "NAME|FILE.toml",
    ),
]
Steps = Annotated[int | None, option("--steps", "Short for gait.steps=N.", "N")]
Uncertainty = Annotated[
    list[Path] | None,
    option(
        "--uncertainty",
        "convergence.json of a gait, from 'ampm convergence': a value closer to its limit, or to the "
        "value beside it, than its numerical uncertainty is undecided. Repeatable, one per gait.",
        "FILE",
    ),
]
PlannerName = Annotated[
    str | None,
    option(
        "--planner",
        "Short for gait.planner: ampm, lipm, ipm, preview, dcm, a table, or your own, which may replan.",
        "NAME|FILE.csv|.parquet|MODULE:CLASS",
    ),
]
Footsteps = Annotated[
    Path | None,
    option(
        "--footsteps",
        "Walk over footsteps from rest to rest: foot,x,y,heading [m, rad]; z [m], time [s] if wanted.",
        "FILE.csv",
    ),
]
Controller = Annotated[
    str | None,
    option("--controller", "Short for controller.name: ampm, joint-pd, your own.", "NAME|MODULE:CLASS"),
]
Engine = Annotated[
    str | None, option("--engine", "Short for simulation.engine: mujoco, or drake.", "mujoco|drake")
]
OwnMetrics = Annotated[
    list[str] | None,
    option("--metric", "A metric of your own, a val.Metric in a module. Repeatable.", "MODULE:NAME"),
]
OwnProfile = Annotated[
    str | None,
    option("--profile", f"Tolerance profile: {PROFILES}; if not given, the preset's own.", "P"),
]
Scheduler = Annotated[
    str | None,
    option("--scheduler", "Run on this dask scheduler: tcp://HOST:8786, or its --scheduler-file.", "ADDRESS"),
]
Resume = Annotated[bool, option("--resume", "Go on with what is missing in --out.")]
Workers = Annotated[
    int | None,
    option("--workers", "Processes; one per core by default, 0 to walk in this very one.", "N", least=0),
]
Force = Annotated[bool, option("--force", "Replace an earlier result at --out.")]
Json = Annotated[bool, option("--json", "Print JSON, and nothing else, on stdout.")]


_SHORT = {
    "body": "body.source",
    "steps": "gait.steps",
    "planner": "gait.planner",
    "controller": "controller.name",
    "engine": "simulation.engine",
}


def with_short(settings: list[str] | None, **options: str | int | None) -> list[str]:
    """Settings of ``--set``, and those of options that are short for a key; a file's path is absolute."""
    found = list(settings or ())
    for name, value in options.items():
        if name in ("body", "planner") and value is not None and Path(str(value)).is_file():
            value = str(Path(str(value)).resolve())
        if value is not None:
            found.append(f"{_SHORT[name]}='{value}'" if isinstance(value, str) else f"{_SHORT[name]}={value}")
    return found


def with_footsteps(path: Path | None, steps: int | None) -> dict[str, Any]:
    """Sections of a run with the footsteps of a file, or none.

    Raises:
        InputError: the file is not usable, or a number of steps is given, too.
    """
    if path is None:
        return {}
    if steps is not None:
        raise InputError("--steps counts the steps of a periodic gait; leave it out, or --footsteps.")
    from ampm.planner.routes import read_footsteps  # imported here: NumPy is slow to load

    return {"footsteps": read_footsteps(path)}


def check_picture(path: Path) -> None:
    """Refuse a picture that cannot be written; an earlier one is replaced, as it can be drawn again.

    Raises:
        InputError: another suffix, no folder, or nothing can be written there.
    """
    if path.suffix not in PICTURES:
        raise InputError(f"{path} must end in {' or '.join(PICTURES)}; the suffix chooses the format.")
    check_folder_of(path)
    check_output_file(path, force=True)


def answer(
    result: Result, describe: Callable[[Result], Any], show: Callable[[Result], None], *, as_json: bool
) -> None:
    """Print a result, as JSON or for a reader."""
    if as_json:
        print_json(describe(result))
    else:
        show(result)
