"""Objects that a user gives by an option: classes by name, pushes by numbers."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from typing import Any

from ampm.exceptions import InputError
from validation.trial.disturbances import Push
from validation.trial.users import UsersCode


def load_object(option: str, text: str) -> Any:
    """Import what ``module:name`` means; modules of the working directory are found, too.

    Raises:
        InputError: there is no such module, or no such name in it.
    """
    module, colon, name = text.partition(":")
    if not (module and colon and name):
        raise InputError(f"{option} {text!r} must be MODULE:CLASS, for example mine:Controller.")
    sys.path.insert(0, str(Path.cwd()))
    try:
        return getattr(import_module(module), name)
    except (ImportError, AttributeError) as error:
        raise InputError(f"{option} {text!r} cannot be imported ({error}); correct the name.") from error
    finally:
        sys.path.pop(0)


def make_object(option: str, text: str) -> Any:
    """Call what :func:`load_object` imports.

    Raises:
        InputError: as it does, or the call fails.
    """
    factory = load_object(option, text)
    with UsersCode("class", factory):
        return factory()


def parse_push(text: str) -> Push:
    """A push from ``SEGMENT,FX,FY,FZ,AT,DURATION``.

    Raises:
        InputError: the text is none.
    """
    segment, *parts = (part.strip() for part in text.split(","))
    try:
        x, y, z, at, duration = (float(part) for part in parts)
    except ValueError:
        raise InputError(
            f"--push {text!r} must be SEGMENT,FX,FY,FZ,AT,DURATION; write for example chest,50,0,0,2.0,0.1."
        ) from None
    return Push(segment, (x, y, z), at, duration)
