"""HTML pages from templates, with their style sheets."""

from collections.abc import Sequence
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

_LOADER = PackageLoader("validation.show")
_ENVIRONMENT = Environment(
    loader=_LOADER, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
)


def render_page(template: str, title: str, *, styles: Sequence[str], **context: Any) -> str:
    """Render a self-contained page from the names of its template and style sheets, and further variables."""
    css = Markup("".join(_LOADER.get_source(_ENVIRONMENT, name)[0] for name in styles))
    page = _ENVIRONMENT.get_template("page.html.j2")
    return page.render(template=template, title=title, css=css, **context)
