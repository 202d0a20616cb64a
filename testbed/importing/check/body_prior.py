"""Gaussian prior of a robot's bodies, centred on the model file, for Bayesian evidence."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.parameters.symbols import (
    STANDARD_PERMUTATION,
    UPPER_TRIANGLE,
    barycentric_from_standard,
    point_mass_parameters,
    standard,
)
from testbed.core.robot.inertia import ZERO_INERTIA, Inertia
from testbed.core.robot.tree import Tree

MASS_SIGMA, CENTRE_SIGMA, CENTRE_SIGMA_PER_LENGTH, INERTIA_SIGMA = 0.3, 0.02, 0.2, 0.3
"""Standard deviations of a model file: masses (relative), centres of mass [m] and per distance from
the joint, inertias about them (relative)."""

MIN_MASS_SHARE, MIN_TOOL_MASS_SHARE = 0.03, 0.08
"""Least masses for a body's standard deviations, relative to the robot's mass: of any body, and of
end bodies, which may carry a tool."""

MAX_GYRATION_RADIUS = 0.5
"""Radius of gyration above which an inertia is taken as a placeholder [m]."""

SCALE_SIGMA = 1e-3
"""Relative standard deviation of the common scale of parameters from a force plate."""

ZERO_SIGMA = 1e-9
"""Standard deviation of parameters that are zero."""

MASSLESS_FACTOR = 5.0
"""Factor on the prior's standard deviations where the model file has no masses."""


@dataclass(frozen=True, eq=False)
class BodyPrior:
    """Gaussian prior of all bodies' parameters, x = root (mean + z) with z ~ N(0, 1).

    Attributes:
        mean: Prior mean in whitened coordinates, (10 n,).
        root: Matrix from whitened to standard parameters m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz,
            Izz of each body about its frame's origin, (10 n, 10 n).
        barycentric: Matrices from whitened to barycentric parameters, (n, 10, 10 n).
    """

    mean: Array
    root: Array
    barycentric: Array

    def mass_deviations(self, z: Array) -> Array:
        """Deviations of the masses from the model file, in prior standard deviations, (n,).

        Args:
            z: Whitened parameters relative to the prior mean, (10 n,).
        """
        rows = self.root[::10]
        return np.asarray(rows @ z / np.linalg.norm(rows, axis=1))


def body_prior(tree: Tree) -> BodyPrior:
    """Prior of a robot's bodies, centred on its model file.

    The standard deviations are: 30 % of masses; 2 cm and 20 % of the distance from the joint for
    centres of mass; 30 % of inertias. Light bodies have the standard deviations of bodies with 3 %
    (end bodies: 8 %) of the robot's mass.

    Args:
        tree: Robot; if it has no masses, unit masses with a wide prior are used.
    """
    n, total = tree.n, sum(each.mass for each in tree.inertias)
    bodies = [ZERO_INERTIA] * n
    root = np.zeros((n, 10, n, 10))
    for k, inertia in enumerate(tree.inertias):
        body = _without_placeholder(
            inertia if total else Inertia(1.0, np.zeros(3), np.eye(3))
        )
        least_mass = (MIN_MASS_SHARE if tree.children(k) else MIN_TOOL_MASS_SHARE) * (
            total or n
        )
        scale_mass = max(body.mass, least_mass)
        bodies[k] = ZERO_INERTIA if k < tree.massless else body
        # massless links between the coordinates of a free base: parameters fixed to zero
        root[k, :, k] = (
            ZERO_SIGMA * np.eye(10)
            if k < tree.massless
            else _body_root(body, scale_mass)
        )
    flat = root.reshape(10 * n, 10 * n)
    mean = np.zeros(10 * n)
    if total:
        values = standard(replace(tree, inertias=tuple(bodies))).ravel()
        mean = np.asarray(np.linalg.solve(flat, values))
    flat = flat if total else MASSLESS_FACTOR * flat
    barycentric = barycentric_from_standard(tree, flat.reshape(n, 10, 10 * n))
    return BodyPrior(mean, flat, barycentric)


def _without_placeholder(body: Inertia) -> Inertia:
    """Body in which an implausibly large inertia is replaced by a plausible inertia.

    An inertia is implausible if its radius of gyration exceeds `MAX_GYRATION_RADIUS`. The
    replacement about the centre of mass is m L^2 about all axes, with the length L from
    `_assumed_size`; massless bodies get 1e-6 kg.
    """
    mass = max(body.mass, 1e-6)
    if np.trace(body.central) / 2 <= mass * MAX_GYRATION_RADIUS**2:
        return (
            body if body.mass == mass else Inertia(mass, body.first_moment, body.tensor)
        )
    return Inertia.about_centre(
        mass, body.com, mass * _assumed_size(body) ** 2 * np.eye(3)
    )


def _assumed_size(body: Inertia) -> float:
    """Approximate length of a body [m].

    It is 5 cm plus half the distance of the centre of mass from the frame's origin.
    """
    return 0.05 + 0.5 * float(np.linalg.norm(body.com))


def _body_root(body: Inertia, scale_mass: float) -> Array:
    """Square root of the covariance of a body's standard parameters, (10, 10).

    The columns are derivatives with respect to mass, centre of mass (3), and inertia about the
    centre (6), times standard deviations; the rows are m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz
    about the frame's origin.

    Args:
        body: Body.
        scale_mass: Mass from which the standard deviations are computed [kg].
    """
    centre, distance = body.com, float(np.linalg.norm(body.com))
    root = np.zeros((10, 10))
    if body.mass > 0.1 * scale_mass:
        root[:, 0] = point_mass_parameters(centre)
        root[4:, 0] += body.central[UPPER_TRIANGLE] / body.mass
    else:
        root[:4, 0] = 1.0, *centre
    for k, axis in enumerate(np.eye(3)):
        difference = point_mass_parameters(centre + axis) - point_mass_parameters(
            centre - axis
        )
        root[:, 1 + k] = scale_mass * difference / 2
    root[4:, 4:] = np.eye(6)
    moments = np.abs(np.diagonal(body.central)).max()
    arm = CENTRE_SIGMA + 0.3 * _assumed_size(body)
    sigma = [MASS_SIGMA * scale_mass] + [
        CENTRE_SIGMA + CENTRE_SIGMA_PER_LENGTH * distance
    ] * 3
    sigma += [INERTIA_SIGMA * (moments + scale_mass * arm**2)] * 6
    return np.asarray((root * sigma)[list(STANDARD_PERMUTATION)])


def plate_prior(tree: Tree, mean: Array, root: Array) -> BodyPrior:
    """Prior of a robot's bodies from the posterior of a force plate.

    The first whitened parameter scales the mean, by 1 +- 0.1 %; the others vary along `root`. In
    this prior, the attribute `root` maps to barycentric instead of standard parameters.

    Args:
        tree: Robot.
        mean: Mean of the barycentric parameters, (10 n,).
        root: Square root of the covariance of the barycentric parameters, (10 n, k).
    """
    # the mean as one more column, whose coefficient is one with a small standard deviation
    both = np.column_stack([SCALE_SIGMA * mean, root])
    coefficients = np.append(1 / SCALE_SIGMA, np.zeros(root.shape[1]))
    return BodyPrior(coefficients, both, both.reshape(tree.n, 10, -1))
