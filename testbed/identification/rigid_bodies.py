"""Whether any rigid bodies have the parameters that were found.

The standard parameters of a body are those of rigid matter if and only if its pseudo-inertia
matrix J = [[S, h], [h', m]] is positive semidefinite, S the second moments, h the first, m the
mass [WKS18]. Minimal parameters are linear in them: those of possible robots form a convex
cone. The distance of an estimate from it, in its own sigmas, is a conic program; the bound
that its dual solution gives holds for every robot.
"""

from __future__ import annotations

from dataclasses import dataclass

import clarabel
import numpy as np
from scipy import sparse, special

from testbed.arrays import Array
from testbed.identification.estimate import Estimate

SIGMAS = 5.0
"""An estimate is called impossible beyond a distance that noise exceeds as rarely as this."""

MODEL_ERROR = 0.01
"""Part of each parameter, taken as an error besides sigma: models are never quite right."""

SMALL = 0.1
"""Parameters below this share of the largest of their unit are taken to be that large."""

LENGTH = 0.3
"""Unit of length in which a robot's masses and moments are of one order [m]."""

UPPER = tuple((a, b) for b in range(4) for a in range(b + 1))
"""Entries of the upper triangle, column by column: the order of a cone of the solver."""


@dataclass(frozen=True, eq=False)
class Possibility:
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


def possibility(estimate: Estimate) -> Possibility:
    """Whether an estimate's minimal parameters can be those of rigid bodies.

    Args:
        estimate: Of either method. Rotors that are told together with a body's inertia may
            have any inertia that is not negative.
    """
    base = estimate.base
    scale = np.abs(base.values)
    for unit in set(base.units):
        same = np.array([each == unit for each in base.units])
        scale[same] = np.maximum(scale[same], SMALL * scale[same].max())
    covariance = base.covariance + np.diag((MODEL_ERROR * scale) ** 2)
    spread, axes = np.linalg.eigh(covariance)
    spread = np.maximum(spread, max(np.finfo(float).eps * spread[-1], np.finfo(float).tiny))
    white = (axes / np.sqrt(spread)).T
    limit = float(np.sqrt(special.chdtri(len(scale), 2 * special.ndtr(-SIGMAS))))
    forms = white @ _of_pseudo_inertias(estimate.minimal.standard_matrix)
    distance, rest = _nearest(forms, white @ _rotors(estimate), white @ base.values)
    gap = (axes * np.sqrt(spread)) @ rest
    relative = np.abs(gap) / np.where(scale > 0, scale, 1.0)
    return Possibility(distance, limit, base.values + gap, relative)


def _rotors(estimate: Estimate) -> Array:
    """What a unit of each rotor that is told with a body adds to the parameters, (N, rotors)."""
    regrouped = {} if estimate.drives is None else estimate.drives.regrouped
    columns = [column[: estimate.minimal.count] for column in regrouped.values()]
    return np.array(columns).reshape(len(columns), estimate.minimal.count).T


def _of_pseudo_inertias(standard: Array) -> Array:
    """Forms of standard parameters as forms of J, (N, 10 n), scaled as in the solver's cones.

    Args:
        standard: (N, 10 n), of (m, h, Ixx, Ixy, Iyy, Ixz, Iyz, Izz) body by body.
    """
    of_matrix = np.zeros((10, 4, 4))
    of_matrix[0, 3, 3] = 1.0
    for k in range(3):
        of_matrix[1 + k, k, 3] = LENGTH
    for k, (a, b) in enumerate(((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))):
        of_matrix[4 + k, a, b] -= LENGTH**2  # Ixx = Syy + Szz, Ixy = -Sxy
        of_matrix[4 + k, :3, :3] += LENGTH**2 * (a == b) * np.eye(3)
    entries = np.array([of_matrix[:, a, b] / (1 if a == b else np.sqrt(2)) for a, b in UPPER])
    by_body = standard.reshape(len(standard), -1, 10) @ entries.T
    return np.asarray(by_body.reshape(len(standard), -1))


def _nearest(forms: Array, rotors: Array, wanted: Array) -> tuple[float, Array]:
    """A lower bound of the distance to any robot, and what is left at the nearest, (N,).

    Args:
        forms: Of the entries of every body's J, (N, 10 n).
        rotors: Of every rotor's inertia, (N, m).
        wanted: (N,).
    """
    count, entries, spins = len(wanted), forms.shape[1], rotors.shape[1]
    free = entries + spins
    size = float(np.linalg.norm(wanted)) or 1.0  # the solver likes numbers near one
    # unknowns: the distance, the entries of J, the rotors
    matrix = sparse.bmat(
        [
            [[[-1.0]], None],
            [None, -np.hstack([forms, rotors])],
            [None, -sparse.eye(free)],
        ],
        format="csc",
    )
    right = np.concatenate([[0.0], -wanted / size, np.zeros(free)])
    cones = [
        clarabel.SecondOrderConeT(count + 1),
        *[clarabel.PSDTriangleConeT(4)] * (entries // 10),
        *[clarabel.NonnegativeConeT(spins)] * bool(spins),
    ]
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_threads = False, 1
    costs = np.eye(1, 1 + free)[0]
    solver = clarabel.DefaultSolver(
        sparse.csc_matrix((1 + free, 1 + free)), costs, matrix, right, cones, settings
    )
    found = solver.solve()
    at = size * np.array(found.x)[1:]
    return max(0.0, size * float(found.obj_val_dual)), np.hstack([forms, rotors]) @ at - wanted
