"""Formulas of the pages, `$x$` and `$$x$$`, as MathML: no script, no font, nothing to fetch.

An extension of Python-Markdown, by which the site is built; on the pages as they are, GitHub
shows the same formulas.
"""

from __future__ import annotations

import re
from xml.etree import ElementTree

from latex2mathml.converter import convert
from markdown import Markdown
from markdown.blockprocessors import BlockProcessor
from markdown.extensions import Extension
from markdown.inlinepatterns import InlineProcessor

NAMESPACE = ' xmlns="http://www.w3.org/1998/Math/MathML"'
EARLY = 185
"""After code in backquotes (190), before what a backslash escapes (180)."""


def mathml(formula: str, display: str) -> str:
    """A formula as an element of a page.

    Args:
        formula: In LaTeX.
        display: "inline" or "block".
    """
    return convert(formula.strip(), display=display).replace(NAMESPACE, "")


class Inline(InlineProcessor):
    """`$x$` within a line: no space after the first dollar nor before the second."""

    def __init__(self, md: Markdown) -> None:
        super().__init__(r"(?<![\\$\w])\$(?![\s$])([^$\n]+?)(?<![\s\\])\$(?![\w$])", md)

    def handleMatch(self, m: re.Match[str], data: str) -> tuple[str, int, int]:
        del data
        return self.md.htmlStash.store(mathml(m.group(1), "inline")), m.start(0), m.end(0)


class Block(BlockProcessor):
    """`$$x$$` in lines of its own."""

    def test(self, parent: ElementTree.Element, block: str) -> bool:
        del parent
        return block.strip().startswith("$$") and block.strip().endswith("$$")

    def run(self, parent: ElementTree.Element, blocks: list[str]) -> None:
        formula = mathml(blocks.pop(0).strip().strip("$"), "block")
        place = ElementTree.SubElement(parent, "div", {"class": "formula"})
        place.text = self.parser.md.htmlStash.store(formula)


class Mathematics(Extension):
    """Both."""

    def extendMarkdown(self, md: Markdown) -> None:
        md.inlinePatterns.register(Inline(md), "formula", EARLY)
        md.parser.blockprocessors.register(Block(md.parser), "formulas", EARLY)


def makeExtension(**settings: object) -> Mathematics:
    """Extension that Python-Markdown loads."""
    return Mathematics(**settings)
