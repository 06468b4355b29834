"""Helpers shared by the scripts of this folder: tables in pages, between marks."""

from __future__ import annotations


def between(page: str, name: str, table: str) -> str:
    """The page with another table between its marks.

    Raises:
        ValueError: the page lacks them.
    """
    head, first, rest = page.partition(f"<!-- {name} -->\n")
    _, last, tail = rest.partition(f"\n<!-- end of {name} -->")
    if not (first and last):
        raise ValueError(f"the page lacks the marks of '{name}'")
    return f"{head}{first}{table}{last}{tail}"
