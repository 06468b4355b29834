"""Hashes of what a result depends on: a run's parameters, and the sources and versions that compute it."""

import hashlib
import json
import platform
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from ampm.parameters import OPTION_TABLES, RunParameters
from validation.store.environment import COMPUTING, version_of

_ROOT = Path(__file__).resolve().parents[2]
FOLDERS = (
    "ampm",
    "models",
    *(f"validation/{name}" for name in ("trial", "store", "measure", "judge", "run")),
)
"""Sources that a row is computed with; command line and reports are not among them."""
_SUFFIXES = (".py", ".toml", ".xml", ".csv")
_DIGITS = 16


def parameter_values(run: RunParameters) -> dict[str, Any]:
    """Namespaced key to value, in the order of the sections."""
    sections = run.model_dump()
    rows = {"footsteps": sections.pop("footsteps")} if run.footsteps else {}
    values = {f"{name}.{key}": value for name, section in sections.items() for key, value in section.items()}
    for table in OPTION_TABLES:
        options = values.pop(table, {})
        values |= {f"{table}.{name}": value for name, value in options.items()}
    return values | rows


@cache
def _defaults() -> Mapping[str, Any]:
    return parameter_values(RunParameters())


def run_key(values: Mapping[str, Any]) -> str:
    """Hash of the parameters that differ from their defaults.

    A new parameter in the code changes no key, so runs of two revisions can be matched.

    Args:
        values: namespaced key to value, see :func:`parameter_values`.
    """
    changed = {key: value for key, value in sorted(values.items()) if value != _defaults().get(key)}
    return hashlib.sha256(json.dumps(changed).encode()).hexdigest()[:_DIGITS]


@cache
def code() -> dict[str, str]:
    """Sources and versions of this process: name to hash or version."""
    digest = hashlib.sha256()
    paths = (path for folder in FOLDERS for path in (_ROOT / folder).rglob("*") if path.suffix in _SUFFIXES)
    for path in sorted(paths):
        digest.update(path.relative_to(_ROOT).as_posix().encode())
        digest.update(path.read_bytes())
    found = {"sources": digest.hexdigest()[:_DIGITS], "machine": platform.machine()}
    return found | {name: version_of(name) or "none" for name in COMPUTING}


@cache
def code_hash() -> str:
    """One hash of all of :func:`code`."""
    return hashlib.sha256(json.dumps(code()).encode()).hexdigest()[:_DIGITS]
