"""Users' classes and tables of plans: find and import them, and report their errors with their name."""

import inspect
import io
import math
import os
import pickle
import re
import sys
import sysconfig
import traceback
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, chdir, suppress
from dataclasses import dataclass, is_dataclass
from functools import cache, partial
from importlib import import_module
from importlib.metadata import entry_points
from operator import attrgetter
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ampm.exceptions import AmpmError, InputError, RefusedGait, SolverError, words_of
from ampm.files import LARGEST_TABLE, check_columns, read_file, read_text, separator
from ampm.parameters import NO_PLAN, OPTION_TABLES, RunParameters
from ampm.planner.centroidal import CentroidalPlan
from ampm.planner.step_planners import STEP_PLANNERS
from ampm.planner.support import StepPlan
from ampm.section import Option, nearest
from ampm.sensor_parameters import EXACT
from ampm.walk import Planner

_OURS = [Path(__file__).parents[2] / name for name in ("ampm", "models", "validation", "benchmarks")]
_INSTALLED = map(sysconfig.get_path, ("stdlib", "platstdlib", "scripts"))  # a prefix may be a user's folder
_KNOWN = tuple(os.path.realpath(path) + os.sep for path in map(str, (*_OURS, *_INSTALLED)))
_STANDARD = Path(traceback.__file__).parent  # library
SUFFIXES = (".csv", ".parquet")
"""Suffixes of tables."""
_WAY_OUT = "; correct it, --debug shows the traceback."


@cache
def is_users(file: str) -> bool:
    """Whether a file is neither installed nor of this project."""
    path = os.path.realpath(file)
    return not (path.startswith(_KNOWN) or re.search(r"/(site|dist)-packages/", path))


class UsersError(InputError):
    """An error in a user's class."""

    @property
    def fault(self) -> str:
        """The sentence without its way out."""
        return str(self).removesuffix(_WAY_OUT)


class UsersCode(AbstractContextManager["UsersCode"]):
    """Context that turns an error of a user's class into a :class:`UsersError`.

    Before a walk an :class:`AmpmError` is left as it is, since a planner may refuse a gait.
    """

    def __init__(self, what: str, thing: Any, *, walking: bool = False) -> None:
        self.what, self.thing, self.walking = what, thing, walking

    def __exit__(self, kind: object, error: BaseException | None, trace: TracebackType | None) -> None:
        """Raise an error that names the class."""
        if error is None:  # nearly always, at every control tick
            return
        kept = (UsersError, SolverError) if self.walking else (AmpmError,)
        name = getattr(self.thing, "__qualname__", None) or type(self.thing).__name__
        refusal = isinstance(error, RefusedGait | InputError) and not isinstance(error, UsersError)
        if refusal and not self.walking:
            error.add_note(f"so says the {self.what} {name}")
        if not isinstance(error, (*kept, KeyboardInterrupt)):
            frames = [(Path(frame.filename), frame.lineno) for frame in traceback.extract_tb(trace)]
            places = [at for at in frames if not any(map(at[0].is_relative_to, (*_OURS, _STANDARD)))]
            users = [at for at in places if is_users(str(at[0]))] or places
            place = "".join(f" in {path.name}, line {line}" for path, line in users[-1:])
            raise UsersError(
                f"the {self.what} {name} failed ({type(error).__name__}: {words_of(error)}){place}{_WAY_OUT}"
            ) from error


def real_numbers(name: str, value: Any, shape: tuple[int, ...], *, finite: bool = False) -> NDArray[Any]:
    """Array of a value that a user's code returned, of any type of real numbers.

    Raises ValueError, with the value's ``name``, for another shape, no real numbers, or one that is not
    finite and must be.
    """
    array = np.asarray(value.astype(float).filled(math.nan) if np.ma.is_masked(value) else value)
    if array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape} and must have {shape}")
    if array.dtype.kind not in "bfiu":
        raise ValueError(f"{name} holds {array.dtype} values and must hold real numbers")
    if finite and (wrong := array[~np.isfinite(array)]).size:
        raise ValueError(f"{name} holds {wrong[0]} and must be finite")
    return array


