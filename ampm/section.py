"""Base of everything that is read from TOML: frozen, validated, with errors of one sentence.

Run files and sweep definitions are made of sections, so that both give the same error messages.
"""

import difflib
import math
import reprlib
import tomllib
from collections.abc import Collection, Iterable, Iterator, Mapping
from numbers import Integral
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from ampm.exceptions import InputError
from ampm.files import read_text

_LEAST = 1e-60  # of a number that is not 0
_MOST_LISTED = 20  # known keys that are listed when none resembles the unknown one
_ALIKE = 0.93  # of two names, by difflib: less are other names [1]


def _sizable(value: float) -> float:
    if 0.0 < abs(value) < _LEAST:
        raise ValueError(f"it should be at least {_LEAST:g} in magnitude, if it is not 0")
    return value


def _whole(value: Any) -> Any:
    whole = isinstance(value, Integral) and not isinstance(value, bool)  # NumPy's, too
    return int(value) if whole or (isinstance(value, float) and value.is_integer()) else value


def _option(value: Any) -> bool | int | float | str:
    if isinstance(value, bool | int | str) or (isinstance(value, float) and math.isfinite(value)):
        return value
    raise ValueError("it should be a finite number, a text, true or false")


Real = Annotated[float, Field(allow_inf_nan=False), AfterValidator(_sizable)]
"""A finite float, 0 or of a size that can be squared."""
RealOrInf = Annotated[float, AfterValidator(_sizable)]
"""A float that may be infinite; its bound refuses NaN."""
Whole = Annotated[int, BeforeValidator(_whole)]
"""An integer, also written as 4.0."""
OPEN = "open"
"""Marks what a gait may leave open, to be found for the rest: all others define the gait."""
Open = Annotated[Real, OPEN]
OPTIONS = "options"
"""Name of the field with the options of a user's class, in sections that name one."""
Option = bool | int | float | str
"""Value of an option of a user's class."""
Options = Mapping[str, Annotated[Option, BeforeValidator(_option)]]
"""Options of a user's class, by the names of its parameters."""


class Section(BaseModel):
    """Base of all parameter sections: immutable, no unknown keys, failures raised as :class:`InputError`."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=True)
    section: ClassVar[str] = ""

    def __init_subclass__(cls, section: str = "", **options: Any) -> None:
        super().__init_subclass__(**options)
        cls.section = section or cls.section

    def __init__(self, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise _input_error(error, type(self)) from None

    def __hash__(self) -> int:
        """Hash of all values; pydantic's own cannot hash options."""
        return hash(self.model_dump_json())

    @classmethod
    def known_keys(cls) -> list[str]:
        """Names that an unknown one is compared to."""
        names = [field.alias or name for name, field in cls.model_fields.items()]
        return [f"{cls.section}.{name}" for name in names] if cls.section else names


def parameter(default: Any, description: str, unit: str = "1", **options: Any) -> Any:
    """A field of a section with its default, meaning, SI unit, and options such as bounds."""
    return Field(default, description=description, json_schema_extra={"unit": unit}, **options)


def options_of(kind: str, where: str) -> Any:
    """A field with the options of a user's class; left out of a file if there are none."""
    return Field(
        default_factory=dict,
        description=f"options of the class that {where} names, by the names of its parameters; the class "
        f"says what they mean, for example {kind}.options.gain = 30",
        exclude_if=lambda options: not options,
    )


def unit_of(field: Any) -> str:
    """SI unit of a field, ``"1"`` if it has none."""
    extra = field.json_schema_extra
    return str(extra.get("unit", "1")) if isinstance(extra, dict) else "1"


def nearest(name: str, known: Iterable[str]) -> str | None:
    """The known name whose last part resembles that of a name most; None if none does."""
    lower, leaf = {other.lower(): other for other in known}, name.lower().rpartition(".")[2]
    leaves = {other: other.rpartition(".")[2] for other in lower}
    near = difflib.get_close_matches(leaf, leaves.values(), 1, 0.7)
    close = difflib.get_close_matches(name.lower(), [o for o in lower if leaves[o] in near], 1, 0.0)
    return lower[close[0]] if close else None


def misspelt(names: Iterable[object], known: Collection[str]) -> Iterator[tuple[str, str]]:
    """Names that are not known, each with the known one that is missing and has nearly its letters."""
    given = [str(name) for name in names]
    missing = [name for name in known if name not in given]
    for name in given:
        for meant in difflib.get_close_matches(name, missing, 1, _ALIKE) if name not in known else ():
            yield name, meant


