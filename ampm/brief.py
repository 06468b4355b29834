"""A representation of one line for values that hold arrays."""

from typing import Any

_FACTS = 8


def _said(value: Any) -> str:
    """A number or a text; of anything else its shape, its length, or its type."""
    if isinstance(value, float):
        return f"{value:.6g}"
    if value is None or isinstance(value, int | str):
        return repr(value)
    if hasattr(value, "shape"):
        return f"array{value.shape}"
    if hasattr(value, "__len__") and not isinstance(value, Brief):
        return f"[{len(value)}]"
    return type(value).__name__


class Brief:
    """Base of dataclasses whose ``repr`` is one line: the first fields, without what is in them."""

    def __init_subclass__(cls, **more: Any) -> None:
        """Keep ``dataclass`` from writing another one."""
        super().__init_subclass__(**more)
        if "__repr__" not in vars(cls):
            cls.__repr__ = Brief.__repr__  # type: ignore[method-assign]

    def __repr__(self) -> str:
        """Name and first fields."""
        names: list[str] = [name for name in getattr(self, "__dataclass_fields__", ()) if name[0] != "_"]
        facts = [f"{name}={_said(getattr(self, name))}" for name in names[:_FACTS]]
        return f"{type(self).__name__}({', '.join(facts + ['...'] * (len(names) > _FACTS))})"
