"""Write the tables of docs/errata.md again: ``python -m validation.paper.audit``."""

from __future__ import annotations

from pathlib import Path

from validation.store.machine import one_blas_thread

PAGE = Path("docs/errata.md")
TABLE = Path("docs/data/audit.csv")


def main() -> None:
    """Audit the paper, and write the errata into the page and all rows into the table beside it."""
    one_blas_thread()
    # Imported here: the number of threads must be set before NumPy is loaded.
    from validation.paper.audit import audit
    from validation.paper.audit.table import KINDS, errata_table, summary, write_csv
    from validation.show.text import replace_between

    rows = audit()
    page = PAGE.read_text(encoding="utf-8")
    for kind in KINDS:
        page = replace_between(page, kind, errata_table(rows, kind))
    PAGE.write_text(replace_between(page, "counts", summary(rows)), encoding="utf-8")
    TABLE.parent.mkdir(exist_ok=True)
    write_csv(rows, TABLE)


if __name__ == "__main__":
    main()
