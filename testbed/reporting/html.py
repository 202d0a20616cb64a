"""Pages that one can send: one HTML file with everything in it."""

from __future__ import annotations

import re
from importlib.resources import files
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup, escape

from testbed.files import replacing

_SIGNS = {"+-": "±", "^2": "²", " %": "\u00a0%"}

_HEAD = re.compile(r'<h2 id="([^"]+)">(.*?)</h2>')

_WHOLE = re.compile(r"[-+]?\d[\d.]*e-\d+|--[a-z][a-z-]*")
"""A number, an option: a browser would break them at a sign."""


def write_page(path: Path, template: str, content: dict[str, Any]) -> None:
    """Write a page.

    Args:
        path: The HTML file; what stands there is replaced.
        template: One of those in page/.
        content: What it shows.
    """
    text = rendered(template, content)
    with replacing(path) as fresh:
        fresh.write_text(text, encoding="utf-8")


def rendered(template: str, content: dict[str, Any]) -> str:
    """A page.

    Args:
        template: One of those in page/.
        content: What it shows.
    """
    pages = files("testbed.reporting") / "page"
    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(lambda name: (pages / name).read_text("utf-8")),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"typeset": typeset, "breakable": breakable, "drawing": Markup}
    style = (pages / "style.css").read_text("utf-8")
    text = environment.get_template(template).render(content, style=style)
    heads = _HEAD.findall(text)
    links = " ".join(f'<a href="#{place}">{title}</a>' for place, title in heads)
    return text.replace("<nav></nav>", f'<nav aria-label="Contents">{links}</nav>')


def typeset(text: str) -> Markup:
    """What a terminal writes as +- and m^2 as people write it; numbers, options unbroken."""
    for plain, sign in _SIGNS.items():
        text = text.replace(plain, sign)
    return Markup(_WHOLE.sub(r'<span class="number">\g<0></span>', str(escape(text))))


def breakable(name: str) -> Markup:
    """A name that goes on in the next line, where it must, after an underscore or a slash."""
    return Markup(re.sub("([_/])", r"\1<wbr>", str(escape(name))))
