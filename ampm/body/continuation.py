"""Continuation: from the solution of an easy problem to that of a hard one, in strides along the way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Strides:
    """Shares of the way that are tried at a time [1].

    Attributes:
        shrink: factor after a failure.
        grow: factor after a success.
        first: the first stride.
        least: a shorter one is not tried.
    """

    shrink: float
    grow: float
    first: float = 0.5
    least: float = 0.02


class EndOfWay(Exception):
    """Raised by an attempt that makes no sense: the budget is spent, or the last solution is hopeless."""


def follow(attempt: Callable[[float, float], bool], strides: Strides) -> float:
    """Go from share 0 to share 1.

    Args:
        attempt: called with the share to try and the stride; solves the problem there from the last solution,
            keeps what it finds, and returns whether it succeeded.
        strides: how the share to try is chosen.

    Returns:
        The share that was reached.
    """
    share, stride = 0.0, strides.first
    while share < 1.0 and stride >= strides.least:
        ahead = min(1.0, share + stride)
        try:
            reached = attempt(ahead, stride)
        except EndOfWay:
            break
        if reached:
            share = ahead
        stride *= strides.grow if reached else strides.shrink
    return share
