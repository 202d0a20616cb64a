r"""Names as values: symbols, sums of them and formulas, written as text or in LaTeX.

Text      K*1yz = K1yz - l12z*mb*2y; stars mark redefined parameters
LaTeX     K^{*1}_{yz} = K^{1}_{yz} - l^{12}_{z}\,m\!b^{*2}_{y}
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache
from typing import Literal

import numpy as np

from testbed.core.base.arrays import AnyArray, Array, readonly, skew
from testbed.core.robot.inertia import Inertia
from testbed.core.robot.tree import Tree

PARTS = (
    ("mbar", ""),
    *(("mb", axis) for axis in "xyz"),
    *(("K", pair) for pair in ("xx", "xy", "xz", "yy", "yz", "zz")),
)
"""Of a body's barycentric parameters, in their order: what each is, and along which axes."""

STANDARD = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
"""Order of a body's standard parameters, about and along its frame (Pinocchio's order)."""

UNIT_OF = {"mbar": "kg", "mb": "kg m", "K": "kg m^2"}
"""Units of masses, moments and tensors."""

UNITS = tuple(UNIT_OF[head] for head, _ in PARTS)
"""Units of a body's ten, barycentric or standard."""

UPPER = np.triu_indices(3)
"""Where the six numbers of a tensor stand in it, row by row."""

TENSOR: Array = np.eye(6)[np.array([(0, 1, 2), (1, 3, 4), (2, 4, 5)])]
"""The tensor of six numbers, (3, 3, 6): K[a, b] = sum over k of TENSOR[a, b, k] K6[k]."""

STANDARD_ORDER = (0, 1, 2, 3, 4, 5, 7, 6, 8, 9)
"""Swaps Kxz and Kyy, from the order STANDARD to PARTS and back."""


def standard(tree: Tree) -> Array:
    """Standard parameters of every body, (n, 10) in the order STANDARD [kg, kg m, kg m^2]."""
    rows = [
        (inertia.mass, *inertia.first_moment, *inertia.tensor[UPPER])
        for inertia in tree.inertias
    ]
    return readonly(np.array(rows)[:, STANDARD_ORDER], (tree.n, 10), "standard")


def with_standard(tree: Tree, standard: Array) -> Tree:
    """The same tree with bodies of other standard parameters.

    Args:
        tree: The robot.
        standard: (n, 10) in the order STANDARD [kg, kg m, kg m^2].
    """
    tensors = standard[:, STANDARD_ORDER][:, 4:] @ np.moveaxis(TENSOR, 2, 0).reshape(
        6, 9
    )
    bodies = [
        Inertia(own[0], own[1:4], tensor.reshape(3, 3))
        for own, tensor in zip(standard, tensors, strict=True)
    ]
    return replace(tree, inertias=tuple(bodies))


def barycentric(tree: Tree) -> Array:
    """Barycentric parameters theta of every body, (n, 10) [kg, kg m, kg m^2].

    [FRS96] eqs. (3)-(5). Row j is in body j's frame, in the order PARTS.
    """
    return readonly(to_barycentric(tree, standard(tree)), (tree.n, 10), "theta")


def to_barycentric(tree: Tree, standard: AnyArray) -> AnyArray:
    """Augment every body by what it carries, set as point masses at the joints.

    [FRS96] eqs. (3)-(5), as a recursion over children; linear in the argument.

    Args:
        tree: Gives parents and offsets.
        standard: (n, 10, ...) in the order STANDARD, numbers or symbols.

    Returns:
        theta, (n, 10, ...) in the order PARTS.
    """
    theta = standard[:, STANDARD_ORDER].copy()
    for j in reversed(range(tree.n)):
        if tree.parents[j] >= 0:
            mass = point_mass(tree.joints[j].offset)
            theta[tree.parents[j]] += np.multiply.outer(mass, theta[j, 0])
    return theta


def on_standard(tree: Tree, rows: Array) -> Array:
    """Rows on the barycentric parameters as rows on the standard ones, (k, 10 n) both.

    The transpose of `to_barycentric`: rows theta = on_standard(rows) standard.
    """
    own = rows.reshape(-1, tree.n, 10).copy()
    for j in range(tree.n):
        if tree.parents[j] >= 0:
            own[:, j, 0] += own[:, tree.parents[j]] @ point_mass(tree.joints[j].offset)
    return own[:, :, STANDARD_ORDER].reshape(rows.shape)


def to_standard(tree: Tree, theta: AnyArray) -> AnyArray:
    """The inverse of `to_barycentric`: (n, 10, ...) PARTS -> (n, 10, ...) STANDARD."""
    own = theta.copy()
    for j in range(tree.n):
        if tree.parents[j] >= 0:
            mass = point_mass(tree.joints[j].offset)
            own[tree.parents[j]] -= np.multiply.outer(mass, theta[j, 0])
    return own[:, STANDARD_ORDER]


def parameter_scale(values: Array, units: Sequence[str], share: float) -> Array:
    """Magnitudes of parameters; small ones are a share of the largest of their unit, (p,).

    Args:
        values: Parameters, (p,).
        units: One each.
        share: Least magnitude in parts of the largest of the same unit.
    """
    scale = np.abs(values)
    for unit in set(units):
        same = np.array([each == unit for each in units])
        scale[same] = np.maximum(scale[same], share * scale[same].max())
    return scale


def parameter_symbols(tree: Tree) -> tuple[Symbol, ...]:
    """The 10 n barycentric parameters, body 1 first: mbar1, mb1x, ... K1zz, mbar2, ..."""
    return tuple(component_symbol(body, c) for body in range(tree.n) for c in range(10))


def parameter_names(tree: Tree) -> tuple[str, ...]:
    """Their names."""
    return tuple(symbol.text for symbol in parameter_symbols(tree))


def component_symbol(body: int, component: int, star: bool = False) -> Symbol:
    """One of the ten parameters of a body.

    Args:
        body: Index of the body, from 0; its number is one more.
        component: Index of PARTS.
        star: The redefined parameter; a mass is never redefined.
    """
    head, tail = PARTS[component]
    return Symbol(head, (body + 1,), tail, star and head != "mbar")


def point_mass(offset: AnyArray) -> AnyArray:
    """Ten barycentric parameters of a unit point mass, (10,) in the order PARTS.

    Args:
        offset: Where it is, (3,) [m], numbers or symbols.
    """
    tensor = -skew(offset) @ skew(offset)
    return np.concatenate([[1.0], offset, tensor[UPPER]])


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
    size = over + slash + under if notation == "text" else latex_number(over, under)
    factors = names if size == "1" and names else [size, *names]
    return sign + _TIMES[notation].join(factors)


def latex_number(over: str, under: str = "") -> str:
    """Number in LaTeX of its decimals, or of numerator and denominator."""
    if under:
        return rf"\tfrac{{{over}}}{{{under}}}"
    mantissa, power, exponent = over.partition("e")
    return rf"{mantissa}\cdot 10^{{{int(exponent)}}}" if power else over


@lru_cache(maxsize=4096)
def number(value: float) -> str:
    """A coefficient: whole, halves, thirds and quarters as they are, else six digits."""
    near = Fraction(float(value)).limit_denominator(4)
    return str(near) if abs(float(near) - value) < 1e-12 else f"{value:.6g}"
