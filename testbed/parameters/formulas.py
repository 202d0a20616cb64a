"""Regrouping formulas as text, with the model's own lengths: K*1yz = K1yz - l12z*mb*2y.

One level at a time: a starred parameter on the right has a formula of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

import numpy as np

from testbed.arrays import AnyArray, Array
from testbed.parameters.barycentric import COMPONENTS, parameter_name
from testbed.parameters.regroup import Body
from testbed.parameters.rules import Kept
from testbed.tree.tree import Tree


class Namer:
    """Names and formulas of the redefined parameters of a regrouped tree.

    Args:
        tree: The robot.
        bodies: Its bodies after regrouping.
        known_zero: Which of the 10 n barycentric parameters are known to be zero, (10 n,).
    """

    def __init__(self, tree: Tree, bodies: Sequence[Body], known_zero: AnyArray) -> None:
        self._tree = tree
        self._bodies = bodies
        self._zero = known_zero.reshape(tree.n, 10)
        seen = ~known_zero
        self._present = np.array([np.abs(b.redefined[:, seen]).max(axis=1) > 0 for b in bodies])

    def star(self, body: int) -> str:
        """An asterisk if the body's mb and K have been redefined: it carries others."""
        return "*" if self._tree.children(body) else ""

    def kept(self, body: int, kept: Kept) -> str:
        """Name of a kept parameter, such as mb*2z, 2*K3d, K*1zz, mbar1."""
        label = f"{self.star(body)}{body + 1}"
        if kept.head == "mbar":
            return f"mbar{body + 1}"
        return f"{kept.head}{label}{kept.tail.replace('mb_', 'mb' + label)}"

    def component(self, body: int, component: int) -> str:
        """Name of one of the ten redefined parameters of a body."""
        star = "" if component == 0 else self.star(body)
        return parameter_name(COMPONENTS[component], body + 1, star)

    def formula(self, name: str, body: int, form: Array) -> str:
        """`name` = the form of body `body`, own parameters and its children's redefined ones."""
        terms: list[tuple[str, str]] = []
        for c in np.flatnonzero(form):
            if not self._zero[body, c]:
                own = parameter_name(COMPONENTS[c], body + 1)
                terms.append((number(form[c]), own))
        for child in self._tree.children(body):
            weights = np.tensordot(form, self._bodies[child].passing, (0, 1))  # (4, 10)
            for c in np.flatnonzero(np.abs(weights).max(axis=0)):
                if self._present[child, c]:
                    factor = self._factor(weights[:, c], body, child)
                    if factor:
                        terms.append((factor, self.component(child, int(c))))
        return f"{name} = {join(terms)}"

    def _factor(self, weights: Array, body: int, child: int) -> str:
        """1, lx, ly, lz weighted, as text; "" if it vanishes with the model's lengths."""
        lengths = [f"l{body + 1}{child + 1}{x}" for x in "xyz"]
        offset = self._tree.joints[child].offset
        terms = [(number(weights[0]), "")] if weights[0] else []
        for weight, length, value in zip(weights[1:], lengths, offset, strict=True):
            if weight and value:
                terms.append((number(weight), length))
        if len(terms) == 1:
            factor, length = terms[0]
            return length if factor == "1" and length else _times(factor, length)
        return f"({join(terms)})" if terms else ""


def number(value: float) -> str:
    """A coefficient: a small fraction where it is one, else six digits."""
    near = Fraction(float(value)).limit_denominator(12)
    return str(near) if abs(float(near) - value) < 1e-12 else f"{value:.6g}"


def join(terms: Sequence[tuple[str, str]]) -> str:
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


def _times(factor: str, name: str) -> str:
    if not name:
        return factor
    if factor in ("1", "-1"):
        return factor.replace("1", "") + name
    if "/" in factor and factor.lstrip("-").startswith("1/"):
        sign = "-" if factor.startswith("-") else ""
        return f"{sign}{name}/{factor.split('/')[1]}"
    return f"{factor}*{name}"
