"""Equations in the notation of [FRS96], and as a LaTeX document."""

from __future__ import annotations

import re

from testbed.equations.equations import Equations, Listing
from testbed.equations.expression import (
    Expression,
    Factor,
    FactorKind,
    Number,
    angle_labels,
)
from testbed.equations.languages.text import (
    Notation,
    definitions,
    fraction,
    header_and_definitions,
    header_lines,
    term_texts,
    used_constants,
    wrap,
)

PAPER_STYLE = Notation(
    lambda factor: factor.name.replace("mbar", "mm"), fraction, parameter_first=True
)


def write_paper_notation(listing: Listing, source: str) -> str:
    """Write equations in the notation of [FRS96]; arguments as for `write_equations`.

    qp2 and qpp2 are the velocity and acceleration of joint 2, S223 is sin(2 q2 + q3). Lines
    that begin with * are comments; lines that begin with a blank continue the previous line.
    Entries of a mass matrix or regressor that are zero are left out.
    """
    lines = [f"* {line}".rstrip() for line in header_lines(listing, source)]
    lines += [f"* {name} = {value:.12g}" for name, value, _ in used_constants(listing)]
    lines += _definition_lines(listing)
    for each in listing.equations:
        lines += ["", f"* {each.kind.title}"]
        for name, value in each.program.lines:
            if value or len(each.shape) == 1:
                lines += wrap(f"{name.name} =", term_texts(value, PAPER_STYLE), " ")
    return "\n".join(lines) + "\n"


def _definition_lines(listing: Listing) -> list[str]:
    """Lines that define the barycentric or minimal parameters.

    In the full form, the lines define the barycentric parameters. In other forms, they are comments
    with the formulas of the minimal parameters in terms of the barycentric parameters.
    """
    lines = []
    if listing.form == "full":
        lines += ["", "* Barycentric masses, moments and tensors"]
        for name, value in listing.definitions:
            lines += wrap(
                f"{name.replace('mbar', 'mm')} =", term_texts(value, PAPER_STYLE), " "
            )
    definition_lines = [f"* {line}" for line in definitions(listing)]
    return [*lines, "", *definition_lines] if definition_lines else lines


def expression_line(value: Expression) -> str:
    """Expression as one line in the notation of [FRS96]."""
    return " ".join(term_texts(value, PAPER_STYLE))


TERMS_PER_LINE = 3
"""Number of terms of an equation on one line of a page."""

_COORDINATE_SYMBOLS = {
    FactorKind.POSITION: "q",
    FactorKind.VELOCITY: r"\dot q",
    FactorKind.ACCELERATION: r"\ddot q",
}
_LATEX_SYMBOLS = {
    "phi": r"\phi",
    "w": r"\omega",
    "wd": r"\dot\omega",
    "zdd": r"\ddot z",
}


def write_latex(listing: Listing, source: str) -> str:
    """Write equations as a document for pdflatex; arguments as for `write_equations`."""
    lines = [f"% {line}".rstrip() for line in header_and_definitions(listing, source)]
    lines += [
        r"\documentclass{article}",
        r"\usepackage{amsmath}",
        r"\allowdisplaybreaks",
    ]
    lines += [r"\begin{document}"]
    if listing.constants:
        values = [
            f"{_latex_name(c.name)} &= {_latex_number(v)}"
            for c, v in sorted(listing.constants.items())
        ]
        lines += [r"\begin{align*}", " \\\\\n".join(values), r"\end{align*}"]
    for each in listing.equations:
        lines += [rf"\section*{{{each.kind.name.replace('-', ' ').capitalize()}}}"]
        lines += [
            r"\begin{align*}",
            _equation_rows(each, listing.tree.n),
            r"\end{align*}",
        ]
    return "\n".join([*lines, r"\end{document}"]) + "\n"


def _equation_rows(each: Equations, joints: int) -> str:
    """Rows of an align environment for one kind of equations, with three terms per row.

    Entries of a mass matrix or regressor that are zero are left out.

    Args:
        each: Equations of the kind.
        joints: Number of joints.
    """
    labels = {p.symbol: p.label.without_multiple for p in each.parameters if p.symbol}
    names = {
        symbol: rf"\left({label.latex}\right)" if len(label.terms) > 1 else label.latex
        for symbol, label in labels.items()
    }
    style = Notation(
        lambda factor: names.get(factor) or _latex_factor(factor, joints),
        _latex_number,
        r"\,",
        power=_latex_power,
    )
    lines = []
    for label, value in each.program.lines:
        if value or len(each.shape) == 1:
            pieces = term_texts(value, style)
            rows = range(0, len(pieces), TERMS_PER_LINE)
            text_rows = (
                " ".join(pieces[first : first + TERMS_PER_LINE]) for first in rows
            )
            lines.append(
                f"{_latex_name(label.name)} ={{}}& " + " \\\\\n&".join(text_rows)
            )
    return " \\\\\n".join(lines) or "0 ={}& 0"


def _latex_power(name: str, exponent: int) -> str:
    """Power of a name in LaTeX."""
    base = f"({name})" if "^" in name else name
    return f"{base}^{{{exponent}}}" if exponent > 1 else name


def _latex_number(value: Number) -> str:
    """Number in LaTeX: a fraction, or a mantissa times a power of ten."""
    numerator, _, denominator = fraction(value).partition("/")
    mantissa, _, exponent = numerator.partition("e")
    if exponent:
        return rf"{mantissa}\cdot 10^{{{int(exponent)}}}"
    return rf"\tfrac{{{numerator}}}{{{denominator}}}" if denominator else numerator


def _latex_factor(factor: Factor, joints: int) -> str:
    """Factor in LaTeX: q_{1} for a coordinate, s_{223} for sin(2 q2 + q3).

    The sine of q2 - q3 is s_{2,-3}.
    """
    if factor.kind in _COORDINATE_SYMBOLS:
        return rf"{_COORDINATE_SYMBOLS[factor.kind]}_{{{factor.rank + 1}}}"
    if (
        factor.kind not in (FactorKind.COSINE, FactorKind.SINE)
        or factor.content is None
    ):
        return _latex_name(factor.name)
    labels = angle_labels(factor.content, "-")
    separator = "," if joints > 9 or max(map(len, labels)) > 1 else ""
    letter = "c" if factor.kind is FactorKind.COSINE else "s"
    return rf"{letter}_{{{separator.join(labels)}}}"


def _latex_name(name: str) -> str:
    """Name in LaTeX with subscripts, such as omega_{3x} for w3x.

    Likewise, F3x_7 becomes F_{3x,7}, and phi_Q3_mb3z becomes phi_{Q3,mb3z}.
    """
    stem = re.split(r"[\d_]", name)[0]
    subscript = name[len(stem) :].strip("_").replace("_", ",")
    symbol = _LATEX_SYMBOLS.get(stem) or (
        stem if len(stem) == 1 else rf"\mathrm{{{stem}}}"
    )
    return f"{symbol}_{{{subscript}}}" if subscript else symbol
