"""The one table of results: printed on a terminal, shown on a page, written as Markdown, CSV or LaTeX."""

import csv
import io
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from typing import Any

from markupsafe import escape
from rich.console import Console, ConsoleOptions, RenderResult
from rich.table import Table as TerminalTable
from rich.text import Text

from ampm.brief import Brief
from validation.output import results

COLORS = {"pass": "green", "better": "green", "fail": "red", "worse": "red", "undecided": "yellow"}
"""Colour of a cell on a terminal and on a page, by its whole text in lower case."""
ABSENT = "–"
"""Stands for a number that is absent or not defined."""
BW = "% BW"
"""Percent of body weight, short for tables."""
USED = ">used"
"""Header of a column of percentages that a page also shows as bars."""
_DECIMALS = 6  # most decimals of a number with its uncertainty
_LONG = 34  # characters from which a cell may break its line, whatever it holds
_PARAGRAPH = 70  # characters from which LaTeX breaks the lines of a column
_FILE_WIDTH = 160  # columns of a table that is written to a file or a pipe

_TEX = {
    **{sign: f"\\{sign}" for sign in "&%$#_{}"},
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "--": "-{}-",
    "±": r"$\pm$",
    "−": "$-$",
    "–": "--",
    "²": r"$^2$",
    "³": r"$^3$",
    "½": r"$\frac{1}{2}$",
    "√": r"$\surd$",
    "°": r"$^\circ$",
    "µ": r"$\mu$",
    "∞": r"$\infty$",
    "→": r"$\to$",
    "<": "$<$",
    ">": "$>$",
}


def tex(text: str) -> str:
    """A text as LaTeX writes it."""
    return re.sub("|".join(map(re.escape, _TEX)), lambda found: _TEX[found[0]], text)


@dataclass(frozen=True)
class Table:
    """Rows of texts under a title. A row of which only the first cell has a text is a heading."""

    title: str  # line above; empty for none
    columns: Sequence[str]  # header of each column; a `>` before it aligns the column to the right
    rows: Sequence[Sequence[str]]  # as many cells in each as there are columns; a page shows markup as such
    notes: Sequence[str] = field(default=())  # sentences below

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
        body = [[f"**{row[0]}**", *row[1:]] if is_heading(row) else row for row in self.rows]
        rows = (self.headers, marks, *body)
        escaped = [[cell.replace("|", "\\|").replace("\n", " ") for cell in row] for row in rows]
        lines = [f"| {' | '.join(row)} |" for row in escaped]
        return "\n".join(lines) + "".join(f"\n\n{note}" for note in self.notes)

    __str__ = markdown

    def csv(self) -> str:
        """Table and notes as CSV."""
        buffer = io.StringIO()
        csv.writer(buffer, lineterminator="\n").writerows([[self.title], self.headers, *self.rows])
        return buffer.getvalue() + "".join(f"# {note}\n" for note in self.notes)

    def tex(self) -> str:
        """Table with its title and notes for LaTeX with the package booktabs."""
        sides = ["r" if self.is_right(column) else "l" for column in range(len(self.columns))]
        for column, cells in enumerate(zip(*self.rows, strict=True)):
            if max(map(len, cells)) > _PARAGRAPH:
                sides[column] = r"p{.5\linewidth}"
        body = [
            rf"\multicolumn{{{len(sides)}}}{{l}}{{\emph{{{tex(row[0])}}}}} \\"
            if is_heading(row)
            else " & ".join(map(tex, row)) + r" \\"
            for row in self.rows
        ]
        notes = [rf"\par\raggedright {tex(note)}" for note in self.notes]
        lines = [
            r"\begin{table*}\centering\footnotesize",
            rf"\caption{{{tex(self.title[:1].upper() + self.title[1:])}}}",
            rf"\begin{{tabular}}{{@{{}}{''.join(sides)}@{{}}}}\toprule",
            " & ".join(map(tex, self.headers)) + r" \\ \midrule",
            *body,
            r"\bottomrule\end{tabular}",
            *notes,
            r"\end{table*}",
        ]
        return "\n".join([*lines, ""])

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Title, table and notes for a terminal; empty without rows and notes."""
        table = TerminalTable()
        for number, header in enumerate(self.headers):
            words = all(" " not in row[number] and len(row[number]) < _LONG for row in self.rows)
            is_whole = self.is_right(number) or words
            table.add_column(
                Text(header),
                justify="right" if self.is_right(number) else "left",
                no_wrap=is_whole,  # numbers and single words are not broken
                overflow="ellipsis" if is_whole else "fold",
            )
        for row in self.rows:
            style = "bold" if is_heading(row) else ""
            table.add_row(*(Text(cell, self._color(n, cell) or style) for n, cell in enumerate(row)))
        if self.title and (self.rows or self.notes):
            yield Text(self.title, style="bold")
        if self.rows:
            yield table
        for note in self.notes:
            yield Text(note)

    def __html__(self) -> str:
        """For pages and notebooks; empty without rows and notes."""
        title = f"<h3>{escape(self.title)}</h3>" if self.title else ""
        header = "".join(
            f"<th{self._html_class(number)}>{escape(text)}</th>" for number, text in enumerate(self.headers)
        )
        head = f"<thead><tr>{header}</tr></thead>" if any(self.headers) else ""
        rows = "\n".join(f"<tr>{self._html_row(row)}</tr>" for row in self.rows)
        table = f'<div class="scroll"><table>{head}<tbody>\n{rows}\n</tbody></table></div>' if rows else ""
        notes = "".join(f'<p class="note">{escape(note)}</p>' for note in self.notes)
        return f"{title}{table}{notes}" if rows or notes else ""

    _repr_html_ = __html__

    def _html_row(self, row: Sequence[str]) -> str:
        if is_heading(row):
            return f'<th colspan="{len(row)}" class="group">{escape(row[0])}</th>'
        cells = []
        for column, cell in enumerate(row):
            tag, scope = ("td", "") if column else ("th", ' scope="row"')
            content = f"{escape(cell)}{self._bar(column, cell)}"
            cells.append(f"<{tag}{scope}{self._html_class(column, cell)}>{content}</{tag}>")
        return "".join(cells)

    def _html_class(self, column: int, cell: str = "") -> str:
        names = ["n"] * self.is_right(column) + ["long"] * (len(cell) > _LONG)
        names += ["unit"] * (self.columns[column] in ("unit", "standard"))  # not broken at hyphens
        if color := self._color(column, cell):
            names.append(color)
        return f' class="{" ".join(names)}"' if names else ""

    def _color(self, column: int, cell: str) -> str:
        """Colour of a verdict; the name of a walk has none."""
        return "" if self.columns[column] in ("better", "best") else COLORS.get(cell.lower(), "")

    def _bar(self, column: int, cell: str) -> str:
        """A bar below a percentage."""
        if self.columns[column] != USED or not cell.endswith("%"):
            return ""
        percent = float(cell.removesuffix("%").removeprefix(">"))
        kind = "bar over" if percent > 100.0 else "bar"
        return f'<div class="{kind}"><i style="width:{min(max(percent, 0.0), 100.0):.0f}%"></i></div>'


class Tabled(Brief):
    """Base of results that have tables: a notebook shows them."""

    @property
    def sentence(self) -> str:
        """The result in one sentence; empty where the tables say it."""
        return ""

    def tables(self) -> Sequence[Table]:
        """All tables of the result."""
        raise NotImplementedError

    def _repr_html_(self) -> str:
        """The sentence and the tables, for notebooks."""
        first = f"<p><b>{escape(self.sentence)}</b></p>" if self.sentence else ""
        return first + "".join(table.__html__() for table in self.tables())


def package_rows(name: str) -> list[dict[str, str]]:
    """Rows of a CSV file of this package, by its path in it."""
    return list(csv.DictReader(files("validation").joinpath(name).read_text("utf-8").splitlines()))


def is_heading(row: Sequence[str]) -> bool:
    """Whether a row has a text in the first of several cells only."""
    return len(row) > 1 and bool(row[0]) and not any(row[1:])


def format_number(value: float | str | None, digits: int = 4) -> str:
    """A number for a table, infinity maybe as a word: significant digits, or a dash where there is none."""
    number = math.nan if value is None else float(value)
    if math.isnan(number):
        return ABSENT
    text = f"{number:.{digits}g}"
    return f"{number:.0f}" if "e+0" in text else text


def format_value(value: Any) -> str:
    """A parameter's value for a table: five digits of a float, anything else unchanged."""
    return format_number(value, 5) if value is None or isinstance(value, float) else str(value)


