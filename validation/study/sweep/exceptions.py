"""Errors of a sweep. Loads fast: the command line imports this on every start."""

from __future__ import annotations

from ampm.exceptions import AmpmError


class SweepStopped(AmpmError):
    """The sweep cannot continue: a full disk, a lost scheduler. ``--resume`` continues it later.

    Args:
        reason: what stopped it.
        way_out: what to do before it continues.
    """

    def __init__(self, reason: str, way_out: str = "free some space") -> None:
        self.reason, self.way_out = reason, way_out
        super().__init__(reason, way_out)  # pickled when a worker raises it

    def __str__(self) -> str:
        return f"{self.reason}; every row until now is kept: {self.way_out}, and go on with --resume."
