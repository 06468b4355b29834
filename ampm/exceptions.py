"""Errors of the testbed: one root, and one class for each kind of failure.

A message is one sentence for the user: the value, the limit, and a way out.
"""

from typing import Any


class AmpmError(Exception):
    """Root of every error that the testbed raises on purpose."""


class InputError(AmpmError):
    """The request itself is wrong: an unknown key, a value that is not a number, a file that is missing.

    Attributes:
        details: for programs, those that are known of ``key``, ``value``, ``limit`` (in words), ``way_out``,
            and of an unknown name the ``nearest`` known one. What is None is left out.
    """

    def __init__(self, message: str = "", **details: Any) -> None:
        super().__init__(" ".join(str(message).split()))
        self.details = {name: value for name, value in details.items() if value is not None}


class RefusedGait(AmpmError):
    """A well-formed gait that cannot be walked.

    Attributes:
        reason: short name of the limit, for tables ("switching_velocity_too_low").
        value: beyond ``limit``.
        limit: that the value passed.
        unit: SI, of value and limit; "1" if they have none.
        way_out: what the user can change, the end of the message.
    """

    kind = "refused"

    def __init__(
        self, message: str, *, reason: str, value: float, limit: float, unit: str, way_out: str = ""
    ) -> None:
        super().__init__(message)
        self.reason, self.value, self.limit, self.unit = reason, value, limit, unit
        self.way_out = way_out

    def __str__(self) -> str:
        return f"{self.args[0]}; {self.way_out}." if self.way_out else f"{self.args[0]}."


class MathematicalRefusal(RefusedGait):
    """No body can walk this plan: the closed form itself has no solution."""

    kind = "mathematical"


class BodilyRefusal(RefusedGait):
    """The plan exists, but the body that was given cannot walk it."""

    kind = "bodily"


class SolverError(AmpmError):
    """A numerical solver failed where no fallback makes sense."""


def words_of(error: BaseException) -> str:
    """Message of an error in one line; empty where making it fails."""
    try:
        return " ".join(str(error).split())
    except Exception:
        return ""


class StudyStopped(AmpmError):
    """A study cannot go on: a full disk, a lost scheduler, a worker that cannot work. Finished runs are kept.

    ``reason`` is what stopped it, ``way_out`` what to do before it goes on.
    """

    def __init__(self, reason: str, way_out: str) -> None:
        self.reason, self.way_out = reason, way_out
        super().__init__(reason, way_out)  # pickled when a worker raises it

    def __str__(self) -> str:
        return f"{self.reason}; every finished run is kept: {self.way_out}, and go on with --resume."
