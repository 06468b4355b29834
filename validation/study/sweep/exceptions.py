"""Errors of a sweep. Nothing heavy is imported: the command line loads this on every start."""

from __future__ import annotations

from ampm.exceptions import AmpmError


class SweepStopped(AmpmError):
    """The sweep cannot go on here and now: a full disk, a lost scheduler. ``--resume`` goes on later.

    Args:
        reason: what stopped it.
        way_out: what to do before it goes on.
    """

    def __init__(self, reason: str, way_out: str = "free some space") -> None:
        self.reason, self.way_out = reason, way_out
        super().__init__(reason, way_out)  # as it is pickled on its way from a worker

    def __str__(self) -> str:
        return f"{self.reason}; every row until now is kept: {self.way_out}, and go on with --resume."
