"""Progress of long work, and interruption by a signal. Silent unless a subclass prints.

A ``KeyboardInterrupt`` can be lost: C extensions turn it into an ``ImportError`` or swallow it, and one that
is raised in a callback of the garbage collector vanishes. Therefore the signal also sets a flag, which is
checked between stages and at the end. Only the standard library is imported here, and as little of it as
possible.
"""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NamedTuple

INTERRUPTED = 130


class Interruption:
    """Flag that a signal sets."""

    pending = 0  # number of signals that are not handled
    holding = False  # the first signal is deferred until the present work is done; a second one interrupts

    def install(self) -> None:
        """Handle Ctrl-C and a termination signal from now on."""
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._receive)

    def _receive(self, number: int, frame: object) -> None:
        self.pending += 1
        if self.holding and self.pending == 1:
            return
        raise KeyboardInterrupt

    def check(self) -> None:
        """Raise the ``KeyboardInterrupt`` that was lost, if one was."""
        if self.pending and not self.holding:
            raise KeyboardInterrupt

    def acknowledge(self) -> None:
        """Count all signals so far as handled: an interrupted walk records it itself."""
        self.pending = 0


interruption = Interruption()
"""Process-wide interruption flag."""


class Stage(NamedTuple):
    """One stage of a pipeline; by default it reports nothing."""

    # reports how much is done, and how much there is, in the stage's unit
    advance: Callable[[int, int], None] = lambda done, total: None
    note: Callable[[str], None] = lambda text: None  # reports a message


class Progress:
    """Reports nothing: the default of calls from Python, and the base class of reporters."""

    @contextmanager
    def stage(self, label: str, unit: str = "") -> Iterator[Stage]:
        """Enter one stage.

        Args:
            label: what is being done.
            unit: what ``done`` and ``total`` of :meth:`Stage.advance` count.
        """
        yield Stage()

    def say(self, text: str) -> None:
        """Report one line."""
