"""The ``[[vary]]`` blocks of a sweep: which keys take which values, read with care for whoever wrote them."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, cast

from ampm.exceptions import InputError
from validation.study.sweep.keys import Value, key_info, nearest

Method = Literal["grid", "list", "latin_hypercube", "sobol"]

METHODS: Mapping[str, str] = {
    "grid": "all combinations of the keys' values",
    "list": "the keys' lists side by side: their first values, their second values, ...",
    "latin_hypercube": "count points, evenly spread along every key",
    "sobol": "count points of a scrambled Sobol sequence, evenly spread over all keys together",
}
"""Ways of varying keys, and what they are."""
SAMPLED = ("latin_hypercube", "sobol")
"""Methods that draw ``count`` points from ranges."""
MOST_CASES = 10_000_000
"""Runs of one sweep at most."""
MOST_NUMBERS = 50_000_000
"""Points times keys of one sampled block at most: 400 MB."""
STEPS_KEY = "gait.steps"

_OWN_WORDS = ("method", "count")
_RANGE_WORDS = ("from", "to", "count", "scale")
_SYNONYMS = {"lhs": "latin_hypercube", "latin": "latin_hypercube", "random": "sobol", "product": "grid"}


@dataclass(frozen=True)
class Range:
    """Values between two ends.

    Attributes:
        start: lowest value (``from``), in the key's unit.
        stop: highest value (``to``).
        count: values of a grid, both ends among them; None in a sampled block.
        scale: ``linear``, or ``log`` for equal ratios.
    """

    start: float
    stop: float
    count: int | None = None
    scale: Literal["linear", "log"] = "linear"


@dataclass(frozen=True)
class Block:
    """One ``[[vary]]`` block.

    Attributes:
        method: one of :data:`METHODS`.
        keys: what each varied key takes: a range, or values in the order of the file.
        count: points of a sampled block, else None.
    """

    method: Method
    keys: Mapping[str, Range | tuple[Value, ...]]
    count: int | None = None

    @property
    def lengths(self) -> tuple[int, ...]:
        """Values of every key of a grid or list."""
        return tuple(v.count or 0 if isinstance(v, Range) else len(v) for v in self.keys.values())

    @property
    def size(self) -> int:
        """Cases of this block alone."""
        if self.count is not None:
            return self.count
        return self.lengths[0] if self.method == "list" else math.prod(self.lengths)


def flat_keys(table: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Namespaced keys of nested tables; ``gait.c_s = ...`` and ``"gait.c_s" = ...`` mean the same."""
    flat: dict[str, Any] = {}
    for name, value in table.items():
        # A misspelt section is one, too: its keys are then told with the nearest ones.
        is_section = isinstance(value, dict) and not (value.keys() & set(_RANGE_WORDS))
        for key, item in (
            {f"{name}.{k}": v for k, v in value.items()} if is_section else {name: value}
        ).items():
            if key in flat:
                raise InputError(f"{key} stands twice in {where}; keep one.", key=key)
            flat[key] = item
    return flat


def check_key(key: str, verb: str) -> None:
    """Refuse a key that there is not, or that is not to be set here.

    Args:
        key: namespaced name.
        verb: ``set`` or ``vary``, for the sentence.

    Raises:
        InputError: no such key, or the number of steps.
    """
    key_info(key)
    if key == STEPS_KEY:
        raise InputError(
            f"{STEPS_KEY} cannot be {verb if verb == 'set' else 'varied'} here: all runs of a sweep have "
            "the same number of steps, so that their figures compare; give steps in [sweep].",
            key=key,
        )


