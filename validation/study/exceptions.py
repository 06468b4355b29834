"""Errors of studies. Loads fast: the command line imports this on every start."""

from ampm.exceptions import AmpmError


class StudyStopped(AmpmError):
    """A study cannot go on: a full disk, a lost scheduler, a worker that cannot work. Finished runs are kept.

    Args:
        reason: what stopped it.
        way_out: what to do before it goes on.
    """

    def __init__(self, reason: str, way_out: str) -> None:
        self.reason, self.way_out = reason, way_out
        super().__init__(reason, way_out)  # pickled when a worker raises it

    def __str__(self) -> str:
        return f"{self.reason}; every finished run is kept: {self.way_out}, and go on with --resume."
