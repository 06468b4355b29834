"""Runs as TOML files: presets, files and settings in, one file out that gives back the same bits."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import tomli_w

from ampm.exceptions import InputError
from ampm.parameters import KeyInfo, RunParameters, assign, key_info, keys
from ampm.section import check_table, parse_toml, read_source, unknown

PRESETS: Mapping[str, str] = {
    "normal": "the paper's gait: 0.6 m steps, 1.0 m/s at every switch, no angular momentum about the COM",
    "momentum": "the same with angular momentum about both horizontal axes (c_s 1.2, c_y 0.4)",
    "flat": "an easy gait: 0.3 m steps on flat feet",
    "roll-0.1": "the normal gait with c_y 0.1: large angular momentum about the forward axis (Fig. 11)",
    "roll-0.4": "the same with c_y 0.4",
    "roll-0.7": "the same with c_y 0.7",
    "roll-1.0": "the same with c_y 1: none",
    "pitch": "0.65 m steps with c_s 1.6: large angular momentum about the lateral axis (Fig. 12)",
    "pitch-low": "0.7 m steps with c_s 0.33: the same with the opposite sign",
    "ipm": "the plain inverted pendulum, whose acceleration jumps at every switch, as the normal gait",
}
"""Presets and what they are; each is ``ampm/presets/<name>.toml``."""


def load_run(
    source: str | Path | None = None, settings: Iterable[str] = (), /, **sections: Mapping[str, Any]
) -> RunParameters:
    """Resolve a run from a preset or file and from settings.

    ``load_run("momentum", gait={"c_y": 0.6})`` and ``load_run("momentum", ["gait.c_y=0.6"])`` are the same.

    Args:
        source: name of a preset, path of a TOML file, or None for the defaults.
        settings: ``key=value`` texts, the key namespaced, the value as in TOML (quotes may be left out).
        sections: values by section and key, after the settings.

    Raises:
        InputError: no such preset or file, no valid TOML, an unknown key or a bad value.
    """
    table: dict[str, Any] = {}
    _merge(table, {} if source is None else read_source(source, PRESETS, "ampm", "a preset"))
    for setting in settings:
        assign(table, *_parsed(setting))
    _merge(table, sections)
    return RunParameters(**table)


def _merge(table: dict[str, Any], sections: Mapping[str, Any]) -> None:
    """Set the keys of some sections."""
    for name, section in sections.items():
        if name not in RunParameters.model_fields:
            what = "section" if isinstance(section, Mapping) else "key"
            raise unknown(name, RunParameters.model_fields if what == "section" else keys(), what)
        for key, value in check_table(name, section).items():
            assign(table, f"{name}.{key}", value)


def dump_run(run: RunParameters) -> str:
    """TOML text of a run that :func:`load_run` reads back bit-exactly."""
    return tomli_w.dumps(run.model_dump())


def describe_keys() -> tuple[KeyInfo, ...]:
    """Meaning, unit, default and bounds of every key, in the order of the file."""
    return tuple(key_info(key) for key in keys())


def preset_names() -> tuple[str, ...]:
    """Names of the presets."""
    return tuple(PRESETS)


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
