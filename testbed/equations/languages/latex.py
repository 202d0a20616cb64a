"""Equations as a LaTeX document."""

from __future__ import annotations

import re

from testbed.equations.equations import Equations, Listing
from testbed.equations.expression import (
    Expression,
    Factor,
    Nature,
    Number,
    angle_labels,
)
from testbed.equations.languages.text import (
    Style,
    definitions,
    fraction,
    header,
    preface,
    terms,
    used_constants,
    wrap,
)

STYLE = Style(
    lambda factor: factor.name.replace("mbar", "mm"), fraction, parameter_first=True
)


def paper(listing: Listing, source: str) -> str:
    """The paper's notation; arguments as for `write_equations`.

    qp2 and qpp2 are the velocity and acceleration of joint 2, S223 is sin(2 q2 + q3). Lines
    that begin with * are comments; lines that begin with a blank continue the one before.
    """
    lines = [f"* {line}".rstrip() for line in header(listing, source)]
    lines += [f"* {name} = {value:.12g}" for name, value, _ in used_constants(listing)]
    lines += _definitions(listing)
    for each in listing.equations:
        lines += ["", f"* {each.kind.title}"]
        for name, value in each.program.lines:
            if value or len(each.shape) == 1:
                lines += wrap(f"{name.name} =", terms(value, STYLE), " ")
    return "\n".join(lines) + "\n"


def _definitions(listing: Listing) -> list[str]:
    """What the barycentric parameters stand for, or the minimal ones are made of."""
    lines = []
    if listing.form == "full":
        lines += ["", "* Barycentric masses, moments and tensors"]
        for name, value in listing.definitions:
            lines += wrap(f"{name.replace('mbar', 'mm')} =", terms(value, STYLE), " ")
    made = [f"* {line}" for line in definitions(listing)]
    return [*lines, "", *made] if made else lines


def line(value: Expression) -> str:
    """One expression in the paper's notation."""
    return " ".join(terms(value, STYLE))


TERMS_PER_LINE = 3
"""Terms of an equation that stand on one line of a page."""

_COORDINATES = {
    Nature.POSITION: "q",
    Nature.VELOCITY: r"\dot q",
    Nature.ACCELERATION: r"\ddot q",
}
_GREEK = {"phi": r"\phi", "w": r"\omega", "wd": r"\dot\omega", "zdd": r"\ddot z"}


def latex(listing: Listing, source: str) -> str:
    """A document for pdflatex, one display an equation; arguments as for `write_equations`."""
    lines = [f"% {line}".rstrip() for line in preface(listing, source)]
    lines += [
        r"\documentclass{article}",
        r"\usepackage{amsmath}",
        r"\allowdisplaybreaks",
    ]
    lines += [r"\begin{document}"]
    if listing.constants:
        values = [
            f"{_name(c.name)} &= {_number(v)}"
            for c, v in sorted(listing.constants.items())
        ]
        lines += [r"\begin{align*}", " \\\\\n".join(values), r"\end{align*}"]
    for each in listing.equations:
        lines += [rf"\section*{{{each.kind.name.replace('-', ' ').capitalize()}}}"]
        lines += [r"\begin{align*}", _equations(each, listing.tree.n), r"\end{align*}"]
    return "\n".join([*lines, r"\end{document}"]) + "\n"


def _equations(each: Equations, joints: int) -> str:
    labels = {p.symbol: p.label.stem for p in each.parameters if p.symbol}
    known = {
        symbol: rf"\left({label.latex}\right)" if len(label.terms) > 1 else label.latex
        for symbol, label in labels.items()
    }
    style = Style(
        lambda factor: known.get(factor) or _factor(factor, joints),
        _number,
        r"\,",
        power=_power,
    )
    lines = []
    for label, value in each.program.lines:
        if value or len(each.shape) == 1:
            pieces = terms(value, style)
            rows = range(0, len(pieces), TERMS_PER_LINE)
            broken = (
                " ".join(pieces[first : first + TERMS_PER_LINE]) for first in rows
            )
            lines.append(f"{_name(label.name)} ={{}}& " + " \\\\\n&".join(broken))
    return " \\\\\n".join(lines) or "0 ={}& 0"


def _power(name: str, times: int) -> str:
    base = f"({name})" if "^" in name else name
    return f"{base}^{{{times}}}" if times > 1 else name


def _number(value: Number) -> str:
    over, _, under = fraction(value).partition("/")
    mantissa, _, exponent = over.partition("e")
    if exponent:
        return rf"{mantissa}\cdot 10^{{{int(exponent)}}}"
    return rf"\tfrac{{{over}}}{{{under}}}" if under else over


def _factor(factor: Factor, joints: int) -> str:
    """A coordinate as q_{1}, sine of 2 q2 + q3 as s_{223}, of q2 - q3 as s_{2,-3}."""
    if factor.nature in _COORDINATES:
        return rf"{_COORDINATES[factor.nature]}_{{{factor.rank + 1}}}"
    if factor.nature not in (Nature.COSINE, Nature.SINE) or factor.content is None:
        return _name(factor.name)
    labels = angle_labels(factor.content, "-")
    between = "," if joints > 9 or max(map(len, labels)) > 1 else ""
    letter = "c" if factor.nature is Nature.COSINE else "s"
    return rf"{letter}_{{{between.join(labels)}}}"


def _name(name: str) -> str:
    """w3x as omega_{3x}, F3x_7 as F_{3x,7}, phi_Q3_mb3z as phi_{Q3,mb3z}."""
    head = re.split(r"[\d_]", name)[0]
    below = name[len(head) :].strip("_").replace("_", ",")
    symbol = _GREEK.get(head) or (head if len(head) == 1 else rf"\mathrm{{{head}}}")
    return f"{symbol}_{{{below}}}" if below else symbol
