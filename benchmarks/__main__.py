"""Entry point of ``python -m benchmarks``."""

import os
import sys

if __name__ == "__main__":
    # Before numpy is loaded, as the command line does: one thread on matrices this small, and the same bits.
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    os.environ.setdefault("MUJOCO_GL", "disable")
    from benchmarks.cli import main

    sys.exit(main(sys.argv[1:]))
