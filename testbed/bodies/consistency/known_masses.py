"""Masses that are known of single bodies and of all together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed.bodies.consistency.options import MASS, ConsistencyOptions
from testbed.bodies.prior import Prior
from testbed.core.base.arrays import Array
from testbed.core.base.errors import SettingsError, UnknownName
from testbed.core.robot.tree import Tree

ROUNDING = 1e-9
"""Part of the total by which known masses of all bodies may miss it."""


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
            raise SettingsError(
                f"known.{name} = {mass:g} kg: it has no matter in the model file"
            )
    values, sigma = np.array([*options.masses.values()]).reshape(-1, 2).T
    return KnownMasses(rows, values, sigma, _scale(prior, options, rows, values, sigma))


def _scale(
    prior: Prior, options: ConsistencyOptions, rows: Array, values: Array, sigma: Array
) -> Array:
    """Factors by which the prior's masses meet those that are known exactly, (n,)."""
    total = np.array([name == MASS for name in options.masses], dtype=bool)
    masses = np.array(prior.standard[:, 0])
    open_bodies = masses > 0
    for row, value in zip(
        rows[~total & (sigma == 0)], values[~total & (sigma == 0)], strict=True
    ):
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
