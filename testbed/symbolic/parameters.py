"""Parameters as symbols: barycentric ones, minimal ones, and what the minimal ones stand for."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from testbed.arrays import AnyArray
from testbed.parameters.barycentric import parameter_names
from testbed.parameters.minimal_set import MinimalSet
from testbed.parameters.symbols import Label
from testbed.robot.tree import Tree
from testbed.symbolic.expression import Expression, Factor, Nature, symbol


@dataclass(frozen=True)
class Parameter:
    """One entry of the vector of parameters that equations take.

    Attributes:
        label: Its name as a value, such as 2*K3d.
        unit: kg, kg m or kg m^2.
        symbol: What stands for it, or for what it is a multiple of, in the equations; None
            if it is known to be zero.
    """

    label: Label
    unit: str
    symbol: Factor | None

    @property
    def name(self) -> str:
        """As in the minimal set; or the barycentric parameter's."""
        return self.label.text

    @property
    def times(self) -> int:
        """How many times the symbol it is."""
        return self.label.times


def described(
    labels: Sequence[Label], units: Sequence[str], symbols: AnyArray
) -> tuple[Parameter, ...]:
    """The entries of a vector of parameters.

    Args:
        labels: Their names.
        units: kg, kg m or kg m^2.
        symbols: Numbers times symbols, or 0.
    """
    entries = []
    for label, unit, value in zip(labels, units, symbols, strict=True):
        ((factor,), _) = value.terms[0] if isinstance(value, Expression) else ((None,), 0)
        entries.append(Parameter(label, unit, factor))
    return tuple(entries)


def columns(known_zero: AnyArray) -> AnyArray:
    """A column a barycentric parameter, (n, 10, 10 n); of zeros where it is known to be zero."""
    units = np.diag((~known_zero).ravel().astype(int)).astype(object)
    return units.reshape(*known_zero.shape, known_zero.size)


def all_parameters(tree: Tree, known_zero: AnyArray) -> AnyArray:
    """Symbols of the barycentric parameters, (n, 10, 1); 0 where known to be zero."""
    theta = np.zeros(10 * tree.n, dtype=object)
    for k, name in enumerate(parameter_names(tree)):
        if not known_zero.ravel()[k]:
            theta[k] = parameter_symbol(name, k // 10)
    return theta.reshape(tree.n, 10, 1)


def minimal_parameters(minimal: MinimalSet) -> AnyArray:
    """Symbols of the minimal parameters, each with its number: delta, (N,).

    2*K3d is twice the symbol K3d; a star becomes an s.
    """
    delta = np.zeros(minimal.count, dtype=object)
    safe = distinct([label.stem.text for label in minimal.labels])
    for k, (label, body) in enumerate(zip(minimal.labels, minimal.bodies, strict=True)):
        delta[k] = parameter_symbol(safe[k], body) * label.times
    return delta


def distinct(names: Sequence[str]) -> list[str]:
    """Identifiers for names, no two alike."""
    found: dict[str, None] = {}
    for name in names:
        safe = identifier(name)
        while safe in found:
            safe += "_"
        found[safe] = None
    return list(found)


def identifier(name: str) -> str:
    """A parameter's name as programs can have it: mb*2z becomes mbs2z, 2*K3d 2K3d."""
    text = re.sub(r"^2\*", "2", name).replace("*", "s")
    return re.sub(r"\W", "_", text, flags=re.ASCII)


def lifted(minimal: MinimalSet, columns: AnyArray, n: int) -> AnyArray:
    """Lift times columns, (n, 10, p): barycentric parameters that stand for minimal ones.

    Args:
        minimal: The minimal set.
        columns: (N, p), numbers or symbols.
        n: Number of joints.
    """
    theta = np.zeros((10 * n, columns.shape[1]), dtype=object)
    lift = minimal.lift
    for row, column in zip(*np.nonzero(lift), strict=True):
        theta[row] += float(lift[row, column]) * columns[column]
    return theta.reshape(n, 10, columns.shape[1])


def parameter_symbol(name: str, body: int) -> Expression:
    """The symbol of a parameter; in terms, tensors come first, then moments, then masses.

    Args:
        name: As it stands in equations.
        body: Index of its body.
    """
    kind = 2 if name.startswith("mbar") else 1 if name.startswith("mb") else 0
    return symbol(Nature.PARAMETER, name, 100_000 * kind + body)
