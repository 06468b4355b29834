"""What mkdocs does not do itself: the front page from README.md, formulas as MathML, no network."""

import re
from html import unescape
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]
ROLE = re.compile(r":(?:class|func|meth|mod|data|attr|exc):<code>~?(?:[\w.]*\.)?(\w+)</code>")
OUTSIDE = re.compile(r"\[([^\]]+)\]\((?:LICENSE|CITATION\.cff|examples/?)\)")
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)
BESIDE = re.compile(r"(?:(?<=</m[in]>)|(?<=</msub>))(?=<mi>[a-z]{2,}<)|(?<=[a-z]{2}</mi>)(?=<m[ifns])")
"""Where a thin space belongs: before the name of a function, and before its argument without parentheses."""
LOADED = re.compile(
    r'<(?:script|img|link rel="(?:stylesheet|preconnect|icon)")[^>]*(?:src|href)="(?:https?:)?//'
)


def on_files(files: Files, config: Any) -> Files:
    """Add what is not in the folder: the front page, and a font of formulas, for browsers have none."""
    front = ROOT.joinpath("README.md").read_text(encoding="utf-8").replace("](docs/", "](")
    front = "---\nhide: [navigation]\n---\n" + OUTSIDE.sub(r"\1", front)
    files.append(File.generated(config, "index.md", content=front))
    font = Path(find_spec("ziamath").origin).with_name("fonts") / "STIXTwoMath-Regular.ttf"
    files.append(File.generated(config, "stix-two-math.ttf", content=font.read_bytes()))
    return files


def on_page_content(html: str, **_: Any) -> str:
    """Formulas for any browser without a script; of Sphinx roles in docstrings the name alone."""
    return FORMULA.sub(mathml, ROLE.sub(r"<code>\1</code>", html))


def mathml(found: re.Match[str]) -> str:
    """MathML of one formula that arithmatex marked: a span in a line, a div on its own."""
    answer = convert(unescape(found[2]).strip(), display="inline" if found[1] == "span" else "block")
    if "\\" in answer:
        raise PluginError(f"a command of this formula is unknown: {found[2]}")
    return BESIDE.sub('<mspace width="0.17em"/>', answer)


def on_post_page(output: str, page: Any, **_: Any) -> str:
    """Refuse a page that loads a script, a style or a picture from a network."""
    if found := LOADED.search(output):
        raise PluginError(f"{page.file.src_uri} loads from a network: {found[0]}")
    return output
