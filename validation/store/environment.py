"""What a result depends on: versions, platform, revision, and hashes of parameters and sources."""

import ast
import hashlib
import json
import os
import platform
import subprocess
import sys
from collections.abc import Mapping
from contextlib import suppress
from datetime import UTC, datetime
from functools import cache
from importlib import metadata
from importlib.util import resolve_name
from pathlib import Path
from typing import Any

from ampm.parameters import OPTION_TABLES, RunParameters
from validation.store.machine import HIDDEN_FILE, cores
from validation.trial.users import is_users

COMPUTING = ("mujoco", "dm-control", "pin", "osqp", "numba", "numpy", "scipy")
"""Distributions whose version can change a number."""
DISTRIBUTIONS = ("ampm", *COMPUTING, "drake", "pyarrow", "rerun-sdk", "matplotlib", "pydantic")
"""Distributions whose version can change a result or its picture."""


def describe_environment() -> dict[str, Any]:
    """Versions, platform and source revision; no names of users or machines.

    ``time`` is UTC (ISO 8601), ``memory`` in GB; ``revision`` is the commit, None outside a checkout, and
    ``modified`` says whether the checkout differs from it.
    """
    revision, modified = _revision()
    return {
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
        "python": platform.python_version(),
        "versions": {name: version_of(name) for name in DISTRIBUTIONS},
        "platform": platform.platform(),
        "processor": _processor(),
        "cores": cores(),
        "memory": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9, 1),
        "revision": revision,
        "modified": modified,
    }


def version_of(distribution: str) -> str | None:
    """Installed version of a distribution, None if it is not installed."""
    with suppress(metadata.PackageNotFoundError):
        return metadata.version(distribution)
    return None


def _processor() -> str:
    """Name of the processor; that of its kind where Linux does not tell it."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.machine()


def _revision() -> tuple[str | None, bool | None]:
    """Commit of the checkout that this file lies in, and whether tracked files differ from it."""
    if not (_ROOT / ".git").exists():  # installed elsewhere: an enclosing repository is another project's
        return None, None

    def git(*words: str) -> str:
        command = ["git", "-C", str(_ROOT), *words]
        return subprocess.run(command, check=True, capture_output=True, text=True, timeout=10).stdout.strip()

    try:
        return git("rev-parse", "HEAD"), bool(git("status", "--porcelain", "--untracked-files=no"))
    except (OSError, subprocess.SubprocessError):
        return None, None


_ROOT = Path(__file__).resolve().parents[2]
FOLDERS = (
    "ampm",
    "models",
    *(f"validation/{name}" for name in ("trial", "store", "measure", "judge", "run", "study")),
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
        values |= {f"{table}.{name}": value for name, value in values.pop(table, {}).items()}
    return values | rows


_DEFAULTS = parameter_values(RunParameters())


def run_key(values: Mapping[str, Any]) -> str:
    """Hash of the parameters that differ from their defaults.

    A new parameter in the code changes no key, so runs of two revisions can be matched. The values are those
    of :func:`parameter_values`.
    """
    changed = {key: value for key, value in sorted(values.items()) if value != _DEFAULTS.get(key)}
    return hashlib.sha256(json.dumps(changed).encode()).hexdigest()[:_DIGITS]


@cache
def code_hash() -> str:
    """One hash of all sources and versions of this process, and its machine's kind."""
    digest = hashlib.sha256()
    paths = (path for folder in FOLDERS for path in (_ROOT / folder).rglob("*") if path.suffix in _SUFFIXES)
    for path in sorted(paths):
        digest.update(path.relative_to(_ROOT).as_posix().encode())
        digest.update(path.read_bytes())
    digest.update(repr([platform.machine(), *map(version_of, COMPUTING)]).encode())
    return digest.hexdigest()[:_DIGITS]


def users_file(module: Any) -> str | None:
    """File of a loaded module that is neither installed nor of this project; None of any other module."""
    file = getattr(module, "__file__", None) or getattr(module, HIDDEN_FILE, None)
    return file if file is not None and is_users(file) else None


@cache  # of one study: its workers import them once
def users_sources(module: str) -> str:
    """Hash of a user's module and of those that it imports, new if nobody can read it; else empty."""
    files, names = dict[str, bytes](), [module]
    for name in filter(None, names):  # which grow
        names.append(name.rpartition(".")[0])
        found: Any = sys.modules.get(name)
        file = users_file(found)
        if name == "__main__" and not os.path.isfile(file or ""):
            return os.urandom(_DIGITS).hex()  # typed, or read from a pipe: nothing tells whether it changed
        if name in files or file is None:
            continue
        files[name] = source = Path(file).read_bytes()
        for node in ast.walk(ast.parse(source)) if file.endswith(".py") else ():
            if isinstance(node, ast.Import):
                names += [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                with suppress(ImportError):  # a relative one, of a module without a package
                    home = resolve_name("." * node.level + (node.module or ""), found.__package__)
                    names += [home, *(f"{home}.{alias.name}" for alias in node.names)]
    return hashlib.sha256(b"".join(files.values())).hexdigest() if files else ""
