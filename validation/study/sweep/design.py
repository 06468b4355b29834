"""Definition of a sweep: one TOML file that says which runs to make, and nothing of how.

    [sweep]
    gait = "normal"             # preset, or a TOML file beside this one
    steps = 20

    [set]                       # the same in every run
    body.height = 1.75

    [[vary]]                    # all combinations
    method = "grid"
    gait.c_s = { from = 0.8, to = 1.4, count = 7 }
    gait.c_y = [0.4, 0.7, 1.0]

    [[vary]]                    # crossed with the block above
    method = "sobol"
    count = 32
    body.mass = { from = 45, to = 95, scale = "log" }

Several blocks are crossed: every case of the first with every one of the second, the last block changing
fastest. ``docs/sweeps.md`` explains every word.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Hashable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import tomli_w
from pydantic import Field, TypeAdapter, ValidationError, field_validator, model_validator

from ampm.exceptions import InputError
from ampm.parameters import RunParameters, keys
from ampm.run_file import PRESETS, key_info, load_run
from ampm.section import Real, Section, input_error, parameter, parse_toml, read_toml, unknown
from validation.judge.profiles import profile as find_profile

Value = float | int | str
"""A value of a key."""

MOST_CASES = 10_000_000
"""Runs of one sweep at most."""
MOST_POINTS = 1_000_000
"""Points of one sampled block at most: 8 MB for every key."""
STEPS_KEY = "gait.steps"

_TABLES = ("sweep", "limits", "set", "vary", "base")


def _flat(table: Mapping[str, Any]) -> dict[str, Any]:
    """Namespaced keys of nested tables; ``gait.c_s = ...`` and ``"gait.c_s" = ...`` mean the same."""
    flat: dict[str, Any] = {}
    for name, value in table.items():
        nested = isinstance(value, dict) and "." not in name
        for key, item in {f"{name}.{k}": v for k, v in value.items()}.items() if nested else [(name, value)]:
            if key in flat:
                raise InputError(f"{key} stands twice; keep one.", key=key)
            flat[key] = item
    return flat


@contextmanager
def _place(where: str) -> Iterator[None]:
    """Say in which part of the file an error is."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{where}: {error}", **error.details) from None


# ----------------------------------------------------------------------- blocks


class Range(Section):
    """Values between two ends, in the unit of their key: ``{ from = 0.8, to = 1.4, count = 7 }``."""

    start: Real = Field(alias="from", description="lowest value")
    stop: Real = Field(alias="to", description="highest value")
    count: int | None = Field(None, description="values of a grid, both ends among them", ge=2, le=MOST_CASES)
    scale: Literal["linear", "log"] = Field("linear", description="log spaces by equal ratios")

    @model_validator(mode="after")
    def _check(self) -> Range:
        if not self.start < self.stop:
            raise InputError(
                f"from = {self.start:g} must be less than to = {self.stop:g}; exchange them, or put one "
                "value alone under [set]."
            )
        if self.scale == "log" and not self.start > 0.0:
            raise InputError(f"from = {self.start:g} must be > 0 with the scale log; take scale linear.")
        return self


class Block(Section):
    """One ``[[vary]]`` block: what each varied key takes, a range or values in the order of the file."""

    method: str
    keys: Mapping[str, Range | tuple[Value, ...]]


class Grid(Block):
    """All combinations of the keys' values."""

    method: Literal["grid"]

    @property
    def size(self) -> int:
        """Cases of this block alone."""
        return math.prod(v.count or 0 if isinstance(v, Range) else len(v) for v in self.keys.values())

    @model_validator(mode="after")
    def _check(self) -> Grid:
        for key, value in self.keys.items():
            if not isinstance(value, Range):
                _check_distinct(value, key)
            elif value.count is None:
                raise InputError(f"{key} has no count; write for example count = 5.", key=key)
        return self


class Listed(Block):
    """The keys' lists side by side: their first values, their second values, and so on."""

    method: Literal["list"]
    keys: Mapping[str, tuple[Value, ...]]

    @property
    def size(self) -> int:
        """Cases of this block alone."""
        return len(next(iter(self.keys.values())))

    @field_validator("keys", mode="before")
    @classmethod
    def _check(cls, columns: Mapping[str, Any]) -> Mapping[str, Any]:
        for key, values in columns.items():
            if isinstance(values, Range):
                raise InputError(f'{key} is a range; list its values, or take method = "grid".', key=key)
        if len({len(values) for values in columns.values()}) > 1:
            found = ", ".join(f"{key} has {len(values)}" for key, values in columns.items())
            raise InputError(
                f"the lists stand side by side and must be equally long: {found}. For all combinations take "
                'method = "grid".'
            )
        _check_distinct(list(zip(*columns.values(), strict=True)), "the list")
        return columns


