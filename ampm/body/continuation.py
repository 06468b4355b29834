"""Continuation: from the solution of an easy problem to that of a hard one, in strides along the way."""

from __future__ import annotations

from dataclasses import dataclass

_LEAST = 0.02  # a shorter stride is not tried


@dataclass
class Way:
    """How far a search has come, and how far it tries to go next.

    Attributes:
        shrink: factor of the stride after a failure.
        grow: factor of the stride after a success.
        share: of the way that has been reached [1].
        stride: share of the way that is tried at a time [1].
    """

    shrink: float
    grow: float
    share: float = 0.0
    stride: float = 0.5

    @property
    def open(self) -> bool:
        """Whether there is a stride left to try."""
        return self.share < 1.0 and self.stride >= _LEAST

    @property
    def ahead(self) -> float:
        """Share to try next."""
        return min(1.0, self.share + self.stride)

    def tried(self, *, reached: bool) -> None:
        """Take in whether the problem at the share ahead was solved."""
        self.share, factor = (self.ahead, self.grow) if reached else (self.share, self.shrink)
        self.stride *= factor
