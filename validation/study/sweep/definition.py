"""What a sweep is: one TOML file that says which runs to make, and nothing of how.

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
fastest. ``docs/sweeps-definition.md`` explains every word.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Literal

import tomli_w
from pydantic import Field

from ampm.exceptions import InputError
from ampm.parameters import PRESETS, RunParameters, Section, load_run
from validation.judge.profiles import profile as find_profile
from validation.study.sweep.blocks import SAMPLED, STEPS_KEY, Block, Range, check_key, flat_keys, read_blocks
from validation.study.sweep.keys import Value, key_info, nearest

RECORDINGS: Mapping[str, str] = {
    "none": "no run",
    "failures": "every run that failed or did not complete",
    "worst": "the sweep.worst worst runs",
    "all": "every run",
}
"""Which runs keep a recording."""

_TEXTS = ("name", "gait", "profile", "recordings", "instrument")
_TABLES = ("sweep", "limits", "set", "vary", "base")


def _field(default: Any, description: str, unit: str = "1", **bounds: Any) -> Any:
    return Field(default, description=description, json_schema_extra={"unit": unit}, **bounds)


class Limits(Section):
    """What ends a run that would not end. Simulated time and solver iterations are keys of the run itself."""

    section: ClassVar[str] = "limits"

    wall_clock: float = _field(
        600.0,
        "wall-clock time of one run after which it counts as hung (timed_out) and is run again on resume",
        "s",
        gt=0,
        allow_inf_nan=False,
    )


class SweepDefinition(Section):
    """A sweep, complete: the same definition gives the same runs in the same order.

    ``base`` is the run that ``gait`` names, as it was when the definition was read; :attr:`run` is that with
    steps and ``set``, and every case changes the varied keys of it.
    """

    section: ClassVar[str] = "sweep"

    name: str = _field("sweep", "name of the sweep, for report and table", min_length=1)
    gait: str = _field("normal", "preset, or TOML file relative to the sweep's", min_length=1)
    steps: int = _field(30, "steps of every run", ge=1, le=100_000)
    seed: int = _field(1, "of the sampled blocks", ge=0, le=2**63 - 1)
    profile: str = _field("default", "tolerance profile that judges the runs")
    recordings: Literal["none", "failures", "worst", "all"] = _field(
        "worst", "which runs keep a recording: none, failures, worst or all"
    )
    worst: int = _field(5, "how many runs keep one with recordings = worst", ge=1, le=10_000)
    instrument: str | None = _field(None, "model of the sensors that measure beside the simulator's truth")
    limits: Limits = Field(default_factory=Limits)
    set: Mapping[str, Value] = Field(default_factory=dict)
    vary: tuple[Block, ...] = ()
    base: RunParameters = Field(default_factory=RunParameters)

    def __len__(self) -> int:
        """Number of runs."""
        return math.prod(block.size for block in self.vary)

    @cached_property
    def run(self) -> RunParameters:
        """What all runs share: the gait with ``steps`` and ``set``."""
        return self.base.replace({**self.set, STEPS_KEY: self.steps})

    @property
    def keys(self) -> tuple[str, ...]:
        """Varied keys, in the order of the blocks."""
        return tuple(key for block in self.vary for key in block.keys)

    def notes(self) -> tuple[str, ...]:
        """What a user should know of the design, though nothing is wrong with it."""
        notes = []
        for block in self.vary:
            if block.method == "sobol" and block.count is not None and block.count & (block.count - 1):
                power = 1 << block.count.bit_length()
                notes.append(
                    f"a Sobol sequence is balanced at powers of two: the {block.count} points for "
                    f"{', '.join(block.keys)} are the first of {power}; {power // 2} or {power} points would "
                    "be even"
                )
            clock = [key for key in block.keys if key in ("controller.frequency", "simulation.time_step")]
            if block.method in SAMPLED and clock:
                notes.append(
                    f"points drawn for {' and '.join(clock)} are mostly refused: a control period must be a "
                    "whole number of time steps; list values that fit"
                )
        return tuple(notes)


# ------------------------------------------------------------------------- reading


def load_sweep(path: str | Path) -> SweepDefinition:
    """Read a sweep's definition.

    Args:
        path: TOML file; a gait that is a file is sought beside it.

    Raises:
        InputError: no such file, no valid TOML, or anything in it that makes no sweep.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise InputError(
            f"there is no sweep file {str(path)!r}; give a TOML file.", value=str(path)
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(
            f"the sweep file {str(path)!r} cannot be read ({error}); give a TOML file."
        ) from None
    try:
        stem = path.stem.encode("utf-8", "backslashreplace").decode()  # a name may be no UTF-8
        return parse_sweep(text, name=stem, folder=path.parent)
    except tomllib.TOMLDecodeError as error:
        raise InputError(
            f"the sweep file {str(path)!r} is no valid TOML: {error}; correct that line."
        ) from None


def parse_sweep(text: str, *, name: str = "sweep", folder: Path | None = None) -> SweepDefinition:
    """A sweep's definition from TOML text.

    Args:
        text: of the file.
        name: of the sweep, if the text gives none.
        folder: where a gait that is a file is sought; the current one by default.

    Raises:
        tomllib.TOMLDecodeError: no valid TOML.
        InputError: anything else in it that makes no sweep.
    """
    table = tomllib.loads(text)
    for word in table:
        if word not in _TABLES:
            hint = (
                "values that all runs share belong under [set]"
                if word in RunParameters.model_fields
                else f"did you mean [{nearest(word, _TABLES)}]?"
            )
            raise InputError(f"unknown table [{word}] in a sweep; {hint}.", key=word)
    head = _plain_table(table, "sweep")
    own = [n for n in SweepDefinition.model_fields if n not in ("limits", "set", "vary", "base")]
    _check_words("sweep", head, own)
    for word in _TEXTS:
        if word in head and not (isinstance(head[word], str) and head[word].strip()):
            raise InputError(f"sweep.{word} = {head[word]!r} must be a text in quotes.", key=f"sweep.{word}")
    limits = _plain_table(table, "limits")
    _check_words("limits", limits, list(Limits.model_fields))
    if isinstance(limits.get("wall_clock"), int) and not isinstance(limits["wall_clock"], bool):
        limits["wall_clock"] = float(limits["wall_clock"])
    if "worst" in head and head.get("recordings", "worst") != "worst":
        raise InputError(
            f"sweep.worst = {head['worst']} says how many runs keep a recording with recordings = "
            f'"worst", but recordings = "{head["recordings"]}"; leave worst out.',
            key="sweep.worst",
        )
    if "instrument" in head:
        head["instrument"] = _instrument(head["instrument"], folder)
    gait = head.get("gait", "normal")
    base = _base(gait, table, folder)
    if "name" not in head:
        head["name"] = name
    head.setdefault("steps", base.gait.steps)
    find_profile(SweepDefinition(**head).profile)  # what is wrong is told in the order of the file
    fixed = _fixed(_plain_table(table, "set"))
    bounds = Limits(**limits)
    base.replace(fixed)  # what all runs share must be possible
    blocks = read_blocks(table.get("vary", []), fixed)
    return SweepDefinition(**head, limits=bounds, set=fixed, vary=blocks, base=base)


def _plain_table(table: Mapping[str, Any], name: str) -> dict[str, Any]:
    value = table.get(name, {})
    if not isinstance(value, dict):
        raise InputError(f"{name} must be one table; write [{name}] and its keys below.", key=name)
    return dict(value)


def _check_words(name: str, values: Mapping[str, Any], known: list[str]) -> None:
    for word in values:
        if word not in known:
            close = nearest(word, known)
            raise InputError(
                f"unknown key {f'{name}.{word}'!r}; did you mean {f'{name}.{close}'!r}?",
                key=f"{name}.{word}",
                nearest=f"{name}.{close}",
            )


def _base(gait: str, table: Mapping[str, Any], folder: Path | None) -> RunParameters:
    """The run that the gait names, or the one that the definition carries along."""
    if "base" in table:
        return RunParameters(**_plain_table(table, "base"))
    if gait in PRESETS:
        return load_run(gait)
    beside = (folder or Path()) / gait
    return load_run(beside if beside.is_file() else gait)


def _instrument(name: str, folder: Path | None) -> str:
    """Name of an instrument that there is; one in a file beside the sweep is found from everywhere.

    Raises:
        InputError: there is none.
    """
    from validation.measure.instruments.model import load_instrument  # loads all that measures

    beside = (folder or Path()) / name
    found = str(beside.resolve()) if beside.is_file() else name
    load_instrument(found)
    return found


def _fixed(table: Mapping[str, Any]) -> dict[str, Value]:
    fixed = {}
    for key, value in flat_keys(table, "[set]").items():
        check_key(key, "set")
        if isinstance(value, list | dict):
            raise InputError(
                f"{key} = {value!r} in [set] must be one value; several belong into a [[vary]] block.",
                key=key,
            )
        fixed[key] = key_info(key).convert(value, f"{key} in [set]")
    return fixed


# ------------------------------------------------------------------------- writing


def dump_sweep(definition: SweepDefinition) -> str:
    """TOML text that :func:`parse_sweep` reads back as an equal definition, without any other file."""
    lines = ["[sweep]"]
    for name in ("name", "gait", "steps", "seed", "profile", "recordings"):
        lines.append(f"{name} = {_toml(getattr(definition, name))}")
    if definition.recordings == "worst":
        lines.append(f"worst = {definition.worst}")
    if definition.instrument is not None:
        lines.append(f"instrument = {_toml(definition.instrument)}")
    lines += ["", "[limits]", f"wall_clock = {_toml(definition.limits.wall_clock)}  # [s] per run"]
    if definition.set:
        lines += ["", "[set]", *(f"{key} = {_toml(value)}" for key, value in definition.set.items())]
    for block in definition.vary:
        lines += ["", "[[vary]]", f"method = {_toml(block.method)}"]
        if block.count is not None:
            lines.append(f"count = {block.count}")
        lines += [f"{key} = {toml_values(value)}" for key, value in block.keys.items()]
    text = "\n".join(lines) + "\n"
    if definition.gait in PRESETS and definition.base == load_run(definition.gait):
        return text
    # The file of the gait may change or be out of reach: its contents go along.
    return (
        text
        + "\n# What the gait said when the sweep was read.\n"
        + tomli_w.dumps({"base": definition.base.model_dump()})
    )


def _toml(value: Any) -> str:
    return tomli_w.dumps({"v": value}).removeprefix("v = ").rstrip("\n")


def toml_values(value: Range | tuple[Value, ...]) -> str:
    """What a key of a block takes, as TOML."""
    if not isinstance(value, Range):
        return f"[{', '.join(_toml(item) for item in value)}]"
    parts = [f"from = {_toml(value.start)}", f"to = {_toml(value.stop)}"]
    if value.count is not None:
        parts.append(f"count = {value.count}")
    if value.scale != "linear":
        parts.append(f'scale = "{value.scale}"')
    return f"{{ {', '.join(parts)} }}"
