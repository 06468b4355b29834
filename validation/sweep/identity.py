"""What a sweep's results depend on besides its definition: sources and versions of what computes them."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Mapping
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

from validation.sweep.definition import SweepDefinition, dump_sweep

_ROOT = Path(__file__).resolve().parents[2]
_PACKAGES = ("ampm", "models")
_MODULES = (
    "bridge",
    "compare",
    "margins",
    "measure",
    "planning",
    "profiles",
    "record",
    "run_log",
    "simulate",
    "standing",
    "trial",
    "verdict",
    "watch",
    "sweep/columns",
    "sweep/rows",
    "sweep/work",
)
"""Of ``validation``: what a row is computed with; command line, reports and the like are not."""
_SUFFIXES = (".py", ".toml", ".xml")
_VERSIONS = ("mujoco", "dm-control", "pin", "osqp", "daqp", "numpy", "scipy")
_DIGITS = 16


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
    """Hash of all that decides what is walked and kept; the wall-clock guard is free to change."""
    same = definition.model_copy(update={"limits": type(definition.limits)()})
    text = dump_sweep(same) + definition.run.model_dump_json()
    if definition.instrument is not None:
        from validation.instruments import load_instrument

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


def _sources() -> list[Path]:
    paths = [
        path for package in _PACKAGES for path in (_ROOT / package).rglob("*") if path.suffix in _SUFFIXES
    ]
    paths += [_ROOT / "validation" / f"{name}.py" for name in _MODULES]
    paths += (_ROOT / "validation" / "instruments").glob("*.py")
    return sorted(paths)
