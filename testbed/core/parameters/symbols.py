r"""Standard and barycentric parameters: values, and symbolic names as text or LaTeX.

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

from testbed.core.base.arrays import AnyArray, Array, readonly_array, skew
from testbed.core.robot.inertia import Inertia
from testbed.core.robot.tree import Tree

BARYCENTRIC_COMPONENTS = (
    ("mbar", ""),
    *(("mb", axis) for axis in "xyz"),
    *(("K", pair) for pair in ("xx", "xy", "xz", "yy", "yz", "zz")),
)
"""Kind and axes of a body's ten barycentric parameters, in their order."""

STANDARD_NAMES = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
"""Order of a body's standard parameters, about and along its frame (Pinocchio's order)."""

UNIT_BY_KIND = {"mbar": "kg", "mb": "kg m", "K": "kg m^2"}
"""Unit by kind of parameter: mass, first moments, tensor components."""

PARAMETER_UNITS = tuple(UNIT_BY_KIND[head] for head, _ in BARYCENTRIC_COMPONENTS)
"""Units of a body's ten parameters, barycentric or standard."""

UPPER_TRIANGLE = np.triu_indices(3)
"""Row and column indices of a symmetric tensor's six components, row by row."""

TENSOR_FROM_SIX: Array = np.eye(6)[np.array([(0, 1, 2), (1, 3, 4), (2, 4, 5)])]
"""Map from six components to the tensor, (3, 3, 6): K[a, b] = sum_k T[a, b, k] K6[k]."""

STANDARD_PERMUTATION = (0, 1, 2, 3, 4, 5, 7, 6, 8, 9)
"""Permutation that swaps Kxz and Kyy: from the order of STANDARD_NAMES to that of
BARYCENTRIC_COMPONENTS, and back."""


def standard(tree: Tree) -> Array:
    """Standard parameters of every body, (n, 10) [kg, kg m, kg m^2].

    Row j is about the origin and along the axes of the frame of body j, in the order m mx my mz Ixx
    Ixy Iyy Ixz Iyz Izz.
    """
    rows = [
        (inertia.mass, *inertia.first_moment, *inertia.tensor[UPPER_TRIANGLE])
        for inertia in tree.inertias
    ]
    return readonly_array(
        np.array(rows)[:, STANDARD_PERMUTATION], (tree.n, 10), "standard"
    )


def with_standard_parameters(tree: Tree, standard: Array) -> Tree:
    """Copy of a robot whose bodies have the given standard parameters.

    Args:
        tree: The robot.
        standard: Standard parameters m mx my mz Ixx Ixy Iyy Ixz Iyz Izz, about the origin and along
            the axes of each body frame, (n, 10) [kg, kg m, kg m^2].
    """
    tensors = standard[:, STANDARD_PERMUTATION][:, 4:] @ np.moveaxis(
        TENSOR_FROM_SIX, 2, 0
    ).reshape(6, 9)
    bodies = [
        Inertia(parameters[0], parameters[1:4], tensor.reshape(3, 3))
        for parameters, tensor in zip(standard, tensors, strict=True)
    ]
    return replace(tree, inertias=tuple(bodies))


def barycentric(tree: Tree) -> Array:
    """Barycentric parameters theta of every body, (n, 10) [kg, kg m, kg m^2].

    [FRS96] eqs. (3)-(5). Row j is mbar mbx mby mbz Kxx Kxy Kxz Kyy Kyz Kzz in the frame of body j.
    """
    return readonly_array(
        barycentric_from_standard(tree, standard(tree)), (tree.n, 10), "theta"
    )


def barycentric_from_standard(tree: Tree, standard: AnyArray) -> AnyArray:
    """Convert standard to barycentric parameters, (n, 10, ...).

    Each body is augmented by the masses that it carries, as point masses at its joints, [FRS96]
    eqs. (3)-(5). The recursion over children is linear in the parameters.

    Args:
        tree: Robot with parents and offsets.
        standard: Standard parameters, (n, 10, ...) in the order STANDARD_NAMES, numbers or symbols.

    Returns:
        Barycentric parameters theta, (n, 10, ...), mbar mbx mby mbz Kxx Kxy Kxz Kyy Kyz Kzz.
    """
    theta = standard[:, STANDARD_PERMUTATION].copy()
    for j in reversed(range(tree.n)):
        if tree.parents[j] >= 0:
            mass = point_mass_parameters(tree.joints[j].offset)
            theta[tree.parents[j]] += np.multiply.outer(mass, theta[j, 0])
    return theta


def forms_on_standard(tree: Tree, rows: Array) -> Array:
    """Convert linear forms on barycentric parameters to forms on standard parameters.

    This is the transpose of `barycentric_from_standard`: rows @ theta equals
    forms_on_standard(rows) @ standard.

    Args:
        tree: Robot with parents and offsets.
        rows: Coefficients on the barycentric parameters, (k, 10 n).

    Returns:
        Coefficients on the standard parameters, (k, 10 n).
    """
    forms = rows.reshape(-1, tree.n, 10).copy()
    for j in range(tree.n):
        if tree.parents[j] >= 0:
            forms[:, j, 0] += forms[:, tree.parents[j]] @ point_mass_parameters(
                tree.joints[j].offset
            )
    return forms[:, :, STANDARD_PERMUTATION].reshape(rows.shape)


