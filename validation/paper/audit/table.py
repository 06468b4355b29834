"""The audit for readers: a table on the terminal, JSON, and the page ``docs/audit.md``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import groupby
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from validation.paper.audit.rows import Check, Row, Verdict

COLOURS = {
    Verdict.HOLDS: "green",
    Verdict.ERRATUM: "yellow",
    Verdict.CONTRADICTED: "red",
    Verdict.UNTESTED: "dim",
}
_LONGEST = 44  # characters of a symbolic residual on the terminal
FILE_WIDTH = 100
"""Width of the table in files and pipes [characters]."""
COMMAND = "python -m validation.paper.audit"
"""What writes ``docs/audit.md`` again."""


def describe(rows: Sequence[Row]) -> dict[str, Any]:
    """The audit as a JSON object: counts of verdicts, and the rows."""
    return {
        "counts": {str(verdict): count for verdict, count in _counts(rows)},
        "consistent": all(row.consistent for row in rows),
        "rows": [{"number": number, **row.as_dict()} for number, row in enumerate(rows, 1)],
    }


def print_rows(rows: Sequence[Row], console: Console | None = None) -> None:
    """Print the audit on stdout, with the decisive evidence; ``--json`` has all of it."""
    console = console or Console(highlight=False)
    if not console.is_terminal:
        console.width = FILE_WIDTH
    table = Table(show_lines=True, expand=False)
    table.add_column("where", width=18)
    table.add_column("printed, and → corrected", ratio=3)
    table.add_column("verdict", width=12)
    table.add_column("evidence", ratio=3)
    for row in rows:
        colour = COLOURS[row.verdict]
        where = f"{row.section} {row.place}" if row.section[0].isdigit() else f"{row.section}: {row.place}"
        if row.errata:
            where += f"\n{', '.join(row.errata)}"
        statement = escape(row.printed)
        if row.corrected and row.verdict is not Verdict.HOLDS:
            statement += f"\n[green]→ {escape(row.corrected)}[/green]"
        table.add_row(escape(where), statement, f"[{colour}]{row.verdict}[/{colour}]", escape(_decisive(row)))
    console.print(table)
    console.print(summary(rows))


def summary(rows: Sequence[Row]) -> str:
    """One line: how many rows, and how many of each verdict."""
    return f"{len(rows)} rows: " + ", ".join(f"{count} {verdict}" for verdict, count in _counts(rows))


def _counts(rows: Sequence[Row]) -> list[tuple[Verdict, int]]:
    counted = Counter(row.verdict for row in rows)
    return [(verdict, counted[verdict]) for verdict in Verdict]


def _decisive(row: Row) -> str:
    """What decides a verdict, in few words."""
    if row.verdict is Verdict.UNTESTED:
        return row.why
    if row.verdict is Verdict.HOLDS:
        return _line(row.checks[0], short=True)
    lines = [_line(check, short=True) for check in row.checks if check.form == "printed" and not check.passed]
    if any(check.form == "corrected" for check in row.checks):
        stands = all(check.passed for check in row.checks if check.form == "corrected")
        lines.append("corrected: passes" if stands else "corrected: FAILS")
    return "\n".join(lines)


def _line(check: Check, *, short: bool = False) -> str:
    """One check in words: what, how much, on which gait."""
    value = check.shown()
    if short and check.kind == "symbolic" and len(value) > _LONGEST:
        value = "not zero"
    words = check.quantity if not value else f"{check.quantity}: {value}"
    return f"{words} ({check.gait})" if check.gait and value else words


def markdown(rows: Sequence[Row]) -> str:
    """The page ``docs/audit.md``."""
    parts = [_HEAD, summary(rows) + ".\n"]
    for section, group in groupby(rows, key=lambda row: row.section):
        parts.append(f"\n## {section.capitalize() if section[0].isalpha() else f'Section {section}'}\n")
        parts.append("| where | printed | corrected | verdict | evidence |\n|---|---|---|---|---|")
        for row in group:
            where = _plain(row.place) + (f" ({', '.join(row.errata)})" if row.errata else "")
            cells = (where, _code(row.printed), _code(row.corrected), str(row.verdict), _evidence(row))
            parts.append("| " + " | ".join(cells) + " |")
    return "\n".join(parts) + "\n"


def _evidence(row: Row) -> str:
    lines = []
    for check in row.checks:
        value = check.shown()
        shown = f": `{value}`" if check.kind == "symbolic" else f": {value}" if value else ""
        gait = f" ({check.gait})" if check.gait else ""
        both = row.verdict is not Verdict.HOLDS
        lines.append((f"*{check.form}*: " if both else "") + _plain(check.quantity) + shown + gait)
    if row.why:
        lines.append(_plain(row.why))
    return "<br>".join(lines)


def _code(text: str) -> str:
    """Formulas as code, words as words."""
    if not text:
        return ""
    return f"`{text}`" if any(sign in text for sign in ("=", "''", "^")) else _plain(text)


def _plain(text: str) -> str:
    """Text whose signs Markdown must leave alone."""
    for sign in ("|", "_", "*", "<", ">"):
        text = text.replace(sign, {"|": "\\|", "<": "&lt;", ">": "&gt;"}.get(sign, f"\\{sign}"))
    return text


_HEAD = f"""# The paper, audited

Every displayed equation and every claim of S. Kudoh and T. Komura, "C² Continuous Gait-Pattern Generation
for Biped Robots" (IROS 2003), from top to bottom. `ampm audit` prints this table in short, and
`ampm audit --json` all of it for machines; `{COMMAND}` writes this page again, and a test holds
it in step.

A verdict is not typed in, it follows from checks. **Symbolic** ones hold a formula against `(p - c) × F` and
Newton's law, derived with sympy, and show the residual that is left. **Numeric** ones are computed on the
`normal` gait, and on `momentum` where `normal` hides a misprint: with `c_s = c_y = 1` its force passes
through the COM. A number that is zero but for rounding is shown as 0. One claim is walked in physics.

* **holds**: the printed form stands its checks.
* **erratum**: it does not, and the corrected form does. The numbers are those of [theory](theory.md).
* **contradicted by the model**: the claim itself is at fault, by the plan, the body's motion or its walk.
* **cannot be tested**: the reason is given.
"""
