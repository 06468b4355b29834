"""Entry point of the console script ``ampm``: handles Ctrl-C before it imports anything slow."""

import os
import sys

from validation.output import own_descriptor
from validation.progress import INTERRUPTED, interruption
from validation.store.machine import one_blas_thread


def main() -> None:
    """Entry point of the console script."""
    interruption.install()
    one_blas_thread()
    own_descriptor()
    try:
        from validation.cli import app as cli  # imported here: Ctrl-C is handled from now on

        if "_AMPM_COMPLETE" in os.environ:  # a shell asks for completions
            cli.app()
        status = cli.call(sys.argv[1:])
    except BaseException:
        if not interruption.pending:  # during an import some modules make another error of an interruption
            raise
        sys.stderr.write("ampm: interrupted\n")
        status = INTERRUPTED
    sys.exit(status)
