"""Equations as a LaTeX document."""

from __future__ import annotations

import re

from testbed.core.parameters.regroup import length_symbol
from testbed.core.parameters.symbols import Label
from testbed.equations.equations import Equations, Listing
from testbed.equations.expression import Expression, Factor, Nature, Number
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

STYLE = Style(lambda factor: factor.name.replace("mbar", "mm"), fraction, parameter_first=True)


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
        titles = ("Barycentric masses", "Barycentric moments", "Barycentric tensors")
        for title, head in zip(titles, ("mbar", "mb", "K"), strict=True):
            lines += ["", f"* {title}"]
            for name, value in listing.definitions:
                if name.rstrip("xyz0123456789") == head:
                    lines += wrap(f"{name.replace('mbar', 'mm')} =", terms(value, STYLE), " ")
    made = [f"* {line}" for line in definitions(listing)]
    return [*lines, "", *made] if made else lines


def line(value: Expression) -> str:
    """One expression in the paper's notation."""
    return " ".join(terms(value, STYLE))


WIDTH = 60
"""Characters of a line of an equation, as printed."""

_COORDINATES = {Nature.POSITION: "q", Nature.VELOCITY: r"\dot q", Nature.ACCELERATION: r"\ddot q"}
_GREEK = {"w": r"\omega", "wd": r"\dot\omega", "zdd": r"\ddot z"}


def latex(listing: Listing, source: str) -> str:
    """A document for pdflatex, one display an equation; arguments as for `write_equations`."""
    lines = [f"% {line}".rstrip() for line in preface(listing, source)]
    lines += [r"\documentclass{article}", r"\usepackage{amsmath}", r"\allowdisplaybreaks"]
    lines += [r"\begin{document}"]
    known = _constants(listing)
    if listing.constants:
        values = (rf"{known[c.name]} &= {_number(v)}" for c, v in sorted(listing.constants.items()))
        lines += [r"\begin{align*}", " \\\\\n".join(values), r"\end{align*}"]
    for each in listing.equations:
        lines += [rf"\section*{{{each.kind.name.replace('-', ' ').capitalize()}}}"]
        lines += [r"\begin{align*}", *_equations(each, known, listing.tree.n), r"\end{align*}"]
    return "\n".join([*lines, r"\end{document}"]) + "\n"


def _constants(listing: Listing) -> dict[str, str]:
    """How the lengths between bodies and the components of gravity are written."""
    joints = enumerate(listing.tree.joints)
    symbols = (length_symbol(joint.parent, k, axis) for k, joint in joints for axis in "xyz")
    gravity = {f"g{axis}": f"g_{{{axis}}}" for axis in "xyz"}
    return {"g": "g"} | gravity | {symbol.text: symbol.latex for symbol in symbols}


def _equations(each: Equations, constants: dict[str, str], joints: int) -> list[str]:
    known = constants | {p.symbol.name: _factor(p.label.stem) for p in each.parameters if p.symbol}
    style = Style(lambda factor: _name(factor, known, joints), _number, r"\,", power=_power)
    lines = []
    for label, value in each.program.lines:
        if value or len(each.shape) == 1:
            rows = _broken(terms(value, style))
            lines.append(rf"{_auxiliary(label.name)} ={{}}& " + " \\\\\n&".join(rows))
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


def _name(factor: Factor, known: dict[str, str], joints: int) -> str:
    if factor.nature in _COORDINATES:
        return rf"{_COORDINATES[factor.nature]}_{{{factor.rank + 1}}}"
    if factor.nature in (Nature.COSINE, Nature.SINE) and factor.content is not None:
        return _wave("c" if factor.nature is Nature.COSINE else "s", factor.content, joints)
    return known.get(factor.name) or _auxiliary(factor.name)


def _wave(letter: str, angle: Expression, joints: int) -> str:
    """Sine of 2 q2 + q3 is s_{223}, of q2 - q3 s_{2,-3}; from ten joints on always commas."""
    labels: list[str] = []
    for (coordinate,), times in angle.terms:
        labels += ["-" * (times < 0) + str(coordinate.rank + 1)] * int(abs(times))
    between = "," if joints > 9 or max(map(len, labels)) > 1 else ""
    return rf"{letter}_{{{between.join(labels)}}}"


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
