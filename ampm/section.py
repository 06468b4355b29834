"""Base of everything that is read from TOML: frozen, validated, with errors of one sentence.

Run files and sweep definitions are made of sections, so that both give the same error messages.
"""

import difflib
import math
import reprlib
import tomllib
from collections.abc import Iterable, Mapping
from importlib.resources.abc import Traversable
from typing import Annotated, Any, ClassVar

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from ampm.exceptions import InputError

LARGEST_FILE = 20_000_000
"""Most characters of a TOML file that is read."""
_MOST_LISTED = 12  # known names that are listed when none resembles the unknown one


def _not_nan(value: float) -> float:
    if math.isnan(value):
        raise ValueError("must be a number")
    return value


def _whole(value: Any) -> Any:
    return int(value) if isinstance(value, float) and value.is_integer() else value


Real = Annotated[float, Field(allow_inf_nan=False)]
"""A finite float."""
RealOrInf = Annotated[float, AfterValidator(_not_nan)]
"""A float that may be infinite, but not NaN."""
Whole = Annotated[int, BeforeValidator(_whole)]
"""An integer, also written as 4.0."""


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
            raise input_error(error, type(self)) from None


def parameter(default: Any, description: str, unit: str, **bounds: Any) -> Any:
    """A field of a section with its default, meaning, SI unit and bounds."""
    return Field(default, description=description, json_schema_extra={"unit": unit}, **bounds)


def unit_of(field: Any) -> str:
    """SI unit of a field, ``"1"`` if it has none."""
    extra = field.json_schema_extra
    return str(extra.get("unit", "1")) if isinstance(extra, dict) else "1"


def nearest(name: str, known: Iterable[str]) -> dict[str, str]:
    """``{"nearest": ...}`` of the known names, the same leaf or section first; empty if none resembles."""
    lower, known = name.lower(), tuple(known)
    section, _, leaf = lower.rpartition(".")
    same_leaf = {k: k for k in known if k.rpartition(".")[2] == leaf}
    same_section = {k.rpartition(".")[2]: k for k in known if section and k.startswith(f"{section}.")}
    if same_leaf:
        return {"nearest": difflib.get_close_matches(lower, same_leaf, 1, 0.0)[0]}
    pool = same_section or {k: k for k in known}
    close = difflib.get_close_matches(leaf if same_section else lower, pool, 1)
    return {"nearest": pool[close[0]]} if close else {}


def unknown(name: str, known: Iterable[str], what: str = "key") -> InputError:
    """Error about an unknown name, with the nearest of the known ones, or all if they are few."""
    known = tuple(known)
    found = nearest(name, known)
    if found:
        hint = f"did you mean {found['nearest']!r}?"
    elif len(known) <= _MOST_LISTED:
        hint = f"known are {', '.join(known)}."
    else:
        hint = "'ampm keys' lists all."
    way_out = f"write {found['nearest']}" if found else hint
    return InputError(f"unknown {what} {name!r}; {hint}", key=name, way_out=way_out, **found)


_LIMITS = {
    "greater_than": ("gt", "must be greater than"),
    "greater_than_equal": ("ge", "must be at least"),
    "less_than": ("lt", "must be less than"),
    "less_than_equal": ("le", "must be at most"),
}
_KINDS = {
    "int_type": "must be a whole number",
    "float_type": "must be a number",
    "finite_number": "must be a finite number",
    "model_type": "must be a table of keys",
}


def input_error(error: ValidationError, model: type[Section]) -> InputError:
    """Translate the first failure of a validation into one sentence: key, value, limit, way out."""
    detail = error.errors()[0]
    location = [str(part) for part in detail["loc"]]
    key = ".".join([model.section, *location] if model.section else location)
    kind, value, context = detail["type"], detail.get("input"), detail.get("ctx", {})
    known = {field.alias or name: field for name, field in model.model_fields.items()}
    if kind == "extra_forbidden":
        return unknown(key, [f"{model.section}.{name}".lstrip(".") for name in known])
    field = known.get(location[0]) if location else None
    if field is None:
        return InputError(f"{key} = {reprlib.repr(value)} {_KINDS['model_type']}.", key=key, value=value)
    meaning = f" Meaning: {field.description}." if field.description else ""
    if kind == "missing":
        return InputError(f"{key} is missing; write {key} = ...{meaning}", key=key, way_out=f"write {key}")
    unit = "" if unit_of(field) == "1" else f" {unit_of(field)}"
    if kind in _LIMITS:
        name, words = _LIMITS[kind]
        limit = f"{words} {context[name]:g}{unit}"
    elif kind == "literal_error":
        limit = f"must be one of {context['expected']}"
    elif kind == "value_error":
        limit = str(context["error"])
    else:  # pydantic's own words: "Input should be a valid string"
        limit = _KINDS.get(kind) or f"must {detail['msg'].partition(' should ')[2]}"
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    given = f"{value:g}{unit}" if is_number and abs(value) < 1e300 else reprlib.repr(value)
    details = {"key": key, "value": value, "limit": limit}
    if field.default is None or field.is_required() or field.default_factory is not None:
        return InputError(f"{key} = {given} {limit}.{meaning}", **details)
    default = f"{field.default:g}{unit}" if isinstance(field.default, float) else repr(field.default)
    way_out = f"the default is {default}"
    return InputError(f"{key} = {given} {limit}; {way_out}.{meaning}", way_out=way_out, **details)


def read_toml(path: Traversable) -> dict[str, Any]:
    """Table of a TOML file; a byte order mark is skipped.

    Raises:
        FileNotFoundError, NotADirectoryError: there is no such file.
        InputError: it cannot be read, is too large, or is no valid TOML.
    """
    try:
        with path.open(encoding="utf-8-sig") as file:
            text = file.read(LARGEST_FILE)
            if file.read(1):
                message = f"the file {str(path)!r} has more than {LARGEST_FILE} characters; give a TOML file."
                raise InputError(message)
    except (FileNotFoundError, NotADirectoryError):
        raise
    except (OSError, ValueError) as error:  # no UTF-8, or a zero byte in its name
        message = f"the file {str(path)!r} cannot be read ({error}); give a readable TOML file."
        raise InputError(message) from None
    return parse_toml(text, f"the file {str(path)!r}")


def parse_toml(text: str, what: str) -> dict[str, Any]:
    """Table of a TOML text; ``what`` names it in the message.

    Raises:
        InputError: no valid TOML, or nested too deeply.
    """
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise InputError(f"{what} is nested too deeply; write plain tables and keys.") from None
    except ValueError as error:  # TOMLDecodeError, and integers of thousands of digits
        raise InputError(f"{what} is no valid TOML: {error}; correct that line.") from None


def check_table(name: str, value: Any) -> Mapping[str, Any]:
    """A section's table.

    Raises:
        InputError: it is something else.
    """
    if isinstance(value, Mapping):
        return value
    way_out = f"write [{name}] and its keys below it"
    message = f"{name} = {reprlib.repr(value)} is no section of keys; {way_out}."
    raise InputError(message, key=name, value=value, way_out=way_out)
