"""Statistics of repeated work on a machine that does other things, too."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray


def least(rounds: Sequence[ArrayLike]) -> NDArray[np.float64]:
    """The least time of each piece of work over several rounds of the same work, shape (N,) [s].

    Another process rarely interrupts the same piece in all rounds, so the least times are those of the work
    itself.
    """
    return np.min(np.stack([np.asarray(spans, dtype=np.float64) for spans in rounds]), axis=0)
