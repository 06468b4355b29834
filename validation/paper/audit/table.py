"""The audit for readers: a table on the terminal, JSON, and the tables of ``docs/errata.md``."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from validation.paper.audit.rows import Check, Row, Verdict
from validation.show.text import markdown_table

COLOURS = {
    Verdict.HOLDS: "green",
    Verdict.ERRATUM: "yellow",
    Verdict.CONTRADICTED: "red",
    Verdict.UNTESTED: "dim",
}
KINDS: Mapping[str, tuple[int, ...]] = {
    "misprints": (1, 2, 3, 4, 6, 7, 8, 9, 10, 11, 14, 15, 16, 23),
    "wording": (5, 19, 20, 21, 26, 27, 28, 30, 31, 33),
    "claims": (12, 13, 17, 18, 24, 25, 29, 32, 34),
}
"""Numbers of the errata by what they are: slips in formulas, words that another place of the paper sets
right, and claims that mechanics or the model does not bear out. E22 is withdrawn."""
_LONGEST = 44  # characters of a symbolic residual on the terminal
FILE_WIDTH = 100
"""Width of the table in files and pipes [characters]."""


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
    """Reason of a verdict, in few words."""
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
    value = check.shown
    if short and check.kind == "symbolic" and len(value) > _LONGEST:
        value = "not zero"
    words = check.quantity if not value else f"{check.quantity}: {value}"
    return f"{words} ({check.gait})" if check.gait and value else words


def errata_table(rows: Sequence[Row], kind: str) -> str:
    """Errata of a kind of :data:`KINDS`, for ``docs/errata.md``: where, printed, corrected, verdict."""
    found: dict[str, Row] = {}
    for row in rows:
        if row.verdict is not Verdict.HOLDS:
            for number in row.errata:
                found.setdefault(number, row)
    lines = []
    for number in (f"E{n}" for n in KINDS[kind]):
        row = found[number]
        verdict = "contradicted" if row.verdict is Verdict.CONTRADICTED else "erratum"
        where = f"{row.section}, {row.place}" if row.section[0].isdigit() else f"{row.section}: {row.place}"
        lines.append((number, _plain(where), _code(row.printed), _code(row.corrected), verdict))
    return markdown_table(("", "where", "printed", "corrected", "verdict"), lines)


def write_csv(rows: Sequence[Row], path: Path) -> None:
    """The whole audit as a table: one line per statement, its checks in words."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("section", "place", "printed", "corrected", "verdict", "errata", "evidence", "why"))
        for row in rows:
            checks = "; ".join(f"{check.form}: {_line(check)}" for check in row.checks)
            texts = (row.section, row.place, row.printed, row.corrected, str(row.verdict))
            writer.writerow((*texts, " ".join(row.errata), checks, row.why))


def _code(text: str) -> str:
    """Markdown of a form: formulas as code, other text unchanged."""
    return f"`{text}`" if any(sign in text for sign in ("=", "''", "^")) else _plain(text)


def _plain(text: str) -> str:
    """Text with Markdown's special characters escaped."""
    for sign in ("|", "_", "*", "<", ">"):
        text = text.replace(sign, {"|": "\\|", "<": "&lt;", ">": "&gt;"}.get(sign, f"\\{sign}"))
    return text