SENT: dict[str, Any] = {}
"""Classes and plans that a study sent to this process, by the texts that name them."""


def load_object(option: str, text: str) -> Any:
    """Import ``module:name``, also of the working directory; raises InputError if there is none."""
    if text in SENT:
        return SENT[text]
    module, colon, name = text.partition(":")
    if not (module and colon and name) or module.endswith(".py"):
        raise InputError(f"{option} {text!r} must be MODULE:NAME without .py, for example mine:Name.")
    if "<" in name:
        raise InputError(f"{option} {text!r} was given in Python; walk there, or name a module's class.")
    here = str(Path.cwd())
    sys.path.insert(0, here)
    try:
        found = import_module(module)
        at, mine = getattr(found, "__file__", None), Path(here, *module.split(".")).with_suffix(".py")
        if at and is_users(at) and mine.is_file() and not mine.samefile(at):
            raise ImportError(f"{at} was imported by this name")
        return attrgetter(name)(found)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # also a panic of Rust
        file = getattr(sys.modules.get(module), "__file__", None)  # may be another module of this name
        way_out = f"add it to {file}, or rename your module." if file else "mend it."
        if (similar := nearest(name, vars(sys.modules.get(module, object)))) not in (None, name):
            way_out = f"did you mean {module}:{similar}?"
        if isinstance(error, ModuleNotFoundError) and f"{module}.".startswith(f"{error.name}."):
            way_out = f"start where {module.replace('.', '/')}.py is, or correct the name."
        raise InputError(
            f"{option} {text!r} cannot be imported ({type(error).__name__}: {words_of(error)}); {way_out}"
        ) from error
    finally:
        sys.path.pop(0)
        if here not in sys.path:  # for what the class imports later; installed packages come first
            sys.path.append(here)


@dataclass(frozen=True)
class Role:
    """A part of a walk that may be played by a user's own class."""

    name: str  # of the part; installed packages add classes by entry points of the group `ampm.NAMEs`
    key: str  # of the run's parameters, that names the class
    options: str  # table of the parameters with the class's options
    known: Mapping[str, str]  # the project's names, and their `module:Class`; empty for what is not a class
    arguments: tuple[str, ...]  # what a class gets before its options
    otherwise: str = "MODULE:CLASS"  # what may stand in the place of a name, for messages

    def named(self, run: RunParameters) -> tuple[str, Mapping[str, Option]]:
        """Name and options of the class in a run."""
        return run.value(self.key), run.value(self.options)

    def find(self, text: str, options: Mapping[str, Option] = MappingProxyType({})) -> Any:
        """Import the class or function of a name: ours, an installed package's, or ``module:Class``.

        Returns None for a name of ours that stands for no class, and a planner for a table of a plan. Raises
        :class:`InputError` if nothing has this name, it cannot be imported or read, or an option is unknown
        or missing.
        """
        if self is PLANNER and (path := Path(text)).suffix in SUFFIXES:
            from ampm.planners import TablePlanner  # imported here: Pinocchio is slow to load

            self.check_options(text, None, options)
            return SENT.get(text) or TablePlanner(read_columns(path), path.name)
        known = dict(self.known)
        if ":" not in text and text not in known:
            known |= {item.name: item.value for item in entry_points(group=f"ampm.{self.name}s")}
            if text not in known:
                raise InputError(
                    f"unknown {self.key} {text!r}; known: {', '.join(known)}; take one of them, or "
                    f"{self.otherwise}, for example mine:{self.name.capitalize()}.",
                    key=self.key,
                    value=text,
                )
        place = known.get(text, text)
        factory = load_object(self.key, place) if place else None
        self.check_options(text, factory, options)
        return factory

    def check_options(
        self, text: str, factory: Callable[..., Any] | None, given: Mapping[str, Option]
    ) -> None:
        """Refuse options that a class or function does not take, and the lack of one that it needs.

        None takes no options. Raises :class:`InputError`.
        """
        try:
            signature = inspect.signature(factory or (lambda: None))
        except (TypeError, ValueError):  # compiled code has no signature; its call will say what is wrong
            return
        before = self.arguments if factory else ()
        try:
            signature.bind(*before, **given)
        except TypeError as error:
            names, first = [*signature.parameters], len(before)
            problem = f"is not made with {self.options} {dict(given)}: {error}; it takes "
            problem += ", ".join(names[first:]) or "no options; leave them out"
            if len(names) > first:
                problem += f"; an option of one {self.name} alone stands after its name: {text},NAME=VALUE"
            if self.key == "gait.planner" and "run" in names:
                problem = "takes the run, but must be a class, or make an object, with plan(run, robot)"
            if len(names) < first:
                problem = f"takes ({', '.join(names)}) and must take ({', '.join(before)})"
            said = f"the {self.name} {text} {problem}."
            raise InputError(said, key=self.options, value=dict(given)) from error

    def name_of(self, factory: Any) -> str:
        """Name of a class, function or object, as :meth:`find` takes it; with < if it cannot be made anew."""
        kind = factory.func if isinstance(factory, partial) else factory
        is_object = not hasattr(kind, "__qualname__")
        kind = type(kind) if is_object else kind
        name = kind.__qualname__
        if isinstance(factory, partial):
            name = f"<partial {name}>"
        elif is_object and not _is_as_made(factory):
            name = f"<object of {name}>"
        text = f"{kind.__module__}:{name}"
        ours = next((name for name, place in self.known.items() if place == text), "")
        if ours and load_object(self.key, text) is not kind:  # a class that calls itself by our name
            return f"{kind.__module__}:<class {name}>"
        return ours or text


