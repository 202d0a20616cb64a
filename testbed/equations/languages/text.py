"""What all languages share: terms and sums as text, lines of a length, the header.

Names of expressions are made by this room. Whatever comes from a model file, such as the
names of joints, is shown in comments only, and only its harmless characters.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from fractions import Fraction

from testbed.equations.equations import Equations, Listing
from testbed.equations.expression import Expression, Factor, Nature, Number, Term
from testbed.equations.robot import almost_right

WIDTH = 96
COORDINATES = {Nature.POSITION: "q", Nature.VELOCITY: "qp", Nature.ACCELERATION: "qpp"}
"""As functions of programs have them."""


@dataclass(frozen=True)
class Style:
    """How a language writes terms.

    Attributes:
        name: A factor's name.
        number: A positive number.
        times: Between factors.
        parameter_first: Whether the number stands behind the parameter, as in the paper.
        plus_first: Whether a sum begins with a term that is not subtracted, if it has one.
        power: A factor that stands once or several times in a term.
    """

    name: Callable[[Factor], str]
    number: Callable[[Number], str]
    times: str = "*"
    parameter_first: bool = False
    plus_first: bool = False
    power: Callable[[str, int], str] = lambda name, times: "*".join([name] * times)


def decimal(value: Number) -> str:
    """A number with a decimal point, that reads back as the same."""
    return repr(float(value))


def fraction(value: Number) -> str:
    """A number as people write it, and as it reads back: 1/2, 0.4318."""
    if (
        isinstance(value, float)
        and value == (near := Fraction(value))
        and near.denominator <= 64
    ):
        return str(near)
    return repr(value)


PROGRAMS = Style(lambda factor: factor.name, decimal, plus_first=True)
"""How Python and C write terms."""


def terms(value: Expression, style: Style) -> list[str]:
    """Every term with its sign, the first one's plus left out."""

    def order(term: Term) -> bool:
        """First what is added; or another equation's left-hand side: Q2 = Q3 + ..."""
        factors, size = term
        if style.plus_first:
            return size < 0
        return not (len(factors) == 1 and re.fullmatch(r"Q\d+", factors[0].name))

    texts: list[str] = []
    for factors, size in sorted(value.terms, key=order):
        parameters = [f for f in factors if f.nature is Nature.PARAMETER]
        rest = [f for f in factors if f.nature is not Nature.PARAMETER]
        number = [style.number(abs(size))] if abs(size) != 1 or not factors else []
        names, others = (_product(each, style) for each in (parameters, rest))
        parts = (
            [*names, *number, *others]
            if style.parameter_first
            else [*number, *names, *others]
        )
        sign = "-" if size < 0 else "+"
        lead = f"{sign} " if texts else sign.replace("+", "")
        texts.append(lead + style.times.join(parts))
    return texts or ["0"]


def _product(factors: list[Factor], style: Style) -> list[str]:
    """Factors as written, repeated ones as powers."""
    return [
        style.power(_factor(each, style), times)
        for each, times in Counter(factors).items()
    ]


def _factor(factor: Factor, style: Style) -> str:
    if factor.inside:
        return f"({' '.join(terms(factor.inside, style))})"
    return style.name(factor)


def wrap(start: str, pieces: list[str], indent: str) -> list[str]:
    """Wrap pieces of an expression at `WIDTH` columns; further lines are indented."""
    lines = [start]
    for piece in pieces:
        if len(lines[-1]) + 1 + len(piece) > WIDTH and lines[-1].strip():
            lines.append(indent + piece)
        else:
            lines[-1] += f" {piece}" if lines[-1] else piece
    return lines


def harmless(text: str) -> str:
    """Text from a file, fit for any language's comments: letters, digits and a few signs.

    Letters of other scripts become their numbers, such as u65e5; everything else an underline,
    colons among them: a comment with `coding:` changes how Python reads a file.
    """
    spelled = "".join(
        c if c.isascii() or not c.isalnum() else f"u{ord(c):04x}" for c in text
    )
    return re.sub(r"[^A-Za-z0-9_.,+\-() /]", "_", spelled)[:120]


