r"""Names as values: symbols, sums of them and formulas, written as text or in LaTeX.

Text      K*1yz = K1yz - l12z*mb*2y; stars mark redefined parameters
LaTeX     K^{*1}_{yz} = K^{1}_{yz} - l^{12}_{z}\,m\!b^{*2}_{y}
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import Literal

Notation = Literal["text", "latex"]

_HEADS = {"mbar": r"\bar{m}", "mb": r"m\!b"}


@dataclass(frozen=True)
class Symbol:
    """A parameter of a body, or the length from one body to another.

    Attributes:
        head: "mbar", "mb", "K", or "l" for a length.
        bodies: Number of the body, from 1; of a length, both. 0 is the bedplate.
        tail: Component, such as "z" or "yz"; "d" for half a difference; "" for a mass.
        star: Whether the parameter is redefined.
    """

    head: str
    bodies: tuple[int, ...]
    tail: str
    star: bool = False

    @property
    def text(self) -> str:
        """As printed: K*2yz, mbar1, l23z, l9_10z."""
        between = "" if max(self.bodies) < 10 else "_"
        return f"{self.head}{'*' * self.star}{between.join(map(str, self.bodies))}{self.tail}"

    @property
    def latex(self) -> str:
        """In LaTeX: K^{*2}_{yz}, l^{9,10}_{z}."""
        between = "" if max(self.bodies) < 10 else ","
        above = "*" * self.star + between.join(map(str, self.bodies))
        below = f"_{{{self.tail}}}" if self.tail else ""
        return f"{_HEADS.get(self.head, self.head)}^{{{above}}}{below}"


@dataclass(frozen=True)
class DriveSymbol:
    """The coefficient of one term of one joint.

    Attributes:
        kind: Such as "rotor".
        joint: The joint's name.
    """

    kind: str
    joint: str

    @property
    def text(self) -> str:
        """As printed: rotor/waist."""
        return f"{self.kind}/{self.joint}"

    @property
    def latex(self) -> str:
        r"""In LaTeX: \mathrm{rotor}_{\mathrm{waist}}."""
        joint = "".join(rf"\{c}" if c in "_&%$#{}" else c for c in self.joint)
        return rf"\mathrm{{{self.kind}}}_{{\mathrm{{{joint}}}}}"


@dataclass(frozen=True)
class Term:
    """A product: a number, or a sum of numbers times lengths, times a symbol.

    Attributes:
        symbol: What is multiplied; None for a number alone.
        weight: The summands of the factor, with their lengths; None is 1.
    """

    symbol: Symbol | DriveSymbol | None
    weight: tuple[tuple[float, Symbol | None], ...] = ((1.0, None),)

    def write(self, notation: Notation) -> str:
        """As text or in LaTeX; a leading minus stands without a blank."""
        name = [getattr(self.symbol, notation)] if self.symbol else []
        if len(self.weight) == 1:
            ((value, length),) = self.weight
            lengths = [getattr(length, notation)] if length else []
            return _product(value, [*lengths, *name], notation)
        inner = [Term(length, ((value, None),)) for value, length in self.weight]
        return _TIMES[notation].join([f"({join(inner, notation)})", *name])


@dataclass(frozen=True)
class Label:
    """The name of an unknown: a symbol, a multiple of one, or a sum of such.

    Attributes:
        terms: Its summands.
    """

    terms: tuple[Term, ...]

    @property
    def times(self) -> int:
        """How many times its symbol it is: 2 for 2*K3d; 1 for sums."""
        return int(self.terms[0].weight[0][0]) if len(self.terms) == 1 else 1

    @property
    def symbols(self) -> tuple[Symbol | DriveSymbol | None, ...]:
        """What its summands are of."""
        return tuple(term.symbol for term in self.terms)

    @property
    def text(self) -> str:
        """In one word: mb*2z, 2*K3d, K*1zz+rotor/waist."""
        return "".join(self.pieces)

    @property
    def pieces(self) -> list[str]:
        """Its summands with their signs: K*1zz, +rotor/waist."""
        return [piece.replace(" ", "", 1) for piece in summands(self.terms, "text")]

    @property
    def stem(self) -> Label:
        """The name without its multiple: K3d for 2*K3d."""
        return Label((Term(self.terms[0].symbol),)) if len(self.terms) == 1 else self

    @property
    def latex(self) -> str:
        """In LaTeX."""
        return join(self.terms, "latex")


@dataclass(frozen=True)
class Formula:
    """How an unknown is made of others.

    Attributes:
        left: The unknown.
        right: The sum that it stands for; empty for 0.
    """

    left: Label
    right: tuple[Term, ...]

    def __str__(self) -> str:
        """As text."""
        return f"{join(self.left.terms, 'text')} = {self.said}"

    @property
    def said(self) -> str:
        """The right-hand side as text."""
        return join(self.right, "text")

    @property
    def trivial(self) -> bool:
        """Whether it says only that the unknown is itself."""
        return self.left.terms == self.right

    def latex(self, between: str = "=") -> str:
        """In LaTeX.

        Args:
            between: Between the sides; "&=" in an aligned display.
        """
        return f"{self.left.latex} {between} {join(self.right, 'latex')}"


def join(terms: Sequence[Term], notation: Notation) -> str:
    """A sum of terms: a - l*b; "0" for none."""
    return " ".join(summands(terms, notation)) or "0"


def summands(terms: Sequence[Term], notation: Notation) -> list[str]:
    """The terms of a sum, each with its sign: a, - l*b."""
    found: list[str] = []
    for term in terms:
        product = term.write(notation)
        if not found:
            found.append(product)
        elif product.startswith("-"):
            found.append(f"- {product[1:]}")
        else:
            found.append(f"+ {product}")
    return found


_TIMES = {"text": "*", "latex": r"\,"}


def _product(value: float, names: list[str], notation: Notation) -> str:
    """A number times names: a, -a*b, a/2, 3/2*a."""
    over, slash, under = number(abs(value)).partition("/")
    sign = "-" if value < 0 else ""
    if notation == "text" and over == "1" and slash and names:
        return f"{sign}{'*'.join(names)}/{under}"
    size = over + slash + under if notation == "text" else _latex_number(over, under)
    factors = names if size == "1" and names else [size, *names]
    return sign + _TIMES[notation].join(factors)


def _latex_number(over: str, under: str) -> str:
    if under:
        return rf"\tfrac{{{over}}}{{{under}}}"
    mantissa, power, exponent = over.partition("e")
    return rf"{mantissa}\cdot 10^{{{int(exponent)}}}" if power else over


@lru_cache(maxsize=4096)
def number(value: float) -> str:
    """A coefficient: whole, halves, thirds and quarters as they are, else six digits."""
    near = Fraction(float(value)).limit_denominator(4)
    return str(near) if abs(float(near) - value) < 1e-12 else f"{value:.6g}"