def read_blocks(value: Any, fixed: Mapping[str, Value]) -> tuple[Block, ...]:
    """The blocks of a definition.

    Args:
        value: of ``vary`` in the TOML.
        fixed: keys of ``[set]``, which cannot be varied as well.

    Raises:
        InputError: anything that makes no sweep.
    """
    if isinstance(value, dict):
        raise InputError("[vary] must be written [[vary]], with double brackets: there may be several.")
    if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
        raise InputError("vary must be a table of keys; write [[vary]] and its keys below.")
    if not value:
        raise InputError(
            "the sweep varies nothing; add a [[vary]] block, for example with "
            'method = "grid" and gait.c_y = [0.4, 1.0].'
        )
    blocks: list[Block] = []
    for number, table in enumerate(value, start=1):
        block = _block(table, f"[[vary]] block {number}")
        for key in block.keys:
            if key in fixed:
                raise InputError(
                    f"{key} is both fixed in [set] and varied in [[vary]] block {number}; keep one.", key=key
                )
            before = [n for n, other in enumerate(blocks, start=1) if key in other.keys]
            if before:
                raise InputError(
                    f"{key} is varied in [[vary]] blocks {before[0]} and {number}; keep one.", key=key
                )
        blocks.append(block)
    total = math.prod(block.size for block in blocks)
    if total > MOST_CASES:
        sizes = " x ".join(f"{block.size:,}" for block in blocks)
        raise InputError(
            f"the sweep would have {total:,} runs ({sizes}), more than {MOST_CASES:,}; lower a count, or "
            "vary several keys in one sobol block instead of crossing them.",
            value=total,
            limit=MOST_CASES,
        )
    return tuple(blocks)


def _block(table: Mapping[str, Any], where: str) -> Block:
    method = _method(table.get("method"), where)
    values = flat_keys({k: v for k, v in table.items() if k not in _OWN_WORDS}, where)
    for key, value in values.items():
        if "." not in key and not isinstance(value, list | dict):
            close = nearest(key, _OWN_WORDS)
            raise InputError(f"{where}: unknown key {key!r}; did you mean {close!r}?", key=key, nearest=close)
        check_key(key, "vary")
    if not values:
        raise InputError(f"{where} varies no key; add for example gait.c_y = {_example(method)}.")
    count = _block_count(table, method, where)
    parsed = {key: _values(key, value, method, where) for key, value in values.items()}
    if method == "list":
        _check_rows(parsed, where)
    if count is not None and count * len(parsed) > MOST_NUMBERS:
        raise InputError(
            f"{where}: {count:,} points of {len(parsed)} keys are more than {MOST_NUMBERS:,} numbers; "
            "lower count."
        )
    return Block(method, parsed, count)


def _method(given: Any, where: str) -> Method:
    known = ", ".join(METHODS)
    if given is None:
        raise InputError(f"{where} has no method; write method = one of {known}.", key="method")
    if not isinstance(given, str) or given not in METHODS:
        close = _SYNONYMS.get(str(given), nearest(str(given), METHODS))
        raise InputError(
            f"{where}: method = {given!r} is unknown; did you mean {close!r}? There are {known}.",
            key="method",
            nearest=close,
        )
    return cast(Method, given)


def _example(method: str) -> str:
    return "{ from = 0.4, to = 1.0 }" if method in SAMPLED else "[0.4, 0.7, 1.0]"


def _block_count(table: Mapping[str, Any], method: str, where: str) -> int | None:
    count = table.get("count")
    if method not in SAMPLED:
        if count is not None:
            raise InputError(
                f"{where}: a {method} has no count of its own; "
                + (
                    "give it with each range, { from = ..., to = ..., count = ... }."
                    if method == "grid"
                    else "its lists say how many cases there are."
                ),
                key="count",
            )
        return None
    if count is None:
        raise InputError(
            f"{where}: {method} needs count = the number of points, for example 64.", key="count"
        )
    return _count(count, f"{where}: count", 1)