def _is_as_made(thing: Any) -> bool:
    """Whether an object is as its class makes it without arguments."""
    try:
        return pickle.dumps(thing) == pickle.dumps(type(thing)())
    except Exception:  # which code of a user may raise
        return False


CONTROLLER = Role(
    name="controller",
    key="controller.name",
    options="controller.options",
    known={"ampm": "ampm.control.controller:TrackingController"},
    arguments=("robot", "run"),
)
ESTIMATOR = Role(
    name="estimator",
    key="sensors.estimator",
    options="sensors.options",
    known={EXACT: "", "kalman": "ampm.sensors.kalman:Kalman"},
    arguments=("robot", "run", "start"),
)
PLANNER = Role(
    name="planner",
    key="gait.planner",
    options="planner.options",
    known=dict.fromkeys(STEP_PLANNERS, "") | {NO_PLAN: "ampm.planners:StandingPlanner"},
    arguments=(),
    otherwise="a table FILE.csv or FILE.parquet, or MODULE:CLASS",
)

_ROLES = (CONTROLLER, ESTIMATOR, PLANNER)  # all parts of a walk that may be a user's own class


def check_classes(run: RunParameters) -> None:
    """Refuse names and options of a run as :meth:`Role.find` does, before anything is planned.

    Nothing is imported for a name of ours without options; a planner is not made.
    """
    for role in _ROLES:
        name, options = role.named(run)
        if name not in role.known or options:
            role.find(name, options)


def users_classes(value: Any) -> dict[str, Any]:
    """Users' classes and tables that the runs in a value name, by these names.

    Raises :class:`InputError` if there is no such controller, planner or estimator.
    """
    if isinstance(value, RunParameters):
        named = ((role, *role.named(value)) for role in _ROLES)
        return {name: role.find(name, options) for role, name, options in named if name not in role.known}
    if is_dataclass(value):
        value = vars(value)
    items = value.values() if isinstance(value, Mapping) else value if isinstance(value, list | tuple) else ()
    return {name: thing for item in items for name, thing in users_classes(item).items()}


def users_files(run: RunParameters) -> list[Path]:
    """A user's own body and its model, without meshes, and files that options name, such as a policy."""
    options = map(run.value, OPTION_TABLES)
    values = [value for table in options for value in table.values() if isinstance(value, str)]
    files = [Path(value) for value in (run.body.source, *values) if os.path.isfile(value)]
    if Path(run.body.source) in files:
        from models.source import read_body_file, source_path  # loads the simulator

        with suppress(InputError):  # its runs will say what is wrong
            files.append(source_path(read_body_file(files[0]).source, files[0].parent))
    return files


