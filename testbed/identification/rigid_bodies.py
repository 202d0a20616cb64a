"""Whether any rigid bodies have the parameters that were found.

The standard parameters of a body are those of rigid matter if and only if its pseudo-inertia
matrix J = [[S, h], [h', m]] is positive semidefinite, S the second moments, h the first, m the
mass [WKS18]. Minimal parameters are linear in them: those of possible robots form a convex
cone. The distance of an estimate from it, in its own sigmas, is found by least squares over
J = L L'; that there is nothing nearer follows from the residual r, for which
r' K(J) >= 0 for every J >= 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

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

HEAVIER = 100.0
"""The proof holds for robots at most this many times as heavy as the nearest possible one."""

ROUNDS = 100
"""Most steps of least squares."""

FINISHED = 1e-7
"""Relative gain of a step below which there is nothing to be gained."""


@dataclass(frozen=True, eq=False)
class Possibility:
    """How far an estimate is from those of possible robots.

    Attributes:
        distance: At least this far, in sigmas, model errors counted.
        limit: Distance beyond which it is no noise.
        nearest: Minimal parameters of a possible robot near by, (N,).
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
    limit = float(np.sqrt(stats.chi2.isf(2 * stats.norm.sf(SIGMAS), len(scale))))
    cone = _Cone(white @ estimate.minimal.standard_matrix, white @ _rotors(estimate))
    rest, size = cone.residual_of_nearest(white @ base.values, limit)
    gap = (axes * np.sqrt(spread)) @ rest
    distance = max(0.0, cone.proven_distance(rest, HEAVIER * size))
    return Possibility(distance, limit, base.values + gap, np.abs(gap) / scale)


def _rotors(estimate: Estimate) -> Array:
    """What a unit of each rotor that is told with a body adds to the parameters, (N, rotors)."""
    regrouped = {} if estimate.drives is None else estimate.drives.regrouped
    columns = [column[: estimate.minimal.count] for column in regrouped.values()]
    return np.array(columns).reshape(len(columns), estimate.minimal.count).T


def _pseudo_inertia() -> Array:
    """Standard parameters of a pseudo-inertia matrix with lengths in LENGTH, (10, 4, 4)."""
    matrix = np.zeros((10, 4, 4))
    matrix[0, 3, 3] = 1.0
    for k in range(3):
        matrix[1 + k, k, 3] = matrix[1 + k, 3, k] = LENGTH / 2
    pairs = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))
    for k, (a, b) in enumerate(pairs):  # Ixx = Syy + Szz, Ixy = -Sxy
        own = np.zeros((3, 3))
        own[a, b] += 0.5
        own[b, a] += 0.5
        matrix[4 + k, :3, :3] = LENGTH**2 * ((a == b) * np.eye(3) - own)
    return matrix


class _Cone:
    """Parameters of possible robots: forms of every body's J and of every rotor."""

    def __init__(self, standard: Array, rotors: Array) -> None:
        """From their matrices on standard parameters, (N, 10 n), and rotors, (N, m)."""
        self.count, self.bodies = len(standard), standard.shape[1] // 10
        by_body = standard.reshape(self.count, self.bodies, 10)
        self.forms = np.einsum("pia,axy->pixy", by_body, _pseudo_inertia())
        self.rotors = rotors

    def residual_of_nearest(self, wanted: Array, enough: float) -> tuple[Array, float]:
        """What is left of the nearest possible parameters less `wanted`, (N,); and their size.

        Args:
            wanted: (N,).
            enough: Distance at which nothing nearer is looked for.
        """
        roots, spins = self._start(wanted)
        rest, damping = self._rest(roots, spins, wanted), 1e-3
        for _ in range(ROUNDS):
            if rest @ rest < enough**2:
                break
            slope = self._slope(roots, spins)
            normal = slope @ slope.T
            for _ in range(12):
                ridge = damping * np.trace(normal) / self.count * np.eye(self.count)
                step = -slope.T @ np.linalg.solve(normal + ridge, rest)
                tried = roots + step[: roots.size].reshape(roots.shape), spins + step[roots.size :]
                left = self._rest(*tried, wanted)
                if left @ left < rest @ rest:
                    break
                damping *= 8
            else:
                break
            gain = 1 - (left @ left) / (rest @ rest)
            (roots, spins), rest, damping = tried, left, damping / 5
            if gain < FINISHED:
                break
        return rest, float((roots**2).sum() + (spins**2).sum())

    def proven_distance(self, rest: Array, size: float) -> float:
        """Least distance from `wanted` of any robot up to that size: a lower bound.

        Args:
            rest: `residual_of_nearest`.
            size: Largest sum of all traces of J and of all rotors.
        """
        seen = np.einsum("p,pixy->ixy", rest, self.forms)
        least = np.concatenate([np.linalg.eigvalsh(seen)[:, 0], rest @ self.rotors])
        worst = float(least.min(initial=0.0))
        length = float(np.linalg.norm(rest))
        return (length**2 + size * worst) / length if length > 0 else 0.0

    def _start(self, wanted: Array) -> tuple[Array, Array]:
        """Roots L, (n, 4, 4), and square roots of rotors, (m,), near the unconstrained fit."""
        flat = self.forms.reshape(self.count, -1)
        fit = np.linalg.lstsq(np.hstack([flat, self.rotors]), wanted, rcond=1e-9)[0]
        inertia, spin = fit[: flat.shape[1]].reshape(-1, 4, 4), fit[flat.shape[1] :]
        spread, axes = np.linalg.eigh((inertia + inertia.transpose(0, 2, 1)) / 2)
        least = 1e-3 * np.abs(spread).max()
        return axes * np.sqrt(np.maximum(spread, least))[:, None], np.sqrt(np.maximum(spin, least))

    def _rest(self, roots: Array, spins: Array, wanted: Array) -> Array:
        inertia = roots @ roots.transpose(0, 2, 1)
        found = np.tensordot(self.forms, inertia, 3) + self.rotors @ spins**2
        return np.asarray(found - wanted)

    def _slope(self, roots: Array, spins: Array) -> Array:
        """Derivative of `_rest` by roots and spins, (N, 16 n + m)."""
        by_roots = 2 * np.einsum("pixy,iyz->pixz", self.forms, roots)
        return np.hstack([by_roots.reshape(self.count, -1), 2 * self.rotors * spins])
