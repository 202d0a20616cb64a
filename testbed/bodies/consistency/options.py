"""What a person asks of physically consistent bodies: the one place of defaults."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from testbed.bodies.prior import Prior
from testbed.core.base.arrays import Array
from testbed.core.base.errors import SettingsError, UnknownName
from testbed.core.estimation.settings import finite_number, stated_values, with_sigmas
from testbed.core.parameters.symbols import STANDARD
from testbed.core.robot.friction import JointTerm
from testbed.core.robot.tree import Tree

PLANES = ("xy", "xz", "yz")
"""Planes of symmetry, through the origin of a body's frame."""

MASS = "mass"
"""Of all moving bodies together; `mass/LINK` is that of one with all that is fixed to it."""

SURE = 3.0
"""Sigmas by which known masses may contradict each other."""


@dataclass(frozen=True, kw_only=True)
class ConsistencyOptions:
    """What is asked of physically consistent bodies, besides that they fit the data.

    Plain values only: an experiment file's table [consistent] holds the same keys.
    """

    prior_error: float = 0.5
    """How wrong the model file's bodies are taken to be, in parts of themselves."""

    known: Mapping[str, float | Sequence[float]] = field(default_factory=dict, hash=False)
    """Masses, or mass and sigma, by name: "mass" is that of all moving bodies, "mass/LINK" of one
    with all that is fixed to it [kg]."""

    symmetric: Mapping[str, str | Sequence[str]] = field(default_factory=dict, hash=False)
    """Planes of symmetry by link, through the origin of its frame: "xz", or ["xz", "yz"]."""

    centres_in_shapes: bool = False
    """Whether every mass centre lies in the box around its link's shapes in the model file."""

    __pydantic_config__: ClassVar = {"extra": "forbid", "strict": True}

    def __post_init__(self) -> None:
        if not (finite_number(self.prior_error) or 0) > 0:
            raise SettingsError(f"prior_error is a positive part of one: {self.prior_error!r}")
        if not isinstance(self.centres_in_shapes, bool):
            raise SettingsError(f"centres_in_shapes is true or false: {self.centres_in_shapes!r}")
        object.__setattr__(self, "known", _masses(self.known))
        object.__setattr__(self, "symmetric", _symmetric(self.symmetric))
        self._check_total()

    @property
    def masses(self) -> dict[str, tuple[float, float]]:
        """Mass and sigma by name [kg]."""
        return with_sigmas(self.known)

    def _check_total(self) -> None:
        """Whether the total leaves room for the masses that are known."""
        parts = {name: mass for name, mass in self.masses.items() if name != MASS}
        if MASS not in self.masses or not parts:
            return
        total, doubt = self.masses[MASS]
        together = sum(mass for mass, _ in parts.values())
        spread = math.hypot(doubt, *(sigma for _, sigma in parts.values()))
        if together - total > SURE * spread:
            raise SettingsError(
                f"known masses: {' + '.join(parts)} make {together:g} kg, more than the {total:g} "
                f"kg of '{MASS}', the mass of all bodies"
            )


def _masses(given: object) -> dict[str, float | tuple[float, ...]]:
    """Masses by name, checked one by one."""
    found = stated_values(given)
    for name, (mass, _) in with_sigmas(found).items():
        if name != MASS and not name.startswith(f"{MASS}/"):
            raise SettingsError(f"known.{name}: only '{MASS}' and '{MASS}/LINK' can be known")
        if mass <= 0:
            raise SettingsError(f"known.{name} = {mass:g} kg: masses are positive")
    return found


def _symmetric(given: object) -> dict[str, tuple[str, ...]]:
    """Planes by link, checked one by one."""
    if not isinstance(given, Mapping):
        raise SettingsError(f"symmetric is a table of planes by link, found {given!r}")
    found = {}
    for link, planes in given.items():
        listed = (planes,) if isinstance(planes, str) else tuple(planes)
        for plane in listed:
            if plane not in PLANES:
                raise UnknownName(f"plane of symmetry of '{link}'", str(plane), PLANES)
        found[str(link)] = listed
    return found


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
        *_mass_bounds(tree, prior, options),
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


def _mass_bounds(tree: Tree, prior: Prior, options: ConsistencyOptions) -> Iterator[_One]:
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
        if term.positive:
            yield _One(f"{term.name(tree)} not negative", ((k, 1.0),), least=True)
