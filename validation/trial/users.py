"""Code that users bring along: whatever goes wrong in it is told as theirs."""

from __future__ import annotations

from types import TracebackType
from typing import Any

from ampm.exceptions import AmpmError, InputError


class UsersCode:
    """Context that turns an error of a user's class into one sentence.

    Args:
        what: it is, ``controller`` for example.
        thing: the class, factory or object.

    Raises:
        InputError: anything was raised but an :class:`AmpmError`, which passes.
    """

    def __init__(self, what: str, thing: Any) -> None:
        self.what, self.thing = what, thing

    def __enter__(self) -> None:
        """Nothing to prepare."""

    def __exit__(self, kind: object, error: BaseException | None, trace: TracebackType | None) -> None:
        """Name the class."""
        if isinstance(error, Exception) and not isinstance(error, AmpmError):
            name = getattr(self.thing, "__qualname__", None) or type(self.thing).__name__
            raise InputError(
                f"the {self.what} {name} failed ({type(error).__name__}: {error}); correct it, --debug shows "
                "the traceback."
            ) from error
