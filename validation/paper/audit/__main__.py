"""Write the page of the audit again: ``python -m validation.paper.audit [docs/audit.md]``."""

from __future__ import annotations

import os
import sys
from pathlib import Path


def main() -> None:
    """Audit the paper and write the page."""
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # before numpy, as the console script does
        os.environ.setdefault(variable, "1")
    from validation.cli.console import Narrator
    from validation.paper.audit import audit
    from validation.paper.audit.table import markdown

    page = Path(sys.argv[1] if len(sys.argv) > 1 else "docs/audit.md")
    page.write_text(markdown(audit(Narrator())), encoding="utf-8")


if __name__ == "__main__":
    main()
