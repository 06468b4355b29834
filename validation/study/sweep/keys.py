"""What can be set and varied: every key of a run with its type, bounds, unit and meaning."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, Literal, get_args, get_origin

import numpy as np

from ampm.exceptions import InputError
from ampm.parameters import RunParameters, keys

if TYPE_CHECKING:
    from numpy.typing import NDArray

Value = float | int | str
"""A value of a key."""
Kind = Literal["float", "int", "text"]

LARGEST_INTEGER = 2**53
"""Whole numbers beyond are no longer exact as floats, which ranges are computed with."""


@dataclass(frozen=True)
class KeyInfo:
    """One key of a run.

    Attributes:
        key: namespaced name.
        kind: type of its values.
        unit: SI unit, ``"1"`` if it has none.
        description: its meaning.
        greater_than, at_least, less_than, at_most: bounds, None where there is none.
        finite: whether infinity is refused.
        options: values of a text, empty for numbers.
    """

    key: str
    kind: Kind
    unit: str
    description: str
    greater_than: float | None = None
    at_least: float | None = None
    less_than: float | None = None
    at_most: float | None = None
    finite: bool = True
    options: tuple[str, ...] = ()

    @property
    def ends(self) -> tuple[float, float]:
        """Lowest and highest value; infinite where there is no bound."""
        low = [b for b in (self.greater_than, self.at_least) if b is not None]
        high = [b for b in (self.less_than, self.at_most) if b is not None]
        return (low[0] if low else -math.inf, high[0] if high else math.inf)

    @property
    def rules(self) -> tuple[str, str]:
        """How the ends are meant: ``greater than`` or ``at least``, ``less than`` or ``at most``."""
        # Without a bound, infinity itself may be taken or not.
        open_low = self.greater_than is not None or (self.at_least is None and self.finite)
        open_high = self.less_than is not None or (self.at_most is None and self.finite)
        return ("greater than" if open_low else "at least", "less than" if open_high else "at most")

    def below(self, values: NDArray[Any]) -> NDArray[np.bool_]:
        """Which numbers are under the lowest that the key may have; same shape."""
        low = self.ends[0]
        return ~(values > low) if self.rules[0] == "greater than" else ~(values >= low)

    def above(self, values: NDArray[Any]) -> NDArray[np.bool_]:
        """Which numbers are over the highest that the key may have; same shape."""
        high = self.ends[1]
        return ~(values < high) if self.rules[1] == "less than" else ~(values <= high)

    def convert(self, value: Any, where: str) -> Value:
        """A value as this key has it.

        Args:
            value: as TOML gives it.
            where: what to call it in an error.

        Raises:
            InputError: another type, not a number, or none of the options. Bounds are not looked at: a case
                beyond them is refused when it is planned, and counted by the screening before.
        """
        if self.kind == "text":
            if value not in self.options:
                raise InputError(
                    f"{where} = {value!r} must be one of {', '.join(self.options)}; "
                    f"did you mean {nearest(str(value), self.options)!r}?",
                    key=self.key,
                    value=value,
                    nearest=nearest(str(value), self.options),
                )
            return str(value)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise InputError(f"{where} = {value!r} must be a number.", key=self.key, value=value)
        if self.kind == "int":
            if not float_of(value).is_integer() or abs(value) > LARGEST_INTEGER:
                raise InputError(
                    f"{where} = {value!r} must be a whole number; write it without a fraction.",
                    key=self.key,
                    value=value,
                )
            return int(value)
        number = float_of(value)
        if math.isnan(number):
            raise InputError(f"{where} = nan must be a number; leave the value out.", key=self.key)
        return number


def float_of(value: float | int) -> float:
    """A number as a float; whole numbers too large for one become infinite."""
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


@cache
def key_info(key: str) -> KeyInfo:
    """What is known of a key.

    Raises:
        InputError: there is none of this name; the nearest is named.
    """
    if key not in keys():
        RunParameters().replace({key: 0.0})  # raises, and knows the nearest key
        raise InputError(f"unknown key {key!r}.", key=key)
    section, _, name = key.partition(".")
    model: Any = RunParameters.model_fields[section].annotation
    field = model.model_fields[name]
    extra = field.json_schema_extra
    options = tuple(str(o) for o in get_args(field.annotation)) if get_origin(field.annotation) else ()
    kind: Kind = "text" if options else "int" if field.annotation is int else "float"

    def bound(attribute: str) -> float | None:
        found = [getattr(m, attribute) for m in field.metadata if getattr(m, attribute, None) is not None]
        return float(found[0]) if found else None

    return KeyInfo(
        key=key,
        kind=kind,
        unit=str(extra.get("unit", "1")) if isinstance(extra, dict) else "1",
        description=str(field.description),
        greater_than=bound("gt"),
        at_least=bound("ge"),
        less_than=bound("lt"),
        at_most=bound("le"),
        finite=any(getattr(m, "allow_inf_nan", None) is False for m in field.metadata),
        options=options,
    )


def nearest(word: str, known: Iterable[str]) -> str:
    """The known word most like ``word``."""
    return difflib.get_close_matches(word.lower(), list(known), n=1, cutoff=0.0)[0]
