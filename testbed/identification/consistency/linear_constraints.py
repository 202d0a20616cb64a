"""Conditions on bodies, linear in their parameters."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from testbed.arrays import Array
from testbed.errors import SettingsError, UnknownName
from testbed.identification.consistency.options import MASS, ConsistencyOptions
from testbed.parameters.barycentric import STANDARD
from testbed.parameters.prior import Prior
from testbed.robot.friction import ROTOR, JointTerm
from testbed.robot.tree import Tree

SIDES = ("least", "greatest")


@dataclass(frozen=True, eq=False)
class Conditions:
    """Linear conditions on x: standard parameters body by body, then the joints' terms.

    Attributes:
        names: What each asks, (k,), in words.
        rows: (k, m).
        values: What rows x is, or is at least, (k,).
        sigma: 0 for what holds exactly, (k,).
        least: Whether rows x is at least the value, and not the value, (k,).
    """

    names: tuple[str, ...]
    rows: Array
    values: Array
    sigma: Array
    least: Array

    def where(self, kind: NDArray[np.bool_]) -> Conditions:
        """Some of them.

        Args:
            kind: Which, (k,).
        """
        chosen = np.flatnonzero(kind)
        names = tuple(self.names[k] for k in chosen)
        rest = (self.rows, self.values, self.sigma, self.least)
        return Conditions(names, *(array[chosen] for array in rest))

    @property
    def exact(self) -> Conditions:
        """Those that x obeys exactly."""
        return self.where((self.least == 0) & (self.sigma == 0))

    @property
    def doubtful(self) -> Conditions:
        """Those that have a sigma."""
        return self.where(self.sigma > 0)

    @property
    def bounds(self) -> Conditions:
        """Those that x is on one side of."""
        return self.where(self.least > 0)


@dataclass(frozen=True, eq=False)
class _One:
    """One condition; parts are (place in x, factor)."""

    name: str
    parts: tuple[tuple[int, float], ...]
    value: float = 0.0
    sigma: float = 0.0
    least: bool = False


def conditions(
    tree: Tree, prior: Prior, options: ConsistencyOptions, terms: tuple[JointTerm, ...]
) -> Conditions:
    """All that is asked.

    Args:
        tree: The robot.
        prior: Which bodies have matter, and where their shapes are.
        options: What is asked.
        terms: Of the joints' torque: friction and rotors are not negative.

    Raises:
        UnknownName: There is no such link.
        SettingsError: A link that has no matter is to have a mass.
    """
    ones = [
        *_masses(tree, prior, options),
        *_symmetries(tree, prior, options),
        *(_centres(tree, prior) if options.centres_in_shapes else ()),
        *_terms(tree, terms),
    ]
    rows = np.zeros((len(ones), 10 * tree.n + len(terms)))
    for row, one in zip(rows, ones, strict=True):
        for place, factor in one.parts:
            row[place] += factor
    numbers = np.array([[one.value, one.sigma, one.least] for one in ones]).reshape(-1, 3).T
    return Conditions(tuple(one.name for one in ones), rows, *numbers)


def _masses(tree: Tree, prior: Prior, options: ConsistencyOptions) -> Iterator[_One]:
    links = {joint.body: k for k, joint in enumerate(tree.joints)}
    for name, (mass, sigma) in options.masses.items():
        link = name.removeprefix(f"{MASS}/")
        if name != MASS and link not in links:
            raise UnknownName("link of a known mass", link, tuple(links))
        bodies = prior.massive if name == MASS else (links[link],)
        if not set(bodies) <= set(prior.massive):
            raise SettingsError(f"known.{name} = {mass:g} kg: it has no matter in the model file")
        label = f"{name} = {mass:g} kg"
        yield _One(label, tuple((10 * k, 1.0) for k in bodies), mass, sigma)


def _symmetries(tree: Tree, prior: Prior, options: ConsistencyOptions) -> Iterator[_One]:
    """First moments across a plane, and second ones with those in it, are zero."""
    links = {joint.body: k for k, joint in enumerate(tree.joints)}
    for link, planes in options.symmetric.items():
        if link not in links:
            raise UnknownName("symmetric link", link, tuple(links))
        if links[link] not in prior.massive:
            continue
        across = {axis for plane in planes for axis in "xyz" if axis not in plane}
        zero = [f"m{axis}" for axis in "xyz" if axis in across]
        zero += [f"I{pair}" for pair in ("xy", "xz", "yz") if across & set(pair)]
        for name in zero:
            place = 10 * links[link] + STANDARD.index(name)
            yield _One(f"'{link}' symmetric about {' and '.join(planes)}", ((place, 1.0),))


def _centres(tree: Tree, prior: Prior) -> Iterator[_One]:
    """Mass centres in the boxes around shapes: first moments between multiples of the mass."""
    for body in prior.massive:
        name = tree.joints[body].body
        for side, sign, ends in zip(SIDES, (1.0, -1.0), prior.extent[body], strict=True):
            for axis, end in enumerate(ends):
                if np.isfinite(end):
                    label = f"{side} {'xyz'[axis]} of the mass centre of '{name}' in its shapes"
                    parts = ((10 * body + 1 + axis, sign), (10 * body, -sign * float(end)))
                    yield _One(label, parts, least=True)


def _terms(tree: Tree, terms: tuple[JointTerm, ...]) -> Iterator[_One]:
    """Friction takes energy, and rotors have inertia."""
    for k, term in enumerate(terms, start=10 * tree.n):
        if term.law.resists or term.law == ROTOR:
            yield _One(f"{term.name(tree)} not negative", ((k, 1.0),), least=True)
