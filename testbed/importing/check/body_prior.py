"""Prior of a robot's bodies about its model file, for the evidence of readings of a log."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.parameters.symbols import (
    STANDARD_ORDER,
    UPPER,
    point_mass,
    standard,
    to_barycentric,
)
from testbed.core.robot.inertia import NOTHING, Inertia
from testbed.core.robot.tree import Tree

MASS, CENTRE, REACH, INERTIA = 0.3, 0.02, 0.2, 0.3
"""Sigmas of a model file: of masses, of centres of mass [m] and per distance from the joint, of
inertias about them."""

LIGHT, TOOL = 0.03, 0.08
"""Parts of the robot's mass that a body's sigma is counted from at least: of any, and of those that
carry no other, which may carry a tool."""

WIDEST = 0.5
"""Radius of gyration beyond which an inertia is a placeholder [m]."""

CERTAIN = 1e-3
"""Sigma of the size of what a force plate has shown."""

NONE = 1e-9
"""Sigma of parameters that are zero."""

UNKNOWN = 5.0
"""Times that the prior is as wide where the model file has no masses."""


@dataclass(frozen=True, eq=False)
class BodyPrior:
    """Prior of all bodies' parameters, x = root (mean + z) with z ~ N(0, 1).

    Attributes:
        mean: Mean in sigmas, (10 n,).
        root: Standard parameters by these, (10 n, 10 n).
        barycentric: Barycentric parameters by these, (n, 10, 10 n).
    """

    mean: Array
    root: Array
    barycentric: Array

    def mass_deviations(self, z: Array) -> Array:
        """Deviations of the masses from the model file in sigmas, (n,).

        Args:
            z: Parameters about the mean in sigmas, (10 n,).
        """
        rows = self.root[::10]
        return np.asarray(rows @ z / np.linalg.norm(rows, axis=1))


def body_prior(tree: Tree) -> BodyPrior:
    """Prior of a robot's bodies about its model file.

    Args:
        tree: The robot; without masses, one of unit masses is as likely as any.
    """
    n, total = tree.n, sum(each.mass for each in tree.inertias)
    bodies = [NOTHING] * n
    root = np.zeros((n, 10, n, 10))
    for k, inertia in enumerate(tree.inertias):
        body = _measured(inertia if total else Inertia(1.0, np.zeros(3), np.eye(3)))
        least = (LIGHT if tree.children(k) else TOOL) * (total or n)
        heavy = max(body.mass, least)
        bodies[k] = NOTHING if k < tree.massless else body
        # links between the coordinates of a free base have no matter, whatever the data say
        root[k, :, k] = (
            NONE * np.eye(10) if k < tree.massless else _body_root(body, heavy)
        )
    flat = root.reshape(10 * n, 10 * n)
    mean = np.zeros(10 * n)
    if total:
        values = standard(replace(tree, inertias=tuple(bodies))).ravel()
        mean = np.asarray(np.linalg.solve(flat, values))
    flat = flat if total else UNKNOWN * flat
    barycentric = to_barycentric(tree, flat.reshape(n, 10, 10 * n))
    return BodyPrior(mean, flat, barycentric)


def _measured(body: Inertia) -> Inertia:
    """Body with a placeholder inertia replaced by one of its size."""
    mass = max(body.mass, 1e-6)
    if np.trace(body.central) / 2 <= mass * WIDEST**2:
        return (
            body if body.mass == mass else Inertia(mass, body.first_moment, body.tensor)
        )
    return Inertia.about_centre(mass, body.com, mass * _size(body) ** 2 * np.eye(3))


def _size(body: Inertia) -> float:
    """Approximate length of a body [m]."""
    return 0.05 + 0.5 * float(np.linalg.norm(body.com))


def _body_root(body: Inertia, heavy: float) -> Array:
    """Root of the covariance of a body's standard parameters, (10, 10).

    Its columns are derivatives by mass, centre of mass, and inertia about it, times sigmas.
    """
    centre, away = body.com, float(np.linalg.norm(body.com))
    root = np.zeros((10, 10))
    if body.mass > 0.1 * heavy:
        root[:, 0] = point_mass(centre)
        root[4:, 0] += body.central[UPPER] / body.mass
    else:
        root[:4, 0] = 1.0, *centre
    for k, axis in enumerate(np.eye(3)):
        moved = point_mass(centre + axis) - point_mass(centre - axis)
        root[:, 1 + k] = heavy * moved / 2
    root[4:, 4:] = np.eye(6)
    moments = np.abs(np.diagonal(body.central)).max()
    arm = CENTRE + 0.3 * _size(body)
    sigma = [MASS * heavy] + [CENTRE + REACH * away] * 3
    sigma += [INERTIA * (moments + heavy * arm**2)] * 6
    return np.asarray((root * sigma)[list(STANDARD_ORDER)])


def plate_prior(tree: Tree, mean: Array, root: Array) -> BodyPrior:
    """Prior of a robot's bodies from a force plate's posterior.

    Args:
        tree: The robot.
        mean: Of the barycentric parameters, (10 n,).
        root: Root of their covariance, (10 n, k).
    """
    # the mean as one more column, whose coefficient is one with hardly any doubt
    both = np.column_stack([CERTAIN * mean, root])
    coefficients = np.append(1 / CERTAIN, np.zeros(root.shape[1]))
    return BodyPrior(coefficients, both, both.reshape(tree.n, 10, -1))
