"""What mkdocs does not do itself: pages from files outside docs/, formulas as MathML, no network."""

import csv
import re
from html import unescape
from importlib import resources
from importlib.util import find_spec
from itertools import groupby
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files

from ampm import __version__
from ampm.run_file import find_keys
from validation.table import Table

ROOT = Path(__file__).resolve().parents[1]
ROLE = re.compile(r":(?:class|func|meth|mod|data|attr|exc):<code>~?(?:[\w.]*\.)?(\w+)</code>")
OUTSIDE = re.compile(r"\[([^\]]+)\]\(examples/?\)")
SOURCES = {
    r"CONTRIBUTING\.md": "contributing",
    r"ampm/\w+\.py": "parameters",
    r"validation/judge/limits\.csv": "tolerances",
}
"""Files that the pages link to, as they stand in the repository, and the page of the site made from each."""
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)
BESIDE = re.compile(r"(?:(?<=</m[in]>)|(?<=</msub>))(?=<mi>[a-z]{2,}<)|(?<=[a-z]{2}</mi>)(?=<m[ifns])")
"""Where a thin space belongs: before the name of a function, and before its argument without parentheses."""
LOADED = re.compile(
    r'<(?:script|img|link rel="(?:stylesheet|preconnect|icon)")[^>]*(?:src|href)="(?:https?:)?//'
)


def on_config(config: Any) -> Any:
    """The version, at the foot of every page."""
    config.copyright = f"AMPM testbed {__version__}, Apache-2.0"
    return config


def on_files(files: Files, config: Any) -> Files:
    """Add what is not in the folder, and a font of formulas, for browsers have none."""
    pages = {
        "index.md": "---\nhide: [navigation]\n---\n" + at_root("README.md"),
        "contributing.md": at_root("CONTRIBUTING.md"),
        "changelog.md": f"---\ntitle: Changelog, version {__version__}\n---\n" + at_root("CHANGELOG.md"),
        "parameters.md": parameters(),
        "tolerances.md": tolerances(),
        "LICENSE": at_root("LICENSE"),
        "CITATION.cff": at_root("CITATION.cff"),
    }
    for path, content in pages.items():
        files.append(File.generated(config, path, content=content))
    font = Path(find_spec("ziamath").origin).with_name("fonts") / "STIXTwoMath-Regular.ttf"
    files.append(File.generated(config, "stix-two-math.ttf", content=font.read_bytes()))
    return files


def at_root(name: str) -> str:
    """Text of a file beside docs/, with links as they are from docs/."""
    text = ROOT.joinpath(name).read_text(encoding="utf-8").replace("](docs/", "](")
    return OUTSIDE.sub(r"\1", text.replace("](CONTRIBUTING.md", "](contributing.md"))


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Let links to a source lead to the page that is made from it; of other files outside, keep the words."""
    for source, made in SOURCES.items():
        markdown = re.sub(rf"\]\(\.\./((?:\.\./)*){source}", rf"](\1{made}.md", markdown)
    outside = re.escape("../" * (1 + page.file.src_uri.count("/")))
    return re.sub(rf"\[([^\]]+)\]\({outside}[^)]*\)", r"\1", markdown)


def parameters() -> str:
    """The page of all parameters, from the table of ``ampm keys``."""
    parts = [
        "# Parameters",
        "Every key of a run file, as `ampm keys` lists it. `ampm keys WORD` finds a key, `--set KEY=VALUE` "
        "sets it. Defaults hold without a preset. [Open values](gaits.md#finding-open-values) are found.",
    ]
    for section, keys in groupby(find_keys(), lambda info: info.key.partition(".")[0]):
        rows = [
            (f"`{key.key}`", str(key.default), "" if key.unit == "1" else key.unit, key.range, key.meaning)
            for key in keys
        ]
        table = Table("", ("key", ">default", "unit", "bounds", "meaning"), rows)
        parts += [f"## {section}", table.markdown()]
    return "\n\n".join(parts) + "\n"


def tolerances() -> str:
    """The page of all limits with their reasons, from the file that the judge reads."""
    with resources.files("validation.judge").joinpath("limits.csv").open(encoding="utf-8") as file:
        header, *rows = csv.reader(file)
    profiles = header[2:-1]
    shown = []
    for name, grows, *limits, reason in rows:
        given = [f"{profile}&nbsp;{limit}" for profile, limit in zip(profiles, limits, strict=True) if limit]
        shown.append((f"`{name}`", grows, "<br>".join(given), reason))
    limits = Table("", ("metric", "grows with", "limits", "reason"), shown)
    parts = [
        "# Tolerances",
        "Limits for the default body, in SI units and body weights. A profile that is not named has the "
        "limit of `default`, if it judges the metric at all. "
        "[Profiles](measurement.md#verdict-and-tolerances) says what each is for.",
        limits.markdown(),
    ]
    return "\n\n".join(parts) + "\n"


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
    """Refuse a page that loads anything from a network, or shows classes without their fields."""
    if page.file.src_uri == "api.md" and "root mean square error" not in output:
        raise PluginError("api.md shows no fields of validation.Statistics; docs/fields.py adds them.")
    if found := LOADED.search(output):
        raise PluginError(f"{page.file.src_uri} loads from a network: {found[0]}")
    return output
