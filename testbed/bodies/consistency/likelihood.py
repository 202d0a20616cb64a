"""What estimates say of standard parameters: rows of which noise has a sigma of one.

Minimal parameters are linear in the standard ones and in the joints' own terms. What was taken
to be zero for an estimate is a statement as well, as far as the measured forces identify it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import null_space

from testbed.core.base.arrays import Array
from testbed.core.dynamics.drive_set import drive_set
from testbed.core.estimation.diagnostics.rigid_bodies import SMALL
from testbed.core.estimation.estimate import METHODS, Estimate
from testbed.core.estimation.regression.normal_equations import (
    inverse_root,
    unit_diagonal,
)
from testbed.core.parameters.minimal_set import minimal_set, selection
from testbed.core.parameters.symbols import on_standard, parameter_scale
from testbed.core.robot.friction import JointTerm
from testbed.core.robot.tree import Tree

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


def evidence(
    tree: Tree, estimate: Estimate, terms: tuple[JointTerm, ...]
) -> Likelihood:
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

    size = parameter_scale(estimate.values, estimate.units, SMALL)
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
    spread += np.diag((FINEST * parameter_scale(own.values, own.units, SMALL)) ** 2)
    rotors = () if torques.drives is None else torques.drives.regrouped.values()
    alone = np.array(
        [not any(column[k] for column in rotors) for k in range(len(apart))]
    )
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
