"""Pseudo-inertia matrices J = [[S, h], [h', m]] of bodies, and their coordinates."""

from __future__ import annotations

import numpy as np

from testbed.core.base.arrays import Array, skew
from testbed.core.base.transform import Transform

UPPER = tuple((a, b) for b in range(4) for a in range(b + 1))
"""Entries of the upper triangle, column by column: the order of `coordinates`."""

ROWS, COLUMNS = (list(each) for each in zip(*UPPER[:6], strict=True))
"""Of an inertia tensor's entries, in the order of STANDARD."""


def _of_coordinates() -> Array:
    """The matrix of each coordinate alone, (10, 4, 4), all of norm one."""
    found = np.zeros((10, 4, 4))
    for k, (a, b) in enumerate(UPPER):
        found[k, a, b] = found[k, b, a] = 1.0 if a == b else np.sqrt(0.5)
    return found


OF_COORDINATES = _of_coordinates()


def matrices(standard: Array) -> Array:
    """J of bodies, (..., 4, 4).

    Args:
        standard: Their standard parameters, (..., 10) [kg, kg m, kg m^2].
    """
    found = np.empty((*standard.shape[:-1], 4, 4))
    found[..., ROWS, COLUMNS] = found[..., COLUMNS, ROWS] = standard[..., 4:]
    found[..., :3, :3] = _complement(found[..., :3, :3], 0.5)
    found[..., 3, :3] = found[..., :3, 3] = standard[..., 1:4]
    found[..., 3, 3] = standard[..., 0]
    return found


def parameters(pseudo: Array) -> Array:
    """Standard parameters of bodies, (..., 10) [kg, kg m, kg m^2].

    Args:
        pseudo: Their J, (..., 4, 4), symmetric.
    """
    tensor = _complement(pseudo[..., :3, :3], 1.0)
    parts = pseudo[..., 3, 3:], pseudo[..., 3, :3], tensor[..., ROWS, COLUMNS]
    return np.concatenate(parts, axis=-1)


def inertia_matrix(X_AB: Transform) -> Array:
    """Standard parameters about and along frame A from those about and along B, (..., 10, 10).

    Args:
        X_AB: Pose of frame B in A.
    """
    X = X_AB.matrix[..., None, :, :]
    return np.swapaxes(parameters(X @ OF_STANDARD @ np.swapaxes(X, -1, -2)), -1, -2)


def inertia_rate(twist: Array) -> Array:
    """Rate of standard parameters in the frame that a body moves in, (10, 10).

    Args:
        twist: Of the body, linear part first, (6,).
    """
    S = np.zeros((4, 4))
    S[:3, :3], S[:3, 3] = skew(twist[3:]), twist[:3]
    return parameters(S @ OF_STANDARD + OF_STANDARD @ S.T).T


def _complement(tensors: Array, share: float) -> Array:
    """Share of the trace times one, less the tensors, (..., 3, 3): second moments, and back."""
    trace = np.trace(tensors, axis1=-2, axis2=-1)
    return np.asarray(share * trace[..., None, None] * np.eye(3) - tensors)


OF_STANDARD = matrices(np.eye(10))
"""J of a unit of each standard parameter, (10, 4, 4)."""


def coordinates(matrices: Array) -> Array:
    """The ten coordinates of symmetric matrices, (..., 10): sums of squares are kept.

    Args:
        matrices: (..., 4, 4).
    """
    return np.asarray(np.einsum("...ab,kab->...k", matrices, OF_COORDINATES))


def of_coordinates(coordinates: Array) -> Array:
    """Symmetric matrices of their coordinates, (..., 4, 4).

    Args:
        coordinates: (..., 10).
    """
    return np.tensordot(coordinates, OF_COORDINATES, 1)


def standard_of_coordinates(roots: Array) -> Array:
    """By body, its standard parameters as forms of the coordinates of Y, J = U Y U', (..., 10, 10).

    Args:
        roots: U, (..., 4, 4): makes Y a matrix of numbers near one.
    """
    bodies = np.einsum("...ab,kbc,...dc->...kad", roots, OF_COORDINATES, roots)
    return np.swapaxes(parameters(bodies), -1, -2)
