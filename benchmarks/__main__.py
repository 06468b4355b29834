"""Entry point of ``python -m benchmarks``."""

import os
import sys

if __name__ == "__main__":
    from validation.store.machine import one_blas_thread

    one_blas_thread()
    os.environ.setdefault("MUJOCO_GL", "disable")
    from benchmarks.cli import app
    from validation.cli.app import call

    sys.exit(call(sys.argv[1:], app))