class Sampled(Block):
    """Points spread over ranges: evenly along every key, or (``sobol``) over all keys together."""

    method: Literal["latin_hypercube", "sobol"]
    count: int = Field(description="number of points", ge=1, le=MOST_POINTS)
    keys: Mapping[str, Range]

    @property
    def size(self) -> int:
        """Cases of this block alone."""
        return self.count

    @field_validator("keys", mode="before")
    @classmethod
    def _check(cls, ranges: Mapping[str, Any]) -> Mapping[str, Any]:
        for key, value in ranges.items():
            if not isinstance(value, Range):
                raise InputError(
                    f"{key} is a list, but points are drawn from ranges; write {{ from = ..., to = ... }}, "
                    "or put the list into a [[vary]] block of its own, which is crossed with this one.",
                    key=key,
                )
            if value.count is not None:
                raise InputError(f"{key}: the count belongs to the block; write it below method.", key=key)
        return ranges


AnyBlock = Annotated[Grid | Listed | Sampled, Field(discriminator="method")]
_BLOCK: TypeAdapter[Grid | Listed | Sampled] = TypeAdapter(AnyBlock)


def _block(table: Mapping[str, Any]) -> Grid | Listed | Sampled:
    """A block of the file, in which the varied keys stand beside the block's own words.

    Raises:
        InputError: it makes no block.
    """
    own = {name: value for name, value in table.items() if name in ("method", "count")}
    found = _flat({name: value for name, value in table.items() if name not in own})
    if not found:
        raise InputError("no key is varied; add for example gait.c_y = [0.4, 0.7, 1.0].")
    if "count" in own and own.get("method") in ("grid", "list"):
        raise InputError(f"a {own['method']} has no count of its own; give one with each range.", key="count")
    values = {key: _values(key, value) for key, value in found.items()}
    try:
        return _BLOCK.validate_python({"method": "", **own, "keys": values})
    except ValidationError as error:
        raise input_error(error, Block) from None


def _values(key: str, value: Any) -> Range | tuple[Value, ...]:
    """Values of one key of a block.

    Raises:
        InputError: neither values nor a range of this key.
    """
    if key not in keys():
        raise unknown(key, [*keys(), "method", "count"])
    info = key_info(key)
    if isinstance(value, dict):
        if info.kind == "text":
            raise InputError(f"{key} is a text and has no range; list {', '.join(info.options)}.", key=key)
        with _place(key):
            found = Range(**value)
        info.convert(found.start), info.convert(found.stop)
        return found
    if not isinstance(value, list) or not value:
        raise InputError(
            f"{key} = {value!r} must be a list of values or a range; one value alone belongs under [set].",
            key=key,
        )
    return tuple(info.convert(item) for item in value)


def _check_distinct(items: Sequence[Hashable], place: str) -> None:
    item, number = Counter(items).most_common(1)[0]
    if number > 1:
        raise InputError(f"{place} has {item!r} twice, the same run; keep one.")


# ------------------------------------------------------------------- definition


class Limits(Section):
    """Limits that end a run. Simulated time and solver iterations are keys of the run itself."""

    section: ClassVar[str] = "limits"

    wall_clock: Real = parameter(
        600.0,
        "time after which a run counts as hung (timed_out); resume walks it again",
        "s",
        gt=0,
    )


class SweepDefinition(Section):
    """A sweep, complete: the same definition gives the same runs in the same order.

    ``base`` is the run that ``gait`` names, as it was when the definition was read; :attr:`run` is that with
    steps and ``set``, and every case changes the varied keys of it.
    """

    section: ClassVar[str] = "sweep"

    name: str = Field("sweep", description="name of the sweep, for report and table", min_length=1)
    gait: str = Field("normal", description="preset, or TOML file relative to the sweep's", min_length=1)
    steps: int = Field(30, description="steps of every run", ge=1, le=100_000)
    tune: bool = Field(False, description="make the free choices of every run first, as ampm tune does")
    seed: int = Field(1, description="of the sampled blocks", ge=0, le=2**63 - 1)
    profile: str = Field("default", description="tolerance profile that judges the runs")
    recordings: Literal["none", "failures", "worst", "all"] = Field(
        "worst", description="which runs keep a recording"
    )
    worst: int = Field(5, description="how many runs keep one if recordings = worst", ge=1, le=10_000)
    instrument: str | None = Field(None, description="model of the sensors that measure beside the truth")
    limits: Limits = Field(default_factory=Limits)
    set: Mapping[str, Value] = Field(default_factory=dict)
    vary: tuple[AnyBlock, ...] = ()
    base: RunParameters = Field(default_factory=RunParameters)

    def __len__(self) -> int:
        """Number of runs."""
        return math.prod(block.size for block in self.vary)

    @cached_property
    def run(self) -> RunParameters:
        """Parameters that all runs share: the gait with ``steps`` and ``set``."""
        return self.base.replace({**self.set, STEPS_KEY: self.steps})

    @property
    def keys(self) -> tuple[str, ...]:
        """Varied keys, in the order of the blocks."""
        return tuple(key for block in self.vary for key in block.keys)

    @model_validator(mode="after")
    def _check(self) -> SweepDefinition:
        find_profile(self.profile)
        if not self.vary:
            raise InputError(
                "the sweep varies nothing; add a [[vary]] block, for example with "
                'method = "grid" and gait.c_y = [0.4, 1.0].'
            )
        places = [(key, "[set]") for key in self.set]
        for number, block in enumerate(self.vary, start=1):
            places += [(key, f"[[vary]] block {number}") for key in block.keys]
        where: dict[str, str] = {STEPS_KEY: "[sweep] as steps, the same for all runs"}
        for key, place in places:
            if key in where:
                raise InputError(f"{key} stands in {place}, and in {where[key]}; keep one.", key=key)
            where[key] = place
        total = math.prod(block.size for block in self.vary)
        if total > MOST_CASES:
            raise InputError(
                f"the sweep would have {total:,} runs, more than {MOST_CASES:,}; lower a count, or vary "
                "several keys in one sobol block instead of crossing them."
            )
        _ = self.run  # what all runs share must be possible
        return self


