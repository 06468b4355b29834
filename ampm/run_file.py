"""Runs as TOML files: read from presets, files and settings; written to one file that gives the same bits."""

import math
import operator
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import tomli_w

from ampm.exceptions import InputError
from ampm.parameters import OPEN_KEYS, SECTIONS, RunParameters, assign, keys, unknown_key
from ampm.presets import PRESETS
from ampm.section import check_table, nearest, parse_toml, read_toml, unit_of, unknown


def load_run(
    source: str | Path | None = None, settings: str | Iterable[str] = (), /, **sections: Any
) -> RunParameters:
    """Resolve a run from a preset or file and from settings.

    ``load_run("momentum", gait={"c_y": 0.6})`` and ``load_run("momentum", ["gait.c_y=0.6"])`` are the same.

    Values that settings, sections and a file give are kept. The values of :data:`ampm.parameters.OPEN_KEYS`
    that a preset has, or that are left at their defaults, are open: planning a walk finds them where anything
    else was changed (:func:`changes`), unless the run is taken :meth:`~ampm.parameters.RunParameters.as_is`.

    Args:
        source: name of a preset, path of a TOML file, or None for the defaults. Files that a file names and
            that are beside it, of a body or a plan, are found there.
        settings: ``key=value`` text or texts, the key namespaced, the value as in TOML (quotes may be
            left out).
        sections: values by section and key, after the settings; ``footsteps`` is a list of such tables.

    Raises:
        InputError: no such preset or file, no valid TOML, an unknown key or a bad value.
    """
    table: dict[str, Any] = {}
    own: dict[str, Any] = {}  # of the user
    _merge(table, {} if source is None else _read_source(source))
    if source is not None and source not in PRESETS:
        _place_files(table, Path(source).parent)
    for setting in [settings] if isinstance(settings, str) else settings:
        assign(own, *_parsed(setting))
    _merge(own, sections)
    about = _keys_of(table) - set(OPEN_KEYS if source in PRESETS else ())
    _merge(table, own)
    return RunParameters(**table).giving(about | _keys_of(own))


def _read_source(source: str | Path) -> dict[str, Any]:
    """Table of a preset or of a TOML file.

    Raises:
        InputError: there is neither; or what is there is no readable TOML.
    """
    if source in PRESETS:
        return read_toml(resources.files("ampm").joinpath("presets", f"{source}.toml"))
    try:
        return read_toml(Path(source))
    except (FileNotFoundError, NotADirectoryError):
        similar = nearest(str(source), PRESETS)
        hint = f"did you mean {similar['nearest']!r}? " if similar else ""
        known = ", ".join(PRESETS)
        message = f"there is neither a preset nor a file {str(source)!r}; {hint}known are {known}."
        raise InputError(message, value=str(source), **similar) from None


def changes(run: RunParameters) -> dict[str, Any]:
    """Keys and values by which a run differs from all presets; open values are found only if there are any.

    Those of gait, body and feet except the number of steps, relative to the nearest preset. Empty for a
    preset's own walk, for a run that leaves nothing open, and for the plain inverted pendulum (``lipm``),
    whose ZMP jumps for any values of the open keys.
    """
    if run.gait.planner == "lipm" or run.given >= set(OPEN_KEYS):
        return {}
    values = {
        key: run.value(key)
        for key in keys()
        if key.startswith(("gait.", "body.", "foot.")) and key not in ("gait.steps", "gait.planner")
    }
    found = [{key: value for key, value in values.items() if value != own.value(key)} for own in _presets()]
    return min(found, key=len)


@cache
def _presets() -> tuple[RunParameters, ...]:
    return tuple(map(load_run, PRESETS))


def _keys_of(table: Mapping[str, Mapping[str, Any]]) -> set[str]:
    return {f"{name}.{key}" for name, section in table.items() if name in SECTIONS for key in section}


def _merge(table: dict[str, Any], sections: Mapping[str, Any]) -> None:
    """Set the keys of some sections."""
    for name, section in sections.items():
        if name == "footsteps":
            table[name] = section
            continue
        if name not in RunParameters.model_fields:
            what = "section" if isinstance(section, Mapping) else "key"
            raise unknown(name, RunParameters.model_fields if what == "section" else keys(), what)
        for key, value in check_table(name, section).items():
            assign(table, f"{name}.{key}", value)


