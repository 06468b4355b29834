"""Functions that numba compiles once per machine; plain Python under ``NUMBA_DISABLE_JIT=1``.

numba looks for changes of a function in its own file only, not in those of the functions that it calls. The
compiled code is therefore kept in a folder named after all source files that it may come from.
"""

import hashlib
import inspect
import logging
import os
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any, TypeVar, get_args

os.environ.setdefault("NUMBA_OPT", "1")  # as fast to run as at level 3, and sooner compiled

import numba
import numpy as np
from numba import extending, types
from numba.core import config, event
from numba.experimental import structref
from platformdirs import user_cache_path

Function = TypeVar("Function", bound=Callable[..., Any])
Kind = TypeVar("Kind")

_SOURCES = (
    "ampm/compiled.py",
    "ampm/linear.py",
    "ampm/reference.py",
    "ampm/vectors.py",
    "ampm/body/*.py",
    "ampm/control/*.py",
    "ampm/sensors/*.py",
    "ampm/stepping/*.py",
    "validation/trial/*.py",  # also where the named tuples are defined
)


@cache
def folder() -> Path:
    """Where the compiled code of these very sources is kept."""
    package, digest = Path(__file__).parent, hashlib.sha256()
    for pattern in _SOURCES:
        for path in sorted(package.parent.glob(pattern)):
            digest.update(path.read_bytes())
    base = package / "__pycache__" if os.access(package, os.W_OK) else user_cache_path("ampm")
    return Path(os.environ.get("NUMBA_CACHE_DIR", base)) / f"compiled-{digest.hexdigest()[:16]}"


def compiled(function: Function) -> Function:
    """Compile a function when it is first called, and keep the code on disk."""
    options = {"error_model": "numpy"}  # a division by zero gives what numpy gives
    before, config.CACHE_DIR = config.CACHE_DIR, str(folder())
    try:
        return numba.njit(cache=True, **options)(function)
    except RuntimeError:  # no folder can be written
        return numba.njit(**options)(function)
    finally:
        config.CACHE_DIR = before


def bound(function: Any, fixed: Sequence[Any], *example: Any) -> Any:
    """A compiled function with its first arguments fixed, called without numba's look-up of types.

    numba looks them up at every call, which for records takes longer than many functions.

    Args:
        function: see :func:`compiled`.
        fixed: its first arguments.
        example: its other arguments. Later ones must have the same types, and arrays the same order in
            memory: nothing checks this.
    """
    if not config.DISABLE_JIT:
        function = function.compile(tuple(map(numba.typeof, (*fixed, *example))))
    return partial(function, *fixed)


@structref.register
class HandleType(types.StructRef):
    """Fields of a named tuple, by reference."""


structref.define_boxing(HandleType, structref.StructRefProxy)


def refer(parts: Any) -> Any:
    """One reference to all fields of a named tuple of arrays, numbers and such named tuples.

    Compiled functions read the fields by the same names. As an argument a named tuple is unpacked at every
    call, 60 ns for each array; a reference is not. Arrays are shared; numbers are copied and stay. Python
    cannot read a reference: keep the named tuple beside it. Under ``NUMBA_DISABLE_JIT=1`` it is its argument.
    """
    return parts if config.DISABLE_JIT else _refer_to(parts)


def _handle(parts: Any) -> Any:
    """The reference, in compiled code."""
    return parts


@extending.overload(_handle)
def _handle_of(parts: Any) -> Any:
    if not isinstance(parts, types.BaseNamedTuple):
        return None
    space = {"Any": Any, "kind": _handle_type(parts), "new": structref.new, "handle_of": _handle}
    lines = ["def make(parts: Any) -> Any:", "    handle = new(kind)"]
    for name, part in zip(parts.fields, parts, strict=True):
        call = "handle_of" * isinstance(part, types.BaseNamedTuple)
        lines.append(f"    handle.{name} = {call}(parts.{name})")
    exec("\n".join([*lines, "    return handle"]), space)
    return space["make"]


def _handle_type(kind: Any) -> Any:
    """Type of the reference to a named tuple of this type; of anything else the type itself."""
    if not isinstance(kind, types.BaseNamedTuple):
        return types.unliteral(kind)
    return HandleType([(name, _handle_type(part)) for name, part in zip(kind.fields, kind, strict=True)])


@compiled
def _refer_to(parts: Any) -> Any:
    return _handle(parts)


def records(shape: int | tuple[int, ...], kind: type) -> Any:
    """Zeroed entries with the fields of a class, which compiled functions read as attributes.

    A field is a number, or floats as ``Annotated[Array, shape]``. Those of base classes come last: numba
    takes an entry with more fields at its end for one with fewer.
    """
    annotated = [item for part in kind.__mro__ for item in inspect.get_annotations(part).items()]
    fields = [(name, float, *get_args(of)[1:]) if get_args(of) else (name, of) for name, of in annotated]
    array = np.zeros(shape, np.dtype(fields, align=True))
    return array.view(np.recarray) if config.DISABLE_JIT else array


def zeros_of(kind: type[Kind], sizes: Mapping[str, int], **given: Any) -> Kind:
    """A named tuple with what is given, and else zeros in the shapes of ``Annotated[Array, shape]``."""
    for name, annotation in kind.__annotations__.items():
        if name not in given:
            array, shape = get_args(annotation)
            dtype = get_args(get_args(array)[1])[0]
            given[name] = np.zeros([sizes.get(length, length) for length in shape], dtype)
    return kind(**given)


class _Compilation(event.TimingListener):
    """Reports the first compilation, and adds up the wall-clock time of all."""

    _announced = False

    @property
    def seconds(self) -> float:
        """Time of all compilations so far [s]."""
        return float(self.duration) if self.done else 0.0

    def on_start(self, event: Any) -> None:
        super().on_start(event)
        module = event.data["dispatcher"].py_func.__module__ or ""
        if not self._announced and module.startswith(("ampm.", "validation.")):
            self._announced = True
            logging.getLogger("ampm").warning(
                "Compiling what is used for the first time on this machine; a first walk takes a minute more."
            )


compilation = _Compilation()
event.register("numba:compile", compilation)
