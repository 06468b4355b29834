"""Entry point of the console script ``ampm``: ready for Ctrl-C before anything heavy is imported."""

from __future__ import annotations

import os
import signal
import sys

from validation.progress import INTERRUPTED, interruption


def main() -> None:
    """Entry point of the console script."""
    interruption.install()
    arguments = sys.argv[1:]
    try:
        # Before numpy is loaded: threads on matrices this small cost three times what they save, and a run's
        # bits must not depend on how many cores share a sum.
        for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
            os.environ.setdefault(variable, "1")
        from validation.cli import app as cli

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
    # The answer is out. The interpreter's own end would put the default back, which kills without a status.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    sys.exit(int(status))


def _interrupted(arguments: list[str]) -> int:
    """Say so without any of the modules whose import may have been interrupted."""
    if "--json" in arguments:
        sys.stdout.write(
            '{\n  "error": {\n    "kind": "interrupted",\n    "message": "interrupted"\n  }\n}\n'
        )
        sys.stdout.flush()
    sys.stderr.write("ampm: interrupted\n")
    return INTERRUPTED
