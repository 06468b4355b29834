"""Write the page of the audit again: ``python -m validation.paper.audit [docs/audit.md]``."""

from __future__ import annotations

import sys
from pathlib import Path

from validation.store.machine import one_blas_thread


def main() -> None:
    """Audit the paper and write the page."""
    one_blas_thread()
    from validation.cli.console import Narrator
    from validation.paper.audit import audit
    from validation.paper.audit.table import markdown

    page = Path(sys.argv[1] if len(sys.argv) > 1 else "docs/audit.md")
    page.write_text(markdown(audit(Narrator())), encoding="utf-8")


if __name__ == "__main__":
    main()
