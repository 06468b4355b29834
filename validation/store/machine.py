"""Cores, threads and memory of this process. Only the standard library is imported, as this runs first."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

THREAD_VARIABLES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")
"""Environment variables for the number of threads, read with linear algebra; the first that is set counts."""
HIDDEN_FILE = "_hidden_file"
"""Attribute of the main module that keeps its file inside :func:`hidden_main`."""


def cores() -> int:
    """Processors that this process may use: by its affinity, and by the quota of a container."""
    from dask.system import cpu_count  # imported here, as it takes long

    return int(cpu_count())


def one_blas_thread() -> None:
    """Give linear algebra one thread, unless the environment says otherwise; call it before numpy is loaded.

    On such small matrices threads cost three times what they save, and a run's bits must not depend on the
    number of cores.
    """
    for variable in THREAD_VARIABLES:
        os.environ.setdefault(variable, "1")


@contextmanager
def hidden_main() -> Iterator[None]:
    """Start worker processes that do not run the user's script again.

    ``multiprocessing`` imports the main module into every process that it spawns. A script without a
    ``__main__`` guard would begin its study again there.
    """
    main = sys.modules["__main__"]
    before = {name: getattr(main, name, None) for name in ("__spec__", "__file__")}
    try:
        main.__dict__.update({**dict.fromkeys(before), HIDDEN_FILE: before["__file__"]})
        yield
    finally:
        main.__dict__.update({**before, HIDDEN_FILE: None})


def memory_peak() -> float | None:
    """Largest resident memory of this process so far [MB]; None where that is not known.

    ``ru_maxrss`` would count the process that this one was started by.
    """
    with suppress(OSError), open("/proc/self/status", encoding="utf-8") as file:
        for line in file:
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024 / 1e6
    return None
