"""Statistics of repeated work on a machine that does other things, too."""

import timeit
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray


def repeat(work: Callable[[], object], times: int) -> list[float]:
    """Times of ``work``, repeated that often after one call that is not counted [s]."""
    return timeit.repeat(work, setup=work, number=1, repeat=times)


def least(rounds: Sequence[ArrayLike]) -> NDArray[np.float64]:
    """The least time of each piece of work over several rounds of the same work, shape (N,) [s].

    Another process rarely interrupts the same piece in all rounds, so the least times are those of the work
    itself.
    """
    return np.min(np.stack([np.asarray(spans, dtype=np.float64) for spans in rounds]), axis=0)
