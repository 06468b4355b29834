"""Functions that numba compiles once per machine; plain Python under ``NUMBA_DISABLE_JIT=1``.

numba looks for changes of a function in its own file only, not in those of the functions that it calls. The
compiled code is therefore kept in a folder named after all source files that it may come from.
"""

import hashlib
import logging
import os
import time
from collections.abc import Callable, Sequence
from functools import cache, partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, TypeVar

import numba
import numpy as np
from numba import extending, types
from numba.core import config, event
from numba.core.imputils import lower_getattr_generic
from numba.core.typing.templates import AttributeTemplate
from platformdirs import user_cache_path

Function = TypeVar("Function", bound=Callable[..., Any])

_SOURCES = (
    "ampm/compiled.py",
    "ampm/linear.py",
    "ampm/qp.py",
    "ampm/vectors.py",
    "ampm/body/*.py",
    "ampm/control/*.py",
    "validation/trial/*.py",
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


class Bundle(SimpleNamespace):
    """Arrays and numbers that a compiled function gets as one argument and reads as its attributes.

    As arguments of their own they would be unpacked at every call, 70 ns each. Compiled functions read their
    headers where they are kept here, so the arrays must not be replaced, nor the numbers changed.
    """

    def __init__(self, **parts: Any) -> None:
        headers = np.array([word for part in parts.values() for word in _header(part)], dtype=np.int64)
        kind = BundleType(tuple((name, numba.typeof(part)) for name, part in parts.items()))
        place = headers.__array_interface__["data"][0]
        self.__dict__.update(parts, _headers=headers, _address=place, _type=kind)

    def __setattr__(self, name: str, value: Any) -> None:
        """The headers would stay those of the first."""
        raise AttributeError(f"{name} is part of a bundle and cannot be replaced")

    def __reduce__(self) -> Any:
        """A copy would read the arrays at the addresses of the first."""
        raise TypeError("a bundle has the addresses of its arrays and cannot be copied")


def _header(part: Any) -> list[int]:
    """What numba knows of an array, in the order of its ``ArrayModel``, or the bits of a number."""
    if not isinstance(part, np.ndarray):
        kind = np.float64 if isinstance(part, float) else np.int64
        return [int(np.array(part, dtype=kind).view(np.int64))]
    place = part.__array_interface__["data"][0]
    return [0, 0, part.size, part.itemsize, place, *part.shape, *part.strides]


class BundleType(types.Type):
    """Names and types of a bundle's parts."""

    key: tuple[tuple[str, Any], ...] = ()

    def __init__(self, parts: tuple[tuple[str, Any], ...]) -> None:
        self.key, self.parts, offset = parts, {}, 0
        for name, kind in parts:
            self.parts[name] = kind, offset
            offset += 5 + 2 * kind.ndim if isinstance(kind, types.Array) else 1
        super().__init__(f"Bundle({hashlib.sha256(repr(parts).encode()).hexdigest()[:16]})")


extending.register_model(BundleType)(extending.models.OpaqueModel)
extending.typeof_impl.register(Bundle)(lambda bundle, _: bundle._type)


@extending.infer_getattr
class _Part(AttributeTemplate):
    key = BundleType

    def generic_resolve(self, bundle: BundleType, name: str) -> Any:
        return bundle.parts[name][0] if name in bundle.parts else None


@lower_getattr_generic(BundleType)
def _part(context: Any, builder: Any, bundle: BundleType, value: Any, name: str) -> Any:
    kind, offset = bundle.parts[name]
    place = builder.gep(value, [context.get_constant(types.intp, 8 * offset)])
    place = builder.bitcast(place, context.get_data_type(kind).as_pointer())
    return context.unpack_value(builder, kind, place)


@extending.unbox(BundleType)
def _address(_: Any, bundle: Any, context: Any) -> Any:
    address = context.pyapi.object_getattr_string(bundle, "_address")
    place = context.pyapi.long_as_voidptr(address)
    context.pyapi.decref(address)
    return extending.NativeValue(place)


def records(shape: int | tuple[int, ...], fields: Sequence[Any]) -> Any:
    """Zeroed entries with fields (name, type, shape), which compiled functions read as attributes."""
    array = np.zeros(shape, np.dtype(list(fields), align=True))
    return array.view(np.recarray) if config.DISABLE_JIT else array


class _Compilation(event.Listener):
    """Reports the first compilation, and adds up the wall-clock time of all [s]."""

    def __init__(self) -> None:
        self.seconds, self._running, self._announced = 0.0, 0, False

    def on_start(self, event: Any) -> None:
        if not self._running:  # a function compiles those that it calls
            self.seconds -= time.perf_counter()
        self._running += 1
        module = event.data["dispatcher"].py_func.__module__ or ""
        if not self._announced and module.startswith(("ampm.", "validation.")):
            self._announced = True
            logging.getLogger("ampm").warning(
                "Compiling what is used for the first time on this machine; a first walk takes a minute more."
            )

    def on_end(self, event: Any) -> None:
        self._running -= 1
        if not self._running:
            self.seconds += time.perf_counter()


compilation = _Compilation()
event.register("numba:compile", compilation)
