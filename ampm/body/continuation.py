"""Continuation: from the solution of an easy problem to that of a hard one, in steps along a path."""

from dataclasses import dataclass

_LEAST = 0.02  # a shorter step is not tried


@dataclass
class Continuation:
    """Share of a path that a search has reached, and the step that it tries next.

    Attributes:
        shrink: factor of the step after a failure.
        grow: factor of the step after a success.
        share: of the path that has been reached [1].
        step: share of the path that is tried at a time [1].
    """

    shrink: float
    grow: float
    share: float = 0.0
    step: float = 0.5

    @property
    def open(self) -> bool:
        """Whether there is a step left to try."""
        return self.share < 1.0 and self.step >= _LEAST

    @property
    def ahead(self) -> float:
        """Share to try next."""
        return min(1.0, self.share + self.step)

    def tried(self, *, reached: bool) -> None:
        """Record whether the problem at the share ahead was solved."""
        self.share, factor = (self.ahead, self.grow) if reached else (self.share, self.shrink)
        self.step *= factor
