"""What estimates say of standard parameters: rows of which noise has a sigma of one.

Minimal parameters are linear in the standard ones and in the joints' own terms. What was taken
to be zero for an estimate is a statement as well, as far as the measured forces identify it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import clarabel
import numpy as np
from scipy import sparse, special
from scipy.linalg import null_space

from testbed.bodies.prior import standard_of_coordinates
from testbed.core.base.arrays import Array
from testbed.core.dynamics.drive_set import drive_set
from testbed.core.estimation.estimate import METHODS, Estimate
from testbed.core.estimation.regression.normal_equations import (
    TINY,
    inverse_root,
    square_root,
    unit_diagonal,
)
from testbed.core.parameters.minimal_set import minimal_set, selection
from testbed.core.parameters.symbols import on_standard
from testbed.core.robot.friction import JointTerm
from testbed.core.robot.tree import Tree

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
    unit = 1 / np.sqrt(np.maximum(np.diagonal(covariance), TINY))
    limit = float(np.sqrt(special.chdtri(len(scale), 2 * special.ndtr(-sigmas))))
    forms, rotors = _of_bodies(estimate.minimal.standard_matrix), _rotors(estimate)
    root = square_root(covariance * np.outer(unit, unit))
    normal = _separating(unit[:, None] * forms, unit[:, None] * rotors, unit * base.values, root)
    distance = max(0.0, float(normal @ (unit * base.values)))
    gap = -distance * (covariance @ (unit * normal))
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
    return found


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
    return by_body.reshape(len(standard), -1)


def _separating(forms: Array, rotors: Array, wanted: Array, root: Array) -> Array:
    """The normal of the furthest plane between parameters and all robots, one sigma long, (N,).

    Args:
        forms: Of the coordinates of every body's J, (N, 10 n).
        rotors: Of every rotor's inertia, (N, m).
        wanted: The parameters, (N,).
        root: R, (N, N), their covariance R R'.
    """
    size = float(np.linalg.norm(np.linalg.solve(root, wanted))) or 1.0  # for the solver: near one
    count = len(wanted)
    rows = np.vstack([np.zeros(count), -root.T, forms.T, rotors.T])
    cones = [
        clarabel.SecondOrderConeT(1 + count),
        *[clarabel.PSDTriangleConeT(4)] * (forms.shape[1] // 10),
        *([clarabel.NonnegativeConeT(rotors.shape[1])] if rotors.size else []),
    ]
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_threads = False, 1
    program = clarabel.DefaultSolver(
        sparse.csc_matrix((count, count)),  # no quadratic part
        -wanted / size,
        sparse.csc_matrix(rows),
        np.eye(1, len(rows))[0],
        cones,
        settings,
    )
    return np.array(program.solve().x)


FINEST = 1e-7
"""Sigmas below this part of a parameter are rounding: they are taken to be that large."""


UNKNOWN = 10.0
"""Sigmas, in parts of themselves, of parameters that are not identifiable."""

ROUNDING = 1e-14
"""Part of the greatest eigenvalue of a covariance below zero that is no sign of a wrong one."""


@dataclass(frozen=True, eq=False)
class Likelihood:
    """What one estimate says of x: standard parameters body by body, then the joints' terms.

    Attributes:
        estimate: The estimate.
        rows: Its parameters as forms of x, (p, m).
        white: What makes errors of its parameters numbers of sigma one, (p, p).
        zero: Forms of x that were taken to be zero, (k, m).
        widened: By how much its sigmas were widened, because another estimate contradicts it.
    """

    estimate: Estimate
    rows: Array
    white: Array
    zero: Array
    widened: float = 1.0

    def left(self, x: Array) -> Array:
        """How far the estimate is from what x says, in independent sigmas, (p,)."""
        return self.white @ (self.rows @ x - self.estimate.values)


def precise(estimate: Estimate) -> bool:
    """Whether an estimate's covariance is one, and not of rounding.

    With hardly more rows than unknowns the noise that is left says nothing, and variances of some
    combinations come out as nothing or less.

    Args:
        estimate: Of either method.
    """
    variance = np.diagonal(estimate.covariance)
    if (variance < 0).any():
        return False
    size = np.linalg.eigvalsh(unit_diagonal(estimate.covariance)[0])
    return bool(size[0] >= -ROUNDING * size[-1])


def terms_of(estimates: Sequence[Estimate]) -> tuple[JointTerm, ...]:
    """Terms of the joints' torque that estimates know of.

    Args:
        estimates: Of one robot.
    """
    asked = (t for e in estimates if e.drives is not None for t in e.drives.asked)
    return tuple(dict.fromkeys(asked))


def evidence(tree: Tree, estimate: Estimate, terms: tuple[JointTerm, ...]) -> Likelihood:
    """What an estimate says.

    Args:
        tree: The robot; its inertias do not matter.
        estimate: Of either method.
        terms: Those that x holds.
    """
    own, zero = _on_barycentric(tree, estimate)
    drives = estimate.drives
    asked = () if drives is None else drives.asked
    place = [10 * tree.n + terms.index(term) for term in asked]

    def on_x(rows: Array) -> Array:
        found = np.zeros((len(rows), 10 * tree.n + len(terms)))
        found[:, : 10 * tree.n] = on_standard(tree, rows[:, : 10 * tree.n])
        found[:, place] = rows[:, 10 * tree.n :]
        return found

    size = sizes(estimate.values, estimate.units)
    unknown = [name in estimate.unidentifiable for name in estimate.names]
    finest = (np.where(unknown, UNKNOWN, FINEST) * size) ** 2
    white = inverse_root(estimate.covariance + np.diag(finest)).T
    return Likelihood(estimate, on_x(own), white, on_x(zero))


def agreeing(likelihoods: Sequence[Likelihood]) -> list[Likelihood]:
    """The same, sigmas of joint torques widened where the plate contradicts them.

    Torque constants and friction of other laws bias the bodies that torques identify, and their
    sigmas do not know it: the plate's estimate judges them.

    Args:
        likelihoods: By one method or by both.
    """
    by_method = {each.estimate.method: each for each in likelihoods}
    if len(by_method) < len(METHODS):
        return list(likelihoods)
    torques = by_method["internal"]
    factor = _contradiction(by_method["external"].estimate, torques.estimate)
    widened = replace(torques, white=torques.white / factor, widened=factor)
    return [widened if each is torques else each for each in likelihoods]


def _contradiction(plate: Estimate, torques: Estimate) -> float:
    """Rms difference of what both determine, in sigmas; at least one."""
    try:
        likelihoods = selection(torques.minimal, plate.minimal)
    except ValueError:  # other zeros, or a plate that measures changes only
        return 1.0
    own = torques.base
    apart = likelihoods @ plate.base.values - own.values
    spread = likelihoods @ plate.base.covariance @ likelihoods.T + own.covariance
    spread += np.diag((FINEST * sizes(own.values, own.units)) ** 2)
    rotors = () if torques.drives is None else torques.drives.regrouped.values()
    alone = np.array([not any(column[k] for column in rotors) for k in range(len(apart))])
    white = inverse_root(spread[np.ix_(alone, alone)]).T @ apart[alone]
    return max(1.0, float(np.sqrt(np.mean(white**2)))) if alone.any() else 1.0


def _on_barycentric(tree: Tree, estimate: Estimate) -> tuple[Array, Array]:
    """An estimate's parameters, and what it takes to be zero, on barycentric ones and terms.

    With known zeros, minimal parameters stand for fewer barycentric ones than forces identify. What
    forces identify without them is a multiple of those, and across that nothing.
    """
    minimal, drives = estimate.minimal, estimate.drives
    own = minimal.matrix if drives is None else drives.matrix
    if not minimal.known_zero.any():
        return own, np.zeros((0, own.shape[1]))
    whole = minimal_set(tree, minimal.model, minimal.gravity, tared=minimal.tared)
    likelihoods = whole.matrix
    if drives is not None:
        laws = tuple(dict.fromkeys(term.law for term in drives.asked))
        likelihoods = drive_set(tree, whole, laws).matrix
    size = np.linalg.norm(likelihoods, axis=1, keepdims=True)
    likelihoods = likelihoods / size
    kept = np.array(likelihoods)
    kept[:, : minimal.known_zero.size][:, minimal.known_zero.ravel()] = 0.0
    link = kept @ np.linalg.pinv(own)
    return np.linalg.pinv(link) @ likelihoods, null_space(link.T).T @ likelihoods
