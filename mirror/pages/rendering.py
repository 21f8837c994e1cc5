"""Pages as Jinja2 templates: a page's own template lies in the folder ``templates`` of the package that fills it.

Every value is escaped; HTML comes from templates only. A name that a template uses and nobody gives is an error.
"""

from __future__ import annotations

import base64
import hashlib
import json
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any, Final

from mirror.version import __version__

if TYPE_CHECKING:
    from jinja2 import Environment
    from markupsafe import Markup

_SHARED: Final = "mirror.pages"


def render_page(package: str, template: str, **values: object) -> str:
    """Render a page.

    Args:
        package: the package whose folder ``templates`` has the template, such as ``mirror.view``.
        template: the file; it extends ``layout.html``.
        **values: what the template shows; strings are escaped. The layout needs ``title``.
    """
    return load_environment(package).get_template(template).render(values)


def render_part(package: str, template: str, macro: str, *values: object) -> Markup:
    """Render a macro of a template as a part of a page, marked as safe from a second escaping.

    Args:
        package: the package whose folder ``templates`` has the template.
        template: the file.
        macro: the macro's name.
        *values: its arguments; strings are escaped.
    """
    rendered: Markup = getattr(load_environment(package).get_template(template).module, macro)(*values)
    return rendered


def script_data(value: Any) -> Markup:
    """Encode a value as JSON for a ``script`` element: no text in it can end the element."""
    from markupsafe import Markup

    return Markup(json.dumps(value, ensure_ascii=False, separators=(",", ":")).replace("<", "\\u003c"))


def style_sheet() -> str:
    """Read the CSS of all pages."""
    return files(_SHARED).joinpath("style.css").read_text()


def read_script(package: str, name: str) -> Markup:
    """Read a script that lies in a package, to be embedded in a page."""
    from markupsafe import Markup

    return Markup(files(package).joinpath(name).read_text())


def content_policy(script: str, *, images: str = "'none'", media: str = "'none'") -> str:
    """Return the content security policy of a page with one script: nothing else runs, and nothing is loaded.

    Args:
        script: the script.
        images: sources of images, such as ``data:``.
        media: sources of videos.
    """
    style, run = (
        f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
        for text in (style_sheet(), script)
    )
    return (
        f"default-src 'none'; img-src {images}; media-src {media}; style-src {style}; script-src {run}; "
        "base-uri 'none'; form-action 'none'"
    )


@cache
def load_environment(package: str) -> Environment:
    """Make the template environment of a package: its own templates, and the templates that all pages share.

    Args:
        package: the package whose folder ``templates`` has templates.
    """
    from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup

    environment = Environment(
        loader=ChoiceLoader([PackageLoader(name, "templates") for name in dict.fromkeys((package, _SHARED))]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        auto_reload=False,
    )
    environment.globals.update(style=Markup(style_sheet()), version=__version__)
    return environment
