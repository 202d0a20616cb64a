"""What is known before any data: a total mass, a gain of the plate, any single unknown.

Facts are linear in the unknowns. They are put in exactly, one unknown fewer each; how uncertain
they are themselves comes back into the covariance afterwards.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from testbed.arrays import Array
from testbed.errors import SettingsError, UnknownName
from testbed.parameters.minimal_set import MinimalSet
from testbed.robot.tree import Tree

MASS = "mass"
"""Of all moving bodies together, as the plate carries it."""

INDEPENDENT = 1e-9
"""Part of a fact that the others do not say."""

IN_SPACE = 1e-9
"""Part of a combination that the minimal parameters cannot say, of one that they can."""


@dataclass(frozen=True, eq=False)
class Facts:
    """Facts about unknowns x: rows x = values.

    Attributes:
        names: What is known.
        rows: (k, m).
        values: (k,).
        root: R with R R' the values' covariance, (k, r).
    """

    names: tuple[str, ...]
    rows: Array
    values: Array
    root: Array

    def __len__(self) -> int:
        return len(self.names)


@dataclass(frozen=True, eq=False)
class Free:
    """Unknowns as far as facts leave them free: x = fixed @ values + lead z.

    Attributes:
        lead: (m, m - k).
        fixed: (m, k).
    """

    lead: Array
    fixed: Array


def parse_known(words: Iterable[str]) -> dict[str, tuple[float, float]]:
    """Value and sigma by name, of words such as mass=20 and gain/Fz=1+-0.001.

    Args:
        words: As written.

    Raises:
        SettingsError: A word is not of that form.
    """
    found = {}
    for word in words:
        name, equals, numbers = word.rpartition("=")
        value, _, sigma = numbers.partition("+-")
        try:
            found[name] = float(value), float(sigma or 0.0)
        except ValueError:
            equals = ""
        if not equals or not name:
            raise SettingsError(f"--known '{word}': write it as mass=20 or mass=20+-0.01")
    return found


def facts(
    tree: Tree,
    minimal: MinimalSet,
    names: Sequence[str],
    numbers: Sequence[str],
    given: Mapping[str, tuple[float, float]],
) -> Facts:
    """Facts about a robot's unknowns and the instrument's numbers after them.

    Args:
        tree: The robot.
        minimal: Its minimal parameters.
        names: Of its unknowns, these first.
        numbers: Names of the instrument's.
        given: Value and sigma by name: "mass" [kg], a minimal parameter, or a number.

    Raises:
        UnknownName: There is no such name.
        SettingsError: No minimal parameters say it, or facts repeat each other.
    """
    unknowns = (*names, *numbers)
    rows = np.zeros((len(given), len(unknowns)))
    for row, name in zip(rows, given, strict=True):
        if name == MASS:
            row[: minimal.count] = _total_mass(tree, minimal)
        elif name in unknowns:
            row[unknowns.index(name)] = 1.0
        else:
            raise UnknownName("known fact", name, (MASS, *unknowns))
    values = np.array(list(given.values())).reshape(-1, 2)
    return Facts(tuple(given), rows, values[:, 0], np.diag(values[:, 1]))


def _total_mass(tree: Tree, minimal: MinimalSet) -> Array:
    """The combination of minimal parameters that is the mass of all moving bodies, (N,)."""
    wanted = np.zeros((tree.n, 10))
    wanted[[k for k, joint in enumerate(tree.joints) if joint.parent < 0], 0] = 1.0
    found = wanted.ravel() @ minimal.lift
    if np.abs(found @ minimal.matrix - wanted.ravel()).max() > IN_SPACE:
        raise SettingsError(
            "the total mass is not among what this recording tells: it needs the plate, and its "
            "weight without tare"
        )
    return np.asarray(found)


def free(given: Facts) -> Free:
    """What facts leave free; the unknowns that they settle are those with the largest part.

    Args:
        given: The facts.

    Raises:
        SettingsError: One of them follows from the others.
    """
    count, size = given.rows.shape
    rows, right = given.rows.copy(), np.eye(count)
    pivots: list[int] = []
    for k in range(count):
        at = int(np.abs(rows[k]).argmax())
        if abs(rows[k, at]) <= INDEPENDENT * np.abs(given.rows[k]).max():
            raise SettingsError(
                f"'{given.names[k]}' is known twice: it follows from {', '.join(given.names[:k])}"
            )
        right[k] /= rows[k, at]
        rows[k] /= rows[k, at]
        others = np.arange(count) != k
        right[others] -= np.outer(rows[others, at], right[k])
        rows[others] -= np.outer(rows[others, at], rows[k])
        pivots.append(at)
    kept = [m for m in range(size) if m not in pivots]
    lead, fixed = np.zeros((size, len(kept))), np.zeros((size, count))
    lead[kept, range(len(kept))] = 1.0
    lead[pivots] = -rows[:, kept]
    fixed[pivots] = right
    return Free(lead, fixed)