def format_duration(seconds: float) -> str:
    """A time as text: ``250 µs``, ``12 s``, ``45 min``, ``3 h 20 min``, ``11.6 days``; a dash for NaN."""
    if math.isnan(seconds):
        return ABSENT
    for unit, size, most in (("µs", 1e-6, 1000), ("ms", 1e-3, 1000), ("s", 1.0, 90)):
        if seconds < most * size:
            return f"{seconds / size:.3g} {unit}"
    hours, minutes = divmod(round(seconds / 60), 60)
    if seconds < 5400:
        return f"{60 * hours + minutes} min"
    if hours < 48:
        return f"{hours} h {minutes} min" if minutes else f"{hours} h"
    return f"{seconds / 86400:.1f} days"


def with_uncertainty(value: float | str | None, uncertainty: float | str | None) -> str:
    """A number with its uncertainty of two digits, cut at its last one; alone where none is known.

    A power of ten stands behind both if they are small.
    """
    number, doubt = (math.nan if item is None else float(item) for item in (value, uncertainty))
    if math.isnan(number) or math.isnan(doubt):
        return format_number(value, 3)
    if math.isinf(number) or math.isinf(doubt) or doubt == 0.0:
        return f"{format_number(value, 3)} ± {format_number(doubt, 2).replace('inf', '∞')}"
    decimals = 1 - math.floor(math.log10(float(f"{doubt:.1e}")))
    power = math.floor(math.log10(max(abs(number), doubt)))
    if decimals > _DECIMALS and power < -2:
        return f"({with_uncertainty(number / 10.0**power, doubt / 10.0**power)})e{power}"
    shown = [round(item, decimals) + 0.0 for item in (number, doubt)]  # no negative zero
    return " ± ".join(f"{item:.{max(decimals, 0)}f}" for item in shown)


def format_share(value: float | str | None, limit: float | None) -> str:
    """How much of a limit a value uses, for a column :data:`USED`; empty where there is none."""
    number = math.nan if value is None else float(value)
    if math.isnan(number) or not limit or limit < 0.0:
        return ""
    share = number / limit
    return f"{100.0 * share:.0f} %" if share < 100.0 else "> 10000 %"


def short_unit(unit: str) -> str:
    """A unit, short for tables; empty for that of a plain number, ``1``."""
    return "" if unit == "1" else unit.replace("% of body weight", BW)


def print_tables(tables: Iterable[Table]) -> None:
    """Print tables on stdout; in a file or a pipe they are wide enough not to break lines."""
    console = Console(file=results(), highlight=False)
    if not console.is_terminal:
        console.width = max(console.width, _FILE_WIDTH)
    for table in tables:
        console.print(table)
