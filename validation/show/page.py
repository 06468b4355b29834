"""HTML pages from templates, with their style sheet."""

from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

_LOADER = PackageLoader("validation.show")
_ENVIRONMENT = Environment(
    loader=_LOADER, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
)


def render_page(template: str, title: str, **context: Any) -> str:
    """Render a self-contained page from the name of its template, and further variables."""
    return _ENVIRONMENT.get_template("page.html.j2").render(template=template, title=title, **context)
