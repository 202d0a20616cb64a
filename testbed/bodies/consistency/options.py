"""What a person asks of physically consistent bodies: the one place of defaults."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from testbed.bodies.prior import Prior
from testbed.core.base.arrays import Array
from testbed.core.base.errors import SettingsError, UnknownName
from testbed.core.estimation.settings import Settings, finite_number, with_sigmas
from testbed.core.robot.tree import Tree

MASS = "mass"
"""Of all moving bodies together; `mass/LINK` is that of one with all that is fixed to it."""

ROUNDING = 1e-9
"""Part of the total by which known masses of all bodies may miss it."""


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

    __pydantic_config__: ClassVar = {"extra": "forbid", "strict": True}

    def __post_init__(self) -> None:
        if not (finite_number(self.prior_error) or 0) > 0:
            raise SettingsError(f"prior_error is a positive part of one: {self.prior_error!r}")
        object.__setattr__(self, "known", Settings(known=self.known).known)
        for name, (mass, _) in self.masses.items():
            if name != MASS and not name.startswith(f"{MASS}/"):
                raise SettingsError(f"known.{name}: only '{MASS}' and '{MASS}/LINK' can be known")
            if mass <= 0:
                raise SettingsError(f"known.{name} = {mass:g} kg: masses are positive")

    @property
    def masses(self) -> dict[str, tuple[float, float]]:
        """Mass and sigma by name [kg]."""
        return with_sigmas(self.known)


@dataclass(frozen=True, eq=False)
class KnownMasses:
    """Masses of sums of bodies.

    Attributes:
        rows: Whether each body belongs to a sum, (k, n).
        values: [kg], (k,).
        sigma: [kg], 0 where a mass holds exactly, (k,).
        scale: Factors on the prior's bodies that obey what holds exactly, (n,).
    """

    rows: Array
    values: Array
    sigma: Array
    scale: Array


def known_masses(tree: Tree, prior: Prior, options: ConsistencyOptions) -> KnownMasses:
    """Masses that are known, body by body.

    Args:
        tree: The robot.
        prior: Which bodies have matter.
        options: What is known.

    Raises:
        UnknownName: There is no such link.
        SettingsError: A link that has no matter is to have a mass; or parts contradict the total.
    """
    links = [joint.body for joint in tree.joints]
    massive = prior.standard[:, 0] > 0
    rows = np.zeros((len(options.masses), tree.n))
    for row, (name, (mass, _)) in zip(rows, options.masses.items(), strict=True):
        link = name.removeprefix(f"{MASS}/")
        if name != MASS and link not in links:
            raise UnknownName("link of a known mass", link, links)
        row[:] = massive if name == MASS else np.eye(tree.n)[links.index(link)]
        if row @ ~massive:
            raise SettingsError(f"known.{name} = {mass:g} kg: it has no matter in the model file")
    values, sigma = np.array([*options.masses.values()]).reshape(-1, 2).T
    return KnownMasses(rows, values, sigma, _scale(prior, options, rows, values, sigma))


def _scale(
    prior: Prior, options: ConsistencyOptions, rows: Array, values: Array, sigma: Array
) -> Array:
    """Factors on the prior's bodies that obey the exact masses, (n,)."""
    total = np.array([name == MASS for name in options.masses], dtype=bool)
    masses = np.array(prior.standard[:, 0])
    open_bodies = masses > 0
    for row, value in zip(rows[~total & (sigma == 0)], values[~total & (sigma == 0)], strict=True):
        masses = np.where(row > 0, value, masses)
        open_bodies &= row == 0
    for value in values[total & (sigma == 0)]:
        rest = value - masses[~open_bodies].sum()
        if open_bodies.any() and rest > 0:
            masses[open_bodies] *= rest / masses[open_bodies].sum()
        elif open_bodies.any() or abs(rest) > ROUNDING * value:
            raise SettingsError(
                f"no bodies obey all that is asked: {', '.join(options.masses)} contradict each "
                f"other: {value - rest:g} kg are known of {value:g} kg"
            )
    return masses / np.where(prior.standard[:, 0] > 0, prior.standard[:, 0], 1.0)