def standard_from_barycentric(tree: Tree, theta: AnyArray) -> AnyArray:
    """Convert barycentric to standard parameters: the inverse of `barycentric_from_standard`.

    Args:
        tree: Robot with parents and offsets.
        theta: Barycentric parameters, (n, 10, ...), numbers or symbols.
    """
    standard = theta.copy()
    for j in range(tree.n):
        if tree.parents[j] >= 0:
            mass = point_mass_parameters(tree.joints[j].offset)
            standard[tree.parents[j]] -= np.multiply.outer(mass, theta[j, 0])
    return standard[:, STANDARD_PERMUTATION]


def parameter_scale(values: Array, units: Sequence[str], share: float) -> Array:
    """Scale of each parameter: its magnitude, with a lower bound for each unit, (p,).

    Args:
        values: Parameters, (p,).
        units: Unit of each parameter.
        share: Smallest scale, as a share of the largest magnitude of the same unit.
    """
    scale = np.abs(values)
    for unit in set(units):
        same = np.array([each == unit for each in units])
        scale[same] = np.maximum(scale[same], share * scale[same].max())
    return scale


def parameter_symbols(tree: Tree) -> tuple[Symbol, ...]:
    """Symbols of the 10 n barycentric parameters, body 1 first: mbar1, mb1x, ... K1zz, mbar2 ..."""
    return tuple(component_symbol(body, c) for body in range(tree.n) for c in range(10))


def parameter_names(tree: Tree) -> tuple[str, ...]:
    """Names of the 10 n barycentric parameters, body 1 first."""
    return tuple(symbol.text for symbol in parameter_symbols(tree))


def component_symbol(body: int, component: int, star: bool = False) -> Symbol:
    """Symbol of a body's barycentric parameter.

    Args:
        body: Index of the body, from 0; its number is `body + 1`.
        component: Index into BARYCENTRIC_COMPONENTS.
        star: True for the redefined parameter; has no effect on a mass.
    """
    head, tail = BARYCENTRIC_COMPONENTS[component]
    return Symbol(head, (body + 1,), tail, star and head != "mbar")


def point_mass_parameters(offset: AnyArray) -> AnyArray:
    """Barycentric parameters mbar mbx mby mbz Kxx ... Kzz of a unit point mass, (10,).

    Args:
        offset: Position of the mass, (3,) [m], numbers or symbols.
    """
    tensor = -skew(offset) @ skew(offset)
    return np.concatenate([[1.0], offset, tensor[UPPER_TRIANGLE]])


Notation = Literal["text", "latex"]

_HEADS = {"mbar": r"\bar{m}", "mb": r"m\!b"}


@dataclass(frozen=True)
class Symbol:
    """Symbol of a body's parameter, or of an offset component between two bodies.

    Attributes:
        head: "mbar", "mb", "K", or "l" for a length.
        bodies: Number of the body, from 1, or of both bodies of a length; 0 is the bedplate.
        tail: Component, such as "z" or "yz"; "d" for half a difference; "" for a mass.
        is_redefined: True for a redefined parameter.
    """

    head: str
    bodies: tuple[int, ...]
    tail: str
    is_redefined: bool = False

    @property
    def text(self) -> str:
        """Symbol as text: K*2yz, mbar1, l23z, l9_10z."""
        separator = "" if max(self.bodies) < 10 else "_"
        return (
            f"{self.head}{'*' * self.is_redefined}"
            f"{separator.join(map(str, self.bodies))}{self.tail}"
        )

    @property
    def latex(self) -> str:
        """Symbol in LaTeX: K^{*2}_{yz}, l^{9,10}_{z}."""
        separator = "" if max(self.bodies) < 10 else ","
        superscript = "*" * self.is_redefined + separator.join(map(str, self.bodies))
        subscript = f"_{{{self.tail}}}" if self.tail else ""
        return f"{_HEADS.get(self.head, self.head)}^{{{superscript}}}{subscript}"


@dataclass(frozen=True)
class DriveSymbol:
    """Symbol of the coefficient of a joint term, such as a rotor inertia.

    Attributes:
        kind: Kind of the term, such as "rotor".
        joint: Joint name.
    """

    kind: str
    joint: str

    @property
    def text(self) -> str:
        """Symbol as text: rotor/waist."""
        return f"{self.kind}/{self.joint}"

    @property
    def latex(self) -> str:
        r"""Symbol in LaTeX: \mathrm{rotor}_{\mathrm{waist}}."""
        joint = "".join(rf"\{c}" if c in "_&%$#{}" else c for c in self.joint)
        return rf"\mathrm{{{self.kind}}}_{{\mathrm{{{joint}}}}}"


