"""What the barycentric parameters stand for: masses, centres, central inertias and lengths.

Names     m2 mass; l22y centre of mass in the body's frame; J2yz central inertia; l23z offset
Source    [FRS96] eqs. (3)-(5), and the first part of its listing
"""

from __future__ import annotations

import numpy as np

from testbed.arrays import AnyArray
from testbed.parameters.barycentric import UPPER, component_symbol, point_mass
from testbed.parameters.formulas import length_symbol
from testbed.robot.tree import Tree
from testbed.symbolic.budget import Budget
from testbed.symbolic.expression import Expression, Nature, collect, expression, symbol
from testbed.symbolic.parameters import parameter_symbol
from testbed.symbolic.polynomial import Ring
from testbed.symbolic.robot import Robot
from testbed.symbolic.tidy import present


def barycentric_definitions(
    tree: Tree, robot: Robot, known_zero: AnyArray, budget: Budget
) -> list[tuple[str, Expression]]:
    """Name and meaning of every barycentric parameter that is not known to be zero.

    Args:
        tree: The robot.
        robot: The same on paper.
        known_zero: Which are known to be zero, (n, 10). Where a body's own are, so are the
            components of its centre of mass and central inertia that are zero in the file.
        budget: Counts terms.
    """
    masses = _total_masses(tree)
    ring = Ring(budget=budget)
    found = []
    for j in range(tree.n):
        values = _own(tree, j, bool(known_zero[j].any()))
        for child in tree.children(j):
            mass = parameter_symbol(f"mbar{child + 1}", child)
            values[1:] = values[1:] + point_mass(robot.joints[child].offset)[1:] * mass
        values[0] = masses[j]
        for component, (value, zero) in enumerate(zip(values, known_zero[j], strict=True)):
            if not zero:
                shown = present(ring, ring.expand(expression(value)), frozenset())
                budget.write(len(shown.terms))
                found.append((component_symbol(j, component).text, shown))
    return sorted(found, key=lambda pair: _order(pair[0]))


def _total_masses(tree: Tree) -> list[Expression]:
    """Of each body, the sum of its mass and of all that it carries."""
    totals = [symbol(Nature.PARAMETER, f"m{j + 1}", j) for j in range(tree.n)]
    for j in reversed(range(tree.n)):
        carried = (term for child in tree.children(j) for term in totals[child].terms)
        totals[j] = collect((*totals[j].terms, *carried))
    return totals


def _own(tree: Tree, j: int, by_file: bool) -> AnyArray:
    """A body's own ten parameters about its frame, of mass, centre and central inertia."""
    inertia, mass = tree.inertias[j], symbol(Nature.PARAMETER, f"m{j + 1}", j)
    centre = np.zeros(3, dtype=object)
    for axis, length in zip(range(3), inertia.com, strict=True):
        if not (by_file and abs(length) < TINY):
            centre[axis] = symbol(Nature.CONSTANT, length_symbol(j, j, "xyz"[axis]).text)
    central = np.zeros(6, dtype=object)
    scale = np.abs(inertia.central).max()
    for k, (a, b) in enumerate(zip(*UPPER, strict=True)):
        if not (by_file and abs(inertia.central[a, b]) < TINY * scale):
            central[k] = symbol(Nature.PARAMETER, f"J{j + 1}{'xyz'[a]}{'xyz'[b]}", j)
    own: AnyArray = point_mass(centre) * mass
    own[4:] = own[4:] + central
    return own


TINY = 1e-12
"""Of a length [m], or as part of the largest inertia: zero in the file but for rounding."""


def _order(name: str) -> int:
    """Masses, moments, tensors, as in the paper's listing."""
    return 0 if name.startswith("mbar") else 1 if name.startswith("mb") else 2
