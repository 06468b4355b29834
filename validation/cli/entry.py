"""Entry point of the console script ``ampm``: handles Ctrl-C before it imports anything slow."""

import gc
import os
import signal
import sys

from validation.progress import INTERRUPTED, interruption
from validation.store.machine import one_blas_thread


def main() -> None:
    """Entry point of the console script."""
    interruption.install()
    gc.set_threshold(20_000)  # imports make many objects, of which none is garbage
    arguments = sys.argv[1:]
    try:
        one_blas_thread()
        from validation.cli import app as cli  # imported here: Ctrl-C is handled from now on

        if "_AMPM_COMPLETE" in os.environ:  # a shell asks for completions
            cli.app()
        status = cli.call(arguments)
    except SystemExit:
        raise
    except BaseException as error:
        if not (interruption.pending or isinstance(error, KeyboardInterrupt)):
            raise
        interruption.finished = True
        status = _interrupted(arguments)
    interruption.finished = True
    # The output is complete. The interpreter's shutdown would restore the default handler, which ends without
    # a status.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    gc.freeze()  # a shutdown that searches all objects for garbage takes a tenth of a second
    sys.exit(int(status))


def _interrupted(arguments: list[str]) -> int:
    """Report the interruption without modules whose import may have been interrupted."""
    if "--json" in arguments:
        sys.stdout.write(
            '{\n  "error": {\n    "kind": "interrupted",\n    "message": "interrupted"\n  }\n}\n'
        )
        sys.stdout.flush()
    sys.stderr.write("ampm: interrupted\n")
    return INTERRUPTED