@dataclass(frozen=True)
class Term:
    """Product of a symbol and a factor (a number, or a sum of numbers times lengths).

    Attributes:
        symbol: Symbol in the product; None for a number alone.
        weight: Summands of the factor, each a number and a length; a length of None means 1.
    """

    symbol: Symbol | DriveSymbol | None
    weight: tuple[tuple[float, Symbol | None], ...] = ((1.0, None),)

    def write(self, notation: Notation) -> str:
        """Write the product as text or LaTeX, without space after a leading minus sign."""
        name = [getattr(self.symbol, notation)] if self.symbol else []
        if len(self.weight) == 1:
            ((value, length),) = self.weight
            lengths = [getattr(length, notation)] if length else []
            return _product(value, [*lengths, *name], notation)
        inner = [Term(length, ((value, None),)) for value, length in self.weight]
        return _PRODUCT_SIGNS[notation].join([f"({write_sum(inner, notation)})", *name])


@dataclass(frozen=True)
class Label:
    """Symbolic name of an unknown: a symbol, a multiple of a symbol, or a sum.

    Attributes:
        terms: Summands of the name.
    """

    terms: tuple[Term, ...]

    @property
    def multiple(self) -> int:
        """Integer multiple of the symbol: 2 for 2*K3d; 1 for sums."""
        return int(self.terms[0].weight[0][0]) if len(self.terms) == 1 else 1

    @property
    def symbols(self) -> tuple[Symbol | DriveSymbol | None, ...]:
        """Symbols of the summands."""
        return tuple(term.symbol for term in self.terms)

    @property
    def text(self) -> str:
        """Name as text without spaces: mb*2z, 2*K3d, K*1zz+rotor/waist."""
        return "".join(self.pieces)

    @property
    def pieces(self) -> list[str]:
        """Signed summands as text without spaces: K*1zz, +rotor/waist."""
        return [piece.replace(" ", "", 1) for piece in summands(self.terms, "text")]

    @property
    def without_multiple(self) -> Label:
        """Name without the integer multiple: K3d for 2*K3d; sums are unchanged."""
        return Label((Term(self.terms[0].symbol),)) if len(self.terms) == 1 else self

    @property
    def latex(self) -> str:
        """Name in LaTeX."""
        return write_sum(self.terms, "latex")


@dataclass(frozen=True)
class Formula:
    """Formula of an unknown: left-hand side, and sum on the right-hand side.

    Attributes:
        left: Name of the unknown.
        right: Terms of the sum; empty for 0.
    """

    left: Label
    right: tuple[Term, ...]

    def __str__(self) -> str:
        """Formula as text."""
        return f"{write_sum(self.left.terms, 'text')} = {self.right_text}"

    @property
    def right_text(self) -> str:
        """Right-hand side as text."""
        return write_sum(self.right, "text")

    @property
    def is_trivial(self) -> bool:
        """True if both sides of the formula are the same."""
        return self.left.terms == self.right

    def latex(self, relation: str = "=") -> str:
        """Formula in LaTeX.

        Args:
            relation: Relation sign between the sides; "&=" for aligned equations.
        """
        return f"{self.left.latex} {relation} {write_sum(self.right, 'latex')}"


def write_sum(terms: Sequence[Term], notation: Notation) -> str:
    """Write a sum of terms, such as "a - l*b"; an empty sum is "0"."""
    return " ".join(summands(terms, notation)) or "0"


def summands(terms: Sequence[Term], notation: Notation) -> list[str]:
    """Terms of a sum as text, each with its sign, such as "a", "- l*b"."""
    summands_text: list[str] = []
    for term in terms:
        product = term.write(notation)
        if not summands_text:
            summands_text.append(product)
        elif product.startswith("-"):
            summands_text.append(f"- {product[1:]}")
        else:
            summands_text.append(f"+ {product}")
    return summands_text


_PRODUCT_SIGNS = {"text": "*", "latex": r"\,"}


def _product(value: float, names: list[str], notation: Notation) -> str:
    """Write a product of a number and names, such as "a", "-a*b", "a/2", "3/2*a"."""
    numerator, bar, denominator = number_text(abs(value)).partition("/")
    sign = "-" if value < 0 else ""
    if notation == "text" and numerator == "1" and bar and names:
        return f"{sign}{'*'.join(names)}/{denominator}"
    magnitude = (
        numerator + bar + denominator
        if notation == "text"
        else latex_number(numerator, denominator)
    )
    factors = names if magnitude == "1" and names else [magnitude, *names]
    return sign + _PRODUCT_SIGNS[notation].join(factors)


def latex_number(numerator: str, denominator: str = "") -> str:
    """Write a number in LaTeX, from decimal text or from numerator and denominator."""
    if denominator:
        return rf"\tfrac{{{numerator}}}{{{denominator}}}"
    mantissa, power, exponent = numerator.partition("e")
    return rf"{mantissa}\cdot 10^{{{int(exponent)}}}" if power else numerator


@lru_cache(maxsize=4096)
def number_text(value: float) -> str:
    """Write a coefficient as a fraction (denominator up to 4), otherwise with six digits."""
    fraction = Fraction(float(value)).limit_denominator(4)
    return str(fraction) if abs(float(fraction) - value) < 1e-12 else f"{value:.6g}"
