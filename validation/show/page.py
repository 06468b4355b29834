"""HTML pages from templates, with style sheets and scripts inlined."""

from collections.abc import Sequence
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

_LOADER = PackageLoader("validation.show")
_ENVIRONMENT = Environment(
    loader=_LOADER, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
)


def render_page(
    template: str, title: str, *, styles: Sequence[str], scripts: Sequence[str] = (), **context: Any
) -> str:
    """Render a self-contained page.

    Args:
        template: name of its content among the templates; it finds the scripts as ``script``.
        title: of the page.
        styles: names of style sheets among the templates, in order.
        scripts: names of scripts, in order.
        context: further variables of the template.
    """
    css, script = (
        Markup("".join(_LOADER.get_source(_ENVIRONMENT, name)[0] for name in names))
        for names in (styles, scripts)
    )
    return _ENVIRONMENT.get_template("page.html.j2").render(
        template=template, title=title, css=css, script=script, **context
    )