def preface(listing: Listing, source: str) -> list[str]:
    """What the equations are of and in which parameters, a line each, without comment signs."""
    return [*header(listing, source), *definitions(listing)]


def header(listing: Listing, source: str) -> Iterator[str]:
    """What the equations are of, a line each, without comment signs."""
    tree, g = listing.tree, listing.gravity
    yield f"Equations of {harmless(tree.name)}, {listing.form} form, by testbed"
    if source:
        yield f"Model: {harmless(source)}"
    yield f"Gravity: {g[0]:g} {g[1]:g} {g[2]:g} m/s^2 in the bedplate frame"
    yield "Joints, with the body that carries each (0 is the bedplate):"
    for j, joint in enumerate(tree.joints):
        yield f"  {j + 1:3d}  {joint.kind}, on {joint.parent + 1}: {harmless(joint.name)}"
    for name, off in almost_right(tree).items():
        about = f"{harmless(name)} is {off:.1g} rad off a right angle"
        yield f"NOTE: {about}; --right-angles sets it right"
    zero = int(listing.known_zero.sum())
    if zero:
        yield f"{zero} barycentric parameters are known to be zero and left out"
    for each in listing.equations:
        yield f"{each.kind.name}: {operations(each)}"
    yield "Units m, kg, s, rad; conventions in docs/conventions.md of testbed"


def definitions(listing: Listing) -> Iterator[str]:
    """How the minimal parameters are made of the barycentric ones, a line each."""
    for model, minimal in listing.minimal.items():
        yield f"Parameters of the {model} model, delta_{model[0]}:"
        yield from (f"  {line}" for line in (*minimal.auxiliary, *minimal.formulas))


def operations(each: Equations) -> str:
    """Counts in words."""
    count = each.program.count
    text = (
        f"{count.multiplications} multiplications, {count.additions} additions, "
        f"{count.trigonometric} sines and cosines"
    )
    return (
        f"{text}; {count.once} operations on parameters alone" if count.once else text
    )


def used_constants(listing: Listing) -> list[tuple[str, float, str]]:
    """Name, value and unit of each constant that the equations need, in order."""
    symbols = {symbol for each in listing.equations for symbol in each.program.symbols}
    return [
        (
            factor.name,
            listing.constants[factor],
            "m" if factor.name.startswith("l") else "m/s^2",
        )
        for factor in sorted(symbols)
        if factor.nature is Nature.CONSTANT
    ]


def function_name(each: Equations) -> str:
    """Of the function that computes them."""
    return each.kind.name.replace("-", "_")


def inputs(each: Equations) -> Iterator[tuple[str, str]]:
    """Names and where they come from: qp1 from qp[0], K3d from delta_d[2] / 2, S2 from sin(q2)."""
    program = each.program
    for symbol in program.symbols:
        if symbol.nature in COORDINATES:
            letter = COORDINATES[symbol.nature]
            yield symbol.name, f"{letter}[{symbol.rank}]"
    used = set(program.symbols)
    for k, parameter in enumerate(each.parameters):
        if parameter.symbol is not None and parameter.symbol in used:
            divided = f" / {parameter.times}" if parameter.times != 1 else ""
            yield parameter.symbol.name, f"{each.vector}[{k}]{divided}"
    for wave in program.waves:
        if wave.content is not None:
            function = "cos" if wave.nature is Nature.COSINE else "sin"
            yield wave.name, f"{function}({' '.join(terms(wave.content, PROGRAMS))})"


def assignments(each: Equations) -> Iterator[tuple[str, list[str]]]:
    """Name and terms of each line of a program; results as result[0] or result[0][1]."""
    places = {
        name: "".join(f"[{k}]" for k in place) for name, place in each.places.items()
    }
    names = {name: f"result{place}" for name, place in places.items()}
    style = replace(PROGRAMS, name=lambda factor: names.get(factor, factor.name))
    for label, value in each.program.lines:
        yield names.get(label, label.name), terms(value, style)
