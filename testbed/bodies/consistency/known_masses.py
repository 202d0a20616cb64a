"""Known masses of single bodies and of all bodies together, as linear constraints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed.bodies.consistency.options import TOTAL_MASS, ConsistencyOptions
from testbed.bodies.prior import PriorBodies
from testbed.core.base.arrays import Array
from testbed.core.base.errors import SettingsError, UnknownName
from testbed.core.robot.tree import Tree

TOTAL_TOLERANCE = 1e-9
"""Relative tolerance between the known total and the sum of the bodies' known masses."""


@dataclass(frozen=True, eq=False)
class KnownMasses:
    """Known total masses of groups of bodies.

    Attributes:
        rows: 1 for the bodies in each of the k groups, else 0, (k, n).
        values: Total masses of the groups, (k,) [kg].
        sigma: Standard deviations of the masses, (k,) [kg]; 0 for exact masses.
        prior_factors: Factors on the prior bodies that give the exactly known masses, (n,).
    """

    rows: Array
    values: Array
    sigma: Array
    prior_factors: Array


def known_masses(
    tree: Tree, prior: PriorBodies, options: ConsistencyOptions
) -> KnownMasses:
    """Known masses of the options as linear constraints on the bodies' masses.

    Args:
        tree: Robot.
        prior: Prior bodies.
        options: Options with the known masses.

    Raises:
        UnknownName: A link does not exist.
        SettingsError: A link that is massless in the model file has a known mass, or exact masses
            contradict the total.
    """
    links = [joint.body for joint in tree.joints]
    massive = prior.standard[:, 0] > 0
    rows = np.zeros((len(options.masses), tree.n))
    for row, (name, (mass, _)) in zip(rows, options.masses.items(), strict=True):
        link = name.removeprefix(f"{TOTAL_MASS}/")
        if name != TOTAL_MASS and link not in links:
            raise UnknownName("link of a known mass", link, links)
        row[:] = massive if name == TOTAL_MASS else np.eye(tree.n)[links.index(link)]
        if row @ ~massive:
            raise SettingsError(
                f"known.{name} = {mass:g} kg: it has no matter in the model file"
            )
    values, sigma = np.array([*options.masses.values()]).reshape(-1, 2).T
    return KnownMasses(
        rows, values, sigma, _prior_factors(prior, options, rows, values, sigma)
    )


def _prior_factors(
    prior: PriorBodies,
    options: ConsistencyOptions,
    rows: Array,
    values: Array,
    sigma: Array,
) -> Array:
    """Factors on the prior bodies that give the exactly known masses, (n,).

    If the total mass is known exactly, the bodies without exactly known masses share the remaining
    mass in proportion to their prior masses.

    Args:
        prior: Prior bodies.
        options: Options with the known masses.
        rows: 1 for the bodies in each of the k groups with a known mass, else 0, (k, n).
        values: Known masses, (k,) [kg].
        sigma: Standard deviations of the masses, (k,) [kg].

    Raises:
        SettingsError: The exact masses contradict the exact total.
    """
    is_total = np.array([name == TOTAL_MASS for name in options.masses], dtype=bool)
    masses = np.array(prior.standard[:, 0])
    is_open = masses > 0
    for row, value in zip(
        rows[~is_total & (sigma == 0)], values[~is_total & (sigma == 0)], strict=True
    ):
        masses = np.where(row > 0, value, masses)
        is_open &= row == 0
    for value in values[is_total & (sigma == 0)]:
        remaining_mass = value - masses[~is_open].sum()
        if is_open.any() and remaining_mass > 0:
            masses[is_open] *= remaining_mass / masses[is_open].sum()
        elif is_open.any() or abs(remaining_mass) > TOTAL_TOLERANCE * value:
            raise SettingsError(
                f"no bodies obey all that is asked: {', '.join(options.masses)} contradict each "
                f"other: {value - remaining_mass:g} kg are known of {value:g} kg"
            )
    return masses / np.where(prior.standard[:, 0] > 0, prior.standard[:, 0], 1.0)
