"""What ``ampm audit`` does."""

from __future__ import annotations

from validation.cli.console import Narrator, print_json
from validation.paper.audit import audit


def run(*, as_json: bool) -> bool:
    """Audit the paper and print the result on stdout.

    Args:
        as_json: JSON instead of a table.

    Returns:
        Whether every corrected form stands its checks: the audit of the audit.

    Raises:
        InputError: sympy is not installed.
    """
    narrator = Narrator()
    rows = audit(narrator)
    from validation.paper.audit.table import describe, print_rows  # after the check for sympy

    if as_json:
        print_json(describe(rows))
    else:
        print_rows(rows)
    failed = [row for row in rows if not row.consistent]
    for row in failed:
        narrator.say(f"section {row.section}, {row.place}: the corrected form does not stand its checks")
    return not failed
