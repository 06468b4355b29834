"""How values are shown: one line, however long their arrays."""

from dataclasses import fields
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


def _said(value: Any) -> str:
    """A number or a text; of anything else its shape or its type."""
    if isinstance(value, float):
        return f"{value:.6g}"
    if value is None or isinstance(value, int | str):
        return repr(value)
    return f"array{value.shape}" if hasattr(value, "shape") else type(value).__name__
