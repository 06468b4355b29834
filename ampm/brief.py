"""How values are shown: one line as ``repr``, a few lines by ``print``, a table in a notebook."""

from collections.abc import Sequence
from dataclasses import fields
from html import escape
from typing import Any

_FACTS = 8


class Brief:
    """Base of dataclasses whose ``repr`` is one line: the first fields, of arrays their shape."""

    def __init_subclass__(cls, **more: Any) -> None:
        """Keep ``dataclass`` from writing another one; a class's own stays."""
        super().__init_subclass__(**more)
        if "__repr__" not in vars(cls):
            cls.__repr__ = Brief.__repr__  # type: ignore[method-assign]

    def __repr__(self) -> str:
        """Name and first fields."""
        names = [field.name for field in fields(self) if field.name[0] != "_"]  # type: ignore[arg-type]
        facts = [f"{name}={_said(getattr(self, name))}" for name in names[:_FACTS]]
        return f"{type(self).__name__}({', '.join(facts)}{', ...' if len(names) > _FACTS else ''})"


def text_of(title: str, rows: Sequence[Sequence[str]]) -> str:
    """A title, and below it rows of aligned columns."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in rows]
    return "\n".join([title, *(f"  {line}".rstrip() for line in lines)])


class Described(Brief):
    """Base of values that print as a title and rows of aligned cells, and show as a table in notebooks."""

    def _described(self) -> tuple[str, Sequence[Sequence[str]]]:
        """Title, and rows of equal length."""
        raise NotImplementedError

    def __str__(self) -> str:
        """Title, and below it the rows."""
        return text_of(*self._described())

    def _repr_html_(self) -> str:
        """Title and a table, for notebooks."""
        title, rows = self._described()
        body = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows)
        return f"<p><b>{escape(title)}</b></p><table>{body}</table>"


def _said(value: Any) -> str:
    """A number or a text; of anything else its shape or its type."""
    if isinstance(value, float):
        return f"{value:.6g}"
    if value is None or isinstance(value, int | str):
        return repr(value)
    return f"array{value.shape}" if hasattr(value, "shape") else type(value).__name__