def _place_files(table: Mapping[str, Any], folder: Path) -> None:
    """Make paths of a body's or a plan's file absolute that are of this folder."""
    for section, key in (("body", "source"), ("gait", "planner")):
        value = table.get(section, {}).get(key)
        if isinstance(value, str) and Path(value).suffix and (folder / value).is_file():
            table[section][key] = str((folder / value).resolve())


def dump_run(run: RunParameters) -> str:
    """TOML text of a run that :func:`load_run` reads back bit-exactly."""
    return tomli_w.dumps(run.model_dump())


@dataclass(frozen=True)
class KeyInfo:
    """One key of a run.

    Attributes:
        key: namespaced name.
        meaning: in words.
        unit: SI unit, ``"1"`` if it has none.
        default: its value where it is not given.
        kind: type of its values.
        options: values of a text, empty for numbers and for a text that is free.
        bounds: limits by comparison (``gt``, ``ge``, ``lt``, ``le``), those that there are.
        finite: whether infinity is refused.
    """

    key: str
    meaning: str
    unit: str
    default: float | int | str
    kind: Literal["float", "int", "text"]
    options: tuple[str, ...]
    bounds: Mapping[str, float]
    finite: bool

    @property
    def range(self) -> str:
        """Bounds or options as text."""
        signs = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
        bounds = [f"{signs[name]} {limit:g}" for name, limit in self.bounds.items()]
        return ", ".join(bounds) or " | ".join(self.options)

    def inside(self, values: Any) -> Any:
        """Which numbers of an array are within the bounds, same shape."""
        good = values == values  # no NaN
        if self.finite:
            good &= abs(values) < math.inf
        for comparison, limit in self.bounds.items():
            good &= getattr(operator, comparison)(values, limit)
        return good

    def convert(self, value: Any) -> float | int | str:
        """A value of TOML as this key has it, within its bounds or not.

        Raises:
            InputError: another type, not a number, or none of the options.
        """
        is_number = isinstance(value, float) or (type(value) is int and abs(value) <= _LARGEST_INTEGER)
        if self.kind == "text":
            good = value in self.options if self.options else bool(value) and isinstance(value, str)
            wanted = f"one of {', '.join(self.options)}" if self.options else "a text"
        elif self.kind == "int":
            good, wanted = is_number and value % 1 == 0, "a whole number"
        else:
            good, wanted = is_number and not math.isnan(value), "a number"
        if not good:
            limit = f"must be {wanted}"
            raise InputError(f"{self.key} = {value!r} {limit}.", key=self.key, value=value, limit=limit)
        return {"text": str, "int": int, "float": float}[self.kind](value)


_LARGEST_INTEGER = 2**53  # whole numbers beyond are not exact as floats


@cache
def key_info(key: str) -> KeyInfo:
    """Information about a key, from the field of its section.

    Raises:
        InputError: there is none of this name; the nearest is named.
    """
    if key not in keys():
        raise unknown_key(key)
    section, _, name = key.partition(".")
    field = SECTIONS[section].model_fields[name]
    options = get_args(field.annotation) if get_origin(field.annotation) is Literal else ()
    bounds = {
        name: getattr(item, name)
        for item in field.metadata
        for name in ("gt", "ge", "lt", "le")
        if getattr(item, name, None) is not None
    }
    return KeyInfo(
        key=key,
        meaning=str(field.description),
        unit=unit_of(field),
        default=field.default,
        kind="text" if options or field.annotation is str else "int" if field.annotation is int else "float",
        options=options,
        bounds=bounds,
        finite=any(getattr(item, "allow_inf_nan", None) is False for item in field.metadata),
    )


def describe_keys() -> tuple[KeyInfo, ...]:
    """Meaning, unit, default and bounds of every key, in the order of the file."""
    return tuple(key_info(key) for key in keys())


def _parsed(setting: str) -> tuple[str, Any]:
    """Key and value of a ``key=value`` text: TOML where it is TOML, else a number, else the text itself."""
    key, equals, text = (part.strip() for part in setting.partition("="))
    if not (key and equals):
        way_out = "write for example gait.c_s=1.2"
        why = "no key=value pair" if not equals else "without a key before ="
        raise InputError(f"the setting {setting!r} is {why}; {way_out}.", value=setting, way_out=way_out)
    try:
        table = parse_toml(f"value = {text}", "the value")
        if table.keys() == {"value"}:
            return key, table["value"]
    except InputError:
        pass
    try:
        return key, float(text)
    except ValueError:
        return key, text