def load_planner(text: str, options: Mapping[str, Option] = MappingProxyType({})) -> "Planner":
    """The planner that a text names.

    It is a name of :data:`ampm.planner.step_planners.STEP_PLANNERS`, a table (``.csv`` or ``.parquet``, see
    :mod:`ampm.planner.table`), a name of an installed package, or ``module:Class``, made with ``options``.
    Raises as :meth:`Role.find` does.
    """
    from ampm.planners import PeriodicPlanner, TablePlanner  # imported here: Pinocchio is slow to load

    factory = PLANNER.find(text, options)
    if factory is None:
        return PeriodicPlanner(text)
    if isinstance(factory, TablePlanner):
        return factory
    with UsersCode("planner", factory), chdir("."):
        planner: Planner = factory(**options)
    return planner


def planner_problem(made: Any) -> str:
    """What a planner made instead of a WalkPlan, and what completes it."""
    text = f"a {type(made).__name__}, not a WalkPlan"
    if isinstance(made, StepPlan):
        return f"{text}; ampm.WalkPlan.of(plan, posture=...) adds the posture"
    if isinstance(made, CentroidalPlan):
        return f"{text}; it lacks feet and posture: ampm.PeriodicPlanner().plan or ampm.make_plan adds them"
    return text


def replan_period(planner: Any) -> float:
    """Time from one call of a planner's ``replan`` to the next; infinite if there is none [s]."""
    with UsersCode("planner", planner):
        if not hasattr(planner, "replan"):
            return math.inf
        period = float(getattr(planner, "replan_period", 0.0))
        if not period >= 0.0:
            raise ValueError(f"its replan_period is {period} s; give a number of seconds, 0 or more")
    return period


def read_columns(path: Path) -> dict[str, NDArray[Any]]:
    """Columns of a table by name, shape (N,) each; an empty cell is NaN, or None among texts.

    Columns of CSV are parted as in its first line, by commas, semicolons or tabs (then with decimal commas,
    too); lines before it that begin with # are skipped. Raises :class:`InputError` if it has another suffix,
    or is missing or no such table.
    """
    # Imported here: pyarrow is slow to load.
    import pyarrow.csv
    import pyarrow.parquet as pq

    if path.suffix not in SUFFIXES:
        raise InputError(f"{path} must end in {' or '.join(SUFFIXES)}; the suffix chooses the format.")
    try:
        if path.suffix == ".parquet":
            with pq.ParquetFile(io.BytesIO(read_file(path, LARGEST_TABLE))) as file:
                cells = file.metadata.num_rows * file.metadata.num_columns
                if cells > LARGEST_TABLE // 8:  # a few bytes may stand for many
                    raise InputError(f"{path} has {cells:,} cells; give at most {LARGEST_TABLE // 8:,}.")
                table = file.read()
        else:
            text = read_text(path, LARGEST_TABLE)
            while text.startswith("#"):  # comments of a logger
                text = text.partition("\n")[2]
            rows, between = text.partition("\n")[2], separator(text)
            table = pyarrow.csv.read_csv(
                io.BytesIO(text.encode()),
                # A thread that still reads would abort a process that ends early.
                read_options=pyarrow.csv.ReadOptions(use_threads=False),
                parse_options=pyarrow.csv.ParseOptions(delimiter=between),
                convert_options=pyarrow.csv.ConvertOptions(
                    decimal_point="," if between != "," and re.search(r"\d,\d", rows) else "."
                ),
            )
        table = table.rename_columns([name.strip() for name in table.column_names])
        check_columns(table.column_names, path)
        return {name: table[name].to_numpy() for name in table.column_names}
    except (OSError, ValueError) as error:  # pyarrow's errors are ValueErrors
        raise InputError(f"{path} cannot be read as a table ({error}); give a whole file.") from error
