"""Equations as a LaTeX document."""

from __future__ import annotations

import re

from testbed.parameters.formulas import length_symbol
from testbed.parameters.symbols import Label
from testbed.robot.tree import Tree
from testbed.symbolic.equations import Equations, Listing
from testbed.symbolic.expression import Factor, Nature, Number
from testbed.symbolic.languages.text import Style, definitions, fraction, header, terms

WIDTH = 60
"""Characters of a line of an equation, as printed."""

_GREEK = {"w": r"\omega", "wd": r"\dot\omega", "zdd": r"\ddot z"}


def latex(listing: Listing, source: str) -> str:
    """Equations as a document for pdflatex, one display an equation.

    Args:
        listing: The equations.
        source: Where the robot comes from.
    """
    said = (*header(listing, source), *definitions(listing))
    lines = [f"% {line}".rstrip() for line in said]
    lines += [r"\documentclass{article}", r"\usepackage{amsmath}", r"\allowdisplaybreaks"]
    lines += [r"\begin{document}"]
    lengths = _lengths(listing.tree)
    if listing.constants:
        values = (
            rf"{_constant(c.name, lengths)} &= {_number(v)}"
            for c, v in sorted(listing.constants.items())
        )
        lines += [r"\begin{align*}", " \\\\\n".join(values), r"\end{align*}"]
    for each in listing.equations:
        lines += [rf"\section*{{{each.kind.name.replace('-', ' ').capitalize()}}}"]
        lines += [r"\begin{align*}", *_equations(each, lengths), r"\end{align*}"]
    return "\n".join([*lines, r"\end{document}"]) + "\n"


def _lengths(tree: Tree) -> dict[str, str]:
    """How the lengths between bodies are written."""
    symbols = (length_symbol(j.parent, k, a) for k, j in enumerate(tree.joints) for a in "xyz")
    return {symbol.text: symbol.latex for symbol in symbols}


def _equations(each: Equations, lengths: dict[str, str]) -> list[str]:
    known = lengths | {p.symbol.name: _factor(p.label.stem) for p in each.parameters if p.symbol}
    style = Style(lambda factor: _name(factor, known), _number, r"\,", power=_power)
    lines = []
    for label, value in each.program.lines:
        if value or len(each.shape) == 1:
            rows = _broken(terms(value, style))
            lines.append(rf"{_name(label, known)} ={{}}& " + " \\\\\n&".join(rows))
    return [" \\\\\n".join(lines) or "0 ={}& 0"]


def _factor(label: Label) -> str:
    """A parameter as a factor: a sum is put in brackets."""
    return rf"\left({label.latex}\right)" if len(label.terms) > 1 else label.latex


def _broken(pieces: list[str]) -> list[str]:
    """Terms in lines of a width, counted in characters that show."""
    rows, width = [""], 0
    for piece in pieces:
        size = len(re.sub(r"\\[a-z]+|[\\{}_^,]", "", piece)) + 2
        if width and width + size > WIDTH:
            rows, width = [*rows, ""], 0
        rows[-1] = f"{rows[-1]} {piece}".strip()
        width += size
    return rows


def _power(name: str, times: int) -> str:
    base = rf"({name})" if "^" in name else name
    return rf"{base}^{{{times}}}"


def _number(value: Number) -> str:
    text = fraction(value)
    if "/" in text:
        over, under = text.split("/")
        return rf"\tfrac{{{over}}}{{{under}}}"
    if "e" in text:
        mantissa, exponent = text.split("e")
        return rf"{mantissa}\cdot 10^{{{int(exponent)}}}"
    return text


def _name(factor: Factor, known: dict[str, str]) -> str:
    name, nature = factor.name, factor.nature
    if nature is Nature.PARAMETER:
        return known[name]
    if nature in (Nature.POSITION, Nature.VELOCITY, Nature.ACCELERATION):
        letters = {"q": "q", "qp": r"\dot q", "qpp": r"\ddot q"}
        head = name.rstrip("0123456789")
        return rf"{letters[head]}_{{{name[len(head) :]}}}"
    if nature in (Nature.COSINE, Nature.SINE):
        return _wave(name)
    if nature is Nature.CONSTANT:
        return _constant(name, known)
    return _auxiliary(name)


def _wave(name: str) -> str:
    """S223 is s_{223}, S_2_m3 is s_{2,-3}."""
    letter, label = name[0].lower(), name[1:]
    inside = label.strip("_").replace("_", ",").replace("m", "-")
    return rf"{letter}_{{{inside}}}"


def _constant(name: str, lengths: dict[str, str]) -> str:
    return lengths.get(name) or re.sub(r"^g(.)$", r"g_{\1}", name)


def _auxiliary(name: str) -> str:
    """w3x is omega^3_x, F3x_7 is F^3_{x,7}, phi_Q3_mb3z is phi_{Q3,mb3z}."""
    if name.startswith("phi_"):
        _, row, column = name.split("_", 2)
        plain = column.replace("_", r"\_")
        return rf"\phi_{{\mathrm{{{row}}},\mathrm{{{plain}}}}}"
    parts = re.fullmatch(r"([A-Za-z]+?)(\d*)([xyz]*)((?:_\d+)*)", name)
    if parts is None:
        plain = name.replace("_", r"\_")
        return rf"\mathrm{{{plain}}}"
    head, body, axes, columns = parts.groups()
    if head in ("t", "k", "Q", "G", "M") and not axes:
        return rf"{head}_{{{body}{columns.replace('_', ',')}}}"
    below = axes + columns.replace("_", "," if axes else "")
    text = _GREEK.get(head, head)
    return text + (f"^{{{body}}}" if body else "") + (f"_{{{below}}}" if below else "")
