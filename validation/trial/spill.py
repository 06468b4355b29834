"""Large arrays in temporary files, so that a long walk needs little memory.

Their pages are the system's: :func:`release` gives them back, and they are read again when they are used.
Small arrays, and all of them where there is no room on the disk, are in memory as any other.
"""

import math
import mmap
import os
import tempfile
import weakref
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

LEAST = 1 << 17
"""Rows from which an array is in a file; 30 steps at the default time step have a third of them."""

ROWS = 16_384
"""Rows that are worked on between two releases."""
_files: weakref.WeakSet[mmap.mmap] = weakref.WeakSet()


def zeros(shape: Sequence[int], dtype: Any = np.float64) -> NDArray[Any]:
    """Array of zeros; its file has no name and ends with it."""
    size = math.prod(shape) * np.dtype(dtype).itemsize
    if not size or shape[0] < LEAST or not hasattr(mmap, "MADV_DONTNEED"):
        return np.zeros(shape, dtype)
    try:
        with tempfile.TemporaryFile(prefix="ampm-") as file:
            os.posix_fallocate(file.fileno(), 0, size)  # now, as a full disk would end the process later
            memory = mmap.mmap(file.fileno(), size)
    except OSError:
        return np.zeros(shape, dtype)
    _files.add(memory)
    return np.ndarray(tuple(shape), dtype, buffer=memory)


def release() -> None:
    """Give back the memory of all such arrays; their numbers stay."""
    for memory in tuple(_files):
        memory.madvise(mmap.MADV_DONTNEED)


def blocks(rows: int, most: int = ROWS) -> Iterator[slice]:
    """Rows a part at a time, ``most`` of them; the memory is given back after each."""
    for start in range(0, rows, most):
        yield slice(start, min(start + most, rows))
        release()
