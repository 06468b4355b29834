"""Exit statuses, and the options and arguments that commands share."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, is_dataclass
from enum import IntEnum
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from ampm.exceptions import InputError
from ampm.files import absolute, quoted
from ampm.presets import preset_names
from validation.cli.console import Narrator, print_json, print_line
from validation.table import print_tables

if TYPE_CHECKING:
    from validation.judge.profiles import Profile
    from validation.trial.disturbances import Disturbance
    from validation.trial.plan import Request

STOPPED = "5 stopped and 130 interrupted: --resume goes on."
EXITS = f"2 bad input or refused, 4 crash of ampm itself, {STOPPED}"
WALK, LOOK, CHECK, BODIES = "Walk", "Look", "Check", "Bodies and gaits"
"""Groups of commands in ``ampm --help``."""
PROFILES = "default, strict, jumps, footsteps, odometry, odometry-footsteps, pushed or free"


class Status(IntEnum):
    """Exit statuses."""

    PASS = 0
    OUT_OF_TOLERANCE = 1
    REFUSED = 2
    NOT_COMPLETED = 3
    CRASH = 4
    STOPPED = 5
    PARTIAL = 6
    INTERRUPTED = 130
    BROKEN_PIPE = 141


def option(
    name: str, help: str, metavar: str | None = None, *, default: Any = None, least: int | None = None
) -> Any:
    """Declare an option as the default of a parameter or field; without metavar and default it is a flag.

    A bracket in its help is no markup; a number may have a least value.
    """
    default = False if default is None and metavar is None else default
    return typer.Option(default, name, help=help.replace("[", r"\["), metavar=metavar, min=least)


_PRESETS = ", ".join(preset_names())

GAIT: Any = typer.Argument(None, help=f"Preset ({_PRESETS}) or TOML file; normal if none.", metavar="GAIT")
GAITS: Any = typer.Argument(None, help=f"Presets ({_PRESETS}) or TOML files; normal if none.", metavar="GAIT")
SETTINGS: Any = option("--set", "Change a parameter: gait.c_s=1.2; see 'ampm keys'. Repeatable.", "KEY=VALUE")
AS_IS: Any = option("--as-is", "Take open values from the preset or the defaults, without a search.")
BODY: Any = option(
    "--body",
    "Body that walks, a name of 'ampm body list' or a description. Without GAIT it walks a gait of its size.",
    "NAME|FILE.toml",
)
STEPS: Any = option("--steps", "Short for gait.steps=N.", "N")
UNCERTAINTY: Any = option(
    "--uncertainty",
    "convergence.json of a gait, from 'ampm convergence': a value is undecided if its limit, or another "
    "walk's value, is closer than its numerical uncertainty. Repeatable, one per gait.",
    "FILE",
)
COLUMNS: Any = option(
    "--columns",
    "Other name, unit or sign of a log's column: com_x=COMx[mm], force_z=-Fz; or a TOML file. Repeatable.",
    "NAME=COLUMN[UNIT]|FILE.toml",
)
METRICS: Any = option("--metric", "Your own metric, a val.Metric in a module. Repeatable.", "MODULE:NAME")
PROFILE: Any = option("--profile", f"Tolerance profile: {PROFILES}; by default the walk's own.", "P")
JSON: Any = option("--json", "Print JSON, and nothing else, on stdout.")

SHORT = {
    "planner": "gait.planner",
    "body": "body.source",
    "controller": "controller.name",
    "engine": "simulation.engine",
    "steps": "gait.steps",
}
"""Options that are short for a key."""


def with_short(settings: Sequence[str] | None, **options: str | int | None) -> list[str]:
    """Settings of ``--set`` and of options that are short for a key, each once; a file's path is absolute."""
    found = list(settings or ())
    for name, value in options.items():
        if value is not None:
            text = quoted(absolute(value)) if isinstance(value, str) else str(value)
            found.append(f"{SHORT[name]}={text}")
    texts: dict[str, str] = {}
    for setting in found:
        key, _, text = (part.strip() for part in setting.partition("="))
        if (old := texts.setdefault(key, text)) != text:
            raise InputError(f"{key} is given twice, as {old} and as {text}; give it once.", key=key)
    return found


def read_mapping(texts: Iterable[str]) -> dict[str, str]:
    """A mapping of texts ``NAME=COLUMN[UNIT]``, or TOML files of such lines; else InputError."""
    from ampm.section import read_toml  # loads pydantic

    found: dict[str, str] = {}
    for text in texts:
        name, equals, column = (part.strip() for part in text.partition("="))
        if text.endswith(".toml") and not equals:
            found |= {key: str(value) for key, value in read_toml(Path(text)).items()}
        elif name and column:
            found[name] = column
        else:
            raise InputError(f"cannot read the column {text!r}; write as com_x=COMx[mm], or FILE.toml.")
    return found


