"""What is known before any data, as linear conditions: a total mass, its centre, any unknown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.errors import SettingsError, UnknownName
from testbed.core.dynamics.newton_euler import Motion, parameter_regressor
from testbed.core.parameters.minimal_set import MinimalSet
from testbed.core.robot.tree import Tree

MASS = "mass"
"""Of all moving bodies together, as the plate carries it [kg]."""

CENTRE = "centre/"
"""Of their mass, along an axis of the bedplate's frame [m]: centre/x with all joints at zero,
centre/x@elbow=1.57 with one of them elsewhere."""

_LOADS = {"x": (2, 4, -1.0), "y": (2, 3, 1.0), "z": (0, 4, 1.0)}
"""By axis: along which one a unit of gravity has to pull, backwards, for the first moment along it
to be a channel of the wrench, and of which sign: a moment is the first moment x the force."""


def total_mass(tree: Tree, minimal: MinimalSet) -> Array:
    """The combination of minimal parameters that is the mass of all moving bodies, (N,) [kg].

    Args:
        tree: The robot.
        minimal: Its minimal parameters.

    Raises:
        SettingsError: No minimal parameters say it.
    """
    return _combination(minimal, _wrench(tree, np.zeros(tree.n), 2)[2], MASS)


def centre_of_mass(tree: Tree, minimal: MinimalSet, name: str, value: float) -> Array:
    """The combination that is zero where the centre of mass is at `value`, (N,) [kg m].

    It is their first moment less `value` times their mass.

    Args:
        tree: The robot.
        minimal: Its minimal parameters.
        name: Such as "centre/x", or "centre/x@elbow=1.57,waist=0.3".
        value: [m].

    Raises:
        UnknownName: There is no such axis or joint.
        SettingsError: The posture is none, or no minimal parameters say it.
    """
    axis, _, where = name.removeprefix(CENTRE).partition("@")
    if axis not in _LOADS:
        raise UnknownName("known fact", name, [f"{CENTRE}{each}" for each in _LOADS])
    pulled, channel, sign = _LOADS[axis]
    moment = sign * _wrench(tree, _posture(tree, name, where), pulled)[channel]
    return _combination(minimal, moment, name) - value * total_mass(tree, minimal)


def _posture(tree: Tree, name: str, where: str) -> Array:
    """Joint positions of words such as elbow=1.57,waist=0.3; zero where none is given, (n,)."""
    q = np.zeros(tree.n)
    for word in filter(None, where.split(",")):
        joint, _, number = word.rpartition("=")
        try:
            q[tree.index(joint)] = float(number)
        except ValueError:
            q[:] = np.nan
        if not np.isfinite(q).all():
            raise SettingsError(
                f"'{name}': write a posture as {CENTRE}x@{tree.names[-1]}=1.57"
            )
    return q


def _wrench(tree: Tree, q: Array, pulled: int) -> Array:
    """Of every barycentric parameter at rest, gravity of 1 m/s^2 against an axis, (6, 10 n)."""
    gravity = -np.eye(3)[pulled]
    return np.asarray(
        parameter_regressor(tree, Motion.at_rest(q[None]), "reaction", gravity)[0]
    )


def _combination(minimal: MinimalSet, wanted: Array, name: str) -> Array:
    """A functional on the barycentric parameters as one on the minimal ones, (N,)."""
    wanted = np.where(minimal.known_zero.ravel(), 0.0, wanted)
    form = wanted @ minimal.lift
    # part of a combination that the minimal parameters cannot say, of one that they can
    if np.abs(form @ minimal.matrix - wanted).max() > 1e-9 * np.abs(wanted).max(
        initial=1.0
    ):
        raise SettingsError(
            f"'{name}' is not identifiable from this recording: "
            + (
                "it needs the plate, and its weight without tare"
                if name == MASS
                else "its motion does not change with it; measure it along another axis, or in "
                "another posture"
            )
        )
    return form


@dataclass(frozen=True, eq=False)
class LinearConstraints:
    """Facts about unknowns x: rows x = values.

    Attributes:
        names: What is known.
        rows: (k, m).
        values: (k,).
        root: R with R R' the values' covariance, (k, r), for unknowns that make `scale` one.
        scale: What a fact's doubt grows with, (k, m): of a centre of mass with the mass; of a row
            of zeros with nothing.
        reached: What that is of the unknowns so far, (k,).
    """

    names: tuple[str, ...]
    rows: Array
    values: Array
    root: Array
    scale: Array
    reached: Array

    def __len__(self) -> int:
        return len(self.names)

    def about(self, unknowns: Sequence[int]) -> LinearConstraints:
        """The same of some of the unknowns, the others being zero.

        Args:
            unknowns: Which.
        """
        return replace(self, rows=self.rows[:, unknowns], scale=self.scale[:, unknowns])

    def around(self, unknowns: Array) -> LinearConstraints:
        """About what is still to be added to unknowns.

        Args:
            unknowns: The unknowns, (m,).
        """
        reached = self.reached + self.scale @ unknowns
        return replace(self, values=self.values - self.rows @ unknowns, reached=reached)

    def doubt(self, added: Array) -> Array:
        """`root`, as large as the unknowns make it.

        Args:
            added: To the unknowns so far, (m,).
        """
        size = np.abs(self.reached + self.scale @ added)
        return np.where(self.scale.any(axis=1), size, 1.0)[:, None] * self.root


@dataclass(frozen=True, eq=False)
class NullSpace:
    """Unknowns as far as facts leave them free: x = fixed @ values + lead z.

    Attributes:
        lead: (m, m - k).
        fixed: (m, k).
    """

    lead: Array
    fixed: Array


def facts(
    tree: Tree,
    minimal: MinimalSet,
    names: Sequence[str],
    numbers: Sequence[str],
    given: Mapping[str, tuple[float, float]],
) -> LinearConstraints:
    """Facts about a robot's unknowns and the instrument's numbers after them.

    Args:
        tree: The robot.
        minimal: Its minimal parameters.
        names: Of its unknowns, these first.
        numbers: Names of the instrument's.
        given: Value and sigma by name: "mass" [kg], "centre/x" [m], a minimal parameter, or a
            number.

    Raises:
        UnknownName: There is no such name.
        SettingsError: No minimal parameters say it, or facts repeat each other.
    """
    unknowns = (*names, *numbers)
    rows, scale = (np.zeros((len(given), len(unknowns))) for _ in range(2))
    values, sigmas = np.array(list(given.values())).reshape(-1, 2).T
    for k, name in enumerate(given):
        if name == MASS:
            rows[k, : minimal.count] = total_mass(tree, minimal)
        elif name.startswith(CENTRE):
            row = centre_of_mass(tree, minimal, name, float(values[k]))
            rows[k, : minimal.count], values[k] = row, 0.0
            scale[k, : minimal.count] = total_mass(tree, minimal)
        elif name in unknowns:
            rows[k, unknowns.index(name)] = 1.0
        else:
            raise UnknownName("known fact", name, (MASS, f"{CENTRE}x", *unknowns))
    return LinearConstraints(
        tuple(given), rows, values, np.diag(sigmas), scale, np.zeros(len(given))
    )


def free(given: LinearConstraints) -> NullSpace:
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
        # part of a fact that the others do not say
        if abs(rows[k, at]) <= 1e-9 * np.abs(given.rows[k]).max():
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
    basis, fixed = np.zeros((size, len(kept))), np.zeros((size, count))
    basis[kept, range(len(kept))] = 1.0
    basis[pivots] = -rows[:, kept]
    fixed[pivots] = right
    return NullSpace(basis, fixed)