def unknown(name: str, known: Iterable[str], what: str = "key", **details: Any) -> InputError:
    """Error about an unknown name, with the nearest of the known ones, or all, of keys if they are few."""
    name, known = str(name), tuple(known)
    similar = nearest(name, known)
    hint = way_out = f"known: {', '.join(known)}."
    if similar:
        hint, way_out = f"did you mean {similar!r}?", f"write {similar}"
    elif what == "key" and len(known) > _MOST_LISTED:
        hint = way_out = "'ampm keys' lists all."
    details = {"key": name, "way_out": way_out, "nearest": similar} | details
    return InputError(f"unknown {what} {name!r}; {hint}", **details)


def _input_error(error: ValidationError, model: type[Section]) -> InputError:
    """Translate the first failure of a validation into one sentence: key, value, limit, way out."""
    detail = error.errors()[0]
    location = [str(part) for part in detail["loc"]]
    key = ".".join([model.section, *location] if model.section else location)
    kind, value = detail["type"], detail.get("input")
    if kind == "extra_forbidden":
        if isinstance(value, Mapping) and not model.section:
            return unknown(key, model.model_fields, "section")
        if key in model.known_keys():
            section, _, name = key.partition(".")
            return InputError(f"{key!r} is a key of a section; write {section}={{'{name}': ...}}.", key=key)
        return unknown(key, model.known_keys())
    field = {field.alias or name: field for name, field in model.model_fields.items()}[location[0]]
    unit = "" if unit_of(field) == "1" else f" {unit_of(field)}"
    meaning = f" Meaning: {field.description}{unit and f' [{unit.strip()}]'}." if field.description else ""
    if kind == "missing" and len(location) > 1:
        key = key.rpartition(".")[0]
        return InputError(f"{key} lacks a value; give all of them.{meaning}", key=key)
    if kind == "missing":
        line = f"{location[0]} = ... in [{model.section}]." if model.section else f"{key} = ..."
        if keys := getattr(field.annotation, "model_fields", None):
            line = f"[{key}] with {', '.join(name for name, part in keys.items() if part.is_required())}."
        return InputError(f"{key} is missing; write {line}{meaning}", key=key, way_out=f"write {line}")
    limit = limit_of(detail) + (unit if kind.startswith(("greater_than", "less_than")) else "")
    way_out = None
    if kind in ("model_type", "dict_type"):
        limit, way_out = "must be a section of keys", f"write [{key}] and its keys below it"
    elif isinstance(field.default, float | int | str):
        way_out = f"the default is {_with_unit(field.default, field)}"
    return bad_value(key, value, field, limit, way_out, meaning)


def bad_value(
    key: str, value: Any, field: Any, limit: str, way_out: str | None, meaning: str = ""
) -> InputError:
    """Error about the value of a field: key, value with its unit, limit in words, way out, meaning."""
    sentence = f"{key} = {_with_unit(value, field)} {limit}{f'; {way_out}' if way_out else ''}.{meaning}"
    return InputError(sentence, key=key, value=value, limit=limit, way_out=way_out)


def limit_of(detail: Any) -> str:
    """What a value must be, from the details of pydantic's error."""
    kinds = {"int": "be a whole number", "float": "be a number", "tuple": "be a list"}
    words = detail["msg"].partition(" should ")[2]  # "Input should be a valid string"
    words = words.replace("greater than or equal to", "at least").replace("less than or equal to", "at most")
    return f"must {kinds.get(detail['type'].partition('_')[0], words)}"


def _with_unit(value: Any, field: Any) -> str:
    unit = "" if unit_of(field) == "1" else f" {unit_of(field)}"
    is_number = isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300
    return f"{value:g}{unit}" if is_number else reprlib.repr(value)


def read_toml(path: Path) -> dict[str, Any]:
    """Table of a TOML file; raises InputError as :func:`ampm.files.read_text`, and of no valid TOML."""
    return parse_toml(read_text(path), f"the file {str(path)!r}")


def parse_toml(text: str, what: str) -> dict[str, Any]:
    """Table of a TOML text, which ``what`` names in the InputError of no valid TOML, or nested too deeply."""
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise InputError(f"{what} is nested too deeply; write plain tables and keys.") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{what} is not valid TOML: {error}; correct that line.") from None
    except ValueError:
        raise InputError(
            f"{what} is not valid TOML: it has an integer of thousands of digits; shorten it."
        ) from None


def parse_setting(setting: str) -> tuple[str, Any]:
    """Key and value of a ``key=value`` text: TOML where it is TOML, else a number, else the text itself."""
    key, equals, text = (part.strip() for part in setting.partition("="))
    if not (key and equals):
        way_out = "write for example gait.c_s=1.2, or gain=2 of an option"
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
