"""The one table of results: printed on a terminal, shown on a page, written as Markdown."""

import html
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Literal

from rich.console import Console, ConsoleOptions, RenderResult
from rich.table import Table as TerminalTable
from rich.text import Text

COLORS = {"pass": "green", "better": "green", "fail": "red", "worse": "red", "undecided": "yellow"}
"""Colour of a cell on a terminal, by its whole text in lower case."""
_FILE_WIDTH = 160
"""Columns of a table that is written to a file or a pipe."""


@dataclass(frozen=True)
class Table:
    """Rows of texts under a title.

    Attributes:
        title: line above; empty for none.
        columns: header of each column; a ``>`` before it aligns the column to the right.
        rows: cells, as many in each row as there are columns.
        notes: sentences below.
    """

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    notes: Sequence[str] = field(default=())

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(f"table {self.title!r}: {len(row)} cells for {len(self.columns)} columns")

    @property
    def headers(self) -> list[str]:
        """Texts of the header, without the signs of alignment."""
        return [column.removeprefix(">") for column in self.columns]

    def is_right(self, column: int) -> bool:
        """Whether a column is aligned to the right."""
        return self.columns[column].startswith(">")

    def markdown(self) -> str:
        """Table and notes in Markdown, without the title and without a line break at the end."""
        marks = ["---:" if self.is_right(column) else "---" for column in range(len(self.columns))]
        lines = [_markdown_row(cells) for cells in (self.headers, marks, *self.rows)]
        return "\n".join(lines) + "".join(f"\n\n{note}" for note in self.notes)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Title, table and notes for a terminal."""
        table = TerminalTable()
        for number, header in enumerate(self.headers):
            justify: Literal["left", "right"] = "right" if self.is_right(number) else "left"
            table.add_column(Text(header), justify=justify, no_wrap=justify == "right" or number == 0)
        for row in self.rows:
            table.add_row(*(Text(cell, COLORS.get(cell.lower(), "")) for cell in row))
        if self.title:
            yield Text(self.title, style="bold")
        if self.rows:
            yield table
        for note in self.notes:
            yield Text(note)

    def _repr_html_(self) -> str:
        """For notebooks."""
        header = "".join(f"<th>{html.escape(text)}</th>" for text in self.headers)
        rows = "".join(
            f"<tr>{''.join(f'<td>{html.escape(cell)}</td>' for cell in row)}</tr>" for row in self.rows
        )
        notes = "".join(f"<p>{html.escape(note)}</p>" for note in self.notes)
        title = f"<caption>{html.escape(self.title)}</caption>"
        return f"<table>{title}<thead><tr>{header}</tr></thead><tbody>{rows}</tbody></table>{notes}"


def print_tables(tables: Iterable[Table]) -> None:
    """Print tables on stdout; in a file or a pipe they are wide enough not to break lines."""
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = max(console.width, _FILE_WIDTH)
    for table in tables:
        console.print(table)


def markdown_page(tables: Iterable[Table]) -> str:
    """Tables in Markdown, each under its title."""
    return "\n".join(f"## {table.title}\n\n{table.markdown()}\n" for table in tables)


def _markdown_row(cells: Sequence[str]) -> str:
    escaped = (cell.replace("|", "\\|").replace("\n", " ") for cell in cells)
    return f"| {' | '.join(escaped)} |"
