"""Write the table of columns into docs/sweeps.md: ``python docs/sweeps.py``."""

from __future__ import annotations

from pathlib import Path

from validation.study.sweep.columns import COLUMNS

PAGE = Path(__file__).with_suffix(".md")
MARKS = ("<!-- columns -->", "<!-- end of columns -->")


def table() -> str:
    """One line per column."""
    lines = ["| column | kind | unit | meaning |", "|---|---|---|---|"]
    lines += [f"| `{item.name}` | {item.kind} | {item.unit} | {item.words} |" for item in COLUMNS]
    return "\n".join(lines)


if __name__ == "__main__":
    text = PAGE.read_text(encoding="utf-8")
    head, _, rest = text.partition(MARKS[0])
    _, _, tail = rest.partition(MARKS[1])
    PAGE.write_text(f"{head}{MARKS[0]}\n\n{table()}\n\n{MARKS[1]}{tail}", encoding="utf-8")
