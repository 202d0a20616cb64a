"""Regrouping formulas as text, with the model's own lengths: K*1yz = K1yz - l12z*mb*2y.

One level at a time: a starred parameter on the right has a formula of its own. Lengths are
symbols or numbers, the whole is plain text or LaTeX.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from testbed.arrays import Array
from testbed.parameters.barycentric import COMPONENTS, parameter_name
from testbed.parameters.regroup import Body
from testbed.robot.tree import Tree

ROUNDING = 1e-12
"""Coefficients below this are not printed: rounding of zero, an axis turned by a quarter."""

Lengths = Literal["symbols", "numbers"]
Terms = list[tuple[str, str]]  # (factor, name): their products are summed


@dataclass(frozen=True, eq=False)
class Namer:
    """Names and formulas of the redefined parameters of a regrouped tree.

    Attributes:
        tree: The robot.
        bodies: Its bodies after regrouping.
        known_zero: Which of the barycentric parameters are known to be zero, (n, 10).
        present: Which of the redefined ones are not zero, (n, 10).
        lengths: Whether offsets are printed as symbols or as numbers.
    """

    tree: Tree
    bodies: Sequence[Body]
    known_zero: NDArray[np.bool_]
    present: NDArray[np.bool_]
    lengths: Lengths = "symbols"

    def component(self, body: int, component: int) -> str:
        """Name of one of the ten redefined parameters of a body."""
        star = "*" if component and self.tree.children(body) else ""
        return parameter_name(COMPONENTS[component], body + 1, star)

    def formula(self, name: str, body: int, form: Array) -> str:
        """`name` = the form of body `body`: own parameters and what its children pass on.

        Body -1 is the bedplate, whose own parameters do not count; of its children's
        masses it holds the sum and, at their offsets, the first moment.
        """
        terms: Terms = []
        if body >= 0:
            for c in np.flatnonzero(np.abs(form) > ROUNDING):
                if not self.known_zero[body, c]:
                    terms.append((number(form[c]), parameter_name(COMPONENTS[c], body + 1)))
        for child in self.tree.children(body):
            weights = np.tensordot(form, self.bodies[child].passing, (0, 1))  # (4, 10)
            if body < 0:
                weights[0, 0] += form[0]
                weights[1:, 0] += form[1:4]
            for c in np.flatnonzero(np.abs(weights).max(axis=0) > ROUNDING):
                factor = self._factor(weights[:, c], body, child)
                if factor and self.present[child, c]:
                    terms.append((factor, self.component(child, int(c))))
        return f"{name} = {join(terms)}"

    def _factor(self, weights: Array, body: int, child: int) -> str:
        """The weights of 1, lx, ly, lz as text; "" if it vanishes with the model's lengths."""
        offset = self.tree.joints[child].offset
        if self.lengths == "numbers":
            value = weights[0] + weights[1:] @ offset
            return number(value) if abs(value) > ROUNDING else ""
        terms: Terms = [(number(weights[0]), "")] if abs(weights[0]) > ROUNDING else []
        for weight, axis, length in zip(weights[1:], "xyz", offset, strict=True):
            if min(abs(weight), abs(length)) > ROUNDING:
                terms.append((number(weight), length_name(body, child, axis)))
        if len(terms) == 1:
            return _times(*terms[0])
        return f"({join(terms)})" if terms else ""


def length_name(body: int, child: int, axis: str) -> str:
    """Name of a component of the offset from a body to one it carries: l23z, l9_10z.

    Args:
        body: Index of the carrying body, -1 for the bedplate.
        child: Index of the body it carries.
        axis: "x", "y" or "z" of the carrying body.
    """
    return f"l{body + 1}{'' if max(body, child) < 9 else '_'}{child + 1}{axis}"


@lru_cache(maxsize=4096)
def number(value: float) -> str:
    """A coefficient: a small fraction where it is one, else six digits."""
    near = Fraction(float(value)).limit_denominator(12)
    return str(near) if abs(float(near) - value) < 1e-12 else f"{value:.6g}"


def join(terms: Terms) -> str:
    """A sum of factor * name: [("1", "a"), ("-l", "b")] gives a - l*b."""
    text = ""
    for factor, name in terms:
        product = _times(factor, name)
        if not text:
            text = product
        elif product.startswith("-"):
            text += f" - {product[1:]}"
        else:
            text += f" + {product}"
    return text or "0"


def latex(formula: str) -> str:
    """A formula or name in LaTeX: K*1yz gives K^{*1}_{yz}, l12z gives l^{12}_{z}."""
    text = re.sub(r"mbar(\*?\d+)", r"\\bar{m}^{\1}", formula)
    text = re.sub(r"\b(mb|K)(\*?\d+)([a-z]+)", r"\1^{\2}_{\3}", text)
    text = re.sub(r"\bl(\d)(\d)([xyz])", r"l^{\1\2}_{\3}", text)
    text = re.sub(r"\bl(\d+)_(\d+)([xyz])", r"l^{\1,\2}_{\3}", text)
    text = re.sub(r"(\d+)/(\d+)\*", r"\\tfrac{\1}{\2}\\,", text)
    text = re.sub(r"([^ ()]+\})/(\d+)", r"\\tfrac{1}{\2}\\,\1", text)
    text = re.sub(r"(?<!\{)\*", r"\\,", text)
    return text.replace("mb^", r"m\!b^")


def _times(factor: str, name: str) -> str:
    if not name:
        return factor
    if factor in ("1", "-1"):
        return factor.replace("1", "") + name
    if factor.lstrip("-").startswith("1/"):
        sign = "-" if factor.startswith("-") else ""
        return f"{sign}{name}/{factor.split('/')[1]}"
    return f"{factor}*{name}"