def _count(value: Any, where: str, least: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < least:
        raise InputError(f"{where} = {value!r} must be a whole number of at least {least}.", value=value)
    if value > MOST_CASES:
        raise InputError(
            f"{where} = {value:,} is more than a sweep's {MOST_CASES:,} runs; lower it.", value=value
        )
    return value


def _values(key: str, value: Any, method: str, where: str) -> Range | tuple[Value, ...]:
    """What one key of a block takes."""
    info = key_info(key)
    place = f"{where}: {key}"
    if isinstance(value, dict):
        return _range(key, value, method, place)
    if not isinstance(value, list):
        raise InputError(
            f"{place} = {value!r} is one value; put it under [set], or give {_example(method)}.", key=key
        )
    if method in SAMPLED:
        raise InputError(
            f"{place} is a list, but {method} draws from ranges; write {{ from = ..., to = ... }}, or put "
            "the list into a [[vary]] block of its own, which is crossed with this one.",
            key=key,
        )
    if not value:
        raise InputError(f"{place} is an empty list; give at least one value.", key=key)
    items = tuple(info.convert(item, place) for item in value)
    if method == "grid":
        _check_distinct(items, f"{place} has the value")
    return items


def _check_distinct(items: Sequence[Hashable], words: str) -> None:
    seen = set()
    for item in items:
        if item in seen:
            raise InputError(f"{words} {item!r} twice: the same run, with the same figures; keep one.")
        seen.add(item)


def _check_rows(values: Mapping[str, Range | tuple[Value, ...]], where: str) -> None:
    """The lists of a list block stand side by side."""
    columns = {key: value for key, value in values.items() if not isinstance(value, Range)}
    lengths = {key: len(value) for key, value in columns.items()}
    if len(set(lengths.values())) > 1:
        told = ", ".join(f"{key} has {length}" for key, length in lengths.items())
        raise InputError(
            f"{where}: the lists stand side by side and must be equally long: {told}. For all combinations "
            'take method = "grid".'
        )
    _check_distinct(list(zip(*columns.values(), strict=True)), f"{where} has the case")


def _range(key: str, table: Mapping[str, Any], method: str, place: str) -> Range:
    info = key_info(key)
    if info.kind == "text":
        raise InputError(
            f"{place} is a text and has no range; list its values: {', '.join(info.options)}.", key=key
        )
    if method == "list":
        raise InputError(
            f'{place} is a range, but a list needs values; take method = "grid", or give {_example(method)}.',
            key=key,
        )
    for word in table:
        if word not in _RANGE_WORDS:
            close = nearest(word, _RANGE_WORDS)
            raise InputError(
                f"{place}: unknown word {word!r}; did you mean {close!r}? A range has from, to, scale, and "
                "in a grid count.",
                key=key,
                nearest=close,
            )
    for word in ("from", "to"):
        if word not in table:
            raise InputError(f"{place} has no {word!r}; a range needs from and to.", key=key)
    start, stop = (float(info.convert(table[w], f"{place}.{w}")) for w in ("from", "to"))
    if not (math.isfinite(start) and math.isfinite(stop)):
        raise InputError(f"{place} runs from {start:g} to {stop:g}; both must be finite.", key=key)
    if not start < stop:
        raise InputError(
            f"{place} runs from {start:g} to {stop:g}; from must be less than to"
            + (", and one value alone belongs under [set]." if start == stop else "; exchange them."),
            key=key,
        )
    scale = table.get("scale", "linear")
    if scale not in ("linear", "log"):
        raise InputError(
            f"{place}: scale = {scale!r} is unknown; write linear, or log for equal ratios.", key=key
        )
    if scale == "log" and not start > 0.0:
        raise InputError(
            f"{place} has the scale log from {start:g}; equal ratios need from > 0, or take scale linear.",
            key=key,
        )
    count = None
    if method == "grid":
        if "count" not in table:
            raise InputError(
                f"{place} has no count; write {{ from = {start:g}, to = {stop:g}, count = 5 }}.", key=key
            )
        count = _count(table["count"], f"{place}: count", 2)
        if info.kind == "int" and count > stop - start + 1:
            raise InputError(
                f"{place}: there are only {stop - start + 1:.0f} whole numbers from {start:g} to {stop:g}, "
                f"not {count}; lower count.",
                key=key,
            )
    elif "count" in table:
        raise InputError(
            f"{place}: with {method} the count belongs to the block, not to a range; write count = "
            f"{table['count']!r} below method.",
            key=key,
        )
    return Range(start, stop, count, scale)
