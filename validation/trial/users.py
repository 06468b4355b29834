"""Users' classes: find and import them, and report their errors with their name."""

import inspect
import sys
import traceback
from collections.abc import Callable, Mapping
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from types import TracebackType
from typing import Any

import ampm
from ampm.exceptions import AmpmError, InputError
from ampm.section import Option, nearest

_OURS = Path(ampm.__file__).parent, Path(__file__).parents[1], Path(traceback.__file__).parent
OPTIONS_OF: Mapping[str, str] = {
    "controller.name": "controller.options",
    "gait.planner": "planner.options",
    "sensors.estimator": "sensors.options",
}
"""Keys that name a class, and the tables of its options."""
_WAY_OUT = "; correct it, --debug shows the traceback."


class UsersError(InputError):
    """An error in a user's class."""

    @property
    def fault(self) -> str:
        """The sentence without its way out."""
        return str(self).removesuffix(_WAY_OUT)


class UsersCode:
    """Context that turns an error of a user's class into one sentence.

    Args:
        what: its role, for example ``controller``.
        thing: the class, factory or object.

    Raises:
        UsersError: anything was raised but an :class:`AmpmError`, which passes.
    """

    def __init__(self, what: str, thing: Any) -> None:
        self.what, self.thing = what, thing

    def __enter__(self) -> None:
        """No preparation is needed."""

    def __exit__(self, kind: object, error: BaseException | None, trace: TracebackType | None) -> None:
        """Raise an error that names the class."""
        if isinstance(error, Exception | SystemExit) and not isinstance(error, AmpmError):
            name = getattr(self.thing, "__qualname__", None) or type(self.thing).__name__
            frames = [(Path(frame.filename), frame.lineno) for frame in traceback.extract_tb(trace)]
            own = [(path.name, line) for path, line in frames if not any(map(path.is_relative_to, _OURS))]
            place = "".join(f" in {file}, line {line}" for file, line in own[-1:])
            raise UsersError(
                f"the {self.what} {name} failed ({type(error).__name__}: {error}){place}{_WAY_OUT}"
            ) from error


def load_object(option: str, text: str) -> Any:
    """Import the object ``module:name``; modules of the working directory are found, too.

    Raises:
        InputError: there is no such module, or no such name in it.
    """
    module, colon, name = text.partition(":")
    if not (module and colon and name):
        raise InputError(f"{option} {text!r} must be MODULE:CLASS, for example mine:Controller.")
    sys.path.insert(0, str(Path.cwd()))
    try:
        return getattr(import_module(module), name)
    except (Exception, SystemExit) as error:
        raise InputError(
            f"{option} {text!r} cannot be imported ({type(error).__name__}: {error}); correct name or module."
        ) from error
    finally:
        sys.path.pop(0)


def load_named(option: str, text: str, known: Mapping[str, str], group: str) -> Any:
    """Import what a name stands for, or ``module:name``.

    Args:
        option: that names it, for messages.
        text: a name or ``module:name``.
        known: the project's own names, and what they stand for.
        group: of entry points, by which installed packages add names.

    Raises:
        InputError: nothing has this name, or it cannot be imported.
    """
    if ":" not in text and text not in known:
        known = {**known, **{item.name: item.value for item in entry_points(group=group)}}
        if text not in known:
            raise InputError(
                f"{option} {text!r} is none of {', '.join(known)}; take one of them, or MODULE:CLASS, "
                "for example mine:Controller."
            )
    return load_object(option, known.get(text, text))


def check_options(
    key: str,
    name: str,
    options: Mapping[str, Option],
    factory: Callable[..., Any] | None = None,
    positional: int = 0,
) -> None:
    """Refuse options that a class does not take, and the lack of one that it needs.

    Args:
        key: that names the class, one of :data:`OPTIONS_OF`.
        name: of the class.
        options: by name.
        factory: the class or function; None if it takes no options.
        positional: number of arguments that it gets before the options.

    Raises:
        InputError: an option is unknown or missing.
    """
    try:
        every = [] if factory is None else list(inspect.signature(factory).parameters.values())
    except (TypeError, ValueError):  # compiled code has no signature; its call will say what is wrong
        return
    before = [item for item in every if item.kind in (item.POSITIONAL_ONLY, item.POSITIONAL_OR_KEYWORD)]
    named = [item for item in every if item.kind in (item.POSITIONAL_OR_KEYWORD, item.KEYWORD_ONLY)]
    taken = {item.name: item for item in named if item not in before[:positional]}
    table = OPTIONS_OF[key]
    for option in options:
        if option in taken or any(item.kind is item.VAR_KEYWORD for item in every):
            continue
        similar = nearest(option, taken)
        way_out = f"write {similar}" if similar else f"leave it out, or name another class as {key}"
        raise InputError(
            f"{table}.{option} is no option of {name}, which takes {', '.join(taken) or 'none'}; {way_out}.",
            key=f"{table}.{option}",
            value=options[option],
            way_out=way_out,
        )
    for option, item in taken.items():
        if item.default is item.empty and option not in options:
            way_out = f"write {table}.{option} = ..."
            raise InputError(f"{name} needs {table}.{option}; {way_out}", key=key, way_out=way_out)


def make_object(key: str, text: str, options: Mapping[str, Option], *arguments: Any) -> Any:
    """Call what :func:`load_object` imports.

    Args:
        key: that names the class, one of :data:`OPTIONS_OF`.
        text: ``module:Class``.
        options: keyword arguments.
        arguments: before them.

    Raises:
        InputError: as it does, an option is unknown or missing, or the call fails.
    """
    factory = load_object(key, text)
    check_options(key, text, options, factory, len(arguments))
    with UsersCode("class", factory):
        return factory(*arguments, **options)
