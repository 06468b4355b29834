"""Where the console script ``ampm`` begins: ready for Ctrl-C before anything heavy is imported.

A ``KeyboardInterrupt`` can be lost: C extensions turn it into an ``ImportError`` or swallow it, and one that
is raised in a callback of the garbage collector vanishes. So the signal also leaves a mark, which is looked
at between stages and at the end. Only the standard library is imported here, and as little of it as possible.
"""

from __future__ import annotations

import os
import signal
import sys
from typing import Any

INTERRUPTED = 130


class Interruption:
    """The mark that a signal leaves.

    Attributes:
        count: signals so far.
        seen: how many of them somebody has answered.
        holding: whether the first signal waits for :meth:`release`, for work that is worth finishing.
        finished: whether the answer is out, so that a further signal may end the program at once.
    """

    def __init__(self) -> None:
        self.count = self.seen = 0
        self.holding = self.finished = False

    @property
    def pending(self) -> bool:
        """Whether a signal came that nobody has answered."""
        return self.count > self.seen

    def install(self) -> None:
        """Answer Ctrl-C and a termination signal from now on."""
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._receive)
        unraisable = sys.unraisablehook

        def quiet(lost: Any) -> None:
            if not (self.count and isinstance(lost.exc_value, KeyboardInterrupt)):
                unraisable(lost)

        sys.unraisablehook = quiet

    def _receive(self, number: int, frame: object) -> None:
        self.count += 1
        if self.finished:
            os._exit(INTERRUPTED)
        if self.holding and self.count - self.seen == 1:
            return
        raise KeyboardInterrupt

    def check(self) -> None:
        """Raise the ``KeyboardInterrupt`` that was lost on its way, if one was."""
        if self.pending and not self.holding:
            raise KeyboardInterrupt

    def acknowledge(self) -> None:
        """Count what came so far as answered: a walk that was interrupted says so itself."""
        self.seen = self.count

    def hold(self) -> None:
        """Let the first signal wait; a second one still interrupts."""
        self.holding = True

    def release(self) -> None:
        """End of :meth:`hold`."""
        self.holding = False


interruption = Interruption()
"""Of this process."""


def main() -> None:
    """Entry point of the console script."""
    interruption.install()
    arguments = sys.argv[1:]
    try:
        # Before numpy is loaded: threads on matrices this small cost three times what they save, and a run's
        # bits must not depend on how many cores share a sum.
        for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
            os.environ.setdefault(variable, "1")
        from validation.cli import app as cli

        if "_AMPM_COMPLETE" in os.environ:  # a shell asks for completions
            cli.app()
        status = cli.call(arguments)
    except SystemExit:
        raise
    except BaseException as error:
        if not (interruption.pending or isinstance(error, KeyboardInterrupt)):
            raise
        interruption.finished = True
        status = _interrupted(arguments)
    interruption.finished = True
    # The answer is out. The interpreter's own end would put the default back, which kills without a status.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    sys.exit(int(status))


def _interrupted(arguments: list[str]) -> int:
    """Say so without any of the modules whose import may have been interrupted."""
    if "--json" in arguments:
        sys.stdout.write(
            '{\n  "error": {\n    "kind": "interrupted",\n    "message": "interrupted"\n  }\n}\n'
        )
        sys.stdout.flush()
    sys.stderr.write("ampm: interrupted\n")
    return INTERRUPTED
