"""Runs as TOML files: read from presets, files and settings; written to one file that gives the same bits."""

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import tomli_w

from ampm.exceptions import InputError
from ampm.parameters import FIELDS, OPEN_KEYS, OPTION_TABLES, SECTIONS, RunParameters, field_of, merged, put
from ampm.presets import PRESETS
from ampm.section import Option, Options, nearest, parse_setting, read_toml, unit_of, unknown


def load_run(
    source: str | Path | None = None, settings: str | Iterable[str] = (), /, **sections: Any
) -> RunParameters:
    """Resolve a run from a preset or file and from settings.

    ``load_run("momentum", gait={"c_y": 0.6})`` and ``load_run("momentum", ["gait.c_y=0.6"])`` are the same.

    Values that settings, sections and a file give are kept. The values of :data:`ampm.parameters.OPEN_KEYS`
    that a preset has, or that are left at their defaults, are open: planning another walk than a preset's
    finds them (:func:`leaves_open`), unless the run is taken :meth:`~ampm.parameters.RunParameters.as_is`.

    Args:
        source: name of a preset, path of a TOML file, or None for the defaults. Files that a file names and
            that are beside it, of a body or a plan, are found there.
        settings: ``key=value`` text or texts, the key namespaced, the value as in TOML (quotes may be
            left out).
        sections: values by section and key, after the settings; ``footsteps`` is a list of such tables.

    Raises:
        InputError: no such preset or file, no valid TOML, an unknown key or a bad value.
    """
    if not isinstance(source, str | Path | None):
        raise InputError(f"{source!r} names no run; give a preset, a TOML file, or nothing for the defaults.")
    source = None if source is None else str(source)
    table = {} if source is None else _read_source(source)
    asked: dict[str, Any] = {}
    for setting in [settings] if isinstance(settings, str) else settings:
        key, value = parse_setting(setting)
        if key in OPTION_TABLES:
            raise InputError(f"{key} is a table; give its options one by one, as {key}.NAME.", key=key)
        put(asked, key, value)
    asked = merged(asked, sections)
    run = RunParameters(**merged(table, asked))
    if source not in PRESETS:
        return run
    named = {f"{name}.{key}" for name in asked.keys() & SECTIONS.keys() for key in asked[name]}
    return run.giving(run.given - set(OPEN_KEYS) | named)


def _read_source(source: str) -> dict[str, Any]:
    """Table of a preset or of a TOML file, in which files beside it have absolute paths.

    Raises InputError if there is neither, or what is there is no readable TOML.
    """
    if not source:
        raise InputError("the name of the gait is empty; give a preset, a TOML file, or leave it out.")
    if source in PRESETS:
        return read_toml(Path(__file__).with_name("presets") / f"{source}.toml")
    if not os.path.exists(source):
        raise unknown(source, PRESETS, "preset or file", value=source)
    table = {"body": {"root": ""}} if source.endswith((".urdf", ".xml")) else read_toml(Path(source))
    if isinstance(body := table.get("body"), dict) and "root" in body:
        way_out = f"walk it with --body {source}, elsewhere with body.source = {source!r}"
        raise InputError(f"{source} describes a body and is not a gait; {way_out}.", way_out=way_out)
    for section, key in (("body", "source"), ("gait", "planner")):
        values = table.get(section)
        name = values.get(key) if isinstance(values, dict) else None
        if isinstance(name, str) and Path(name).suffix and (path := Path(source).parent / name).is_file():
            table[section][key] = str(path.resolve())
    return table


def leaves_open(run: RunParameters) -> bool:
    """Whether planning finds values of :data:`ampm.parameters.OPEN_KEYS` for a run.

    A preset's own gait, body and feet are walked as they are, with any number of steps and any planner; of
    all others what is not set is found. Nothing is found for the plain inverted pendulum (``lipm``), whose
    ZMP jumps for any values.
    """
    if run.gait.planner == "lipm" or run.given >= set(OPEN_KEYS):
        return False
    return all(_own_walk(run) != _own_walk(preset) for preset in _presets())


def _own_walk(run: RunParameters) -> dict[str, Any]:
    """Values of gait, body and feet."""
    return run.model_dump(include={"gait", "body", "foot"}, exclude={"gait": {"steps", "planner"}})


@cache
def _presets() -> tuple[RunParameters, ...]:
    return tuple(map(load_run, PRESETS))


def dump_run(run: RunParameters) -> str:
    """TOML text of a run that :func:`load_run` reads back bit-exactly."""
    return tomli_w.dumps(run.model_dump())


@dataclass(frozen=True)
class KeyInfo:
    """One key of a run."""

    key: str  # namespaced
    meaning: str
    unit: str  # SI, "1" if it has none
    default: float | int | str | Mapping[str, Option]
    kind: Literal["float", "int", "text", "option"]
    options: tuple[str, ...]  # values of a text; empty for numbers and for a text that is free
    range: str  # bounds or options, for people


@cache
def key_info(key: str) -> KeyInfo:
    """Information about a key, from its section's field; InputError, with the nearest, if there is none."""
    field = field_of(key)
    kinds: Mapping[Any, Any] = {str: "text", int: "int", Options: "option"}
    options = get_args(field.annotation) if get_origin(field.annotation) is Literal else ()
    bounds = [
        f"{sign} {getattr(item, comparison):g}"
        for item in field.metadata
        for comparison, sign in (("gt", ">"), ("ge", ">="), ("lt", "<"), ("le", "<="))
        if getattr(item, comparison, None) is not None
    ]
    return KeyInfo(
        key=key,
        meaning=str(field.description),
        unit=unit_of(field),
        default=field.get_default(call_default_factory=True),
        kind="text" if options else kinds.get(field.annotation, "float"),
        options=options,
        range=", ".join(bounds) or " | ".join(options),
    )


def find_keys(*words: str) -> tuple[KeyInfo, ...]:
    """Keys that all words fit, in the order of the file.

    The name of a section fits the keys of this section. Any other word, and ``planner``, fits the keys that
    have it in their name or meaning, in upper or lower case. Options of users' classes are one key a class.
    Raises InputError if no key fits.
    """

    def fits(info: KeyInfo, word: str) -> bool:
        if word in SECTIONS and word != "planner":  # whose name is gait.planner
            return info.key.partition(".")[0] == word
        return word in f"{info.key} {info.meaning}".lower()

    every = map(key_info, FIELDS)
    found = tuple(info for info in every if all(fits(info, word.strip().lower()) for word in words))
    if not found:
        similar = nearest(words[0], RunParameters.known_keys())
        way_out = f"did you mean {similar!r}?" if similar else f"sections are {', '.join(SECTIONS)}."
        what = " and ".join(map(repr, words))
        raise InputError(f"no key fits {what}; {way_out}", value=what, way_out=way_out, nearest=similar)
    return found