def load_sweep(path: str | Path) -> SweepDefinition:
    """Read a sweep's definition.

    Args:
        path: TOML file; a gait that is a file is sought beside it.

    Raises:
        InputError: no such file, no valid TOML, or anything in it that makes no sweep.
    """
    path = Path(path)
    stem = path.stem.encode("utf-8", "backslashreplace").decode()  # a name may be no UTF-8
    try:
        return _sweep_of(read_toml(path), stem, path.parent)
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(f"the sweep file {str(path)!r} does not exist.", value=str(path)) from None


def parse_sweep(text: str, *, name: str = "sweep", folder: Path | None = None) -> SweepDefinition:
    """A sweep's definition from TOML text.

    Args:
        text: of the file.
        name: of the sweep, if the text gives none.
        folder: where a gait that is a file is sought; the current one by default.

    Raises:
        InputError: no valid TOML, or anything in it that makes no sweep.
    """
    return _sweep_of(parse_toml(text, "the definition"), name, folder or Path())


def _sweep_of(table: Mapping[str, Any], name: str, folder: Path) -> SweepDefinition:
    for word, value in table.items():
        if word in RunParameters.model_fields:
            raise InputError(f"[{word}] is no table of a sweep; put its keys under [set].", key=word)
        if word not in _TABLES:
            raise unknown(word, _TABLES)
        is_list = isinstance(value, list) and all(isinstance(item, dict) for item in value)
        if not (is_list if word == "vary" else isinstance(value, dict)):
            brackets = "[[vary]]" if word == "vary" else f"[{word}]"
            raise InputError(f"{word} must be a table; write {brackets} and its keys below.", key=word)
    head = dict(table.get("sweep", {}))
    for word in head.keys() & set(_TABLES):
        raise unknown(f"sweep.{word}", [f"sweep.{known}" for known in _HEAD])
    gait = head.get("gait", "normal")
    if "base" in table:
        base = RunParameters(**table["base"])
    elif isinstance(gait, str):
        beside = folder / gait
        base = load_run(beside if gait not in PRESETS and beside.is_file() else gait)
    else:
        base = RunParameters()  # the word is refused below
    instrument = head.get("instrument")
    if isinstance(instrument, str):
        # Here, not above: it loads all that measures.
        from validation.measure.instruments.model import load_instrument

        beside = folder / instrument
        head["instrument"] = str(beside.resolve()) if beside.is_file() else instrument
        load_instrument(head["instrument"])
    with _place("[set]"):
        fixed = {key: key_info(key).convert(value) for key, value in _flat(table.get("set", {})).items()}
    blocks = []
    for number, item in enumerate(table.get("vary", []), start=1):
        with _place(f"[[vary]] block {number}"):
            blocks.append(_block(item))
    return SweepDefinition(
        **{"name": name, "steps": base.gait.steps, **head},
        limits=Limits(**table.get("limits", {})),
        set=fixed,
        vary=tuple(blocks),
        base=base,
    )


_HEAD = tuple(name for name in SweepDefinition.model_fields if name not in _TABLES)


def dump_sweep(definition: SweepDefinition) -> str:
    """TOML text that :func:`parse_sweep` reads back as an equal definition, without any other file."""
    head = definition.model_dump(include=set(_HEAD), exclude_none=True)
    if "worst" not in definition.model_fields_set:  # then only runs that did not pass count as worst
        del head["worst"]
    vary = []
    for block in definition.vary:
        words = block.model_dump(by_alias=True, exclude_none=True)
        values = words.pop("keys")
        vary.append({**words, **values})
    table = {
        "sweep": head,
        "limits": definition.limits.model_dump(),
        "set": dict(definition.set),
        "vary": vary,
    }
    # The file of a gait may change or be out of reach: its contents go along.
    if definition.gait not in PRESETS or definition.base != load_run(definition.gait):
        table["base"] = definition.base.model_dump(exclude_unset=True)
    return tomli_w.dumps(table)
