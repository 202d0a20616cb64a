"""Whether any rigid bodies have the parameters that were found.

The standard parameters of a body are those of rigid matter if and only if its pseudo-inertia
matrix J = [[S, h], [h', m]] is positive semidefinite, S the second moments, h the first, m the
mass [WKS18]. Minimal parameters are linear in them: those of possible robots form a convex
cone. The distance of an estimate from it, in its own sigmas, is a conic program; the bound
that its dual solution gives holds for every robot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special
from scipy.linalg import block_diag

from testbed.arrays import Array
from testbed.blas import eigh
from testbed.identification.consistency.conic import Cone, minimise
from testbed.identification.estimate import Estimate
from testbed.parameters.prior import standard_of_coordinates

SIGMAS = 5.0
"""A distance that noise exceeds as rarely as this is no noise, unless it is said otherwise."""

MODEL_ERROR = 0.01
"""Models are never quite right by this part of each parameter, unless it is said otherwise."""

SMALL = 0.1
"""Parameters below this share of the largest of their unit are taken to be that large."""

LENGTH = 0.3
"""Unit of length in which a robot's masses and moments are of one order [m]."""


@dataclass(frozen=True, eq=False)
class RigidBodyTest:
    """How far an estimate is from those of possible robots.

    Attributes:
        distance: At least this far, in sigmas, model errors counted.
        limit: Distance beyond which it is no noise.
        nearest: Minimal parameters of the nearest possible robot, (N,).
        gap: How far each is from them, in parts of itself, (N,).
    """

    distance: float
    limit: float
    nearest: Array
    gap: Array

    @property
    def impossible(self) -> bool:
        """Whether no rigid bodies have the parameters, noise and model errors allowed."""
        return self.distance > self.limit


def rigid_body_test(
    estimate: Estimate, sigmas: float = SIGMAS, model_error: float = MODEL_ERROR
) -> RigidBodyTest:
    """Whether an estimate's minimal parameters can be those of rigid bodies.

    Args:
        estimate: Of either method. Rotors that are identifiable together with a body's inertia may
            have any inertia that is not negative.
        sigmas: An estimate is called impossible beyond a distance that noise exceeds as rarely
            as this.
        model_error: Part of each parameter, taken as an error besides sigma.
    """
    base = estimate.base
    scale = sizes(base.values, base.units)
    covariance = base.covariance + np.diag((model_error * scale) ** 2)
    spread, axes = eigh(covariance)
    spread = np.maximum(spread, max(np.finfo(float).eps * spread[-1], np.finfo(float).tiny))
    white = (axes / np.sqrt(spread)).T
    limit = float(np.sqrt(special.chdtri(len(scale), 2 * special.ndtr(-sigmas))))
    forms = white @ _of_bodies(estimate.minimal.standard_matrix)
    distance, rest = _nearest(forms, white @ _rotors(estimate), white @ base.values)
    gap = (axes * np.sqrt(spread)) @ rest
    relative = np.abs(gap) / np.where(scale > 0, scale, 1.0)
    return RigidBodyTest(distance, limit, base.values + gap, relative)


def sizes(values: Array, units: Sequence[str]) -> Array:
    """How large parameters are, small ones counted as a share of the largest of their unit.

    Args:
        values: (p,).
        units: One each.
    """
    found = np.abs(values)
    for unit in set(units):
        same = np.array([each == unit for each in units])
        found[same] = np.maximum(found[same], SMALL * found[same].max())
    return np.asarray(found)


def _rotors(estimate: Estimate) -> Array:
    """What a unit of each rotor identified with a body adds to the parameters, (N, rotors)."""
    regrouped = {} if estimate.drives is None else estimate.drives.regrouped
    columns = [column[: estimate.minimal.count] for column in regrouped.values()]
    return np.array(columns).reshape(len(columns), estimate.minimal.count).T


def _of_bodies(standard: Array) -> Array:
    """Forms of standard parameters as forms of every body's J, (N, 10 n), scaled for the solver.

    Args:
        standard: (N, 10 n), of (m, h, Ixx, Ixy, Iyy, Ixz, Iyz, Izz) body by body.
    """
    scaled = standard_of_coordinates(np.diag([LENGTH, LENGTH, LENGTH, 1.0]))
    by_body = standard.reshape(len(standard), -1, 10) @ scaled
    return np.asarray(by_body.reshape(len(standard), -1))


def _nearest(forms: Array, rotors: Array, wanted: Array) -> tuple[float, Array]:
    """A lower bound of the distance to any robot, and what is left at the nearest, (N,).

    Args:
        forms: Of the coordinates of every body's J, (N, 10 n).
        rotors: Of every rotor's inertia, (N, m).
        wanted: (N,).
    """
    both = np.hstack([forms, rotors])
    free = both.shape[1]
    size = float(np.linalg.norm(wanted)) or 1.0  # the solver needs numbers near one
    # unknowns: the distance, J of every body, the rotors
    matrices = np.eye(free, 1 + free, 1)
    rest = matrices[forms.shape[1] :]
    matrices = matrices[: forms.shape[1]]
    found = minimise(
        np.eye(1, 1 + free)[0],
        [
            Cone("norm", -block_diag(1.0, both), np.concatenate([[0.0], -wanted / size])),
            Cone("matrices", -matrices, np.zeros(len(matrices))),
            Cone("positive", -rest, np.zeros(len(rest))),
        ],
    )
    return max(0.0, size * found.bound), both @ (size * found.x[1:]) - wanted
