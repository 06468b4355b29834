"""Pages that mkdocs makes: the front page from README.md, and the API reference from the docstrings."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("ampm", "models", "validation")
ROLE = re.compile(r":(?:class|func|meth|mod|data|attr|exc):<code>~?(?:[\w.]*\.)?(\w+)</code>")


def on_files(files: Files, config: Any) -> Files:
    """Add the pages that are not in the folder."""
    front = ROOT.joinpath("README.md").read_text(encoding="utf-8")
    front = re.sub(r"\[([^\]]+)\]\((?:LICENSE|CITATION\.cff)\)", r"\1", front.replace("](docs/", "]("))
    files.append(File.generated(config, "index.md", content=front))
    for package in PACKAGES:
        parts = [f"# API: `{package}`\n"]
        for path in sorted((ROOT / package).rglob("*.py")):
            name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
            if not name.endswith("__main__"):
                parts.append(f"::: {name}\n")
        files.append(File.generated(config, f"api-{package}.md", content="\n".join(parts)))
    return files


def on_page_content(html: str, **_: Any) -> str:
    """Names in docstrings are written with Sphinx roles; show the name alone."""
    return ROLE.sub(r"<code>\1</code>", html)
