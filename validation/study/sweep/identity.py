"""What a sweep's results depend on besides its definition: sources and versions of what computes them."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Mapping
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

from validation.study.sweep.design import Sampled, SweepDefinition, dump_sweep

_ROOT = Path(__file__).resolve().parents[3]
_PACKAGES = ("ampm", "models")
_ROOMS = ("trial", "measure", "judge", "study/sweep")
"""Of ``validation``: what a row is computed with; command line, reports and the like are not."""
_SUFFIXES = (".py", ".toml", ".xml")
_VERSIONS = ("mujoco", "dm-control", "pin", "osqp", "daqp", "numpy", "scipy")
_DIGITS = 16
_SHOWN = 60


@cache
def code() -> dict[str, str]:
    """Sources and versions of this process: name to hash or version."""
    digest = hashlib.sha256()
    for path in _sources():
        digest.update(path.relative_to(_ROOT).as_posix().encode())
        digest.update(path.read_bytes())
    found = {"sources": digest.hexdigest()[:_DIGITS], "machine": platform.machine()}
    for name in _VERSIONS:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "none"
    return found


@cache
def code_hash() -> str:
    """All of :func:`code` in one word."""
    text = ";".join(f"{name}={value}" for name, value in code().items())
    return hashlib.sha256(text.encode()).hexdigest()[:_DIGITS]


def identity(definition: SweepDefinition, revision: str | None) -> dict[str, Any]:
    """What a sweep is: goes into its folder, and is compared when it is resumed.

    Args:
        definition: of the sweep.
        revision: git commit, for people.
    """
    return {"cases": cases_hash(definition), "code": code(), "revision": revision}


def cases_hash(definition: SweepDefinition) -> str:
    """Hash of all that decides what is walked and kept; name and wall-clock guard are free to change."""
    same = definition.model_copy(update={"limits": type(definition.limits)(), "name": "sweep"})
    text = dump_sweep(same) + definition.run.model_dump_json()
    if definition.instrument is not None:
        from validation.measure.instruments.model import load_instrument

        text += repr(load_instrument(definition.instrument))  # a file may change
    return hashlib.sha256(text.encode()).hexdigest()


def changes(kept: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """What of the code differs, in words: ``mujoco 3.17.0 -> 3.18.0``."""
    before, after = dict(kept.get("code", {})), dict(now.get("code", {}))
    found = []
    for name in after:
        if before.get(name) != after[name]:
            if name == "sources":
                found.append("the sources")
            else:
                found.append(f"{name} {before.get(name, 'unknown')} -> {after[name]}")
    return found


def differences(kept: SweepDefinition, now: SweepDefinition) -> list[str]:
    """What of two definitions differs, in words: ``sweep.steps = 20 in the folder, 30 in the file``."""
    before, after = _settings(kept), _settings(now)
    found = []
    for name in sorted(before.keys() | after.keys(), key=[*after, *before].index):
        one, other = before.get(name), after.get(name)
        if one != other:
            found.append(f"{name} = {_short(one)} in the folder, {_short(other)} in the file")
    if not found and [list(block.keys) for block in kept.vary] != [list(block.keys) for block in now.vary]:
        found.append("the order of the varied keys, which numbers the runs")
    return found


def _settings(definition: SweepDefinition) -> dict[str, str]:
    """All that :func:`cases_hash` depends on: place in the file to value, as texts."""
    names = ("gait", "steps", "seed", "profile", "recordings", "worst", "instrument")
    found = {f"sweep.{name}": repr(getattr(definition, name)) for name in names}
    found |= {f"{key} under [set]": repr(value) for key, value in definition.set.items()}
    for number, block in enumerate(definition.vary, start=1):
        place = f"[[vary]] block {number}"
        found[f"method of {place}"] = repr(block.method)
        if isinstance(block, Sampled):
            found[f"count of {place}"] = repr(block.count)
        found |= {f"{key} of {place}": str(value) for key, value in block.keys.items()}
    for section, values in definition.base.model_dump().items():
        found |= {f"{section}.{key} of the gait": repr(value) for key, value in values.items()}
    return found


def _short(text: str | None) -> str:
    if text is None:
        return "nothing"
    return text if len(text) <= _SHOWN else text[: _SHOWN - 3] + "..."


def _sources() -> list[Path]:
    folders = [*(_ROOT / name for name in _PACKAGES), *(_ROOT / "validation" / name for name in _ROOMS)]
    return sorted(path for folder in folders for path in folder.rglob("*") if path.suffix in _SUFFIXES)
