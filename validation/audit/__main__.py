"""Write the page of the audit again: ``python -m validation.audit [docs/audit.md]``."""

from __future__ import annotations

import sys
from pathlib import Path

from validation.audit import audit
from validation.audit.table import markdown
from validation.console import Narrator

if __name__ == "__main__":
    page = Path(sys.argv[1] if len(sys.argv) > 1 else "docs/audit.md")
    page.write_text(markdown(audit(Narrator())), encoding="utf-8")