@dataclass(frozen=True)
class WalkOptions:
    """What walks: changes of a gait, its body, planner, controller and engine."""

    settings: list[str] | None = SETTINGS
    as_is: bool = AS_IS
    body: str | None = BODY
    planner: str | None = option(
        "--planner",
        "Short for gait.planner: ampm, lipm, ipm, preview, dcm, a table, or a class of your own, which "
        "may replan. With none the body begins standing, and its controller walks by itself.",
        "NAME|FILE.csv|.parquet|MODULE:CLASS",
    )
    controller: str | None = option(
        "--controller", "Short for controller.name: ampm, or a class of your own.", "NAME|MODULE:CLASS"
    )
    engine: str | None = option("--engine", "Short for simulation.engine.", "mujoco|drake")
    command: str | None = option(
        "--command",
        "With --planner none: velocity forward and to the left [m/s], and rate of the heading [rad/s].",
        "VX,VY,WZ",
    )

    def changes(self, steps: int | None = None) -> list[str]:
        """All but ``as_is`` as ``key=value`` texts."""
        short = {name: value for name, value in vars(self).items() if name in SHORT}
        found = list(self.settings or ())
        if self.command is not None:
            parts = self.command.split(",")
            if len(parts) != 3:
                raise InputError(f"--command {self.command} must be three numbers VX,VY,WZ, such as 0.5,0,0.")
            found += [f"command.{key}={part}" for key, part in zip(("vx", "vy", "wz"), parts, strict=True)]
        return with_short(found, steps=steps, **short)

    def request(self, gait: str | None, steps: int | None = None, **more: Any) -> Request:
        """A gait with these changes; further arguments as in :func:`validation.trial.plan.load_request`."""
        from validation.trial.plan import load_request  # loads NumPy

        return load_request(gait, self.changes(steps), **{"as_is": self.as_is, **more})


@dataclass(frozen=True)
class Length:
    """How many steps are walked, or which."""

    steps: int | None = STEPS
    footsteps: Path | None = option(
        "--footsteps",
        "Walk over footsteps, from rest to rest: foot, x, y [m]; optional heading [rad], z [m], time [s].",
        "FILE.csv",
    )

    def sections(self) -> dict[str, Any]:
        """Sections of a run with the footsteps of the file, or none; InputError if steps are given, too."""
        if self.footsteps is None:
            return {}
        if self.steps is not None:
            raise InputError("--steps counts the steps of a periodic gait; leave it out, or --footsteps.")
        from ampm.planner.routes import read_footsteps  # imported here: NumPy is slow to load

        return {"footsteps": read_footsteps(self.footsteps)}


@dataclass(frozen=True)
class Running:
    """How a study is run and kept, see :class:`validation.study.many.Execution`."""

    out: Path | None = option("--out", "Folder of the result, with every walk.", "DIR")
    resume: bool = option("--resume", "Go on with what is missing in --out.")
    workers: int | None = option(
        "--workers", "Number of processes; by default one per core; 0 walks in this process.", "N", least=0
    )
    scheduler: str | None = option(
        "--scheduler", "Run on this dask scheduler: its address, tcp://HOST:8786, or its file.", "ADDRESS"
    )
    as_json: bool = JSON

    def given(self) -> dict[str, Any]:
        """All but ``as_json``, and progress on the terminal."""
        given = {name: value for name, value in vars(self).items() if name != "as_json"}
        return {**given, "progress": Narrator()}

    def answer(self, result: Any) -> None:
        """Print a result, and name the folder that holds it."""
        print_result(result, as_json=self.as_json)
        Narrator().wrote(self.out)


def print_result(result: Any, *, as_json: bool) -> None:
    """Print a result with ``as_dict``, ``sentence`` and ``tables``."""
    if as_json:
        print_json(result.as_dict())
        return
    if result.sentence:
        print_line(result.sentence, "bold")
    print_tables(result.tables())


@dataclass(frozen=True)
class Result:
    """Where a result goes."""

    out: Path | None = option("--out", "Folder of the result; by default runs/NAME-TIME.", "DIR")
    force: bool = option("--force", "Replace an earlier result at --out.")
    as_json: bool = JSON


@dataclass(frozen=True)
class Disturbing:
    """Disturbances beside those of the keys."""

    push: list[str] | None = option(
        "--push",
        "Push a segment by a force [N] from a time [s] on: chest,50,0,0,2,0.1. Repeatable.",
        "SEGMENT,FX,FY,FZ,AT,DURATION",
    )
    disturbance: list[str] | None = option(
        "--disturbance", "A disturbance of your own, a class without arguments. Repeatable.", "MODULE:CLASS"
    )

    def load(self) -> list[Disturbance]:
        """The disturbances."""
        from validation.trial.disturbances import load_disturbance, parse_push  # loads NumPy

        return [*map(parse_push, self.push or ()), *map(load_disturbance, self.disturbance or ())]


@dataclass(frozen=True)
class Judging:
    """Limits and metrics of one's own."""

    profile: str | None = PROFILE
    metric: list[str] | None = METRICS

    def load(self) -> Profile | None:
        """Register the metrics; the profile, None for that of the preset."""
        from validation.judge.profiles import find_profile  # loads NumPy

        load_metrics(self.metric)
        return None if self.profile is None else find_profile(self.profile)


def load_metrics(texts: Sequence[str] | None) -> None:
    """Register metrics of a user's own."""
    from validation.judge.metrics import load_metric  # loads NumPy
    from validation.judge.profiles import find_profile

    for text in texts or ():
        load_metric(text)
    find_profile("default")  # refuses a limit in an unknown profile


def grouped(command: Callable[..., int]) -> Callable[..., int]:
    """A command each of whose parameters of a class of options becomes one option for each field."""
    groups: dict[str, Any] = {}
    taken: list[inspect.Parameter] = []
    for parameter in inspect.signature(command, eval_str=True).parameters.values():
        kind = parameter.annotation
        if is_dataclass(parameter.annotation):
            groups[parameter.name] = kind
            taken += inspect.signature(kind, eval_str=True).parameters.values()
        else:
            taken.append(parameter)

    @wraps(command)
    def call(**values: Any) -> int:
        for name, kind in groups.items():
            values[name] = kind(**{field.name: values.pop(field.name) for field in fields(kind)})
        return command(**values)

    call.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY) for parameter in taken]
    )
    call.__annotations__ = {parameter.name: parameter.annotation for parameter in taken}
    return call
