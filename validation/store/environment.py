"""Versions, platform and revision of a run, to trace its numbers."""

import os
import platform
import subprocess
from contextlib import suppress
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

from validation.store.machine import cores

COMPUTING = ("mujoco", "dm-control", "pin", "osqp", "numba", "numpy", "scipy")
"""Distributions whose version can change a number."""
DISTRIBUTIONS = ("ampm", *COMPUTING, "drake", "pyarrow", "rerun-sdk", "matplotlib", "pydantic")
"""Distributions whose version can change a result or its picture."""


def describe_environment() -> dict[str, Any]:
    """Versions, platform and source revision; no names of users or machines.

    Returns:
        JSON-ready table: ``time`` (UTC, ISO 8601), ``python``, ``versions``, ``platform``, ``processor``,
        ``cores``, ``memory`` [GB], ``revision`` (git commit, None outside a checkout), and
        ``modified`` (whether the checkout differs from it).
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
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
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
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():  # installed elsewhere: an enclosing repository is another project's
        return None, None

    def git(*words: str) -> str:
        command = ["git", "-C", str(root), *words]
        return subprocess.run(command, check=True, capture_output=True, text=True, timeout=10).stdout.strip()

    try:
        return git("rev-parse", "HEAD"), bool(git("status", "--porcelain", "--untracked-files=no"))
    except (OSError, subprocess.SubprocessError):
        return None, None
