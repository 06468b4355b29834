"""Pages that mkdocs makes: the front page from README.md, and the API reference."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

import ampm
import validation

ROOT = Path(__file__).resolve().parents[1]
ROLE = re.compile(r":(?:class|func|meth|mod|data|attr|exc):<code>~?(?:[\w.]*\.)?(\w+)</code>")


def on_files(files: Files, config: Any) -> Files:
    """Add the pages that are not in the folder."""
    front = ROOT.joinpath("README.md").read_text(encoding="utf-8")
    front = re.sub(r"\[([^\]]+)\]\((?:LICENSE|CITATION\.cff)\)", r"\1", front.replace("](docs/", "]("))
    files.append(File.generated(config, "index.md", content=front))
    files.append(File.generated(config, "api.md", content=_reference()))
    return files


def _reference() -> str:
    """Page of the public names: those of ``import ampm`` and ``import validation as val``."""
    parts = ["# Python API\n"]
    for package in (ampm, validation):
        parts.append(f"## `import {package.__name__}`\n")
        for name in package.__all__:
            value = getattr(package, name)
            if callable(value):
                parts.append(f"::: {value.__module__}.{value.__qualname__}\n")
    return "\n".join(parts)


def on_page_content(html: str, **_: Any) -> str:
    """Names in docstrings are written with Sphinx roles; show the name alone."""
    return ROLE.sub(r"<code>\1</code>", html)
